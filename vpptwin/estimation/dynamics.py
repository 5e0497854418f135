"""Inverse dynamics of a rig along its logs: what motion asks for, and what inputs make of it."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

import mujoco
import numpy as np

from vpptwin.estimation.gaps import LOOK_BACK, usable_starts
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.series import Measurements
from vpptwin.estimation.windows import average_held
from vpptwin.twin.robot.actuation import JOINT
from vpptwin.twin.robot.manifold import difference_poses
from vpptwin.twin.spec import TwinSpec

REACH = 0.025
"""Accelerations are differences of velocities so long before and after an instant [s]."""
MAX_ROWS = 1200
"""Instants that are looked at, over all logs."""


def find_driven_joint(model: mujoco.MjModel, actuator: int) -> int | None:
    """The joint that an actuator acts on itself; None where its transmission is another."""
    return int(model.actuator_trnid[actuator, 0]) if model.actuator_trntype[actuator] == JOINT else None


@dataclass(frozen=True)
class Forces:
    """Generalised forces at n instants of the logs."""

    flight: np.ndarray  # index of the log, (n,)
    time: np.ndarray  # s since its start, (n,)
    pose: np.ndarray  # (n, nq) m, rad
    velocity: np.ndarray  # (n, nv) m/s, rad/s
    control: np.ndarray  # inputs, mean around the instant, (n, nu)
    inertial: np.ndarray  # mass times acceleration, (n, nv) N, N m
    actuator: np.ndarray  # what the inputs make of it in the twin, (n, nv)
    missing: np.ndarray  # what motion asks for beyond what the twin's model has for it, (n, nv)
    # m/s², rad/s², (n, nv)
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def measure_forces(spec: TwinSpec, measurements: Sequence[Measurements], late: float = 0.0) -> Forces:
    """Inverse dynamics of the twin's MJCF, none of its effects on, along every log; inputs act `late` [s]."""
    parts = [measure_log(spec, log, i, MAX_ROWS // len(measurements), late) for i, log in enumerate(measurements)]
    return Forces(*(np.concatenate(rows) for rows in zip(*parts)))


def measure_log(spec: TwinSpec, log: Measurements, index: int, count: int, late: float) -> tuple[np.ndarray, ...]:
    """The rows of `Forces` of one log, at most so many."""
    model, log = spec.model, log.in_eights()  # a span that tells a state best would smear a tight spot
    times = np.linspace(log.start + LOOK_BACK, log.end - LOOK_BACK, count)
    times = times[usable_starts(log, times - REACH, 2.0 * REACH)]
    around = [estimate_states(log, times + side, model, False) for side in (-REACH, 0.0, REACH)]
    if log.driven:
        led, (before, at, after) = spec.robot.driven, (pose for pose, _ in around)
        for (_, velocity), ends, span in zip(around, ((before, at), (before, after), (at, after)), (1.0, 2.0, 1.0)):
            velocity[:, led] = difference_poses(model, *ends)[:, led] / (span * REACH)
    pose, velocity = around[1]
    acceleration = (around[2][1] - around[0][1]) / (2.0 * REACH)
    edges = times[:, None] + np.array([-REACH, REACH])
    control = average_held(log.command, edges - late)[:, 0]
    inertial, actuator, missing = invert(model, pose, velocity, acceleration, control)
    return np.full(len(times), index), times, pose, velocity, control, inertial, actuator, missing, acceleration


def invert(
    model: mujoco.MjModel, pose: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, control: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inertial, actuators' and missing force at n instants, (n, nv) each, as if no equality or contact held anything.

    A stiff gear answers the noise of either side by a thousand times what moves the rig, a wheel that of slip.
    """
    model = copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    inertial, actuator, missing = (np.zeros_like(velocity) for _ in range(3))
    for i in range(len(pose)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = pose[i], velocity[i], control[i]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        actuator[i] = data.qfrc_actuator
        data.qacc[:] = acceleration[i]
        mujoco.mj_inverse(model, data)  # M(q) a + c(q, v) (Featherstone, ch. 5)
        mujoco.mj_mulM(model, data, inertial[i], acceleration[i])
        missing[i] = data.qfrc_inverse - actuator[i]
    return inertial, actuator, missing
