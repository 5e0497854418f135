"""The independent simulation moves as mechanics says: fall, drag, dry friction, load on the guide, servo."""

from __future__ import annotations

import math

import numpy as np
import pytest

from proving.drone.effects import Effects
from proving.drone.plant import Plant
from proving.drone.rig import PITCH, Rig, X, Z
from proving.drone.rotor import NODES, SUBSTEPS, Servo

WEIGHT = 4.905  # N, of craft and slider, 0.50 kg; with the carriage 0.58 kg move along x


def place(effects: Effects, state: list[float], free: bool = False) -> Plant:
    """One rig at x m, z m, theta rad and their rates."""
    return Plant(Rig([effects], [None], free), np.array(state[:3])[:, None], np.array(state[3:])[:, None])


def glide(effects: Effects, state: list[float], thrust: float, duration: float) -> np.ndarray:
    """Positions and velocities (steps + 1, 6) under a constant force along body z, N, without moment."""
    return push(place(effects, state), thrust, duration)


def push(plant: Plant, thrust: float, duration: float) -> np.ndarray:
    """Let a constant force along body z, N, act on a plant; its positions and velocities, (steps + 1, 6)."""
    thrusts = np.full((len(NODES), 2, 1), thrust / 2)
    path = [np.append(plant.position, plant.velocity)]
    for _ in range(round(duration * 1000)):
        plant.advance(thrusts, np.full_like(thrusts, 471.0), np.zeros((SUBSTEPS, 3, 1)))
        path.append(np.append(plant.position, plant.velocity))
    return np.array(path)


def test_thrown_craft_follows_the_parabola() -> None:
    """Without thrust and effects the craft falls freely, spins evenly and keeps its energy."""
    path = glide({}, [-0.5, 1.0, 0.3, 0.6, 3.0, 4.0], 0.0, 0.5)
    time = np.arange(len(path)) * 0.001
    np.testing.assert_allclose(path[:, 0], -0.5 + 0.6 * time, atol=1e-12)
    np.testing.assert_allclose(path[:, 1], 1.0 + 3.0 * time - 4.905 * time**2, atol=1e-12)  # midpoint rule: exact
    np.testing.assert_allclose(path[:, 2], 0.3 + 4.0 * time, atol=1e-12)
    energy = 0.5 * 0.5 * path[:, 4] ** 2 + 0.5 * 9.81 * path[:, 1]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


