"""Dry friction measured as on a bench: force ramps, constant speeds, pushes held for ten seconds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from tests.twin.hover import MASS_X, PITCH, VEHICLE, WEIGHT, X, Z, make_twin, place
from vpptwin.twin import Twin

Effects = dict[str, dict[str, np.ndarray | float]]
JOINTS = {X: "rail_x", Z: "rail_z", PITCH: "pitch"}
MASS = {X: MASS_X, Z: WEIGHT / VEHICLE.gravity, PITCH: VEHICLE.airframe.inertia}
GRAVITY, CRAFT, CARRIAGE = VEHICLE.gravity, VEHICLE.airframe.mass, VEHICLE.rig.carriage_mass
STILL = 1e-10
"""Rounding over ten seconds [m, rad]; 1e-4 m would be creep."""


def push(
    twin: Twin, forces: np.ndarray, seconds: float, pose: np.ndarray, velocity: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and velocity after every step, (N, steps, 3), under a hand's force (N, segments, 3) besides the weight's."""
    steps = round(seconds / twin.dt)
    held = forces + np.array([0.0, WEIGHT, 0.0])
    start = place(twin, pose, velocity)
    _, qpos, qvel, _ = twin.replay_commands(start, np.zeros((twin.num_sims, steps, 2)), disturbance=held)
    return twin.pose_at_time(qpos, qvel), qvel


def measure_breakaway(
    effects: Effects, joint: int, direction: np.ndarray, most: float, pose: np.ndarray, side: np.ndarray | None = None
) -> np.ndarray:
    """Force or torque (N,) at which a joint gives way, raised in 3 s to `most` [N, N m], a push to the side besides."""
    ramp = np.zeros((len(direction), 3000, 3))
    ramp[..., joint] = direction[:, None] * np.linspace(0.0, most, 3000)
    if side is not None:
        ramp += side[:, None]
    _, velocity = push(make_twin(len(direction), effects), ramp, 3.0, pose)
    moving = np.abs(velocity[..., joint]) > 1e-9
    assert moving.any(axis=1).all()
    first = moving.argmax(axis=1)
    return np.abs(ramp[np.arange(len(ramp)), first, joint])


