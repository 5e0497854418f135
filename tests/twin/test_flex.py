"""What gives, against the textbook's equations in a loop of its own: LuGre friction and an elastic mode on the rail."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest

from tests.twin.hover import MASS_X, SPEC, X, Z, make_twin, share_kernel
from tests.twin.test_friction import MASS, Effects, level_poses, push

SEGMENT, SECONDS = 0.02, 1.0
"""A push stands for so long, and a flight takes so long [s]."""
FINE = 2e-5
"""Step of the loop [s]."""
COMPLIANCE = np.array([1e-4, 1e-3, 3e-3, 5e-3])  # m/N
COULOMB, STICTION, STRIBECK = 0.3, 0.2, 0.05  # N, N, m/s
SHARE, FREQUENCY, ZETA = (np.array(v) for v in ([0.05, 0.1, 0.3, 0.5], [3.0, 8.0, 20.0, 40.0], [0.0, 0.03, 0.3, 0.1]))
Loop = Callable[[np.ndarray, float], np.ndarray]


def draw_pushes() -> np.ndarray:
    """Forces on the rail that hold a carriage now and drag it then, (4, segments) N."""
    return np.random.default_rng(1).normal(0.0, 0.8, (4, round(SECONDS / SEGMENT)))


def loop_bristles(force: np.ndarray, step: float) -> np.ndarray:
    """Velocity (4, segments) at the end of each push: bristles that slip beyond 0.9, in explicit Euler steps."""
    v, z, path, stiffness = np.zeros(4), np.zeros(4), [], 1.0 / COMPLIANCE
    for held in force.T:
        for _ in range(round(SEGMENT / step)):
            level = COULOMB + STICTION * np.exp(-((v / STRIBECK) ** 2))
            share = np.sign(v) * stiffness * z / level
            rate = v * (1.0 - np.maximum(share - 0.9, 0.0) / 0.1)
            most = np.maximum(level, stiffness * np.abs(z))  # damping raises no force above it
            friction = np.clip(stiffness * z + 2.0 * np.sqrt(stiffness * MASS_X) * v * (share < 0.9), -most, most)
            z = z + step * rate
            v = v + step * (held - friction) / MASS_X
        path.append(v)
    return np.array(path).T


def loop_elastic(force: np.ndarray, step: float) -> np.ndarray:
    """Velocity (4, segments) at the end of each push: two masses, a spring and a damper between them."""
    x, v, path = np.zeros((2, 4)), np.zeros((2, 4)), []
    mass, rate = np.array([np.full(4, MASS_X), SHARE * MASS_X]), 2.0 * np.pi * FREQUENCY
    for held in force.T:
        for _ in range(round(SEGMENT / step)):
            pull = mass[1] * (rate**2 * (x[0] - x[1]) + 2.0 * ZETA * rate * (v[0] - v[1]))
            v = v + step * np.array([held - pull, pull]) / mass
            x = x + step * v
        path.append(v[0])
    return np.array(path).T


def fly(effects: Effects, force: np.ndarray, step: float) -> np.ndarray:
    """The twin's velocity along the rail at the end of each push, (4, segments)."""
    model = copy.copy(SPEC.model)
    model.opt.timestep = step
    hand = np.zeros((*force.shape, 3))
    hand[..., X] = force
    with share_kernel():
        twin = make_twin(4, effects, SPEC.with_robot(model=model))
    _, velocity = push(twin, hand, SECONDS, level_poses(4))
    each = round(SEGMENT / step)
    return velocity[:, each - 1 :: each, X]


BRISTLES: Effects = {
    "rail_x.coulomb": {"force": COULOMB}, "rail_x.stiction": {"force": STICTION, "velocity": STRIBECK},
    "rail_x.lugre": {"compliance": COMPLIANCE},
}  # fmt: skip
MODE: Effects = {"rail_x.elastic": {"share": SHARE, "frequency": FREQUENCY, "zeta": ZETA}}


@pytest.mark.parametrize(("effects", "loop"), [(BRISTLES, loop_bristles), (MODE, loop_elastic)], ids=["lugre", "mode"])
def test_twin_agrees_with_the_textbook(effects: Effects, loop: Loop) -> None:
    """Under random pushes both move alike, within what their steps explain: a first order leaves what halving took."""
    force = draw_pushes()
    coarse, fine = fly(effects, force, 1e-3), fly(effects, force, 5e-4)
    first, second = loop(force, FINE), loop(force, FINE / 2)
    explained = np.maximum.accumulate(np.abs(fine - coarse) + np.abs(second - first), axis=1).max(axis=1)
    error = np.abs(fine - second).max(axis=1)
    assert (error < 1.5 * explained + 1e-6).all(), (error, explained)
    assert (explained < 0.03 * np.ptp(second, axis=1)).all()
    stiff = fly({name: values for name, values in effects.items() if name not in ("rail_x.lugre", *MODE)}, force, 5e-4)
    assert (np.abs(stiff - second).max(axis=1) > 3.0 * error).all()  # without it the twin is elsewhere


