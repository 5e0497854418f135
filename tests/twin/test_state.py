"""State is an argument and a result: nothing is shared, nothing is kept, rows are independent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.twin.hover import assert_states
from vpptwin.actuators.layer import constants_dtype, layer_dtype, nominal_constants
from vpptwin.twin import Twin, TwinState, load_twin
from vpptwin.twin.stepping import kernel
from vpptwin.twin.stepping.kernel import find_first

SPEC = load_twin()
ACTIVE = ("rail_x.coulomb", "command.delay", "air.drag", "rotor.thrust_gain", "airframe.mass", "rail_x.lugre",
          "rail_x.elastic")  # fmt: skip


def freeze(state: TwinState) -> dict[str, np.ndarray]:
    """Make writing to a state raise; returns a copy of what it holds."""
    for array in (state.time, state.qpos, state.qvel, state.warmstart, state.memory, state.effects, state.actuators):
        array.flags.writeable = False
    return {name: array.copy() for name, array in state.arrays().items()}


def assert_equal(state: TwinState, content: dict[str, np.ndarray]) -> None:
    """A state holds exactly these arrays."""
    for name, array in state.arrays().items():
        np.testing.assert_array_equal(array, content[name], err_msg=name)


def assert_apart(first: TwinState, second: TwinState) -> None:
    """Two states share no memory."""
    for (name, a), (_, b) in zip(first.arrays().items(), second.arrays().items(), strict=True):
        assert a.size == 0 or not np.shares_memory(a, b), name


@pytest.fixture
def twin() -> Twin:
    """Four simulations with different parameters."""
    twin = Twin(SPEC, 4, active=ACTIVE, num_threads=1)
    twin.set_parameter("rail_x.coulomb", "force", np.array([0.0, 0.1, 0.2, 0.3]))
    twin.set_parameter("command.delay", "delay", np.array([0.0, 0.001, 0.0025, 0.01]))
    twin.set_parameter("rail_x.lugre", "compliance", np.array([0.0, 1e-3, 2e-3, 5e-3]))
    twin.set_parameter("rail_x.elastic", "share", np.array([0.0, 0.1, 0.2, 0.3]))
    return twin


@pytest.fixture
def flown(twin: Twin) -> TwinState:
    """A state mid-flight, every array of it different from zero somewhere."""
    start = twin.initial_state(qvel=np.random.default_rng(0).normal(size=(4, 3)))
    return twin.step_policy(start, command(twin, 1), 0.05)


def command(twin: Twin, seed: int) -> np.ndarray:
    """Random thrusts and rates, (N, 2)."""
    return np.random.default_rng(seed).normal([5.0, 0.0], [1.0, 3.0], (twin.num_sims, 2))


def test_step_policy_leaves_its_arguments(twin: Twin, flown: TwinState) -> None:
    """Flying on from a state changes neither it nor the command, and gives a state of its own."""
    wanted = command(twin, 2)
    wanted.flags.writeable = False
    before = freeze(flown)
    after = twin.step_policy(flown, wanted, 0.02)
    twin.step_policy(after, wanted, 0.02)
    assert_equal(flown, before)
    assert_apart(flown, after)
    np.testing.assert_allclose(after.time - flown.time, 0.02, rtol=1e-9)


def test_replay_leaves_its_arguments(twin: Twin, flown: TwinState) -> None:
    """Replaying changes neither state, commands, speeds nor disturbance, and what it returns is its own."""
    rng = np.random.default_rng(4)
    blades, speed = rng.uniform(0.05, 0.15, (4, 30, 2)), rng.uniform(440, 500, (4, 30, 2))
    push = rng.normal(size=(4, 3, 3))
    for array in (blades, speed, push):
        array.flags.writeable = False
    before = freeze(flown)
    after, qpos, qvel, _ = twin.replay_commands(flown, blades, speed, disturbance=push)
    assert_equal(flown, before)
    assert_apart(flown, after)
    for name, array in after.arrays().items():
        assert not any(np.shares_memory(array, given) for given in (blades, speed, push)), name
    held = qpos.copy(), qvel.copy(), {name: array.copy() for name, array in after.arrays().items()}
    twin.step_policy(after, command(twin, 5))
    np.testing.assert_array_equal(qpos, held[0])
    np.testing.assert_array_equal(qvel, held[1])
    assert_equal(after, held[2])
    np.testing.assert_array_equal(qpos[:, -1], after.qpos)
    np.testing.assert_array_equal(after.rotor_speed, speed[:, -1])


def test_initial_state_is_a_copy(twin: Twin) -> None:
    """Positions given for a start are copied, for one simulation or for all."""
    pose = np.tile([0.1, 1.2, 0.3], (4, 1))
    state = twin.initial_state(qpos=pose)
    assert not np.shares_memory(state.qpos, pose)
    np.testing.assert_array_equal(twin.initial_state(qpos=pose[0]).qpos, pose)
    first, second = twin.initial_state(), twin.initial_state()
    assert_apart(first, second)
    np.testing.assert_array_equal(first.qpos, [[0.0, 1.0, 0.0]] * 4)


def test_taking_and_copying_share_nothing(flown: TwinState) -> None:
    """Rows taken from a state, with repeats, and copies of it, are equal and independent."""
    content = {name: array.copy() for name, array in flown.arrays().items()}
    for ids in (np.array([2, 0, 2]), np.arange(4)):
        rows = flown.take(ids)
        assert_equal(rows, {name: array[ids] for name, array in content.items()})
        assert_apart(flown, rows)
    copy = flown.copy()
    assert_apart(flown, copy)
    for array in copy.arrays().values():
        array[:] = -1
    assert_equal(flown, content)


def test_replacing_rows_shares_nothing(twin: Twin, flown: TwinState) -> None:
    """Exchanged rows come from the other state, the rest stays; `write_rows` does in place what this does to a copy."""
    ids = np.array([3, 1])
    rows = twin.initial_state().take(np.array([0, 1]))
    before, given = freeze(flown), freeze(rows)
    mixed, written = flown.replace_rows(ids, rows), flown.copy()
    written.write_rows(ids, rows)
    assert_states(written, mixed)
    assert_apart(written, rows)
    for name, array in mixed.arrays().items():
        np.testing.assert_array_equal(array[ids], given[name], err_msg=name)
        np.testing.assert_array_equal(array[[0, 2]], before[name][[0, 2]], err_msg=name)
        array[:] = -1
    assert_apart(mixed, flown)
    assert_apart(mixed, rows)
    assert_equal(flown, before)
    assert_equal(rows, given)


def test_partial_reset_continues_as_new(twin: Twin, flown: TwinState) -> None:
    """A row reset mid-flight flies bit for bit as from a fresh start, the others as if nothing had happened."""
    fresh, ids = twin.initial_state(qvel=np.full(3, 0.3)), np.array([1, 3])
    mixed = flown.replace_rows(ids, fresh.take(ids))
    wanted = command(twin, 6)
    both = twin.step_policy(mixed, wanted, 0.05)
    started, continued = twin.step_policy(fresh, wanted, 0.05), twin.step_policy(flown, wanted, 0.05)
    others = np.array([0, 2])
    assert_states(both.take(ids), started.take(ids))
    assert_states(both.take(others), continued.take(others))


def test_two_short_steps_are_one_long_one(twin: Twin, flown: TwinState) -> None:
    """20 ms and 30 ms under the same command end bit-equal to 50 ms; in place a state keeps its arrays."""
    wanted, state = command(twin, 7), flown.copy()
    before = [state.qpos, state.actuators, state.memory]
    twin.advance_policy(state, wanted, 0.02)
    twin.advance_policy(state, wanted, 0.03)
    assert_states(state, twin.step_policy(flown, wanted, 0.05))
    assert_states(twin.step_policy(twin.step_policy(flown, wanted, 0.02), wanted, 0.03), state)
    assert all(now is then for now, then in zip([state.qpos, state.actuators, state.memory], before))


def test_parameters_differ_per_simulation() -> None:
    """Equal starts under equal commands part ways when one parameter differs, in the order of its values."""
    twin = Twin(SPEC, 3, active=ACTIVE)
    for effect_id, parameter, values in (
        ("airframe.mass", "mass", [-0.05, 0.0, 0.05]),
        ("rotor.thrust_gain", "gain", [1.1, 1.0, 0.9]),
        ("air.drag", "k_d", [0.0, 0.1, 0.2]),
    ):
        twin.set_parameter(effect_id, parameter, np.array(values))
        rising = twin.initial_state(qpos=np.array([0.0, 1.2, 0.0]), qvel=np.array([0.0, 1.0, 0.0]))
        after = twin.step_policy(rising, np.tile([8.0, 0.0], (3, 1)), 0.2)
        assert (np.diff(after.qpos[:, 1]) < -1e-3).all(), effect_id  # m
        effect = twin.effects[effect_id]
        twin.set_parameter(effect_id, parameter, effect.parameter(parameter).off)
        same = twin.step_policy(rising, np.tile([8.0, 0.0], (3, 1)), 0.2)
        assert np.ptp(same.qpos, axis=0).max() == 0.0


def test_parameters_of_some_simulations(twin: Twin) -> None:
    """Values for some ids go to these simulations; what is read back is a copy, constants included."""
    twin.set_parameter("rail_x.coulomb", "force", np.array([0.7, 0.8]), ids=np.array([3, 0]))
    read = twin.parameter("rail_x.coulomb", "force")
    np.testing.assert_array_equal(read, [0.8, 0.1, 0.2, 0.7])
    twin.set_parameter("airframe.mass", "mass", np.array([0.05, 0.1]), ids=np.array([3, 0]))
    constant = twin.constant("body_mass")
    np.testing.assert_array_equal(constant[:, -1], 0.45 + np.array([0.1, 0.0, 0.0, 0.05]))
    read[:] = 9.0
    constant[:] = 9.0
    np.testing.assert_array_equal(twin.parameter("rail_x.coulomb", "force"), [0.8, 0.1, 0.2, 0.7])
    assert twin.constant("body_mass").max() == 0.45 + 0.1
    earlier = twin.constant("actuator.delay")
    twin.set_parameter("command.delay", "delay", 0.004)
    np.testing.assert_array_equal(earlier[:, 0], [0.0, 0.001, 0.0025, 0.01])
    np.testing.assert_array_equal(twin.constant("actuator.delay"), np.full((4, 2), 0.004))


def test_two_twins_of_one_spec_are_independent() -> None:
    """Parameters of one twin do not reach another of the same spec."""
    first, second = (Twin(SPEC, 2, active=["airframe.mass"]) for _ in range(2))
    first.set_parameter("airframe.mass", "mass", 0.1)
    assert first.constant("body_mass")[0, -1] == pytest.approx(0.55)
    assert second.constant("body_mass")[0, -1] == SPEC.model.body("craft").mass[0] == 0.45


def test_pose_and_engine_position_are_inverse(twin: Twin) -> None:
    """The engine's position leads the pose by half a step of the velocity, and the two functions undo each other."""
    rng = np.random.default_rng(8)
    pose, velocity = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    engine = twin.pose_for_engine(pose, velocity)
    np.testing.assert_allclose(engine - pose, 0.0005 * velocity, rtol=1e-9)
    np.testing.assert_allclose(twin.pose_at_time(engine, velocity), pose, atol=1e-15)


