"""The adaptive actuator controller: on the independent stand, with sensor faults, by hand, and inside the twin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from proving.thrust_tracking import COMMANDS, NOMINAL, Spoil, Track, draw_stands, track_thrust
from vpptwin.actuators.adaptive import (
    COMMAND,
    COVARIANCE,
    DRAG,
    FAULT,
    HALF_GAP,
    NO_CURRENT,
    NO_SPEED,
    SIZE,
    SOUND,
    SPREAD,
    STUCK_CURRENT,
    TARGET,
    TRIM,
    correct_pitch,
    estimate_pitch,
    find_fault,
    learn,
    start_memory,
)
from vpptwin.actuators.blade import compute_drag_torque
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec, load_twin

DURATION, LEARNED = 7.0, 2.0
"""Of a run, and after which the controller has seen a few steps, s."""
STANDS = draw_stands(8, 0)


@cache
def track(command: str, adaptive: bool) -> Track:
    """Seven seconds on the eight stands."""
    return track_thrust(STANDS, command, DURATION, adaptive=adaptive, seed=3)


@pytest.mark.parametrize("command", ["steps", "sine, 1 Hz"])
def test_thrust_follows_the_command_four_times_closer(command: str) -> None:
    """With play, trim errors and a drag map that is 20 % off, on every rotor; 2.5 times with what it takes to learn."""
    ours, by_map = track(command, True), track(command, False)
    assert (by_map.error(LEARNED) > 4.0 * ours.error(LEARNED)).all()
    assert by_map.error().mean() > 2.5 * ours.error().mean()


def test_steps_settle_within_a_tenth_of_a_second() -> None:
    """To 5 % of every step, on every rotor."""
    assert track("steps", True).settling(LEARNED).max() <= 0.1
    assert np.median(track("steps", False).settling(LEARNED)) > 0.2


def test_what_is_wrong_is_learned() -> None:
    """Trim within 1 mrad, play within 1 mrad, drag within 1 %."""
    for command in ("steps", "sine, 1 Hz"):
        trim, half_gap, drag = track(command, True).believed[-1]
        true = np.array([[stand["servo.trim"][f"offset_{i}"] for stand in STANDS] for i in (1, 2)])
        np.testing.assert_allclose(trim, true, atol=1e-3)
        np.testing.assert_allclose(half_gap, 0.01, atol=5e-4)
        gain = np.array([stand["rotor.drag"]["gain"] for stand in STANDS])
        np.testing.assert_allclose(drag, np.broadcast_to(gain, drag.shape), rtol=0.01)


def test_no_limit_cycle() -> None:
    """Under a command that stays, after the play is known, thrust stays: no slower or faster swing than 1 % of it."""
    held = track("held", True)
    calm = held.thrust[held.time >= 5.0]
    assert np.ptp(calm, axis=0).max() < 0.06  # N: speed noise in the governor makes 0.02
    assert np.abs(calm.mean(axis=0) - 2.25).max() < 0.1


def test_rotor_speed_through_full_pitch_steps() -> None:
    """Within 2 % of 4500 rpm from one pitch stop to the other and back, and inside the usable band throughout."""
    speed = track("full steps", True).speed
    assert np.abs(speed / NOMINAL.rotor.speed - 1.0).max() < 0.02
    assert np.abs(track("full steps", False).speed / NOMINAL.rotor.speed - 1.0).max() > 0.02


def spoil(sensor: int, reading: float) -> Spoil:
    """The speed (0) or the current (1) of the first rotors reads so from 3 s to 5 s."""

    def show(time: float, *readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shown = [each.copy() for each in readings]
        if 3.0 <= time < 5.0:
            shown[sensor][0] = reading
        return shown[0], shown[1]

    return show


@pytest.mark.parametrize(
    ("sensor", "reading", "code"), [(1, 3.0, STUCK_CURRENT), (0, np.nan, NO_SPEED), (1, np.nan, NO_CURRENT)],
    ids=["stuck", "blind", "dark"],
)  # fmt: skip
def test_a_sensor_fault_falls_back_to_the_map(sensor: int, reading: float, code: int) -> None:
    """It says so within a tenth of a second; thrust is then the map's; afterwards it is as good as before."""
    ours = track_thrust(STANDS, "steps", DURATION, adaptive=True, seed=3, spoil=spoil(sensor, reading))
    by_map, untroubled = track("steps", False), track("steps", True)
    during, after = (ours.time >= 3.1) & (ours.time < 5.0), ours.time >= 5.1
    assert (ours.fault[during][:, 0] == code).all()
    assert (ours.fault[:, 1] == SOUND).all()
    assert (ours.fault[after] == SOUND).all()
    assert np.isfinite(ours.thrust).all()
    settled = (ours.time >= 3.6) & (ours.time < 5.0)
    for seconds, like in ((settled, by_map), (after, untroubled)):
        wrong, other = (
            np.sqrt(((track.thrust - track.reachable[:, None, None])[seconds] ** 2).mean(axis=0))
            for track in (ours, like)
        )
        assert (wrong[0] < 1.1 * other[0] + 0.02).all()
    # without feedback a map of drag that is 20 % off lets speed go by 5 %
    assert np.abs(ours.speed / NOMINAL.rotor.speed - 1.0).max() < (0.08 if code == NO_SPEED else 0.02)
    np.testing.assert_array_equal(ours.believed[4999, :, 0], ours.believed[2999, :, 0])


