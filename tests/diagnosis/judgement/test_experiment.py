"""The next experiment: rivals are told apart by the manoeuvre that the physics says, and by no other rig's."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from benchmarks.next_experiment import Explanation, blame, fly_and_fit
from vpptwin.cli.main import build_parser
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.separation import refit_misfit, separate
from vpptwin.diagnosis.search.suspects import list_unknowns
from vpptwin.robots.planar_drone.experiment import (
    FlownManoeuvre,
    explain_absence,
    fly_library,
    observe_candidates,
    propose_experiment,
)
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import find_manoeuvre
from vpptwin.twin import load_twin

SPEC = load_twin()
UNKNOWNS = list_unknowns(SPEC)


DELAY, LAG = blame("command.delay", delay=0.008), blame("servo.lag", time_constant=0.028)
BIAS, VISCOUS = blame("rail_x.bias", force=0.3), blame("rail_x.viscous", damping=0.3)
MASS, GAIN = blame("airframe.mass", mass=0.05), blame("rotor.thrust_gain", gain=0.91)
TILT = blame("rail.tilt", angle=-0.053)
GROUND = blame("air.ground_effect", gain=0.2, height=0.3)
FEW = ("hover", "x_steps", "aggressive_x", "low_pass", "flip")


@pytest.fixture(scope="module")
def few() -> tuple[list[FlownManoeuvre], Bench]:
    """Five manoeuvres of the library, flown in the nominal twin."""
    candidates = [c for c in fly_library(SPEC, [Explanation(frozenset(), {})]) if c.manoeuvre.name in FEW]
    return candidates, observe_candidates(SPEC, candidates)


def rank(few: tuple[list[FlownManoeuvre], Bench], *hypotheses: Explanation) -> dict[str, np.ndarray]:
    """Separation of every rival by each of the five."""
    candidates, bench = few
    sigma = separate(bench, hypotheses, UNKNOWNS)
    assert np.isfinite(sigma).all()
    assert (sigma >= 0.0).all()
    return {c.manoeuvre.name: sigma[:, i] for i, c in enumerate(candidates)}


@pytest.mark.slow
def test_delay_and_lag_are_told_apart_by_fast_turns(few: tuple[list[FlownManoeuvre], Bench]) -> None:
    """Steps and turns move the servos fast; hovering does not tell."""
    sigma = rank(few, DELAY, LAG)
    assert max(sigma["flip"], sigma["x_steps"]) > 10.0
    assert sigma["hover"] < 0.2 * sigma["x_steps"]


def test_rivals_are_told_apart_by_what_the_physics_says(few: tuple[list[FlownManoeuvre], Bench]) -> None:
    """By hand: along z only the ratio of thrust and lifted mass counts, along x the carriage adds to the mass."""
    sigma = rank(few, MASS, GAIN)
    assert sigma["x_steps"] > 3.0
    assert sigma["hover"] < 1.5
    # Only the low pass comes near the floor.
    sigma = rank(few, GROUND, GAIN)
    assert sigma["low_pass"] > 3.0
    assert all(sigma["low_pass"] > 2.0 * sigma[name] for name in FEW if name != "low_pass")
    # Nothing that is flown tells them apart, and several rivals are weighed one by one.
    sigma = rank(few, BIAS, TILT, VISCOUS)
    assert all(tilt < 0.5 and viscous > 3.0 for tilt, viscous in sigma.values())


def test_more_windows_tell_more(few: tuple[list[FlownManoeuvre], Bench]) -> None:
    """Four times as many windows separate by up to twice as much: tolerances do not grow with the flight."""
    _, bench = few
    flights = bench.windows.flight
    number = np.bincount(flights)
    once, again = (separate(bench, [MASS, GAIN], UNKNOWNS, times * number) for times in (1.0, 4.0))
    assert (again >= once - 1e-9).all()
    assert (again <= 2.0 * once + 1e-9).all()


@pytest.mark.slow
def test_a_flight_keeps_what_was_predicted(few: tuple[list[FlownManoeuvre], Bench]) -> None:
    """Flown for 20 s with noise and gusts and fitted by the search, steps separate about as much as was predicted."""
    candidates, bench = few
    windows = np.full(len(candidates), 20.0 / 0.3)
    place = [c.manoeuvre.name for c in candidates].index("x_steps")
    predicted = separate(bench, [DELAY, LAG], UNKNOWNS, windows)[0, place]
    (flown,) = fly_and_fit(SPEC, find_manoeuvre(LIBRARY, "x_steps"), (DELAY, LAG))
    assert 0.4 < flown / predicted < 2.5


def test_a_misfit_that_parameters_explain_is_gone() -> None:
    """By hand: misfit along a column of norm 3, prior of width 2: 1/(1 + 36) of the square is left, across it all."""
    along, across = np.array([3.0, 0.0]), np.array([0.0, 2.0])
    columns, width = along[None], np.array([2.0])
    assert refit_misfit(along, columns, width, 1.0) == pytest.approx(9.0 / 37.0)
    assert refit_misfit(across, columns, width, 1.0) == pytest.approx(4.0)
    assert refit_misfit(across, columns, width, 5.0) == pytest.approx(20.0)


def test_the_best_manoeuvre_is_proposed_with_its_command() -> None:
    """Bias against viscous friction and a tilted rail: a fast manoeuvre; the tilt, which none tells, is left out."""
    experiment = propose_experiment(SPEC, [BIAS, VISCOUS, TILT], UNKNOWNS)
    assert experiment is not None
    manoeuvre = find_manoeuvre(LIBRARY, experiment.manoeuvre)
    assert experiment.parameters == manoeuvre.choose({})
    assert experiment.separates == ["rail_x.bias", "rail_x.viscous"]
    assert experiment.manoeuvre != "hover"
    assert 3.0 < experiment.sigma < 1000.0
    command = shlex.split(experiment.command)
    assert command[0] == "vpptwin"
    options = build_parser().parse_args(command[1:])
    assert (options.manoeuvre, options.twin, options.out) == (
        experiment.manoeuvre, "nominal", Path(f"{experiment.manoeuvre}.mcap"),
    )  # fmt: skip


@pytest.mark.slow
def test_manoeuvres_that_a_rival_makes_dangerous_are_not_proposed() -> None:
    """A craft with half its thrust and a third more mass falls (by hand: 12.8 N to hover, of 10): none is safe then."""
    values = {("rotor.thrust_gain", "gain"): 0.5, ("airframe.mass", "mass"): 0.15}
    falling = Explanation(frozenset(effect for effect, _ in values), values)
    assert fly_library(SPEC, [DELAY, falling]) == []


def test_no_experiment_is_explained() -> None:
    """Another rig has no library; a lone hypothesis has no rival."""
    other = SPEC.with_robot(rotorcraft=None)
    assert "the drone" in explain_absence(other, [BIAS, TILT])
    assert propose_experiment(other, [BIAS, TILT], UNKNOWNS) is None
    assert "nothing to tell apart" in explain_absence(SPEC, [BIAS])
    assert propose_experiment(SPEC, [BIAS], UNKNOWNS) is None
    assert explain_absence(SPEC, [BIAS, TILT]) == ""