def test_an_elastic_rail_is_two_masses_on_a_spring() -> None:
    """Rig and what gives, 0.58 kg and a fifth of that, started together at 1 m/s with the spring stretched.

    Their momentum stays but for 0.25 ms a step; they swing against each other at ω √(1.2), 5 Hz √(1.2), and with a
    damping ratio of ζ √(1.2).
    """
    plant = place({"rail_x.elastic": {"share": 0.2, "frequency": 5.0, "zeta": 0.02}}, [0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    plant.foreign.sway += 0.05
    time = np.arange(401) * 0.001
    x = push(plant, 0.0, 0.4)[:, 0]
    tone, zeta = 2 * math.pi * 5.0 * math.sqrt(1.2), 0.02 * math.sqrt(1.2)
    ringing = tone * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * tone * time)
    apart = 0.05 * decay * (np.cos(ringing * time) + zeta * tone / ringing * np.sin(ringing * time))
    np.testing.assert_allclose(x, (0.05 - apart) / 6.0, atol=1e-4)  # 0.2 / 1.2 of what the two come nearer


@pytest.mark.parametrize(
    ("effects", "terminal"),
    [
        ({"rail_z.viscous": {"damping": 10.0}}, WEIGHT / 10.0),  # b v = m g
        ({"air.drag": {"k_d": 20.0}}, math.sqrt(WEIGHT / 20.0)),  # k_d v^2 = m g
        ({"rail_z.coulomb": {"force": 1.0}, "rail_z.viscous": {"damping": 10.0}}, 3.905 / 10.0),
    ],
)
def test_terminal_velocity(effects: Effects, terminal: float) -> None:
    """A falling craft reaches the speed at which its drag carries its weight."""
    path = glide(effects, [0.0, 2.0, 0.0, 0.0, 0.0, 0.0], 0.0, 1.5)
    assert path[-1, 4] == pytest.approx(-terminal, rel=1e-6)


@pytest.mark.parametrize("effect", [{"rail_x.coulomb": {"force": 0.3}}, {"rail_x.stiction": {"force": 0.3}}])
def test_below_breakaway_nothing_moves(effect: Effects) -> None:
    """A slider pushed with 97 % of breakaway stands exactly still, and creeps off at 103 %."""
    for share, stays in ((0.97, True), (1.03, False)):
        side = 0.3 * share
        angle = -math.atan2(side, WEIGHT)  # thrust carries the weight and pushes aside
        path = glide(effect, [0.1, 1.0, angle, 0.0, 0.0, 0.0], math.hypot(side, WEIGHT), 1.0)
        assert (np.ptp(path[:, 0]) == 0.0) == stays


def test_friction_stops_a_slider_where_work_says() -> None:
    """Sliding at 1 m/s, 0.58 kg against 2 N stop after m v^2 / (2 F) = 0.145 m, for good."""
    path = glide({"rail_x.coulomb": {"force": 2.0}}, [-0.2, 1.0, 0.0, 1.0, 0.0, 0.0], WEIGHT, 0.6)
    assert path[-1, 0] + 0.2 == pytest.approx(0.145, abs=1e-6)
    assert path[int(0.58 / 2.0 * 1000) + 1, 3] == 0.0  # m v / F = 0.29 s


def test_servo_by_hand() -> None:
    """A command reaches the blade after exactly its delay, 7.3 ms, then with the lag of 35 ms."""
    effects = {"command.delay": {"delay": 0.0073}, "servo.lag": {"time_constant": 0.035}}
    servo = Servo(Rig([effects], [None]), np.zeros((2, 1)))
    pitch = np.array([servo.advance(np.full((2, 1), 0.1))[:, 0, 0] for _ in range(40)])
    time = np.arange(40)[:, None] * 0.001 + NODES
    expected = 0.1 * (1 - np.exp(-np.maximum(time - 0.0073, 0.0) / 0.035))
    np.testing.assert_allclose(pitch, expected, atol=1e-12)
    # Until it arrives, amid a millisecond, the blade stands; then it follows at its rate less the play.
    effects = {
        "command.delay": {"delay": 0.0073},
        "servo.rate_limit": {"rate": 2.0},
        "servo.backlash": {"gap": 0.01},
    }
    servo = Servo(Rig([effects], [None]), np.zeros((2, 1)))
    pitch = np.array([servo.advance(np.full((2, 1), 0.2))[:, 0, 0] for _ in range(60)])
    time = np.arange(60)[:, None] * 0.001 + NODES
    # The lag of 20 ms alone would be faster than 2 rad/s until 0.04 rad are left, after 80 ms.
    np.testing.assert_allclose(pitch, np.maximum(2.0 * (time - 0.0073) - 0.005, 0.0), atol=1e-12)


SIDE = 0.6  # N, horizontal part of the thrust
SIDE_THRUST, SIDE_ANGLE = math.hypot(SIDE, WEIGHT), -math.atan2(SIDE, WEIGHT)


@pytest.mark.parametrize(
    ("effects", "velocity", "load"),
    [
        ({}, 0.0, -SIDE * 0.08 / 0.58),  # the thrust draws the carriage along by the guide
        ({"carriage.mass": {"mass": 0.12}}, 0.0, -SIDE * 0.20 / 0.70),
        ({"rail_x.bias": {"force": -SIDE}}, 0.0, -SIDE),  # held by a cable at the carriage
        ({"rail_x.viscous": {"damping": 0.5}}, SIDE / 0.5, -SIDE),  # steady against drag on the carriage
        ({"rail_x.spring": {"stiffness": 4.0, "rest": -SIDE / 4.0}}, 0.0, -SIDE),
        ({"rail_x.coulomb": {"force": SIDE}}, 0.0, -SIDE),
        ({"rail.tilt": {"angle": math.asin(SIDE / 9.81 / 0.58)}}, 0.0, -SIDE * 0.08 / 0.58),  # at rest
        ({"air.drag": {"k_d": 0.5}}, math.sqrt(SIDE / 0.5), 0.0),  # steady against drag on the craft
    ],
)
def test_guide_carries_what_the_rail_takes(effects: Effects, velocity: float, load: float) -> None:
    """The load that jams a slider is the force through the guide: what acts on the carriage is no part of it."""
    plant = place(effects | {"rail_z.jamming": {"mu": 0.0}}, [0.0, 1.0, SIDE_ANGLE, velocity, 0.0, 0.0])
    push(plant, SIDE_THRUST, 0.002)
    assert plant.side_load is not None
    # Speed, place and slope of the force have changed by some 1e-3 in 2 ms.
    assert plant.side_load[0] == pytest.approx(load, abs=3e-3)


def test_guide_carries_the_swing_of_an_unbalanced_craft() -> None:
    """Seen from the carriage, the guide's force is what the carriage's own acceleration leaves: for every effect."""
    effects = {
        "airframe.com": {"offset": 0.02},
        "airframe.com_height": {"offset": -0.02},
        "rail_x.viscous": {"damping": 0.5},
        "rail_x.bias": {"force": 0.3},
        "rail.tilt": {"angle": 0.05},
        "air.drag": {"k_d": 0.2},
        "rotor.in_plane": {"damping": 5e-4},
        "rail_z.jamming": {"mu": 0.0},
    }
    plant = place(effects, [0.0, 1.0, 0.4, 0.8, -0.5, 6.0])
    push(plant, WEIGHT, 0.05)
    on_carriage = 0.3 - 0.5 * plant.velocity[X, 0] - 0.08 * 9.81 * math.sin(0.05)
    assert plant.side_load is not None
    # Load and acceleration are a substep apart: 0.25 ms of a force that turns at 6 rad/s with 5 N.
    assert plant.side_load[0] == pytest.approx(on_carriage - 0.08 * plant.accel[X, 0], abs=0.01)


def test_friction_by_hand() -> None:
    """Friction is mu N on the guide, and on the rail mu N z over the spacing of the bearings."""
    plant = place({"rail_x.jamming": {"mu": 0.02}, "rail_z.jamming": {"mu": 0.3}}, [0.0, 1.5, 0.0, 1.0, 1.0, 0.0])
    sliding, breakaway = plant.friction.compute_levels(plant.position, plant.velocity, np.array([-2.0]))
    assert sliding[:, 0] == pytest.approx([0.02 * 2.0 * 1.5 / 0.10, 0.3 * 2.0, 0.0])
    assert breakaway is sliding
    # To the right 1.3 of the friction, to the left 0.7 of it, whatever it is made of.
    effects = {
        "rail_x.coulomb": {"force": 0.2},
        "rail_x.stiction": {"force": 0.3, "velocity": 0.05},
        "rail_x.tight_spot": {"force": 0.5, "place": 0.0, "width": 0.1},
        "rail_x.asymmetry": {"fraction": 0.3},
    }
    for velocity, share in ((0.05, 1.3), (-0.05, 0.7)):
        plant = place(effects, [0.1, 1.0, 0.0, velocity, 0.0, 0.0])
        still, zero = np.zeros((2, 1)), np.zeros((3, 1))
        slowed = plant.compute_acceleration(still, still, zero)[X, 0] * 0.58
        friction = 0.2 + 0.3 * math.exp(-1) + 0.5 * math.exp(-1)
        assert slowed == pytest.approx(-math.copysign(share * friction, velocity))


def test_gravity_turns_an_unbalanced_craft_along_a_tilted_rail() -> None:
    """Gravity pulls at the centre of mass in the direction that the tilt gives it: d = (across, along)."""
    effects = {"airframe.com": {"offset": 0.01}, "airframe.com_height": {"offset": 0.02}, "rail.tilt": {"angle": 0.05}}
    plant = place(effects, [0.0, 1.0, 0.7, 0.0, 0.0, 0.0])
    across = 0.01 * math.cos(0.7) - 0.02 * math.sin(0.7)
    along = 0.01 * math.sin(0.7) + 0.02 * math.cos(0.7)
    # Rows: momentum along x and z, angular momentum about the hinge. The craft's com accelerates by a + q' x d.
    moved = np.array(
        [
            [0.58, 0.0, -0.45 * along],
            [0.0, 0.50, 0.45 * across],
            [-0.45 * along, 0.45 * across, 0.006 + 0.45 * 0.0005],
        ]
    )
    leak = 9.81 * math.sin(0.05)
    pulled = [-0.58 * leak, -0.50 * 9.81, 0.45 * (along * leak - across * 9.81)]
    still, zero = np.zeros((2, 1)), np.zeros((3, 1))
    for _ in range(30):  # the coupling takes the acceleration of the step before
        plant.accel = plant.compute_acceleration(still, still, zero)
    assert plant.accel[:, 0] == pytest.approx(np.linalg.solve(moved, pulled), rel=1e-9)


def test_free_craft_has_no_rig() -> None:
    """Without rig the craft's own mass moves in x and z, through floor and wall, and nothing can jam."""
    plant = place({}, [1.4, 0.3, -math.pi / 2, 3.0, -3.0, 0.0], free=True)
    path = push(plant, 0.45, 0.5)
    assert path[-1, 0] == pytest.approx(1.4 + 1.5 + 0.5 * 1.0 * 0.25)
    assert path[-1, 1] == pytest.approx(0.3 - 1.5 - 0.5 * 9.81 * 0.25)
    assert plant.velocity[PITCH, 0] == 0.0
    assert plant.velocity[Z, 0] == pytest.approx(-3.0 - 4.905)
    with pytest.raises(ValueError, match="free craft"):
        place({"rail_z.jamming": {"mu": 0.3}}, [0.0] * 6, free=True)
