"""The plots of reports: valid, labelled, self-contained SVG that shows what it is given."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from vpptwin.viz.plots.plots import (
    bin_quantiles,
    cover_bulk,
    error_by_horizon,
    prediction_overlay,
    residual_against,
    residual_over_time,
)

HORIZONS = [0.05, 0.1, 0.25, 0.5, 1.0]
ERRORS = [0.001, 0.003, 0.01, 0.04, 0.1]
HALVED = [0.5 * value for value in ERRORS]


def plot_residual() -> list[str]:
    """Dry friction of 0.3 N before, noise after."""
    rng = np.random.default_rng(1)
    velocity = rng.normal(0.0, 0.5, 3000)
    noise = 0.1 * rng.normal(size=3000)
    return residual_against(
        velocity, noise - 0.3 * np.sign(velocity), noise, "rail velocity [m/s]", "residual force along x [N]"
    )


TIME = np.linspace(0.0, 2.0, 201)
LOG = np.sin(TIME)
RESTARTS = [0.5, 1.0, 1.5]
PLOTS = {
    "error_by_horizon": (
        lambda: error_by_horizon(HORIZONS, ERRORS, HALVED, 0.0006, [(-0.6, -0.4)] * 5, "position rmse [m]"),
        ["horizon [s]", "position rmse [m]", "before", "after", "sensor noise"],
    ),
    "residual_before": (lambda: plot_residual()[0], ["rail velocity [m/s]", "residual force along x [N]", "before"]),
    "residual_after": (lambda: plot_residual()[1], ["rail velocity [m/s]", "residual force along x [N]", "after"]),
    "prediction_overlay": (
        lambda: prediction_overlay(TIME, LOG, LOG + 0.1, LOG + 0.01, "x [m]", RESTARTS),
        ["time [s]", "x [m]"],
    ),
    "residual_over_time": (
        lambda: residual_over_time(TIME, LOG, 0.1 * LOG, 0.01, "x residual [m]", RESTARTS),
        ["time [s]", "x residual [m]"],
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


def test_residuals_before_and_after_share_an_axis() -> None:
    """Both figures cover the same range, so that the eye compares lengths; outliers don't stretch it."""
    ticks = [re.findall(r">(−?0\.\d)</text>", svg) for svg in plot_residual()]
    assert [t for t in ticks[0] if t.startswith("−0")] == [t for t in ticks[1] if t.startswith("−0")]
    low, high = cover_bulk(np.concatenate([np.linspace(0.5, 1.0, 1000), [500.0]]))
    assert low < 0.0  # zero is in the picture
    assert 1.0 < high < 1.3


def test_plots_bear_scarce_data() -> None:
    """A handful of samples, no cause and no samples at all still give a figure."""
    few = np.array([0.1, 0.2, np.nan])
    assert len(residual_against(few, few, None, "x [m]", "y [N]")) == 1
    assert len(residual_against(np.empty(0), np.empty(0), np.empty(0), "x [m]", "y [N]")) == 2
    assert "<svg" in residual_over_time(few, few, None, 0.1, "y [N]")
    assert "after" not in re.findall(r">([^<]+)</text>", error_by_horizon(HORIZONS, ERRORS))
