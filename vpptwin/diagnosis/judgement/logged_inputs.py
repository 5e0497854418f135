"""Causes that errors of a log's inputs would look the same as: offset and gain of what a torque sensor shows."""

from __future__ import annotations

import mujoco
import numpy as np

from vpptwin.effects import Effect
from vpptwin.effects.actuator import apply_gain
from vpptwin.effects.joint import apply_bias
from vpptwin.twin.spec import TwinSpec


def describe_input_error(spec: TwinSpec, effect: Effect) -> str:
    """A warning that says so; "" where no input of another rig's log would.

    An offset of the input of several joints would be a constant force on each of them.
    """
    if spec.robot.disturbance.known:
        return ""
    if effect.apply is apply_gain:
        return f"{effect.id}: a log that shows the input of {effect.target} wrong by that factor would look the same"
    if effect.apply is not apply_bias:
        return ""
    inputs = list_inputs(spec.model, effect.target)
    told = f"{effect.id}: an offset in the log of {' or '.join(inputs)} would look the same"
    return told if inputs else ""


def list_inputs(model: mujoco.MjModel, joint: str) -> list[str]:
    """Names of the actuators whose input acts on a joint."""
    data, dof = mujoco.MjData(model), int(model.joint(joint).dofadr[0])
    mujoco.mj_forward(model, data)
    still, found = float(data.qfrc_actuator[dof]), []
    for i in range(model.nu):
        data.ctrl[:] = 0.1 * np.eye(model.nu)[i]
        mujoco.mj_forward(model, data)
        if data.qfrc_actuator[dof] != still:
            found.append(model.actuator(i).name or f"actuator {i}")
    return found