@pytest.mark.parametrize("joint", [X, Z])
def test_bristles_hold_below_breakaway(joint: int) -> None:
    """Pushed with 80 % of breakaway for 10 s a slider gives by what its bristles bend, and creeps by less than 1 µm."""
    name = {X: "rail_x", Z: "rail_z"}[joint]
    compliance, sign = np.tile([0.0, 1e-6, 1e-5, 1e-4, 1e-3, 5e-3], 2), np.repeat([1.0, -1.0], 6)
    effects: Effects = {
        f"{name}.coulomb": {"force": 0.3}, f"{name}.stiction": {"force": 0.1},
        f"{name}.lugre": {"compliance": compliance},
    }  # fmt: skip
    hand = np.zeros((12, 1, 3))
    hand[:, 0, joint] = 0.8 * 0.4 * sign
    path, _ = push(make_twin(12, effects), hand, 10.0, level_poses(12))
    bent = sign[:, None] * (path[..., joint] - level_poses(12)[:, None, joint])
    stiffest = np.where(compliance > 0.0, 4e-6 / MASS[joint], 0.0)  # what steps of 1 ms show
    elastic = 0.8 * 0.4 * np.maximum(compliance, stiffest)
    np.testing.assert_allclose(bent[:, -1], elastic, rtol=0.03)  # the push comes at once: the softest slip a little
    assert np.abs(bent[:, -1] - elastic).max() < 1e-4  # creep of 0.1 mm in 10 s
    assert np.ptp(bent[:, 3000:], axis=1).max() < 1e-6


def test_bristles_do_not_creep_under_a_load_that_trembles() -> None:
    """Between 40 and 80 % of breakaway for 10 s, and at rest again, a slider is where it was within 0.1 mm."""
    count = len(COMPLIANCE)
    hand = np.zeros((count, 10000, 3))
    hand[:, :8000, X] = 0.5 * (0.6 + 0.2 * np.sin(2.0 * np.pi * 3.0 * 1e-3 * np.arange(8000)))
    path, _ = push(make_twin(count, BRISTLES), hand, 10.0, level_poses(count))
    assert np.abs(path[:, -1, X] - level_poses(count)[:, X]).max() < 1e-4


def test_stiff_bristles_are_friction_that_sticks() -> None:
    """Bristles too stiff for the step move a carriage as ideal friction does, within the 0.4 mm of mocap's noise."""
    force = np.zeros((4, 50, 3))
    force[..., X] = draw_pushes()
    rubbing: Effects = {name: BRISTLES[name] for name in ("rail_x.coulomb", "rail_x.stiction")}
    stiff = rubbing | {"rail_x.lugre": {"compliance": 1e-9}}
    ideal, found = (push(make_twin(4, e), force, SECONDS, level_poses(4))[0] for e in (rubbing, stiff))
    assert 1e-8 < np.abs(found - ideal).max() < 4e-4


def test_bristles_let_go_of_no_friction() -> None:
    """Without friction there is nothing to bend: a rollout is that of the bare rig."""
    force = np.zeros((4, 50, 3))
    force[..., X] = draw_pushes()
    bare, soft = (
        push(make_twin(4, e), force, SECONDS, level_poses(4)) for e in ({}, {"rail_x.lugre": {"compliance": 1e-3}})
    )
    np.testing.assert_array_equal(bare, soft)


def test_what_is_off_does_not_evolve() -> None:
    """At its off value what an effect keeps stays as it started, bit for bit, also where others of the batch go on."""
    twin = make_twin(2, {"rail_x.elastic": {"share": np.array([0.0, 0.1])}})
    start = twin.initial_state(qpos=np.array([0.2, 1.0, 0.0]), qvel=np.array([0.3, 0.0, 0.0]))
    after = twin.step_policy(start, np.tile([5.0, 2.0], (2, 1)), 0.1)
    np.testing.assert_array_equal(after.effects[0], start.effects[0])
    changed = after.effects[1] != start.effects[1]
    np.testing.assert_array_equal(start.effects[:, changed], [[0.2, 0.3]] * 2)  # it starts with its joint
