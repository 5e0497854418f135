"""The twin against the independent simulation of proving/drone, for every effect on the motion that both have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from _pytest.mark import ParameterSet

from proving.drone.rig import ON_THE_RIG
from tests.twin.independent import DYNAMIC, SENSORS, Comparison, compare
from vpptwin.twin import TwinSpec, load_twin

MODELS = ("vpp_planar", "rail_rig")
# Flights drawn of each case, s of flight, and how many of them must be left without those that run into something.
WHOLE = {"none": 600, "all": 220}, 1.0, 100
SINGLE = dict.fromkeys(DYNAMIC, 24), 0.5, 12
CASES = [
    (model, case)
    for model in MODELS
    for case in ("none", "all", *DYNAMIC)
    if not (model == "vpp_planar" and case in ON_THE_RIG)
]
# The twin limits the rate of the mean of two commands where one arrives amid a step: the blade starts early.
Fly = Callable[[str, str], Comparison]
FlyWrong = Callable[[str], np.ndarray]


@pytest.fixture(scope="module")
def specs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, TwinSpec]:
    """The free craft and the rig, both with the nominal vehicle."""
    folder = tmp_path_factory.mktemp("specs")
    for model in MODELS:
        (folder / f"{model}.yaml").write_text(f"model: {model}.xml\nvehicle: vehicle.yaml\n")
    return {model: load_twin(folder / f"{model}.yaml") for model in MODELS}


@pytest.fixture(scope="module")
def fly(specs: dict[str, TwinSpec]) -> Fly:
    """The comparison that a case of a model belongs to; flown once."""

    @cache
    def fly_all(model: str, whole: bool) -> Comparison:
        cases, seconds, _ = WHOLE if whole else SINGLE
        possible = {c: n for c, n in cases.items() if model == "rail_rig" or c not in ON_THE_RIG}
        return compare(specs[model], possible, model == "vpp_planar", seconds)

    return lambda model, case: fly_all(model, case in WHOLE[0])


@pytest.fixture(scope="module")
def fly_wrong(fly: Fly) -> FlyWrong:
    """States of the flights with a single effect each, flown with its parameters 5 % off."""

    @cache
    def fly_all(model: str) -> np.ndarray:
        comparison = fly(model, "rail_x.coulomb")
        return comparison.flights.make_wrong(0.05).fly(comparison.free).states

    return fly_all


def test_every_effect_on_the_motion_is_compared(specs: dict[str, TwinSpec]) -> None:
    """The twin's effects are those of the independent simulation; what carriage or slider have, a free craft lacks.

    Those that evolve have an integrator of their own in test_flex, those of contacts tests in test_touching.
    """
    for model, missing in (("rail_rig", ()), ("vpp_planar", ON_THE_RIG)):
        effects = [e for e in specs[model].catalogue if not e.id.startswith(SENSORS)]
        ours = {e.id for e in effects if not e.states and not e.touching}
        assert ours == set(DYNAMIC) - set(missing)


def mark(cases: Sequence[tuple[str, str]]) -> list[ParameterSet]:
    """Parameters of a test; of the free craft, which lacks the rig alone, single effects are `slow`."""
    slow = [model == MODELS[0] and case in DYNAMIC for model, case in cases]
    return [pytest.param(*case, marks=[pytest.mark.slow] * late) for case, late in zip(cases, slow, strict=True)]


@pytest.mark.parametrize(("model", "case"), mark(CASES))
def test_twin_agrees_with_an_independent_integrator(fly: Fly, model: str, case: str) -> None:
    """From random states under random blade pitch and throttle both fly alike, but for what their steps explain."""
    comparison, count = fly(model, case), (WHOLE if case in WHOLE[0] else SINGLE)[2]
    which = comparison.select(case)
    assert len(which) >= count
    assert comparison.find_share(which).max() <= 1.0


@pytest.mark.parametrize(("model", "case"), mark([pair for pair in CASES if pair[1] in DYNAMIC]))
def test_effect_that_is_five_percent_off_would_show(fly: Fly, fly_wrong: FlyWrong, model: str, case: str) -> None:
    """The bound is tight: with an effect's parameters 5 % off, those flights that feel it leave the bound."""
    comparison = fly(model, case)
    which = comparison.select(case)
    share = comparison.find_share(which, fly_wrong(model)[..., which])
    assert (share > 1.0).mean() >= 0.25  # many a flight hardly comes near a tight spot, the ground or breakaway


@pytest.mark.parametrize(("model", "case"), [pair for pair in CASES if pair[1] not in DYNAMIC])
@pytest.mark.parametrize("mistake", ["thrust", "delay"])
def test_small_mistake_would_show(fly: Fly, model: str, case: str, mistake: str) -> None:
    """So it is where the whole is compared: 1 % of thrust, or 0.5 ms of delay, and nearly every flight leaves it."""
    comparison = fly(model, case)
    which = comparison.select(case, 40)
    effect, name = {"thrust": ("rotor.thrust_gain", "gain"), "delay": ("command.delay", "delay")}[mistake]
    wrong = []
    for effects in comparison.flights.take(which).hidden:
        size = effects.get(effect, {}).get(name, DYNAMIC[effect][name].off)
        wrong.append(effects | {effect: {name: 1.01 * size if mistake == "thrust" else size + 0.0005}})
    flights = replace(comparison.flights.take(which), hidden=tuple(wrong))
    share = comparison.find_share(which, flights.fly(comparison.free).states)
    assert (share > 1.0).mean() > 0.9
