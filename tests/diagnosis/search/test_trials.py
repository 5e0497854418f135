"""Ranges and steps of suspects, and where along them an effect is tried that no derivative shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders import SLIDERS, lay_bench, load_known, load_rig
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.suspects import (
    CUT,
    LIMIT_STEP,
    MANY,
    Unknown,
    cut_off,
    grid_of_shape,
    list_force_limits,
    list_limits,
    list_trials,
    list_unknowns,
)
from vpptwin.effects import Effect, Parameter, Prior
from vpptwin.effects.actuator import FORCE_LIMIT, attach
from vpptwin.effects.joint import JointScale, bias, spring, viscous
from vpptwin.estimation.windows import WindowMotion
from vpptwin.robots.planar_drone.effects.catalogue import RATE_LIMIT
from vpptwin.twin.spec import load_twin

RATE = Unknown(RATE_LIMIT, RATE_LIMIT.parameters[0], 1000.0)
"""Off at 1000 rad/s; real servos have 4 to 20."""
LEVEL = Parameter(name="level", unit="rad", off=10.0, low=0.05, high=10.0, prior=Prior("uniform", 0.1, 0.3), size=9.0)
CLIP = Unknown(replace(RATE_LIMIT, id="servo.clip", parameters=(LEVEL,), follows="command"), LEVEL, 10.0)
PLACE = JointScale("rail", "on a rail")


def command(values: np.ndarray, known: bool = True) -> Bench:
    """Commands of a cart, (K, steps, 1), and whether it is known, as the drone is, how logs without an effect look."""
    return lay_bench(np.zeros(len(values)), spec=load_known() if known else load_rig(), command=values)


UNIFORM = command(np.linspace(-1.0, 1.0, 100001).reshape(1, -1, 1))
FOREIGN = command(UNIFORM.windows.command, False)
"""The same on a rig that nobody knows."""


def shaped(size: float, low: float = -9.0) -> tuple[Effect, tuple[Unknown, ...]]:
    """A spring whose rest has that typical size, bounds from `low` to 9 and a prior of 0 ± 1, and its unknowns."""
    effect = spring(PLACE)
    rest = replace(effect.parameters[1], size=size, low=low, high=9.0, prior=Prior("normal", 0.0, 1.0))
    effect = replace(effect, parameters=(effect.parameters[0], rest))
    return effect, tuple(Unknown(effect, p, p.off) for p in effect.parameters)


def test_limits_are_told_from_other_parameters() -> None:
    """A rate that nothing reaches yet is a limit; one that the twin already has is not, nor is a force."""
    assert RATE.is_limit
    assert CLIP.is_limit
    assert not Unknown(RATE_LIMIT, RATE.parameter, 10.0).is_limit
    assert not Unknown(bias(PLACE), bias(PLACE).parameters[0], 0.0).is_limit
    limits = {u.effect.id for u in list_unknowns(load_twin()) if u.is_limit}
    assert "servo.rate_limit" in limits
    assert not limits & {"rail_x.coulomb", "command.delay", "servo.lag", "airframe.mass"}


def test_ranges_by_hand() -> None:
    """A limit expected from 4 to 20: any up to 20. A normal prior's 3 widths, 3 typical sizes or all there is."""
    assert RATE.width == RATE.typical == 20.0
    parameter = Parameter(name="p", unit="", off=0.0, low=-4.0, high=4.0, prior=Prior("normal", 0.0, 1.0), size=0.1)
    effect = bias(PLACE)
    for changed, width in (
        (parameter, 3.0),
        (replace(parameter, size=1.5), 4.5),
        (replace(parameter, prior=Prior("normal", 0.0, 9.0)), 8.0),
        (replace(parameter, prior=Prior("uniform", -1.0, 1.0)), 2.0),
    ):
        assert Unknown(effect, changed, 0.0).width == pytest.approx(width)


def test_secants_never_leave_the_bounds() -> None:
    """As long as the parameter's size wherever there is room for it, else turned around or up to a bound."""
    for unknown in list_unknowns(load_twin()):
        p = unknown.parameter
        for value in (p.low, unknown.nominal, 0.3 * p.low + 0.7 * p.high, p.high):
            step = unknown.step_from(value)
            assert step != 0.0
            assert p.low <= value + step <= p.high * (1.0 + 1e-12), unknown.key
            if not unknown.is_limit and p.high - p.low >= 2.0 * p.size:
                assert abs(step) == p.size


def test_secants_by_hand() -> None:
    """Of limits shares of them: downwards, where a limit acts more; upwards at the lower bound."""
    assert RATE.step_from(10.0) == pytest.approx(-10.0 * LIMIT_STEP)
    assert RATE.step_from(0.5) == pytest.approx(0.5 * LIMIT_STEP)
    # Between 0 and 1 with a size of 3: from 0.2 up to 1, from 0.8 down to 0.
    parameter = Parameter(name="p", unit="", off=0.0, low=0.0, high=1.0, prior=Prior("normal", 0.0, 0.1), size=3.0)
    unknown = Unknown(bias(PLACE), parameter, 0.0)
    assert unknown.step_from(0.2) == pytest.approx(0.8)
    assert unknown.step_from(0.8) == pytest.approx(-0.8)