def test_disturbance_is_a_force_held_in_turn(twin: Twin, flown: TwinState) -> None:
    """Three segments of disturbance act one third of the steps each, as so large a bias would."""
    blades, push = np.full((4, 30, 2), 0.1), np.zeros((4, 3, 3))
    push[:, 1, 0] = 0.6
    after = twin.replay_commands(flown, blades, np.full((4, 30, 2), 470.0), disturbance=push).state
    biased = Twin(SPEC, 4, active=(*ACTIVE, "rail_x.bias"), num_threads=1)
    for effect_id, effect in twin.effects.items():
        for p in effect.parameters:
            biased.set_parameter(effect_id, p.name, twin.parameter(effect_id, p.name))
    state = flown
    for force in (0.0, 0.6, 0.0):
        biased.set_parameter("rail_x.bias", "force", force)
        state = biased.replay_commands(state, blades[:, :10], np.full((4, 10, 2), 470.0)).state
    assert_states(after, state)
    without = twin.replay_commands(flown, blades, np.full((4, 30, 2), 470.0)).state
    assert (after.qvel[:, 0] - without.qvel[:, 0] > 0.003).all()  # 0.6 N for 10 ms on 0.6 kg, less friction


def test_rotors_can_be_simulated_from_throttle(twin: Twin, flown: TwinState) -> None:
    """Replayed with throttles instead of measured speeds, rotors speed up and slow down by themselves."""
    throttle = np.full((4, 100, 2), 0.45) * np.array([1.0, 0.5])
    after = twin.replay_commands(flown, np.full((4, 100, 2), 0.1), throttle=throttle).state
    assert (after.rotor_speed[:, 0] > 450.0).all()
    assert (after.rotor_speed[:, 1] < 350.0).all()
    np.testing.assert_array_equal(after.throttle, throttle[:, -1])