def measure_sliding(effects: Effects, joint: int, velocity: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Friction (N,) at velocities (N,): the push that was to hold them for 20 ms, less what it accelerated by."""
    count = len(velocity)
    force, start = np.zeros((count, 1, 3)), np.zeros((count, 3))
    force[:, 0, joint], start[:, joint] = expected, velocity
    _, speed = push(make_twin(count, effects), force, 0.02, np.tile([0.0, 1.0, 0.0], (count, 1)), start)
    return expected - MASS[joint] * (speed[:, -1, joint] - velocity) / 0.02


def level_poses(count: int) -> np.ndarray:
    """Level at 1 m, (count, 3)."""
    return np.tile([0.0, 1.0, 0.0], (count, 1))


def test_joints_stand_still_below_breakaway() -> None:
    """Under 80 % of breakaway, in x, z, pitch or all, in any attitude and with the masses coupled, nothing creeps."""
    rows = [
        (level, angle, com, axes, sign)
        for level in (0.05, 2.0) for angle in (0.0, 0.7, -2.0) for com in (0.0, 0.04)
        for axes in ((X,), (Z,), (PITCH,), (X, Z, PITCH)) for sign in (1.0, -1.0)
    ]  # fmt: skip
    level, angle, com = (np.array([row[i] for row in rows]) for i in range(3))
    friction = np.stack([level, level, 0.1 * level], axis=1)
    effects: Effects = {"rail_x.coulomb": {"force": level}, "rail_z.stiction": {"force": level}}
    effects |= {"pitch.coulomb": {"torque": 0.1 * level}}
    effects |= {"airframe.com": {"offset": com}, "airframe.com_height": {"offset": -0.5 * com}}
    hand = np.zeros((len(rows), 3))
    for i, (_, _, _, axes, sign) in enumerate(rows):
        hand[i, list(axes)] = 0.8 * sign * friction[i, list(axes)]
    across = com * np.cos(angle) + 0.5 * com * np.sin(angle)  # m, of the centre of mass beside the hinge
    hand[:, PITCH] += CRAFT * GRAVITY * across
    pose = np.stack([np.full(len(rows), 0.1), np.full(len(rows), 1.0), angle], axis=1)
    path, velocity = push(make_twin(len(rows), effects), hand[:, None], 10.0, pose)
    assert np.abs(path - pose[:, None]).max() < STILL
    assert np.abs(velocity).max() < STILL


@pytest.mark.parametrize("joint", [X, Z, PITCH])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_breakaway_is_the_parameter(joint: int, sign: float) -> None:
    """A force raised slowly moves a joint when it exceeds the friction, sliding plus stiction, within 2 %."""
    coulomb, stiction = np.array([0.1, 0.5, 1.0, 0.3]), np.array([0.0, 0.0, 0.4, 1.0])
    effects: Effects = {f"{JOINTS[joint]}.coulomb": {"torque" if joint == PITCH else "force": coulomb}}
    if joint == PITCH:
        coulomb, stiction = 0.1 * coulomb, 0.0 * stiction
        effects["pitch.coulomb"]["torque"] = coulomb
    else:
        effects[f"{JOINTS[joint]}.stiction"] = {"force": stiction}
    most = 1.5 * float((coulomb + stiction).max())
    found = measure_breakaway(effects, joint, np.full(4, sign), most, level_poses(4))
    np.testing.assert_allclose(found, coulomb + stiction, rtol=0.02)


@pytest.mark.parametrize("joint", [X, Z])
def test_sliding_friction_follows_the_stribeck_curve(joint: int) -> None:
    """At any constant speed, either way, friction is F_c + force exp(-(v/velocity)²) within 2 %."""
    speed = np.array([0.002, 0.01, 0.03, 0.05, 0.08, 0.15, 0.6])
    velocity = np.concatenate([speed, -speed])
    effects: Effects = {
        f"{JOINTS[joint]}.coulomb": {"force": 0.4},
        f"{JOINTS[joint]}.stiction": {"force": 0.3, "velocity": 0.06},
    }
    expected = np.sign(velocity) * (0.4 + 0.3 * np.exp(-((velocity / 0.06) ** 2)))
    np.testing.assert_allclose(measure_sliding(effects, joint, velocity, expected), expected, rtol=0.02)


def test_pivot_friction_does_not_depend_on_speed() -> None:
    """Dry friction in the pivot is its parameter at any rate, either way."""
    rate = np.array([0.01, 0.5, 8.0, -0.01, -0.5, -8.0])
    found = measure_sliding({"pitch.coulomb": {"torque": 0.02}}, PITCH, rate, 0.02 * np.sign(rate))
    np.testing.assert_allclose(found, 0.02 * np.sign(rate), rtol=0.02)


@pytest.mark.parametrize("joint", [X, Z])
def test_asymmetry_tells_the_directions_apart(joint: int) -> None:
    """Breakaway and sliding friction are (1 + fraction) times what they were forward, (1 - fraction) times back."""
    direction, fraction = np.array([1.0, -1.0, 1.0, -1.0]), np.array([0.4, 0.4, -0.2, -0.2])
    effects: Effects = {
        f"{JOINTS[joint]}.coulomb": {"force": 0.3}, f"{JOINTS[joint]}.stiction": {"force": 0.2},
        f"{JOINTS[joint]}.asymmetry": {"fraction": fraction},
    }  # fmt: skip
    factor = 1.0 + fraction * direction
    found = measure_breakaway(effects, joint, direction, 1.0, level_poses(4))
    np.testing.assert_allclose(found, 0.5 * factor, rtol=0.02)
    effects[f"{JOINTS[joint]}.stiction"] = {"force": 0.0}
    expected = 0.3 * factor * direction
    np.testing.assert_allclose(measure_sliding(effects, joint, 0.3 * direction, expected), expected, rtol=0.02)


def test_tight_spot_is_where_it_should_be() -> None:
    """Breakaway along the rail is 0.2 N and, around 0.4 m, as much more as a bell of width 0.15 m says."""
    place_on_rail = np.array([-0.5, 0.1, 0.25, 0.4, 0.55, 0.7, 1.2])
    effects: Effects = {
        "rail_x.coulomb": {"force": 0.2}, "rail_x.tight_spot": {"force": 1.0, "place": 0.4, "width": 0.15},
    }  # fmt: skip
    pose = level_poses(len(place_on_rail))
    pose[:, X] = place_on_rail
    found = measure_breakaway(effects, X, np.ones(len(pose)), 1.5, pose)
    np.testing.assert_allclose(found, 0.2 + np.exp(-(((place_on_rail - 0.4) / 0.15) ** 2)), rtol=0.02)


LOADS = np.array([0.3, -0.3, 1.0, -1.0, 1.6, -1.6])
"""Horizontal force of the craft on the guide [N], the carriage held."""


@pytest.mark.parametrize("mu", [0.05, 0.3, 1.0])
def test_jamming_of_the_slider_follows_the_load(mu: float) -> None:
    """Pressed sideways against its guide, the slider gives way upwards at mu times that force, within 2 %."""
    effects: Effects = {"rail_z.jamming": {"mu": mu}, "rail_x.coulomb": {"force": 2.0}}
    side = np.stack([LOADS, 0 * LOADS, 0 * LOADS], axis=1)
    found = measure_breakaway(effects, Z, np.ones(len(LOADS)), 1.5 * mu * 1.6, level_poses(len(LOADS)), side)
    np.testing.assert_allclose(found, mu * np.abs(LOADS), rtol=0.02)


@pytest.mark.parametrize("mu", [0.05, 0.5])
def test_jamming_at_the_end_of_the_rail(mu: float) -> None:
    """Where an end stop holds the carriage or a wall the craft, the guide carries what the other one pushes with."""
    # At the left stop the hand presses the craft by 1 N: the guide carries it. At the wall on the right, with the tip,
    # it presses the carriage: the guide carries it again, and the wall rubs with 0.4 times 1 N. Then the craft: the
    # wall rubs alone.
    pose = np.array([[-1.4999, 1.0, 0.0], [1.4849, 1.0, 0.0], [1.4849, 1.0, 0.0]])
    effects: Effects = {"rail_z.jamming": {"mu": mu}, "rail_x.bias": {"force": np.array([0.0, 1.0, 0.0])}}
    effects["pitch.coulomb"] = {"torque": 0.2}  # what the wall rubs with turns it
    ramp = np.zeros((3, 10000, 3))
    ramp[..., X] = np.array([-1.0, 0.0, 1.0])[:, None]
    ramp[:, 1000:, Z] = np.linspace(0.0, 1.2, 9000)  # after a second in which it comes to rest
    _, velocity = push(make_twin(3, effects), ramp, 10.0, pose)
    assert np.abs(velocity[:, 900, :2]).max() < 1e-6
    # The wall's friction is regularized: it creeps, at 0.3 mm/s or less, before it gives way.
    moving = np.abs(velocity[:, 1000:, Z]) > np.array([1e-9, 5e-4, 5e-4])[:, None]
    found = ramp[np.arange(3), 1000 + moving.argmax(axis=1), Z]
    assert found[0] == pytest.approx(mu, rel=0.02)
    np.testing.assert_allclose(found[1:], [mu + 0.4, 0.4], rtol=0.04)


@pytest.mark.parametrize("height", [0.5, 1.0, 2.0])
def test_jamming_of_the_carriage_follows_load_and_height(height: float) -> None:
    """Pressed by the craft against a pull of the rail, the carriage gives way at mu |N| height/spacing, within 2 %."""
    mu = np.array([0.005, 0.02, 0.005, 0.02])
    pull = np.array([1.0, 1.0, -1.0, -1.0])  # N, on the carriage; the craft pushes against it, less and less
    twin = make_twin(4, {"rail_x.jamming": {"mu": mu}, "rail_x.bias": {"force": pull}})
    hand = np.zeros((4, 3000, 3))
    hand[..., X] = -pull[:, None] * np.linspace(1.0, 0.5, 3000)
    pose = level_poses(4)
    pose[:, Z] = height
    _, velocity = push(twin, hand, 3.0, pose)
    moving = np.abs(velocity[..., X]) > 1e-9
    assert moving[:, -1].all()
    load = np.abs(hand[np.arange(4), moving.argmax(axis=1), X])
    np.testing.assert_allclose(1.0 - load, mu * load * height / VEHICLE.rig.bearing_spacing, rtol=0.02)


def test_jamming_while_sliding() -> None:
    """Moving at 0.3 m/s under a load, slider and carriage are held back by the same friction, within 2 %."""
    count, mu_x, mu_z = len(LOADS), 0.02, 0.3
    speed = np.full(count, 0.3)
    expected = mu_z * np.abs(LOADS)
    effects: Effects = {"rail_z.jamming": {"mu": mu_z}, "rail_x.coulomb": {"force": 2.0}}
    force, start = np.zeros((count, 1, 3)), np.zeros((count, 3))
    force[:, 0, X], force[:, 0, Z], start[:, Z] = LOADS, expected, speed
    _, velocity = push(make_twin(count, effects), force, 0.05, level_poses(count), start)
    slowed = MASS[Z] * (velocity[:, -1, Z] - velocity[:, 4, Z]) / 0.045  # the load is known after the first step
    np.testing.assert_allclose(expected - slowed, expected, rtol=0.02)

    expected = mu_x * np.abs(LOADS) * 1.0 / VEHICLE.rig.bearing_spacing
    effects = {"rail_x.jamming": {"mu": mu_x}, "rail_x.bias": {"force": expected - LOADS}}  # on the carriage
    force, start = np.zeros((count, 1, 3)), np.zeros((count, 3))
    force[:, 0, X], start[:, X] = LOADS, speed
    _, velocity = push(make_twin(count, effects), force, 0.05, level_poses(count), start)
    slowed = MASS[X] * (velocity[:, -1, X] - velocity[:, 9, X]) / 0.040
    np.testing.assert_allclose(expected - slowed, expected, rtol=0.02)


def test_guide_carries_what_drags_the_carriage() -> None:
    """A craft that accelerates the rig at a presses on the guide with m_carriage a, and rubs on it accordingly."""
    force = np.zeros((2, 1, 3))
    force[:, 0, X] = 6.0, -6.0
    start = np.tile([0.0, 0.5, 0.0], (2, 1))
    _, velocity = push(make_twin(2, {"rail_z.jamming": {"mu": 0.5}}), force, 0.1, level_poses(2), start)
    load = CARRIAGE * 6.0 / MASS_X
    slowed = (velocity[:, -1, Z] - velocity[:, 9, Z]) / 0.090
    np.testing.assert_allclose(slowed, -0.5 * load / MASS[Z], rtol=0.02)


def test_coupled_joints_stop_together() -> None:
    """With its mass beside the hinge a craft that rubs in three joints comes to rest in all, and stays there."""
    effects: Mapping[str, Mapping[str, float]] = {
        "rail_x.coulomb": {"force": 0.5}, "rail_z.coulomb": {"force": 0.5}, "pitch.coulomb": {"torque": 0.05},
        "airframe.com": {"offset": 0.03}, "airframe.com_height": {"offset": -0.01},
    }  # fmt: skip
    rng = np.random.default_rng(1)
    velocity = rng.uniform(-1, 1, (20, 3)) * [0.5, 0.5, 3.0]
    pose = level_poses(20)
    hand = np.zeros((20, 1, 3))
    path, speed = push(make_twin(20, effects), hand, 4.0, pose, velocity)
    assert np.abs(speed[:, -1000:]).max() < STILL
    assert np.ptp(path[:, -1000:], axis=1).max() < STILL
    assert np.abs(path[:, -1] - pose).max() > 0.1