def test_limits_are_tried_where_the_commands_run_into_them() -> None:
    """What |u| uniform on 0 to 1 has above L is (1 - L)^1.5 of its root mean square: from 1/128 of it to 0.88."""
    found = list_limits(CLIP, UNIFORM)
    np.testing.assert_allclose(found, 1.0 - np.array(CUT[:9]) ** (2.0 / 3.0), rtol=1e-3)
    # 96 % of a uniform command of ±1 span 1.92; crossed in 15, 30, 60, 120, 250 and 500 ms.
    found = list_limits(RATE, UNIFORM)
    np.testing.assert_allclose(found, 1.92 / np.array([0.015, 0.03, 0.06, 0.12, 0.25, 0.5]), rtol=1e-4)
    # Commands ten times as small: rates under 0.5 rad/s and angles under 0.05 rad drop out; still ones try nothing.
    small = command(0.1 * UNIFORM.windows.command)
    np.testing.assert_allclose(list_limits(RATE, small), 0.192 / np.array([0.015, 0.03, 0.06, 0.12, 0.25]), rtol=1e-4)
    np.testing.assert_allclose(list_limits(CLIP, small), 0.1 - 0.1 * np.array(CUT[:6]) ** (2.0 / 3.0), rtol=1e-3)
    assert list_limits(RATE, command(np.zeros((2, 5, 1)))) == []


def test_on_a_rig_that_nobody_knows_limits_cut_off_shares_of_their_own_input() -> None:
    """One input of two says nothing of the other; rates are tried down to their bound, 0.5, which takes 4 s too long.

    Nor does how often one is run into: of peaks of 4 for a thousandth of the time, beside a rest of 0.58, a limit of 2
    cuts off 0.063, a ninth of all, and the four smallest shares less.
    """
    both = np.concatenate([1e3 * UNIFORM.windows.command, UNIFORM.windows.command], axis=2)
    bench = lay_bench([0.0], spec=load_rig(SLIDERS), command=both)
    clip, rate = (replace(limit, effect=replace(limit.effect, target="second")) for limit in (CLIP, RATE))
    found = list_limits(clip, bench)
    np.testing.assert_allclose(found, 1.0 - np.array(CUT[:9]) ** (2.0 / 3.0), rtol=1e-3)
    rates = list_limits(rate, bench)
    np.testing.assert_allclose(rates, 1.92 / np.array([0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0]), rtol=1e-4)
    peaks = np.where(np.arange(10000) % 1000 == 0, 4.0, np.linspace(-1.0, 1.0, 10000))
    assert sum(limit > 2.0 for limit in cut_off(peaks)) == 4
    assert not np.any(cut_off(np.zeros(9)))


@pytest.mark.parametrize("alone", [False, True])
def test_places_are_tried_over_the_likely_part_of_their_prior(alone: bool) -> None:
    """1.5 widths of the prior in steps of three sizes of 0.16: -1.44 to 1.44 by 0.48; bounds cut it."""
    _, (_, rest) = shaped(0.16)
    np.testing.assert_allclose(grid_of_shape(rest, alone), 0.48 * np.arange(-3, 4), atol=1e-12)
    _, (_, rest) = shaped(0.16, low=-0.5)
    np.testing.assert_allclose(grid_of_shape(rest, alone), 0.48 * np.arange(-1, 4), atol=1e-12)


def test_speeds_and_widths_are_tried_at_either_side_of_their_typical_size() -> None:
    """What cannot be zero: 0.6, 1 and 1.6 times its value, inside the bounds; beside another shape its value alone."""
    prior = Prior("normal", 0.5, 0.1)
    speed = Parameter(name="speed", unit="m/s", off=0.5, low=0.1, high=0.7, prior=prior, size=0.2)
    shape = Unknown(spring(PLACE), speed, 0.5)
    np.testing.assert_allclose(grid_of_shape(shape, True), [0.3, 0.5])
    np.testing.assert_allclose(grid_of_shape(shape, False), [0.5])


def test_trials_switch_an_effect_on_at_every_place() -> None:
    """A spring of its typical stiffness at each rest; every limit; nothing of an effect without a shape."""
    effect, unknowns = shaped(0.16)
    unknowns += (Unknown(bias(PLACE), bias(PLACE).parameters[0], 0.0), CLIP)
    trials = list_trials(unknowns, UNIFORM)
    springs, limits = trials[:7], trials[7:]
    assert [t.effect for t in trials] == ["rail.spring"] * 7 + ["servo.clip"] * 9
    stiffness = effect.parameters[0].size
    for trial, rest in zip(springs, 0.48 * np.arange(-3, 4)):
        assert not trial.limit
        assert list(trial.values) == [("rail.spring", "stiffness"), ("rail.spring", "rest")]
        assert list(trial.values.values()) == pytest.approx([stiffness, rest])
    for trial, value in zip(limits, list_limits(CLIP, UNIFORM)):
        assert trial.limit
        assert trial.values == {("servo.clip", "level"): value}