@pytest.mark.parametrize("pitch", [-0.2, -0.05, 0.0, 0.03, 0.2])
@pytest.mark.parametrize("drag", [0.8, 1.0, 1.2])
def test_pitch_from_current(pitch: float, drag: float) -> None:
    """The size of the blade pitch comes back from the current that it takes, steady or while the rotor speeds up."""
    rotor, motor, speed = NOMINAL.rotor, NOMINAL.motor, 460.0
    for acceleration in (0.0, 150.0):
        torque = drag * compute_drag_torque(rotor, speed, pitch) + rotor.inertia * acceleration
        current = motor.no_load_current + motor.k_q * torque
        assert estimate_pitch(rotor, motor, speed, current, acceleration, drag) == pytest.approx(abs(pitch), abs=1e-9)


@pytest.mark.parametrize(("pitch", "ratio"), [(0.1, 1.24), (0.2, 1.14)])
def test_drag_that_is_off_reads_as_thrust(pitch: float, ratio: float) -> None:
    """Why drag is learned too, as docs/actuators.md says: by the map 20 % more of it looks like a steeper blade."""
    rotor, motor = NOMINAL.rotor, NOMINAL.motor
    current = motor.no_load_current + motor.k_q * 1.2 * compute_drag_torque(rotor, rotor.speed, pitch)
    assert estimate_pitch(rotor, motor, rotor.speed, current, 0.0, 1.0) == pytest.approx(ratio * pitch, rel=0.005)


def test_the_papers_simplified_form() -> None:
    """α = √(g_0 (i - i_0) + g_1) - g_2 at constant speed; less current than idling takes is pitch zero."""
    rotor, motor, speed = NOMINAL.rotor, NOMINAL.motor, NOMINAL.rotor.speed
    g_0 = 1.0 / (motor.k_q * rotor.k_d2 * speed**2)
    g_2 = rotor.k_d3 / (2.0 * rotor.k_d2 * speed)
    g_1 = g_2**2 - rotor.k_d1 / rotor.k_d2
    current = np.array([3.0, 5.0, 9.0])
    expected = np.sqrt(g_0 * (current - motor.no_load_current) + g_1) - g_2
    np.testing.assert_allclose(estimate_pitch(rotor, motor, speed, current, 0.0, 1.0), expected, rtol=1e-12)
    assert estimate_pitch(rotor, motor, speed, 0.0, 0.0, 1.0) == 0.0