def test_motors_run_beside_measured_speeds(flown: TwinState) -> None:
    """With throttles beside measured speeds the craft flies by the speeds alone, and the rotors by throttles alone."""
    motors = Twin(SPEC, 4, active=("rotor.drag", "battery.sag"), num_threads=1)
    motors.set_parameter("rotor.drag", "gain", np.array([1.0, 0.85, 1.0, 1.2]))
    motors.set_parameter("battery.sag", "rate", np.array([0.0, 0.0, 0.01, 0.01]))
    start = motors.initial_state(qpos=flown.qpos, qvel=flown.qvel, time=10.0)
    rng = np.random.default_rng(14)
    blades, speed = rng.uniform(0.05, 0.15, (4, 50, 2)), rng.uniform(440.0, 500.0, (4, 50, 2))
    throttle = rng.uniform(0.3, 0.5, (4, 50, 2))
    both = motors.replay_commands(start, blades, speed, throttle)
    measured, simulated = (
        motors.replay_commands(start, blades, speed),
        motors.replay_commands(start, blades, None, throttle),
    )
    np.testing.assert_array_equal(both.qpos, measured.qpos)
    np.testing.assert_array_equal(both.qvel, measured.qvel)
    assert both.rotor_speed is not None
    np.testing.assert_array_equal(both.rotor_speed, simulated.rotor_speed)
    np.testing.assert_array_equal(both.state.actuators["mean_speed"], speed[:, -1])
    assert np.abs(np.diff(both.rotor_speed[:, -1, 0])).min() > 1.0  # rad/s: drag and battery show