def test_what_the_twin_has_is_not_tried() -> None:
    """A spring that is in the twin already has derivatives; a shape of a single place would tell nothing new."""
    effect, _ = shaped(0.16)
    there = tuple(Unknown(effect, p, n) for p, n in zip(effect.parameters, (0.4, 0.0)))
    assert list_trials(there, UNIFORM) == ()
    _, broad = shaped(2.0)
    assert list_trials(broad, UNIFORM) == ()


@pytest.mark.parametrize(
    ("joint", "nominal", "found"),
    [
        ("arm", 1.0, [*(0.5 * (1.0 - np.array(CUT) ** (2.0 / 3.0))), 2.0]),
        ("arm", 0.5, [*(0.5 * (1.0 - np.array(CUT) ** (2.0 / 3.0))), 1.0]),
        ("wire", 1.0, [2.0]),
    ],
)
def test_force_limits_are_tried_where_a_servo_runs_into_them(
    joint: str, nominal: float, found: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Targets up to 0.5 rad from an arm at rest ask for 5 of 10 N m, evenly spread; a tendon tells nothing.

    Beyond a share L of the largest is (1 - L)^3 of the mean square.
    """
    drive = "tendon='wire'" if joint == "wire" else "joint='arm'"
    spec = load_rig(
        "<mujoco><worldbody><body><joint name='arm'/><geom size='0.1' mass='1'/></body>"
        "</worldbody><tendon><fixed name='wire'><joint joint='arm' coef='1'/></fixed></tendon><actuator>"
        f"<position name='servo' {drive} kp='10' kv='1' forcerange='-10 10'/></actuator></mujoco>"
    )
    bench = lay_bench([0.0], spec=spec, command=0.2 + 0.5 * UNIFORM.windows.command)
    rest = np.full((1, 1, bench.windows.steps + 1, 1), 0.2)
    monkeypatch.setattr(bench, "simulate", lambda variations, sensors: WindowMotion(rest, 0.0 * rest, None))
    limit = attach(FORCE_LIMIT, "servo")
    unknown = Unknown(limit, limit.parameters[0], nominal)
    assert list_force_limits([unknown], bench)[limit.id] == pytest.approx(found, abs=5e-3)
    assert [trial.limit for trial in list_trials((unknown,), bench)] == [True] * len(found)


def test_on_a_rig_that_nobody_knows_effects_are_tried_at_several_sizes() -> None:
    """A constant force at 1, 5 and 25 typical sizes either way; what cannot be negative that way only."""
    force = replace(bias(PLACE).parameters[0], low=-10.0, high=10.0, size=0.1)
    damping = replace(viscous(PLACE).parameters[0], low=0.0, high=1.0, size=0.1)
    for effect, parameter, sizes in (
        (bias(PLACE), force, [0.1, -0.1, 0.5, -0.5, 2.5, -2.5]),
        (viscous(PLACE), damping, [0.1, 0.5]),  # 25 sizes would be 2.5
    ):
        trials = list_trials((Unknown(effect, parameter, 0.0),), FOREIGN)
        assert [list(t.values) for t in trials] == [[(effect.id, parameter.name)]] * len(sizes)
        np.testing.assert_allclose([t.values[effect.id, parameter.name] for t in trials], sizes)
        assert list_trials((Unknown(effect, parameter, 0.0),), UNIFORM) == ()


def test_what_else_is_tried_where_nobody_knows_the_rig() -> None:
    """A spring at three sizes and seven rests."""
    effect, unknowns = shaped(0.16)
    trials = list_trials(unknowns, FOREIGN)
    sizes = [s for s in effect.parameters[0].size * np.array([1.0, 5.0, 25.0]) if s <= effect.parameters[0].high]
    assert len(trials) == 7 * len(sizes)
    assert {t.values["rail.spring", "stiffness"] for t in trials} == set(sizes)
    # Damping of 0.4 that the twin of such a rig has is tried off, halved and doubled: up to its bound.
    damping = replace(viscous(PLACE).parameters[0], low=0.0, high=1.0, size=0.1)
    for nominal, sizes in ((0.4, [0.0, 0.2, 0.8]), (0.6, [0.0, 0.3])):
        trials = list_trials((Unknown(viscous(PLACE), damping, nominal),), FOREIGN)
        np.testing.assert_allclose([t.values["rail.viscous", "damping"] for t in trials], sizes)
    # Of an arm's more than 40: five and 25 typical sizes either way, as a spring of 50 took for damping was missed.
    force = replace(bias(PLACE).parameters[0], low=-10.0, high=10.0, size=0.1)
    many = tuple(Unknown(replace(bias(PLACE), id=f"j{i}.bias"), force, 0.0) for i in range(MANY + 1))
    trials = list_trials(many, FOREIGN)
    assert len(trials) == 4 * len(many)
    forces = [t.values["j0.bias", "force"] for t in trials if t.effect == "j0.bias"]
    np.testing.assert_allclose(forces, [0.5, -0.5, 2.5, -2.5])
