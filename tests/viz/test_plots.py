"""The plots of reports: valid, labelled, self-contained SVG that shows what it is given."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from vpptwin.viz.plots import (
    bin_quantiles,
    error_by_horizon,
    parameter_intervals,
    prediction_overlay,
    residual_against,
    suspects_ranking,
)

HORIZONS = [0.05, 0.1, 0.25, 0.5, 1.0]
ERRORS = {"position_rmse_m": [0.001, 0.003, 0.01, 0.04, 0.1], "angle_rmse_rad": [0.003, 0.004, 0.01, 0.02, 0.05]}
HALVED = {key: [0.5 * value for value in values] for key, values in ERRORS.items()}


def plot_residual() -> str:
    """Dry friction of 0.3 N before, noise after."""
    rng = np.random.default_rng(1)
    velocity = rng.normal(0.0, 0.5, 3000)
    noise = 0.1 * rng.normal(size=3000)
    return residual_against(
        velocity, noise - 0.3 * np.sign(velocity), noise, "rail velocity [m/s]", "residual force along x [N]"
    )


def plot_overlay() -> str:
    """Three channels over 2 s, restarted every 0.5 s."""
    time = np.linspace(0.0, 2.0, 201)
    log = np.stack([np.sin(time), np.cos(time), time], -1)
    return prediction_overlay(time, log, log + 0.1, log + 0.01, ["x [m]", "z [m]", "θ [rad]"], [0.5, 1.0, 1.5])


PLOTS = {
    "error_by_horizon": (
        lambda: error_by_horizon(HORIZONS, ERRORS, HALVED, {"position_rmse_m": 0.0006, "angle_rmse_rad": 0.003}),
        ["horizon [s]", "position rmse [m]", "angle rmse [rad]", "before", "after", "sensor noise"],
    ),
    "residual_against": (plot_residual, ["rail velocity [m/s]", "residual force along x [N]", "before", "after"]),
    "suspects_ranking": (
        lambda: suspects_ranking(["air.drag", "rail_x.coulomb"], [0.1, 0.62], "rail_x.coulomb"),
        ["air.drag", "rail_x.coulomb", "0.62", "drop in misfit (twice the log-likelihood)"],
    ),
    "prediction_overlay": (plot_overlay, ["time [s]", "x [m]", "z [m]", "θ [rad]", "log", "twin before"]),
    "parameter_intervals": (
        lambda: parameter_intervals(["force", "k_d"], [0.31, 0.02], [0.01, 0.005], [0.0, 0.0], ["N", "N s²/m²"]),
        ["force [N]", "k_d [N s²/m²]", "nominal"],
    ),
}


@pytest.mark.parametrize("name", PLOTS)
def test_plot_is_labelled_self_contained_svg(name: str) -> None:
    """Parses as XML, carries its labels as text, refers to nothing outside, follows the page's text colour."""
    draw, labels = PLOTS[name]
    svg = draw()
    root = ElementTree.fromstring(svg)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    words = [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert set(labels) <= set(words)
    assert "currentColor" in svg
    assert "#fe01fe" not in svg
    assert "<?xml" not in svg
    assert len(svg) < 200_000
    # Name spaces are all the addresses there are.
    assert set(re.findall(r"https?://[^\"' <]+", svg)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    ids = re.findall(r'\bid="([^"]+)"', svg)
    referred = re.findall(r'(?:url\(#|href="#)([^")]+)', svg)
    assert set(referred) <= set(ids)


def test_plots_of_one_report_do_not_share_ids() -> None:
    """A browser resolves url(#...) to the first element of that id on the page, so ids must differ between figures."""
    ids = [set(re.findall(r'\bid="([^"]+)"', draw())) for draw, _ in PLOTS.values()]
    assert sum(map(len, ids)) == len(set().union(*ids))


def test_same_data_gives_the_same_bytes() -> None:
    """A report can be compared with its predecessor."""
    assert plot_residual() == plot_residual()


def test_running_median_finds_a_step() -> None:
    """Dry friction of 0.3 N shows as medians of +0.3 and -0.3 N on the two sides of zero velocity."""
    rng = np.random.default_rng(2)
    velocity = rng.uniform(-1.0, 1.0, 8000)
    centre, low, median, high = bin_quantiles(velocity, -0.3 * np.sign(velocity) + 0.05 * rng.normal(size=8000))
    # 500 samples a bin: the median's standard error is 1.25 * 0.05 / sqrt(500) = 0.003.
    np.testing.assert_allclose(median, -0.3 * np.sign(centre), atol=0.015)
    # 10 % and 90 % of a normal distribution are 1.28 sigma away.
    np.testing.assert_allclose(high - low, 2.0 * 1.2816 * 0.05, rtol=0.25)


def test_plots_bear_scarce_data() -> None:
    """A handful of samples, no cause and no samples at all still give a figure."""
    few = np.array([0.1, 0.2, np.nan])
    assert "<svg" in residual_against(few, few, None, "x [m]", "y [N]")
    assert "<svg" in residual_against(np.empty(0), np.empty(0), np.empty(0), "x [m]", "y [N]")
    assert "<svg" in suspects_ranking([], [], [])
    assert "after" not in re.findall(r">([^<]+)</text>", error_by_horizon(HORIZONS, ERRORS))


def test_other_rigs_have_a_panel_for_what_they_measure() -> None:
    """Without positions there is only the angle's panel."""
    svg = error_by_horizon(HORIZONS, {"angle_rmse_rad": ERRORS["angle_rmse_rad"]})
    assert "angle rmse [rad]" in svg
    assert "position rmse [m]" not in svg