def test_a_command_takes_up_the_play() -> None:
    """The command leads by half the play in the direction of motion, less the trim, within the pitch stops."""
    memory = start_memory(NOMINAL.rotor.speed)
    memory[TRIM], memory[HALF_GAP], memory[COVARIANCE + 4] = 0.02, 0.01, 0.0
    assert correct_pitch(NOMINAL, memory, 0.1) == pytest.approx(0.1 - 0.02 + 0.01)
    assert correct_pitch(NOMINAL, memory, 0.1) == memory[COMMAND] == pytest.approx(0.09)
    assert correct_pitch(NOMINAL, memory, 0.098) == pytest.approx(0.098 - 0.02 + 0.005)  # halfway to the other side
    assert correct_pitch(NOMINAL, memory, 0.05) == pytest.approx(0.05 - 0.02 - 0.01)
    assert correct_pitch(NOMINAL, memory, -0.21) == pytest.approx(-0.21)
    memory[FAULT] = NO_SPEED
    assert correct_pitch(NOMINAL, memory, 0.1) == 0.1
    assert memory[TARGET] == 0.1
    memory[FAULT], memory[HALF_GAP] = SOUND, 0.0
    memory[COVARIANCE + 4] = 0.5 * SPREAD[1] ** 2
    assert correct_pitch(NOMINAL, memory, 0.1) == pytest.approx(0.1 - 0.5 * 0.02)


def test_with_nothing_learned_it_is_the_map() -> None:
    """The first command of a controller that knows nothing is what was asked for."""
    memory = start_memory(NOMINAL.rotor.speed)
    for pitch in (0.1, -0.05, 0.2):
        assert correct_pitch(NOMINAL, memory, pitch) == pitch


def test_faults_by_hand() -> None:
    """A steady current is stuck only if the throttle moves meanwhile; numbers that are none count at once."""
    memory = start_memory(400.0)
    for _ in range(200):
        find_fault(memory, 400.0, 2.0, 0.4)
    assert memory[FAULT] == SOUND
    find_fault(memory, 400.0, 2.0, 0.45)
    assert memory[FAULT] == STUCK_CURRENT
    find_fault(memory, 400.0, 2.0, 0.4)
    assert memory[FAULT] == STUCK_CURRENT
    find_fault(memory, 400.0, 2.1, 0.4)
    assert memory[FAULT] == SOUND
    for speed, current, code in (
        (np.nan, 2.0, NO_SPEED), (0.0, 2.0, NO_SPEED), (1e9, 2.0, NO_SPEED), (400.0, np.nan, NO_CURRENT),
        (400.0, np.inf, NO_CURRENT),
    ):  # fmt: skip
        find_fault(memory, speed, current, 0.4)
        assert memory[FAULT] == code


def test_nonsense_leaves_beliefs_within_reason() -> None:
    """Sensors that lie about everything cannot make the correction larger than what a linkage may have."""
    random, memory = np.random.default_rng(0), start_memory(470.0)
    for _ in range(3000):
        learn(NOMINAL, memory, float(random.uniform(100.0, 900.0)), float(random.uniform(-50.0, 50.0)), 0.5, 0.001)
        command = correct_pitch(NOMINAL, memory, float(random.uniform(-0.2, 0.2)))
        assert abs(command) <= NOMINAL.rotor.pitch_max
    assert np.isfinite(memory).all()
    assert abs(memory[TRIM]) <= 0.08
    assert 0.4 <= memory[DRAG] <= 2.5


@pytest.fixture(scope="module", params=["straight map", "bent map"])
def hidden(request: pytest.FixtureRequest) -> TwinSpec:
    """The drone with what the controller is there for, by the paper's map and by one a bench may have found."""
    spec, rotor = load_twin(), NOMINAL.rotor
    if request.param == "bent map":
        bent = {"k_t": 0.75 * rotor.k_t, "k_t2": 0.25 * rotor.k_t / rotor.pitch_max, "thrust_power": 2.0}
        spec = spec.with_robot(rotorcraft=NOMINAL.model_copy(update={"rotor": rotor.model_copy(update=bent)}))
    effects = {
        "servo.trim": {"offset_1": 0.015, "offset_2": -0.01}, "servo.backlash": {"gap": 0.02},
        "rotor.drag": {"gain": 1.2},
    }  # fmt: skip
    return spec.with_effects(effects)


