"""What flights could have shown: on a cart that moves all is cleared, on one that stands nothing can be seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.carts import load_cart, measure_cart, open_search, show
from tests.diagnosis.rigs import drive_cart
from vpptwin.diagnosis.judgement.power import judge_power, weigh_strength
from vpptwin.diagnosis.judgement.verdict import Cleared, Unseen
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects.friction import asymmetry
from vpptwin.effects.joint import JointScale


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Search:
    """A cart that is as its twin says."""
    return open_search(load_cart(tmp_path_factory.mktemp("cart")), measure_cart(drive_cart(0.0, 3), 7))


@pytest.fixture(scope="module")
def verdict(moving: Search) -> tuple[list[Cleared], list[Unseen]]:
    """What it could have shown."""
    return judge_power(moving, show(moving), frozenset())


def test_what_a_good_flight_clears(moving: Search, verdict: tuple[list[Cleared], list[Unseen]]) -> None:
    """Each suspect once, in one of both lists, the accused in neither; off values lie inside what is cleared."""
    cleared, unseen = verdict
    effects = {u.effect.id for u in moving.unknowns}
    assert sorted([s.effect for s in cleared] + [s.effect for s in unseen]) == sorted(effects)
    cleared, unseen = judge_power(moving, show(moving), frozenset({"slide.coulomb"}))
    assert {s.effect for s in cleared} | {s.effect for s in unseen} == effects - {"slide.coulomb"}
    # What a cart without any effect shows: off values inside, to 90 % each; all narrower than a typical size.
    cleared, _ = verdict
    parameters = {u.key: u.parameter for u in moving.unknowns}
    limits = {u.effect.id for u in moving.unknowns if u.is_limit}
    intervals = [s for s in cleared if s.effect not in limits]
    inside = [s.low <= parameters[s.effect, s.parameter].off <= s.high for s in intervals]
    assert len(intervals) >= 8
    assert sum(inside) >= len(intervals) - 2
    for suspect in intervals:
        parameter = parameters[suspect.effect, suspect.parameter]
        assert suspect.high - suspect.low < parameter.size
        assert suspect.unit == parameter.unit
        assert parameter.low <= suspect.low <= suspect.high <= parameter.high
    # A motor that gave nearly the largest command saturates nowhere below that: a limit that cuts off 1/128 shows.
    (limit,) = [s for s in verdict[0] if s.effect == "motor.saturation"]
    commands = np.abs(moving.bench.windows.command)
    assert 0.97 * np.percentile(commands, 98.0) < limit.low < commands.max()
    assert limit.high == next(u.parameter.high for u in moving.unknowns if u.effect.id == "motor.saturation")


def test_where_nothing_moves_nothing_of_motion_is_seen(tmp_path: Path) -> None:
    """A cart at rest with its motor off: neither friction nor damping, inertia, gain, delay or limits can be seen.

    A constant force would have set it in motion, and a biased rate would show it moving.
    """
    still = np.zeros_like(drive_cart(0.0, 3)[0])
    search = open_search(load_cart(tmp_path), measure_cart((still, still, still), 7))
    cleared, unseen = judge_power(search, show(search), frozenset())
    names = {s.effect for s in unseen}
    assert names >= {
        "slide.viscous", "slide.inertia", "motor.gain", "motor.delay", "motor.lag", "motor.backlash",
        "motor.rate_limit", "motor.saturation",
    }  # fmt: skip
    for suspect in cleared:
        assert suspect.effect in ("slide.bias", "slide.spring", "slide.rate_bias")
        assert suspect.low <= 0.0 <= suspect.high
    reasons = {s.effect: s.reason for s in unseen}
    assert reasons["motor.saturation"] == "no motion in these logs comes near a limit"
    assert reasons["motor.gain"].startswith("gain of 0.05 would show by only 0.")


def test_what_excludes_the_twin_is_not_cleared(tmp_path: Path) -> None:
    """A cart whose slight friction nobody named: every cleared interval holds what the twin has, to its tolerance.

    Friction of 0.15 N: beyond doubt there, and no more than that is said.
    """
    search = open_search(load_cart(tmp_path), measure_cart(drive_cart(0.15, 3), 7))
    cleared, unseen = judge_power(search, show(search), frozenset())
    unknowns = {u.key: u for u in search.unknowns}
    for suspect in cleared:
        unknown = unknowns[suspect.effect, suspect.parameter]
        tolerance = unknown.parameter.tolerance
        assert unknown.is_limit or suspect.low - tolerance <= unknown.nominal <= suspect.high + tolerance
    reasons = {s.effect: s.reason for s in unseen}
    told = reasons.get("slide.coulomb", "")
    assert told == "force of 0.075 N would show by only 4.0 sigma"


def test_what_only_changes_another_effect_needs_it(moving: Search) -> None:
    """Friction that depends on the direction is not there to be seen where there is no friction."""
    effect = asymmetry(JointScale("a", "on a"))
    found = weigh_strength(moving, show(moving), Unknown(effect, effect.parameters[0], 0.0))
    assert found == Unseen("a.asymmetry", "it only changes a.coulomb, which the twin lacks")
