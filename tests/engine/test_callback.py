"""The control callback: ours while we step, and only for our simulations; the user's before and after."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial

import mujoco
import numpy as np
import pytest

from tests.effects.rigs import Rig
from tests.twin.hover import assert_states
from vpptwin.engine.callback import WORDS, installed
from vpptwin.twin import Twin, TwinState, load_twin

PENDULUM = """<mujoco><size nuserdata="{words}"/><worldbody><body><joint name="j" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody><actuator><motor joint="j"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def twins(rigs: dict[str, Rig]) -> dict[str, Twin]:
    """Drone and cart, some effects on."""
    return {
        "flown": rigs["flown"].twin(4, {"rail_x.coulomb": {"force": 0.3}, "command.delay": {"delay": 0.005}}),
        "cart": rigs["cart"].twin(4, {"slide.coulomb": {"force": 0.3}, "motor.backlash": {"gap": 0.1}}),
    }


@pytest.fixture(autouse=True)
def no_callback() -> Iterator[None]:
    """No control callback before and after a test."""
    assert mujoco.get_mjcb_control() is None
    yield
    mujoco.set_mjcb_control(None)


def compile_pendulum(words: int) -> mujoco.MjModel:
    """A pendulum with a motor, and room for so many words of userdata."""
    return mujoco.MjModel.from_xml_string(PENDULUM.format(words=words))


def swing(model: mujoco.MjModel, steps: int = 50, mark: bool = False) -> np.ndarray:
    """Positions and velocities of a pendulum under steady torque after every step, (steps, 2)."""
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.01
    if mark:
        data.userdata[:] = 1.0
    track = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        track.append([data.qpos[0], data.qvel[0]])
    return np.array(track)


@pytest.mark.parametrize("words", [0, 1, WORDS, WORDS + 1])
@pytest.mark.parametrize("mark", [False, True])
def test_other_models_are_passed_over(twins: dict[str, Twin], words: int, mark: bool) -> None:
    """While our callback is installed, somebody else's model steps bit for bit as without it, userdata or not."""
    alone = swing(compile_pendulum(words), mark=mark)
    for twin in twins.values():
        with installed(twin._kernel.callback):
            np.testing.assert_array_equal(swing(compile_pendulum(words), mark=mark), alone)


def test_compiling_another_model_meanwhile(twins: dict[str, Twin], rigs: dict[str, Rig]) -> None:
    """MuJoCo calls the callback while it compiles a model, ours among them: nothing happens to either."""
    with installed(twins["flown"]._kernel.callback):
        model = compile_pendulum(WORDS)
        again = mujoco.MjSpec.from_file(str(rigs["flown"].spec.model_file)).compile()
    assert model.nuserdata == WORDS
    np.testing.assert_array_equal(again.dof_M0, mujoco.MjModel.from_xml_path(str(rigs["flown"].spec.model_file)).dof_M0)


def test_the_users_callback_comes_back(twins: dict[str, Twin], rigs: dict[str, Rig]) -> None:
    """A control callback installed before we step is not called in our simulations, and works on after them."""
    calls: list[int] = []

    def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        calls.append(1)
        data.ctrl[:] = 0.05

    rig, twin, pendulum = rigs["flown"], twins["flown"], compile_pendulum(0)
    start = rig.start(twin, 1)
    expected = rig.advance(twin, start, 0)
    mujoco.set_mjcb_control(push)
    after = rig.advance(twin, start, 0)
    assert not calls
    np.testing.assert_array_equal(after.qpos, expected.qpos)
    load_twin()  # MuJoCo compiles nothing while a callback in Python is installed; it has to step aside
    rig.twin(1, {"airframe.com": {"offset": 0.01}}).initial_state()
    calls.clear()
    pushed = swing(pendulum)
    assert len(calls) == 50
    mujoco.set_mjcb_control(None)
    assert not np.array_equal(pushed, swing(pendulum))
    mujoco.set_mjcb_control(push)
    assert mujoco.get_mjcb_control() is push


