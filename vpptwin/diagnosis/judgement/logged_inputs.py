"""What a log's inputs may be wrong by: causes that would look the same, and inputs that do not explain the motion."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.forces import REACH, measure_forces
from vpptwin.effects import Effect
from vpptwin.effects.actuator import apply_gain
from vpptwin.effects.joint import apply_bias
from vpptwin.estimation.measurements import Measurements
from vpptwin.twin.model import inertia_at_rest
from vpptwin.twin.spec import TwinSpec

LATE = (0.0, 0.03, 0.06)
"""By which inputs may act late [s], drives' own lag in it."""
DRIVEN = 0.05
"""Share of the force that motion asks for from which inputs drive a degree of freedom at all."""


def describe_input_error(spec: TwinSpec, effect: Effect) -> str:
    """A warning that says so; "" where no input of another rig's log would.

    An offset of the input of several joints would be a constant force on each of them.
    """
    if spec.robot.disturbance.known:
        return ""
    if effect.apply is apply_gain:
        whose = " and ".join(effect.members) or effect.target
        return f"{effect.id}: a log that shows the input of {whose} wrong by that factor would look the same"
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


def describe_weak_inputs(
    spec: TwinSpec, measurements: Sequence[Measurements], criteria: Criteria
) -> list[str]:  # fmt: skip
    """A warning of what moves otherwise than the inputs in the logs say; none where they explain what they drive.

    Inverse dynamics: squared cosine between the force that motion asks for and that of the inputs, which may be late,
    without what noise of the measured rates makes of the former. Where that is most of it, nothing is said.
    """
    found, carried = [], np.diag(inertia_at_rest(spec.model))
    rough = (
        np.array([noise_of_rate(measurements, dof) for dof in range(spec.model.nv)]) * carried / (np.sqrt(2.0) * REACH)
    )
    for late in LATE:
        forces = measure_forces(spec, measurements, late)
        asked, given = forces.missing + forces.actuator, forces.actuator
        sizes = (asked**2).mean(axis=0) - rough**2, (given**2).mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            found.append((asked * given).mean(axis=0) ** 2 / (sizes[0] * sizes[1]))
        found[-1][~(sizes[0] > rough**2) | (sizes[1] <= DRIVEN**2 * sizes[0])] = np.nan
    best = np.max(found, axis=0)
    best[spec.robot.driven] = np.nan
    weak = [f"{share:.0%} on {spec.robot.name_dof(dof)}" for dof, share in enumerate(best) if share < criteria.obeyed]
    told = f"the inputs in these logs explain but {', '.join(weak)} of the force that motion asks for: "
    why = "they may change faster than they are logged, or be asked for and not what acted; causes there are guesses"
    return [told + why] if weak else []


def noise_of_rate(measurements: Sequence[Measurements], dof: int) -> float:
    """Standard deviation of a measured rate [m/s, rad/s]; nan where none is measured in all logs."""
    rates = [log.velocities.get(dof) for log in measurements]
    return float(np.sqrt(np.mean([np.nan if rate is None else rate.std**2 for rate in rates])))