def test_tracks_come_after_every_step(twin: Twin, flown: TwinState) -> None:
    """Track and rotor speeds of a replay are those after each of its steps; no speeds where no motor is simulated."""
    rng = np.random.default_rng(15)
    blades, throttle = rng.uniform(0.05, 0.15, (4, 12, 2)), rng.uniform(0.3, 0.5, (4, 12, 2))
    flight, state = twin.replay_commands(flown, blades, throttle=throttle), flown
    assert flight.rotor_speed is not None
    for k in range(12):
        state = twin.replay_commands(state, blades[:, k : k + 1], throttle=throttle[:, k : k + 1]).state
        for track, here in zip(flight[1:], (state.qpos, state.qvel, state.rotor_speed), strict=True):
            np.testing.assert_array_equal(track[:, k], here)
    assert twin.replay_commands(flown, blades).rotor_speed is None
    measured = twin.replay_commands(flown, blades, np.full((4, 12, 2), 450.0))
    assert measured.rotor_speed is None
    np.testing.assert_array_equal(measured.state.rotor_speed, 450.0)


def test_warm_up_moves_the_actuators_alone(twin: Twin) -> None:
    """Past commands run through delay and lag leave the actuators as a replay of them does."""
    start, blades = twin.initial_state(), np.random.default_rng(9).uniform(0.05, 0.15, (4, 40, 2))
    layer = twin.warm_up(start.actuators, blades)
    replayed = twin.replay_commands(start, blades).state
    for name in ("horn", "blade", "output", "mean", "history", "newest"):
        np.testing.assert_array_equal(layer[name], replayed.actuators[name], err_msg=name)
    assert np.ptp(layer["output"][:, 0]) > 1e-4  # four delays, four states
    assert start.actuators["output"].max() == 0.0


