"""Effects outside the catalogue, and laws of another form, act in the independent simulation as outside.py says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from proving.drone import ALIEN, ALIEN_KINDS, CORE, EXTENDED, FORMS, draw_small, find_also, find_known, fly
from proving.drone.effects import Effects
from proving.drone.plant import Plant
from proving.drone.rig import PITCH, Rig, X, Z
from proving.drone.rotor import NODES, SUBSTEPS, Propeller, Servo
from vpptwin.effects import CATALOGUE

WEIGHT = 4.905  # N, of craft and slider, 0.50 kg; with the carriage 0.58 kg move along x


def place(effects: Effects, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), x: float = 0.0) -> Plant:
    """One upright rig at x m and 1 m height, with velocities m/s, m/s, rad/s."""
    return Plant(Rig([effects], [None]), np.array([[x], [1.0], [0.0]]), np.array(velocity)[:, None])


def feel(plant: Plant, thrust: tuple[float, float] = (WEIGHT / 2, WEIGHT / 2)) -> np.ndarray:
    """Force N, N and moment N m beyond those of the nominal rig. (3,)."""
    still, calm = np.zeros((2, 1)), np.zeros((3, 1))
    plain = Plant(Rig([{}], [None]), plant.position, plant.velocity)
    lift = np.array(thrust)[:, None]
    apart = plant.compute_acceleration(lift, still, calm) - plain.compute_acceleration(lift, still, calm)
    return apart[:, 0] * plant.rig.moved[:, 0]


def coast(plant: Plant, duration: float) -> np.ndarray:
    """Fly with the weight carried; velocities along x, m/s. (steps,)."""
    lift, calm = np.full((len(NODES), 2, 1), WEIGHT / 2), np.zeros((SUBSTEPS, 3, 1))
    speeds = []
    for _ in range(round(duration * 1000)):
        plant.advance(lift, np.zeros_like(lift), calm)
        speeds.append(float(plant.velocity[X, 0]))
    return np.array(speeds)


def test_tables_hang_together() -> None:
    """Every alien has a kind, each kind two at least; forms are of effects that are drawn, and so is what is akin."""
    assert set(ALIEN_KINDS) == set(ALIEN)
    kinds = list(ALIEN_KINDS.values())
    assert {kind: kinds.count(kind) >= 2 for kind in kinds} == dict.fromkeys(kinds, True)
    for form in FORMS.values():
        assert form.nearest in CORE | EXTENDED
        assert set(form.also) <= {effect.id for effect in CATALOGUE}
    hidden = {"form.creep": {}, "alien.hum": {}, "rail.tilt": {}}
    assert find_known(hidden) == {"rail_x.coulomb", "rail.tilt"}
    assert find_also(hidden) == {"rail_x.viscous", "rail_x.lugre"}


@pytest.mark.parametrize(
    ("effects", "velocity", "force"),
    [
        ({"form.creep": {"force": 0.3, "velocity": 0.05}}, (0.05, 0.0, 0.0), (-0.3 * math.tanh(1.0), 0.0, 0.0)),
        ({"form.grease": {"damping": 0.4, "exponent": 0.7}}, (0.0, -0.5, 0.0), (0.0, 0.4 * 0.5**0.7, 0.0)),
        # Speed 0.5 m/s: k |v|^0.7 v
        ({"form.drag": {"k_d": 0.2, "exponent": 1.7}}, (0.3, 0.4, 0.0), (-0.06 * 0.5**0.7, -0.08 * 0.5**0.7, 0.0)),
        ({"form.ground": {"gain": 0.5, "height": 0.5}}, (0.0, 0.0, 0.0), (0.0, WEIGHT * 0.5 / 27, 0.0)),
        ({"form.stribeck": {"force": 0.3, "velocity": 0.05}}, (-0.1, 0.0, 0.0), (0.3 * math.exp(-2.0), 0.0, 0.0)),
        ({"alien.swirl": {"gain": -0.01}}, (0.5, 0.0, 4.0), (0.0, 0.0, -0.02)),
        ({"alien.crosswind": {"gain": 0.2}}, (0.5, -2.0, 0.0), (-0.2, 0.0, 0.0)),
    ],
)
def test_laws(effects: Effects, velocity: tuple[float, float, float], force: tuple[float, float, float]) -> None:
    """Each force as its formula says, at 1 m height, upright."""
    assert feel(place(effects, velocity)) == pytest.approx(force, abs=1e-9)


def test_forces_that_depend_on_place_time_and_the_way() -> None:
    """A spring hardens: half a stretch away from rest it pulls by a quarter more than a straight one."""
    plant = place({"form.spring": {"stiffness": 0.8, "rest": 0.1, "stretch": 0.8}}, x=0.5)
    assert feel(plant)[X] == pytest.approx(-0.8 * 0.4 * 1.25)
    # 0.4 N at 2 Hz: nothing at the start, the whole an eighth of a second on, nothing after a quarter.
    plant = place({"alien.hum": {"force": 0.4, "frequency": 2.0}})
    assert feel(plant)[Z] == 0.0
    coast(plant, 0.125)
    assert feel(plant)[Z] == pytest.approx(0.4, abs=1e-3)
    coast(plant, 0.125)
    assert feel(plant)[Z] == pytest.approx(0.0, abs=1e-3)
    # After ten reaches to the right the whole force pulls left, and still does at rest; after one reach 63 % of it.
    for way, share in ((0.2, 1 - math.exp(-1)), (2.0, 1.0)):
        plant = place({"alien.hysteresis": {"force": 0.5, "reach": 0.2}})
        for _ in range(1000):
            plant.foreign.advance(np.full((3, 1), way), np.zeros((3, 1)), 0.001)
        assert feel(plant)[X] == pytest.approx(-0.5 * share, abs=2e-3)
    # 2 N more on rotor 2 push a fifth of that along body x, beside their moment, which the nominal rig has too.
    assert feel(place({"alien.side_thrust": {"gain": 0.2}}), (1.5, 3.5)) == pytest.approx([0.4, 0.0, 0.0])


def test_hanging_mass_stays_behind_fast_and_goes_along_slowly() -> None:
    """Lifted with 1 m/s^2 a craft is 0.1 kg lighter at first, half a period on heavier, as ever once it has died."""
    plant = place({"alien.slosh": {"mass": 0.1, "frequency": 1.0}})
    spared = []
    for k in range(40_001):
        plant.foreign.advance(np.zeros((3, 1)), np.ones((3, 1)), 0.001)
        if k in (0, 500, 40_000):
            spared.append(feel(plant)[Z])
    # After half a period, damped by exp(-0.05 pi) = 0.855, it swings as far below its new rest.
    assert spared == pytest.approx([0.1, -0.0855, 0.0], abs=2e-3)


def test_blade_breaks_at_its_time() -> None:
    """From then on rotor 1 lacks the share; rotor 2 does not, and it breaks once."""
    propeller = Propeller(Rig([{"alien.chip": {"loss": 0.1, "time": 2.0}}], [None]))
    pitch, speed = np.full((1, 2, 1), 0.1), np.full((1, 2, 1), 471.0)
    whole = propeller.compute_thrust(pitch, speed)
    for time, share in ((1.999, 1.0), (2.0, 0.9), (3.0, 0.9)):
        propeller.break_blade(time)
        np.testing.assert_allclose(propeller.compute_thrust(pitch, speed)[0, :, 0], whole[0, :, 0] * [share, 1.0])


def test_two_lags_in_a_row() -> None:
    """A step through two lags of 15 ms: 1 - (1 + t / 15 ms) exp(-t / 15 ms); beside it a servo with one is as ever."""
    lags = Rig([{"form.lag": {"time_constant": 0.03}}, {}], [None, None])
    servo, alone = Servo(lags, np.zeros((2, 2))), Servo(Rig([{}], [None]), np.zeros((2, 1)))
    pitch = np.array([servo.advance(np.full((2, 2), 0.1))[-1] for _ in range(80)])
    time = np.arange(1, 81) * 0.001 / 0.015
    np.testing.assert_allclose(pitch[:, 0, 0], 0.1 * (1 - (1 + time) * np.exp(-time)), atol=2e-5)
    plain = np.array([alone.advance(np.full((2, 1), 0.1))[-1] for _ in range(80)])
    np.testing.assert_array_equal(pitch[:, :, 1], plain[:, :, 0])


@pytest.mark.slow
def test_gyro_feels_acceleration() -> None:
    """The reading is off by gain times what the accelerometer shows beyond 1 g along body z."""
    flights = [fly(effects, "aggressive", 3.0, 7, gusts=False, jitter=False, dropouts=False)
               for effects in ({}, {"alien.g_sensitivity": {"gain": 0.02}})]  # fmt: skip
    off = []
    for flight in flights:
        truth, imu = flight.truth, flight.topics["/imu/data"].columns
        off.append(-imu["wy"] - truth["velocity"][:, PITCH])
        lift = imu["az"] - 9.81
    assert abs(np.polyfit(flights[0].topics["/imu/data"].columns["az"] - 9.81, off[0], 1)[0]) < 0.002
    assert np.polyfit(lift, off[1], 1)[0] == pytest.approx(0.02, rel=0.1)


def test_small_deviations_keep_off_what_looks_like_the_hidden() -> None:
    """Beside tilt neither bias nor misalignment nor, their own look-alike, anything twice."""
    for seed in range(100):
        small = draw_small(np.random.default_rng(seed), {"rail.tilt": {}}, (*CORE, *EXTENDED))
        assert len(small) <= 2
        assert not {"rail.tilt", "rail_x.bias", "mocap.misalignment"} & set(small)
