"""The C export: it compiles without a warning, agrees with torch and with the Python cascade, and knows itself."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.deploy.conftest import State, compile_library, find_compiler, make_random
from vpptwin.actuators.adaptive import DRAG, HALF_GAP, TRIM, start_memory
from vpptwin.actuators.controller import run_cascade
from vpptwin.actuators.layer import layer_dtype
from vpptwin.actuators.motor import compute_current
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.deploy.c_source import write_c
from vpptwin.deploy.content import TOLERANCE, Content, draw_observations
from vpptwin.deploy.load import CompiledController, load_exported
from vpptwin.engine.trace.c99 import as_float
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import accumulate_error, observe
from vpptwin.train.evaluate.evaluate import load_policy
from vpptwin.twin import Twin, load_twin

NOMINAL = load_vehicle()
HIDDEN = {"servo.trim": {"offset_1": 0.01, "offset_2": -0.01}, "servo.backlash": {"gap": 0.02},
          "gyro.bias": {"bias": 0.05}}  # fmt: skip


def test_actions_are_those_of_torch(shipped: Content, library: Path) -> None:
    """Ten thousand observations, near the target and far from it: within 1e-5."""
    controller = CompiledController(library)
    seen = draw_observations(shipped.trained, 10_000, seed=5)
    with torch.no_grad():
        wanted = load_policy("flip")(torch.from_numpy(seen)).numpy()
    found = np.array([controller.act(row) for row in seen])
    assert np.abs(found - wanted).max() < TOLERANCE
    assert wanted.std() > 0.2


@pytest.mark.parametrize("options", [
    ("setup=VA",), *(pytest.param((setup,), marks=pytest.mark.slow) for setup in ("setup=TA", "setup=PI")),
    ("setup=All", "paper_inputs=true"),
])  # fmt: skip
def test_every_setup_is_observed_as_in_python(options: tuple[str, ...], tmp_path: Path) -> None:
    """Poses turned many times, targets, integrals: observation and integral within float32, and so the action."""
    content = make_random(*options)
    write_c(content, tmp_path)
    controller, rng = CompiledController(compile_library(tmp_path)), np.random.default_rng(3)
    count = 2000
    pose, velocity, target = (rng.normal(size=(count, 3)) * [0.5, 0.5, spread] for spread in (10.0, 4.0, 3.0))
    before = rng.normal(size=(count, 2))
    integral = accumulate_error(before, (target - pose)[:, :2])
    seen = observe(pose, velocity, target, integral, content.trained.observation)
    wanted = content.policy(seen)
    for i in range(count):
        grown, found = before[i].astype(np.float32), np.empty(seen.shape[1], np.float32)
        controller.call("observe", *(v[i].astype(np.float32) for v in (pose, velocity, target)), grown, found)
        np.testing.assert_allclose(grown, integral[i], atol=1e-5)
        off = np.abs(found - seen[i])
        jump = np.abs(off - 2.0 * np.pi) < 1e-4  # -pi is pi
        assert np.where(jump, 0.0, off).max() < 1e-5
        if not jump.any():
            action, _ = controller.decide(pose[i], velocity[i], target[i], before[i])
            np.testing.assert_allclose(action, wanted[i], atol=2e-4)


def start(controller: CompiledController, adaptive: bool) -> State:
    """A state that has begun."""
    state = State()
    assert controller.library["vpptwin_start"](ctypes.byref(state), int(adaptive)) == 0
    return state


@pytest.mark.parametrize("kind", ["map", "adaptive"])
def test_the_cascade_is_that_of_python(library: Path, kind: str) -> None:
    """Readings of a wild flight go through both: pitch and throttle within float32, what is learned alike.

    Speeds fail at one time, and a current is stuck at another.
    """
    controller, adaptive = CompiledController(library), kind == "adaptive"
    twin = Twin(load_twin().with_effects(HIDDEN).with_controller(kind), 1, num_threads=1)
    flown, vehicle = twin.initial_state(time=0.0), record_vehicle(NOMINAL)[0]
    memory = np.zeros(1, layer_dtype(2, 0, adaptive)).view(np.recarray)[0]
    if adaptive:
        memory.adaptive[:] = start_memory(NOMINAL.rotor.speed)
    state, rng = start(controller, adaptive), np.random.default_rng(3)
    noise, worst = np.random.default_rng(4), np.zeros(2)
    stuck = np.zeros(2)
    for tick in range(150):
        thrust, rate = rng.uniform(-8.0, 10.0), rng.uniform(-8.0, 8.0)
        for _ in range(10):
            speed = np.float32(flown.rotor_speed[0] + noise.normal(0.0, 1.0, 2)).astype(float)
            used = memory.throttle.copy()
            current = np.array(
                [compute_current(vehicle.motor, used[i] * NOMINAL.motor.battery, speed[i]) for i in (0, 1)]
            )
            current = np.float32(current + noise.normal(0.0, 0.1, 2)).astype(float)
            if tick == 60:
                stuck = current.copy()
            if 60 < tick < 75:
                current = stuck
            if 90 < tick < 95:
                speed[0] = 0.0
            turn = float(np.float32(flown.qvel[0, 2] + noise.normal(0.0, 0.05)))
            pitch = run_cascade(vehicle, memory, thrust, rate, turn, tuple(speed), tuple(current), twin.dt)
            found, throttle = np.empty(2, np.float32), np.empty(2, np.float32)
            given = (speed.astype(np.float32), current.astype(np.float32), found, throttle)
            controller.call("cascade", state, thrust, rate, turn, *given)
            worst = np.maximum(worst, [np.abs(found - pitch).max(), np.abs(throttle - memory.throttle).max()])
        twin.advance_policy(flown, np.array([[thrust, rate]]))
    # Blade pitch goes to 0.21 rad, throttle to 1. The filter's covariances are differences of like numbers.
    assert (worst < ([2e-4, 2e-3] if adaptive else [2e-6, 2e-5])).all(), worst
    if adaptive:
        learned = np.array(state.learned)
        for place, near in ((TRIM, 2e-4), (HALF_GAP, 2e-4), (DRAG, 2e-3)):
            np.testing.assert_allclose(learned[:, place], memory.adaptive[:, place], atol=near)
        assert np.abs(memory.adaptive[:, TRIM]).max() > 2e-3


BENT = NOMINAL.rotor.model_copy(update={"k_t": 0.04, "k_t2": 0.08, "k_t3": -0.1})
INFLOW = NOMINAL.rotor.model_copy(update={"k_t": 0.09, "inflow": 0.08})


@pytest.mark.parametrize("rotor", [BENT, INFLOW], ids=["bent", "inflow"])
def test_bent_thrust_maps_are_inverted(rotor: object, tmp_path: Path) -> None:
    """Thrusts of a map that a bench found, both ways and beyond the stops."""
    vehicle: Vehicle = NOMINAL.model_copy(update={"rotor": rotor})
    write_c(make_random(vehicle=vehicle), tmp_path)
    controller = CompiledController(compile_library(tmp_path))
    state, record = start(controller, False), record_vehicle(vehicle)[0]
    memory = np.zeros(1, layer_dtype(2, 0, False)).view(np.recarray)[0]
    for thrust in np.linspace(-15.0, 15.0, 61):
        found, throttle, speed = np.empty(2, np.float32), np.empty(2, np.float32), np.full(2, 470.0)
        wanted = run_cascade(record, memory, thrust, 0.3, 0.1, (470.0, 470.0), (5.0, 5.0), 0.001)
        given = (speed.astype(np.float32), np.full(2, 5.0, np.float32), found, throttle)
        controller.call("cascade", state, thrust, 0.3, 0.1, *given)
        np.testing.assert_allclose(found, wanted, atol=3e-6)
        np.testing.assert_allclose(throttle, memory.throttle, atol=3e-5)


def test_nothing_but_tanhf_is_needed(library: Path) -> None:
    """No other function of libm, no allocation: what the object leaves open is tanhf."""
    folder = library.parent
    source = [str(folder / "vpptwin.c"), "-o", str(folder / "vpptwin.o")]
    subprocess.run([find_compiler(), "-std=c99", "-O2", "-fno-stack-protector", "-c", *source], check=True)
    listed = subprocess.run(["nm", "-u", str(folder / "vpptwin.o")], capture_output=True, text=True, check=True)
    assert {line.split()[-1] for line in listed.stdout.splitlines()} <= {"tanhf", "_GLOBAL_OFFSET_TABLE_", "memcpy"}


def test_a_controller_that_is_not_whole_is_refused(library: Path, tmp_path: Path) -> None:
    """One weight changed: test vectors fail, `start` says so, and Python does not load it."""
    source = (library.parent / "vpptwin.c").read_text()
    head, tail = source.split("static const float bias_3[2] = {", 1)
    (tmp_path / "vpptwin.c").write_text(f"{head}static const float bias_3[2] = {{ 0.3f + {tail}")
    (tmp_path / "vpptwin.h").write_text((library.parent / "vpptwin.h").read_text())
    broken = compile_library(tmp_path)
    with pytest.raises(InputError, match="of its test vectors fail"):
        load_exported(broken)
    loaded = ctypes.CDLL(str(broken))
    assert loaded["vpptwin_start"](ctypes.byref(State()), 0) == 1
    assert loaded["vpptwin_selftest"]() > 10


def test_other_libraries_are_refused(tmp_path: Path) -> None:
    """No library, another library, another kind of file, none at all: a line each."""
    (tmp_path / "text.so").write_text("not a library")
    (tmp_path / "other.c").write_text("int answer(void) { return 42; }\n")
    other = tmp_path / "other.so"
    subprocess.run([find_compiler(), "-shared", "-fPIC", str(tmp_path / "other.c"), "-o", str(other)], check=True)
    (tmp_path / "policy.txt").write_text("")
    for name in ("text.so", "other.so", "policy.txt", "none.so"):
        with pytest.raises(InputError) as caught:
            load_exported(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [0.0, 1.0, -2.5e-8, 0.1, 1 / 3, 471.239, 1e20])
def test_literals_are_exact(value: float) -> None:
    """A float literal reads back as the same float32."""
    text = as_float(value)
    assert text.endswith("f")
    assert np.float32(text[:-1]) == np.float32(value)