def test_equal_actuators_are_warmed_up_once(twin: Twin) -> None:
    """Simulations of one number whose constants are equal too get what each would get by itself; others their own."""
    start, drawn = twin.initial_state(), np.random.default_rng(9).uniform(0.05, 0.15, (2, 40, 2))
    number = np.array([0, 1, 1, 0])
    alone = twin.warm_up(start.actuators, drawn[number])
    np.testing.assert_array_equal(twin.warm_up(start.actuators, drawn, number), alone)
    assert len(np.unique(alone["output"][:, 0])) == 4  # four delays
    spec = load_twin()
    same = Twin(spec, 4)
    layer = same.warm_up(same.initial_state().actuators, drawn, number)
    np.testing.assert_array_equal(layer["blade"][number == 0], layer["blade"][[0, 0]])
    np.testing.assert_array_equal(layer, same.warm_up(same.initial_state().actuators, drawn[number]))


def test_actuators_that_forget_are_not_run_through_all_of_the_past(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the last digit: some have lag, play, a rate that limits them or a delay, and one has a large step ahead."""
    layer, constants = np.zeros(6, layer_dtype(2, 30)), np.zeros(6, constants_dtype(2, 3))
    for name, value in nominal_constants(0.0, constants).items():
        constants[name] = value
    constants["actuator.time_constant"][1, 0] = 0.02
    constants["actuator.gap"][2] = 0.02
    constants["actuator.rate_limit"][3] = 50.0
    constants["actuator.delay"] = np.array([0.0, 0.01, 0.0073, 0.02, 0.028, 0.0])[:, None]
    constants["actuator.rate_limit"][4:] = 1000.0
    layer["horn"][5, 1] = 0.6  # as far away as a step reaches, nearly
    past, rows = np.random.default_rng(3).uniform(-0.2, 0.2, (2, 150, 2)), np.array([0, 1, 0, 1, 0, 1])
    forgets = np.array([[1, 1], [0, 1], [0, 0], [0, 0], [0, 0], [0, 0]], bool) | (np.arange(6) > 3)[:, None]
    forgets[5, 1] = False
    np.testing.assert_array_equal(find_first(layer, constants, past, 0.001) > 0, forgets)
    found = kernel.warm_up(layer, constants, past, rows, 0.001)
    monkeypatch.setattr(kernel, "find_first", lambda *given: np.zeros_like(find_first(*given)))
    np.testing.assert_array_equal(found, kernel.warm_up(layer, constants, past, rows, 0.001))


def test_arrays_make_the_state_again(twin: Twin, flown: TwinState) -> None:
    """A state made of another's arrays is equal, independent, and flies on bit-equal."""
    again = TwinState.from_arrays(flown.arrays())
    assert_states(again, flown)
    assert_apart(again, flown)
    assert again.actuators.dtype == flown.actuators.dtype
    wanted = command(twin, 11)
    assert_states(twin.step_policy(again, wanted), twin.step_policy(flown, wanted))


@pytest.mark.parametrize(
    "name", ["qpos", "qvel", "memory", "effects", "actuators.horn", "actuators.history", "actuators.gyro"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_finite_tells_broken_rows(flown: TwinState, name: str, value: float) -> None:
    """A row with one number that is none is told, wherever it is; the others are sound."""
    assert flown.finite().all()
    arrays = flown.copy().arrays()
    arrays[name][2, ...].reshape(-1)[-1:] = value
    np.testing.assert_array_equal(TwinState.from_arrays(arrays).finite(), [True, True, False, True])


def test_broken_row_leaves_the_others_alone(twin: Twin, flown: TwinState) -> None:
    """A simulation that has diverged neither restarts by itself nor touches its neighbours."""
    broken = flown.copy()
    broken.qvel[2] = np.nan
    wanted, others = command(twin, 12), np.array([0, 1, 3])
    after = twin.step_policy(broken, wanted, 0.02)
    np.testing.assert_array_equal(after.finite(), [True, True, False, True])
    sound = twin.step_policy(flown, wanted, 0.02)
    assert_states(after.take(others), sound.take(others))
    np.testing.assert_array_equal(after.time, sound.time)
    healed = after.replace_rows(np.array([2]), flown.take(np.array([2])))
    mixed = sound.replace_rows(np.array([2]), flown.take(np.array([2])))
    assert_states(twin.step_policy(healed, wanted), twin.step_policy(mixed, wanted))


@pytest.mark.parametrize("value", [-0.01, 2.5, np.nan, np.inf])
def test_values_outside_the_bounds_are_refused(twin: Twin, value: float) -> None:
    """A friction that can't be is refused with the bounds, and the twin stays as it was."""
    with pytest.raises(ValueError, match=r"rail_x\.coulomb\.force = .* N; expected 0 to 2"):
        twin.set_parameter("rail_x.coulomb", "force", np.array([0.1, value]), ids=np.array([0, 1]))
    np.testing.assert_array_equal(twin.parameter("rail_x.coulomb", "force"), [0.0, 0.1, 0.2, 0.3])


WRONG_TAPES = {
    "one simulation too few": lambda twin, state: twin.replay_commands(state, np.zeros((3, 5, 2))),
    "one actuator too many": lambda twin, state: twin.replay_commands(state, np.zeros((4, 5, 3))),
    "speeds of fewer steps": lambda twin, state: twin.replay_commands(
        state, np.zeros((4, 5, 2)), rotor_speed=np.zeros((4, 4, 2))
    ),
    "throttle of one rotor": lambda twin, state: twin.replay_commands(
        state, np.zeros((4, 5, 2)), throttle=np.zeros((4, 5, 1))
    ),
    "forces in two axes": lambda twin, state: twin.replay_commands(
        state, np.zeros((4, 5, 2)), disturbance=np.zeros((4, 1, 2))
    ),
    "a state of fewer simulations": lambda twin, state: twin.step_policy(state.take(np.arange(3)), np.zeros((4, 2))),
    "a state of other effects": lambda twin, state: twin.step_policy(
        replace(state, effects=state.effects[:, :1].copy()), np.zeros((4, 2))
    ),
    "past commands of fewer": lambda twin, state: twin.warm_up(state.actuators, np.zeros((3, 5, 2))),
    "past commands of more": lambda twin, state: twin.warm_up(state.actuators, np.zeros((5, 5, 2))),
    "a row of them that is not there": lambda twin, state: twin.warm_up(
        state.actuators, np.zeros((2, 5, 2)), np.array([0, 1, 2, 0])
    ),
    "actuators of fewer": lambda twin, state: twin.warm_up(state.actuators[:3], np.zeros((4, 5, 2))),
}


@pytest.mark.parametrize("call", WRONG_TAPES.values(), ids=WRONG_TAPES)
def test_arrays_of_another_shape_are_refused(
    twin: Twin, flown: TwinState, call: Callable[[Twin, TwinState], object]
) -> None:
    """Compiled code reads without looking: arrays of a wrong shape are refused before, with the right one."""
    before = freeze(flown)
    with pytest.raises(ValueError, match=r"\(.*expected \("):
        call(twin, flown)
    assert_equal(flown, before)


def test_states_of_another_kind_are_refused(twin: Twin, flown: TwinState) -> None:
    """A state with actuators of another kind, or whose arrays are views into others, is refused in place."""
    other = TwinState.from_arrays(
        {name: a[:, :7] if name.endswith("history") else a for name, a in flown.arrays().items()}
    )
    with pytest.raises(ValueError, match="another rig or another catalogue"):
        twin.advance_policy(other, command(twin, 1))
    twice = flown.take(np.repeat(np.arange(4), 2))
    view = replace(twice.take(np.arange(4)), actuators=twice.actuators[::2])
    with pytest.raises(ValueError, match="arrays of its own"):
        twin.advance_policy(view, command(twin, 1))
    twin.step_policy(view, command(twin, 1))  # which copies it first
