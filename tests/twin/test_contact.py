"""Floor, wall and end stops as the twin meets them: it rebounds, passes through nothing, comes to rest and stays."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.twin.hover import PITCH, SPEC, VEHICLE, WEIGHT, X, Z, coast, make_twin, place

ARM, REACH = VEHICLE.airframe.half_length, 0.215
"""Hinge to rotor, and to the end of the hull [m]."""
RADIUS = REACH - ARM
LOW, HIGH = VEHICLE.rig.travel_z
END = VEHICLE.rig.travel_x[1]
WALL = 1.70
"""Where its face is [m]."""
EFFECTS = {
    "airframe.com": {"offset": np.array([0.0, 0.02])}, "rail_z.coulomb": {"force": np.array([0.0, 0.1])},
    "pitch.coulomb": {"torque": np.array([0.0, 0.01])},
}  # fmt: skip
"""Of the second of two simulations; the first is bare."""


def tips(path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the lower and reach to the right of the right end of the hull's axis, (...,) m each."""
    return (
        path[..., Z] - ARM * np.abs(np.sin(path[..., PITCH])),
        path[..., X] + ARM * np.abs(np.cos(path[..., PITCH])),
    )


def energy(path: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Kinetic and potential energy of the bare rig, (...,) J."""
    moving = np.array([WEIGHT / VEHICLE.gravity + VEHICLE.rig.carriage_mass, WEIGHT / VEHICLE.gravity, 0.006])
    return 0.5 * (moving * velocity**2).sum(axis=-1) + WEIGHT * path[..., Z]


@pytest.mark.parametrize(
    ("floor", "pitch"),
    [
        pytest.param(LOW, 0.0, id="level, onto the end stop"),
        pytest.param(REACH, np.pi / 2, id="on its right tip"),
        pytest.param(REACH, -np.pi / 2, id="on its left tip"),
        pytest.param(ARM * np.sin(1.1) + RADIUS, 1.1, id="on its right tip, at an angle"),
    ],
)
def test_dropped_craft_rebounds(floor: float, pitch: float) -> None:
    """Dropped by 0.3 m, with and without effects, a craft leaves the ground again, lower, and comes to rest."""
    twin = make_twin(2, EFFECTS)
    path, velocity = coast(twin, place(twin, np.tile([0.0, floor + 0.3, pitch], (2, 1))), 6.0)
    height = path[..., Z]
    for row in height:
        lowest = int(row[:600].argmin())
        fallen, risen = row[0] - row[lowest], row[lowest : lowest + 400].max() - row[lowest]
        upright = abs(np.sin(pitch)) in (0.0, 1.0)
        assert (0.1 if upright else 0.01) * fallen < risen < 0.5 * fallen  # struck at an angle it starts to spin
    assert velocity[:, :600, Z].max() > 0.1
    assert np.ptp(height[:, -300:], axis=1).max() < 1e-3
    assert (tips(path)[0] > 0.0).all()


ATTITUDES = np.linspace(-np.pi, np.pi, 25)


@pytest.mark.parametrize("spin", [0.0, 12.0, -12.0])
@pytest.mark.parametrize(
    ("start", "velocity"),
    [
        pytest.param((0.0, 0.7), (0.0, -6.0), id="floor"),
        pytest.param((1.0, 1.2), (6.0, 0.0), id="wall"),
        pytest.param((-1.0, 1.2), (-6.0, 0.0), id="left stop"),
        pytest.param((0.0, 2.0), (0.0, 6.0), id="upper stop"),
        pytest.param((1.1, 0.6), (4.3, -4.3), id="corner"),
    ],
)
def test_nothing_tunnels(start: tuple[float, float], velocity: tuple[float, float], spin: float) -> None:
    """At 6 m/s, in any attitude, spinning or not, the hull stays before floor and wall, the slider in its travel."""
    count = len(ATTITUDES)
    twin = make_twin(2 * count, {name: {p: np.repeat(v, count) for p, v in d.items()} for name, d in EFFECTS.items()})
    pose = np.tile(np.column_stack([np.tile(start, (count, 1)), ATTITUDES]), (2, 1))
    path, speed = coast(twin, place(twin, pose, np.tile([*velocity, spin], (2 * count, 1))), 1.0)
    lowest, rightmost = tips(path)
    # The hull sinks in by 13 mm, less than its radius, at 6 m/s; a tip that its spin brings to 8.4 m/s by 3 mm more.
    assert lowest.min() > -0.002
    assert rightmost.max() < WALL + 0.002
    assert np.abs(path[..., X]).max() < END + 0.03
    assert LOW - 0.03 < path[..., Z].min() <= path[..., Z].max() < HIGH + 0.03
    bare = energy(path[:count], speed[:count])
    assert (bare[:, -1] < bare[:, 0] - 0.5).all()  # J, of ten or so: what it hit took some
    assert bare.max() < bare[:, 0].max() + 0.05  # and gave back no more than it got


def test_end_of_the_hull_is_where_these_tests_say() -> None:
    """Reach, wall and stops are those of the model."""
    model = SPEC.model
    hull, wall = model.geom("hull"), model.geom("wall")
    assert hull.size[0] + hull.size[1] == pytest.approx(REACH)
    assert wall.pos[0] - wall.size[0] == pytest.approx(WALL)
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


@pytest.mark.parametrize(
    ("pose", "hold"),
    [
        pytest.param((0.1, LOW, 0.0), 0.0, id="on the lower stop"),
        pytest.param((0.1, ARM + RADIUS, np.pi / 2), 0.0, id="on its tip"),
        pytest.param((0.1, ARM * np.sin(0.9) + RADIUS, 0.9), 0.9, id="leaning, most of its weight held"),
        pytest.param((-END, 1.0, 0.0), 1.0, id="against the left stop"),
        pytest.param((WALL - REACH, 1.0, 0.0), 1.0, id="against the wall"),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_craft_at_rest_stays_at_rest(pose: tuple[float, float, float], hold: float, sign: float) -> None:
    """Where something holds it besides its friction, a slider pushed with 80 % of that creeps below 0.1 mm in 10 s."""
    level = np.array([0.1, 0.5, 2.0])
    twin = make_twin(
        3, {"rail_x.coulomb": {"force": level}, "rail_z.coulomb": {"force": level}, "pitch.coulomb": {"torque": 0.2}}
    )
    hand = np.zeros((3, 1, 3))
    hand[:, 0, Z] = hold * WEIGHT
    if hold < 1.0:
        hand[:, 0, X] = 0.8 * sign * level
    else:  # pressed against it sideways, with more than its friction, and pushed up or down
        hand[:, 0, Z] += 0.8 * sign * level
        hand[:, 0, X] = np.sign(pose[X]) * (level + 1.0)
    qpos = twin.replay_commands(place(twin, np.tile(pose, (3, 1))), np.zeros((3, 12000, 2)), disturbance=hand).qpos
    settled = qpos[:, 2000:]
    assert np.abs(settled - settled[:, :1])[..., :2].max() < 1e-4
    assert np.abs(settled - settled[:, :1])[..., PITCH].max() < 1e-3  # rad: 0.2 mm at the tip
    np.testing.assert_allclose(settled[:, 0], np.tile(pose, (3, 1)), atol=2e-3)


def test_thrown_about_it_comes_to_rest() -> None:
    """Thrown from any pose with friction in every joint, a craft has come to rest ten seconds later."""
    rng, count = np.random.default_rng(0), 60
    bounds = {
        ("rail_x.coulomb", "force"): (0.1, 2.0), ("rail_z.coulomb", "force"): (0.1, 2.0),
        ("pitch.coulomb", "torque"): (0.02, 0.2), ("airframe.com", "offset"): (-0.03, 0.03),
        ("rail_x.jamming", "mu"): (0.0, 0.02), ("rail_z.jamming", "mu"): (0.0, 0.5),
    }  # fmt: skip
    twin = make_twin(
        count, {effect: {name: rng.uniform(*between, count)} for (effect, name), between in bounds.items()}
    )
    pose = rng.uniform([-1.4, 0.3, -np.pi], [1.4, 1.5, np.pi], (count, 3))
    path, velocity = coast(twin, place(twin, pose, rng.uniform(-1, 1, (count, 3)) * [3, 3, 8]), 10.0)
    assert np.isfinite(path).all()
    # Friction in contacts is regularized, so that a tip which should stick creeps: 0.1 mm in 10 s at most.
    assert np.abs(velocity[:, -1000:, :2]).max() < 1e-5
    assert np.abs(velocity[:, -1000:, PITCH]).max() < 1e-4