def test_it_learns_inside_the_twin(hidden: TwinSpec) -> None:
    """Flown through both signs of pitch, the twin's controller finds what is hidden in it; the map's has no memory."""
    for controller in ("adaptive", "map"):
        twin = Twin(hidden.with_controller(controller), 2, num_threads=1)
        state = twin.initial_state()
        for k in range(300):
            thrust = (6.0, -2.0, 8.0, 4.0)[k // 15 % 4]
            tilt, height = state.qpos[:, 2], state.qpos[:, 1] - 1.3
            lift = 5.0 * np.sign(np.cos(tilt)) + (thrust - 4.0 - 6.0 * height - 3.0 * state.qvel[:, 1])
            twin.advance_policy(state, np.column_stack([lift, -4.0 * tilt]))
        assert state.finite().all()
        if controller == "map":
            assert state.actuators["adaptive"].shape == (2, 2, 0)
            continue
        learned = state.actuators["adaptive"]
        assert learned.shape == (2, 2, SIZE)
        np.testing.assert_allclose(learned[0], learned[1])
        np.testing.assert_allclose(learned[0, :, TRIM], [0.015, -0.01], atol=4e-3)
        np.testing.assert_allclose(learned[0, :, HALF_GAP], 0.01, atol=1e-3)
        np.testing.assert_allclose(learned[0, :, DRAG], 1.2, rtol=0.05)
        assert (learned[:, :, FAULT] == SOUND).all()


def test_a_flight_that_shows_little_is_not_believed_to_show_much() -> None:
    """Upright throughout, trim and drag trade against each other: errors are what the filter says."""
    ids = {"servo.trim": ("offset_1", "offset_2"), "servo.backlash": ("gap",), "rotor.drag": ("gain",)}
    stands, nominal = draw_stands(16, 5), load_twin("nominal")
    spec = nominal.with_effects({effect: {} for effect in ids}).with_controller("adaptive")
    twin = Twin(spec, len(stands), num_threads=1)
    for effect, names in ids.items():
        for name in names:
            twin.set_parameter(effect, name, np.array([stand[effect][name] for stand in stands]))
    state = twin.initial_state()
    for k in range(400):
        height = 1.3 + 0.2 * np.sign(np.sin(0.06 * k))
        lift = 5.0 - 8.0 * (state.qpos[:, 1] - height) - 4.0 * state.qvel[:, 1]
        twin.advance_policy(state, np.column_stack([lift, -4.0 * state.qpos[:, 2] - 0.5 * state.qpos[:, 0]]))
    learned = state.actuators["adaptive"]
    trim = np.array([[stand["servo.trim"][f"offset_{i}"] for i in (1, 2)] for stand in stands])
    drag = np.array([[stand["rotor.drag"]["gain"]] for stand in stands])
    for error, place in ((learned[..., TRIM] - trim, 4), (learned[..., DRAG] - drag, 9)):
        sigma = np.sqrt(learned[..., COVARIANCE + place])
        assert np.sqrt((error**2 / sigma**2).mean()) < 2.0
        assert (np.abs(error) < 4.0 * sigma).all()


def test_controllers_are_named(tmp_path: Path) -> None:
    """A twin YAML says which controller flies; others are refused, and rigs that are not the drone have none."""
    file = tmp_path / "twin.yaml"
    file.write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\ncontroller: adaptive\n")
    assert load_twin(file).controller == "adaptive"
    assert load_twin("nominal").controller == "map"
    file.write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\ncontroller: clever\n")
    with pytest.raises(InputError, match="controller = 'clever'; expected 'map' or 'adaptive'"):
        load_twin(file)
    with pytest.raises(InputError, match="unknown controller 'clever'; expected one of map, adaptive"):
        load_twin("nominal").with_controller("clever")
    joints = "{rail_x: /joint_states, rail_z: /joint_states, pitch: /joint_states}"
    file.write_text(f"model: rail_rig.xml\ncontroller: adaptive\nsignals: {{joints: {joints}}}\n")
    with pytest.raises(InputError, match="controller 'adaptive' without vehicle"):
        load_twin(file)
    assert replace(load_twin("nominal"), controller="adaptive").controller == "adaptive"


def test_every_command_stays_within_a_rotor() -> None:
    """What the tests ask for can be reached by the nominal rotor."""
    most = NOMINAL.rotor.k_t * NOMINAL.rotor.speed * NOMINAL.rotor.pitch_max
    for command in COMMANDS.values():
        assert np.abs(command(np.arange(0.0, 8.0, 0.001))).max() <= most + 0.01
