"""The missing force on a cart whose friction is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.rigs import CARTS, FRICTION, record
from vpptwin.diagnosis.evidence.flights import list_starts
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.material import open_held_out
from vpptwin.diagnosis.judgement.wrench import WrenchPlot, plot_wrench
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
    return open_held_out(spec, measurements, list_starts(measurements, spec.robot.window), None)


@pytest.fixture(scope="module")
def plot(held_out: HeldOut) -> WrenchPlot:
    """What the report shows of the true cause."""
    return plot_wrench(held_out, TRUTH, find_effect(held_out.short.spec.catalogue, "slide.coulomb"))


def test_the_right_friction_leaves_little(plot: WrenchPlot) -> None:
    """Force over velocity of the joint, with units; what is left is a small part of what was missing."""
    assert plot.x_label == "slide velocity [m/s]"
    assert plot.y_label == "missing force on slide [N]"
    assert plot.quantity.shape == plot.before.shape == plot.after.shape
    moving = np.abs(plot.quantity) > 0.15
    assert np.median(np.abs(plot.after[moving])) < 0.2 * np.median(np.abs(plot.before[moving]))


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_the_missing_force_is_the_friction(plot: WrenchPlot, direction: float) -> None:
    """Against every clear motion there acts about the friction that the twin lacks."""
    moving = direction * plot.quantity > 0.15
    assert moving.sum() > 10
    assert np.median(plot.before[moving]) == pytest.approx(-direction * FRICTION, rel=0.25)


@pytest.mark.parametrize(
    ("effect", "label"),
    [("slide.inertia", "command of motor"), ("motor.gain", "command of motor")],
    ids=["joint", "actuator"],
)
def test_every_cause_has_something_to_plot_against(held_out: HeldOut, effect: str, label: str) -> None:
    """An effect on a joint that follows the command is shown against that of the joint's own actuator."""
    assert plot_wrench(held_out, {}, find_effect(held_out.short.spec.catalogue, effect)).x_label == label