def test_callbacks_come_back_after_an_error(twins: dict[str, Twin]) -> None:
    """Whatever ends the block, the callbacks of before are installed again."""
    clock = mujoco.get_mjcb_time()

    def interrupt() -> None:
        with installed(twins["flown"]._kernel.callback):
            assert mujoco.get_mjcb_control() is not None
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert mujoco.get_mjcb_control() is None
    assert mujoco.get_mjcb_time() is clock


def test_the_clock_runs_on(twins: dict[str, Twin], rigs: dict[str, Rig]) -> None:
    """MuJoCo's profiling timers, which we stop for speed, run again afterwards."""
    rigs["flown"].roll(twins["flown"], rigs["flown"].start(twins["flown"], 1), count=2)
    model = compile_pendulum(0)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 200)
    timer = data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    assert timer.number == 200
    assert timer.duration > 0.0


def fly(rig: Rig, twin: Twin, count: int = 12) -> TwinState:
    """A rollout from a start of its own."""
    return rig.roll(twin, rig.start(twin, 2), count=count).last


def test_twins_of_different_rigs_take_turns(twins: dict[str, Twin], rigs: dict[str, Rig]) -> None:
    """Stepped in turn, drone and cart fly bit for bit as each does alone."""
    alone = {name: fly(rigs[name], twin) for name, twin in twins.items()}
    states = {name: rigs[name].start(twin, 2) for name, twin in twins.items()}
    for k in range(12):
        for name, twin in twins.items():
            states[name] = rigs[name].advance(twin, states[name], k)
    for name, state in states.items():
        assert_states(state, alone[name])


def run_together(*functions: Callable[[], None]) -> None:
    """Run functions in threads of their own; an error in one is raised here."""
    errors: list[BaseException] = []

    def guard(function: Callable[[], None]) -> None:
        try:
            function()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=guard, args=(function,)) for function in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]


@pytest.mark.parametrize("names", [("flown", "cart"), ("flown", "flown")], ids=["of two rigs", "one and the same"])
def test_twins_in_two_threads(twins: dict[str, Twin], rigs: dict[str, Rig], names: tuple[str, str]) -> None:
    """Stepped from two Python threads at once, two twins, or one and the same, fly bit for bit as each does alone."""
    alone = {name: fly(rigs[name], twins[name], 60) for name in names}
    flown: list[tuple[str, TwinState]] = []

    def work(name: str) -> None:
        flown.extend((name, fly(rigs[name], twins[name], 60)) for _ in range(5))

    run_together(*(partial(work, name) for name in names))
    assert len(flown) == 10
    for name, state in flown:
        assert_states(state, alone[name])
    assert mujoco.get_mjcb_control() is None


def test_other_work_in_another_thread(twins: dict[str, Twin], rigs: dict[str, Rig]) -> None:
    """While a twin flies, another thread compiles models and steps its own: both get what they get alone."""
    alone, pendulum = fly(rigs["flown"], twins["flown"], 60), swing(compile_pendulum(WORDS))
    states: list[TwinState] = []
    done = threading.Event()

    def fly_on() -> None:
        try:
            states.extend(fly(rigs["flown"], twins["flown"], 60) for _ in range(5))
        finally:
            done.set()

    def swing_on() -> None:
        while not done.is_set():
            np.testing.assert_array_equal(swing(compile_pendulum(WORDS)), pendulum)

    run_together(fly_on, swing_on)
    for state in states:
        assert_states(state, alone)


def test_many_threads_of_the_engine(rigs: dict[str, Rig]) -> None:
    """With eight threads in the engine every simulation flies as with one."""
    rig = rigs["flown"]
    one, many = (Twin(rig.spec, 37, active=["command.delay"], num_threads=n) for n in (1, 8))
    for twin in (one, many):
        twin.set_parameter("command.delay", "delay", np.linspace(0.0, 0.02, 37))
    assert_states(fly(rig, one), fly(rig, many))


def test_twins_come_and_go(rigs: dict[str, Rig]) -> None:
    """Twins that are thrown away leave nothing behind that another one would trip over."""
    rig = rigs["flown"]
    expected = None
    for count in (3, 1, 3, 50, 3):
        twin = rig.twin(count)
        state = fly(rig, twin, 3)
        if count == 3:
            expected = expected or state
            assert_states(state, expected)
        del twin, state
