"""The missing force and what is left, on a cart whose friction is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.rigs import CARTS, FRICTION, record
from vpptwin.diagnosis.diagnose import open_held_out
from vpptwin.diagnosis.flights import list_starts, window_length
from vpptwin.diagnosis.holdout import HeldOut
from vpptwin.diagnosis.leftover import explained_share
from vpptwin.diagnosis.wrench import WrenchPlot, plot_wrench
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.twin.spec import load_twin

TRUTH = {("slide.coulomb", "force"): FRICTION}


@pytest.fixture(scope="module")
def held_out(tmp_path_factory: pytest.TempPathFactory) -> HeldOut:
    """Every window of a cart with 1.1 N of dry friction, and a twin without any."""
    log, twin = record(CARTS, FRICTION, tmp_path_factory.mktemp("cart"), seed=5)
    spec = load_twin(twin)
    measurements = [read_measurements(spec, read_flight(log))]
    return open_held_out(spec, measurements, list_starts(measurements, window_length(spec)), None)


@pytest.fixture(scope="module")
def plot(held_out: HeldOut) -> WrenchPlot:
    """What the report shows of the true cause."""
    return plot_wrench(held_out, TRUTH, find_effect(held_out.short.spec.catalogue, "slide.coulomb"))


def test_axes_say_what_they_are(plot: WrenchPlot) -> None:
    """Force over velocity of the joint, with units."""
    assert plot.x_label == "slide velocity [m/s]"
    assert plot.y_label == "missing force on slide [N]"
    assert plot.quantity.shape == plot.before.shape == plot.after.shape


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_the_missing_force_is_the_friction(plot: WrenchPlot, direction: float) -> None:
    """Against every clear motion there acts about the friction that the twin lacks."""
    moving = direction * plot.quantity > 0.15
    assert moving.sum() > 10
    assert np.median(plot.before[moving]) == pytest.approx(-direction * FRICTION, rel=0.25)


def test_with_the_right_friction_little_force_is_missing(plot: WrenchPlot) -> None:
    """What is left is a small part of what was missing."""
    moving = np.abs(plot.quantity) > 0.15
    assert np.median(np.abs(plot.after[moving])) < 0.2 * np.median(np.abs(plot.before[moving]))


def test_truth_costs_less_and_predicts_better(held_out: HeldOut) -> None:
    """The true friction lowers the misfit, chi2 and the error of every horizon from 0.1 s; twice as much overshoots."""
    nothing, truth = held_out.score({}), held_out.score(TRUTH)
    double = held_out.score({("slide.coulomb", "force"): 2.0 * FRICTION})
    assert held_out.cost(TRUTH).sum() < 0.1 * held_out.cost({}).sum()
    assert truth.chi2 < 0.1 * min(nothing.chi2, double.chi2)
    assert nothing.position_rmse_m is not None
    assert truth.position_rmse_m is not None
    assert truth.angle_rmse_rad is None
    for before, after in zip(nothing.position_rmse_m[1:], truth.position_rmse_m[1:]):
        assert after < before


def test_explained_share_by_hand() -> None:
    """A residual that is a function of the quantity's group is explained wholly, one of another quantity not at all."""
    quantity = np.linspace(-1.0, 1.0, 600)
    rng = np.random.default_rng(0)
    assert explained_share(quantity, np.sign(quantity)) == pytest.approx(1.0)
    assert explained_share(quantity, np.abs(quantity) > 2.0 / 3.0) == pytest.approx(1.0)
    noise = rng.standard_normal(600)
    assert abs(explained_share(quantity, noise)) < 0.03
    # Signal of variance 1 in noise of variance 3 is a quarter; 600 samples know that to a few percent.
    assert explained_share(quantity, np.sign(quantity) + np.sqrt(3.0) * noise) == pytest.approx(0.25, abs=0.08)
    assert explained_share(quantity, np.zeros(600)) == 0.0
