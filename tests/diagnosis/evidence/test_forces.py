"""What moved a joint, by inverse dynamics: a pendulum by hand, and what its log says of its scales."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.carts import load_cart, measure_cart
from tests.diagnosis.rigs import BOB, DECAYS, LENGTH, LOG_EVERY, PENDULA, STEP, drive_cart, let_swing, swing, write_rig
from vpptwin.diagnosis.evidence.forces import measure_loads, scale_twin, usual_input
from vpptwin.effects import find_effect
from vpptwin.estimation.dynamics import REACH, Forces, invert, measure_forces
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.robot.robot import GUST, Loads
from vpptwin.twin.spec import load_twin

INERTIA, WEIGHT, DAMPING = BOB * LENGTH**2, BOB * 9.81 * LENGTH, 0.03


def measure(track: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Measurements:
    """A pendulum's log without noise."""
    time = np.arange(len(track[0])) * LOG_EVERY * STEP
    angle = Series("swing", "rad", time, track[0], 1e-4, white=False)
    rate = Series("swing rate", "rad/s", time, track[1], 1e-3, white=False)
    command = Series("control", "", time, track[2].reshape(len(time), -1), 0.0)
    return Measurements("pendulum", {0: angle}, {0: rate}, None, command, None, (), 0.0, float(time[-1]))


def test_inverse_dynamics_by_hand(tmp_path: Path) -> None:
    """A bob at an angle a that accelerates by c under a torque u lacks m L² c + m g L sin a - u."""
    model = load_twin(write_rig(PENDULA, tmp_path)).model
    rows = np.array([[0.0, 0.0, 3.0, 0.0], [0.5, 1.0, -2.0, 1.0], [-1.2, 2.0, 0.0, -1.0]])
    angle, rate, acceleration, torque = np.split(rows, 4, axis=1)
    inertial, actuator, missing = invert(model, angle, rate, acceleration, torque)
    # The bob's own moment of inertia of 1e-6 kg m² is 2e-5 of m L².
    np.testing.assert_allclose(inertial, INERTIA * acceleration, rtol=1e-4)
    np.testing.assert_allclose(actuator, torque)
    np.testing.assert_allclose(missing, INERTIA * acceleration + WEIGHT * np.sin(angle) - torque, rtol=1e-4, atol=1e-12)


def test_what_is_missing_is_the_damping(tmp_path: Path) -> None:
    """Along a log of a damped pendulum under slow torques the missing force is -damping times velocity."""
    spec = load_twin(write_rig(PENDULA, tmp_path))
    torques = 0.5 * np.sin(3.0 * np.arange(4800) * LOG_EVERY * STEP)
    forces = measure_forces(spec, [measure(swing(DAMPING, torques, 0.3))])
    assert len(forces.time) <= 1200
    assert forces.time[0] >= REACH
    np.testing.assert_allclose(forces.actuator[:, 0], forces.control[:, 0])
    # Differences over 50 ms of what swings at about 5 rad/s lose (0.025 * 5)²/6 = 0.3 % of m L² c.
    error = forces.missing + DAMPING * forces.velocity
    assert np.sqrt((error**2).mean()) < 0.1 * DAMPING * np.sqrt((forces.velocity**2).mean())


def test_logs_share_the_instants(tmp_path: Path) -> None:
    """Of two logs as many as of one, each told by its index; without actuators there are no inputs."""
    spec = load_twin(write_rig(DECAYS, tmp_path))
    log = measure(let_swing(DAMPING, 1))
    forces = measure_forces(spec, [log, log])
    assert forces.control.shape == (len(forces.time), 0)
    np.testing.assert_array_equal(np.bincount(forces.flight), [len(forces.time) // 2] * 2)
    assert not forces.actuator.any()


def made_up(**parts: float) -> Forces:
    """100 instants of a pendulum whose loads, velocity, place and control go from 0 up to these."""
    ramp = np.linspace(0.0, 1.0, 101)[:, None]
    of = {
        name: ramp * parts.get(name, 0.0) for name in ("pose", "velocity", "control", "inertial", "actuator", "missing")
    }
    return Forces(np.zeros(101, dtype=int), ramp[:, 0], **of)


def test_loads_by_hand(tmp_path: Path) -> None:
    """The 90th percentile of the largest of what accelerates, drives and weighs; half of 96 % of the travel."""
    spec = load_twin(write_rig(PENDULA, tmp_path))
    loads = measure_loads(spec, made_up(pose=2.0, velocity=5.0, control=0.7, inertial=1.0, actuator=0.7, missing=0.1))
    np.testing.assert_allclose(loads.force, 0.9)
    np.testing.assert_allclose(loads.speed, 4.5)
    np.testing.assert_allclose(loads.travel, 0.96)
    np.testing.assert_allclose(loads.carried, INERTIA, rtol=1e-4)
    np.testing.assert_allclose(loads.control, 0.63)
    # Held against its weight: missing + actuator - inertial is what gravity needs.
    held = measure_loads(spec, made_up(actuator=0.2, missing=1.8))
    np.testing.assert_allclose(held.force, 1.8)
    # A thousandth of what 10 rad/s², 1 rad/s and 1 rad are.
    loads = measure_loads(load_twin(write_rig(PENDULA, tmp_path)), made_up())
    np.testing.assert_allclose(loads.force, 0.01 * INERTIA, rtol=1e-4)
    np.testing.assert_allclose([loads.speed, loads.travel], 1e-3)
    np.testing.assert_array_equal(loads.control, 1.0)


@pytest.mark.parametrize(("inputs", "usual"), [(np.zeros((9, 2)), [1.0, 1.0]), (np.zeros((0, 2)), [1.0, 1.0])])
def test_inputs_that_never_were(inputs: np.ndarray, usual: list[float]) -> None:
    """No samples at all, or all of them zero: 1."""
    np.testing.assert_allclose(usual_input(inputs), usual)


def test_a_rare_input_counts() -> None:
    """One that is zero nine tenths of the time is as large as it gets."""
    control = np.zeros((100, 1))
    control[:5] = -3.0
    np.testing.assert_allclose(usual_input(control), 3.0)


def test_a_twin_is_scaled_by_its_log(tmp_path: Path) -> None:
    """Disturbances, sizes and bounds are shares of what drives the cart, not of its weight; the drone stays itself."""
    spec, flight = load_cart(tmp_path), measure_cart(drive_cart(0.0, 3), 7)
    scaled = scale_twin(spec, [flight])
    assert scaled.robot.loads is not None
    (force,) = scaled.robot.loads.force
    assert 2.0 < force < 10.0  # what the motor gives at most
    np.testing.assert_allclose(scaled.robot.disturbance.std, GUST * force)
    for kind, name, unit in (("bias", "force", force), ("coulomb", "force", force)):
        parameter = next(p for p in find_effect(scaled.catalogue, f"slide.{kind}").parameters if p.name == name)
        assert parameter.size == pytest.approx(0.02 * unit)
        assert parameter.tolerance == pytest.approx(0.0005 * unit)
    damping = find_effect(scaled.catalogue, "slide.viscous").parameters[0]
    assert damping.size == pytest.approx(0.02 * force / scaled.robot.loads.speed[0])


def test_what_the_twin_has_stays_within_bounds(tmp_path: Path) -> None:
    """A damping that no log of this rig would ask for, in its YAML, is no reason to refuse."""
    spec = load_cart(tmp_path)
    path = tmp_path / "rig.yaml"
    path.write_text(path.read_text() + "effects:\n  slide.viscous: {damping: 900.0}\n")
    scaled = scale_twin(load_twin(path), [measure_cart(drive_cart(0.0, 3), 7)])
    assert find_effect(scaled.catalogue, "slide.viscous").parameters[0].high == 900.0
    plain = scale_twin(spec, [measure_cart(drive_cart(0.0, 3), 7)])
    assert find_effect(plain.catalogue, "slide.viscous").parameters[0].high < 900.0


@pytest.mark.parametrize(("force", "control"), [(0.02, 1e-3), (50.0, 5e3)])
def test_what_a_diagnosis_finds_a_twin_may_say(tmp_path: Path, force: float, control: float) -> None:
    """Bounds that loads make lie within those of the MJCF alone: friction far below the weight, inputs of any unit."""
    robot = load_cart(tmp_path).robot
    one = np.ones(1)
    loads = Loads(force * one, one, one, one, one, control * one)
    for wide, found in zip(robot.list_effects(), robot.scale(loads).list_effects(), strict=True):
        for outer, inner in zip(wide.parameters, found.parameters, strict=True):
            assert outer.low <= inner.low, (wide.id, outer.name)
            assert inner.high <= outer.high, (wide.id, outer.name)
