"""What a log's inputs may be wrong by: causes that would look the same, and inputs that do not explain the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.effects import Effect
from vpptwin.effects.actuator import GAIN
from vpptwin.effects.joint import apply_bias
from vpptwin.estimation.checks.efforts import refuse_efforts
from vpptwin.estimation.checks.gate import check_columns
from vpptwin.estimation.checks.support import refuse_held
from vpptwin.estimation.dynamics import REACH, measure_forces
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.doubt import list_overruled
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import FREE
from vpptwin.twin.robot.model import inertia_at_rest
from vpptwin.twin.spec import TwinSpec

LATE = (0.0, 0.03, 0.06)
"""By which inputs may act late [s], drives' own lag in it."""
DRIVEN = 0.05
"""Share of the force that motion asks for from which inputs drive a degree of freedom at all."""
TURN = np.arange(3, 6)
"""A free body's degrees of freedom that turn it, from its first."""
TURNED = (
    "{} turns as logged, because the logged inputs do not explain its turning: they may change faster than they are "
    "logged; forces on it are judged, its inertia, centre of mass and single rotors are not"
)


def describe_input_error(spec: TwinSpec, effect: Effect) -> str:
    """A warning that says so; "" where no input of another rig's log would.

    An offset of the input of several joints would be a constant force on each of them.
    """
    if spec.robot.disturbance.known:
        return ""
    if effect.apply is GAIN.apply:
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
    """A warning of what moves otherwise than the inputs in the logs say; none where they explain what they drive."""
    best = measure_obedience(spec, measurements)
    weak = [f"{share:.0%} on {spec.robot.name_dof(dof)}" for dof, share in enumerate(best) if share < criteria.obeyed]
    told = f"the inputs in these logs explain only {', '.join(weak)} of the force that the motion needs: "
    why = "they may change faster than they are logged, or be commands that were not applied; causes there are guesses"
    return [told + why] if weak else []


def measure_obedience(spec: TwinSpec, measurements: Sequence[Measurements]) -> np.ndarray:
    """Share of the force that motion asks for that inputs explain, (nv,); nan for what they don't drive.

    Inverse dynamics: squared correlation with the force of the inputs, which may be late, without what noise of the
    measured rates makes of the former. Where that is most of it, it is nan. What is constant may be an effect's.
    """
    found, carried = [], np.diag(inertia_at_rest(spec.model))
    rough = (
        np.array([noise_of_rate(measurements, dof) for dof in range(spec.model.nv)]) * carried / (np.sqrt(2.0) * REACH)
    )
    for late in LATE:
        forces = measure_forces(spec, measurements, late)
        asked, given = (force - force.mean(axis=0) for force in (forces.missing + forces.actuator, forces.actuator))
        sizes = (asked**2).mean(axis=0) - rough**2, (given**2).mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            found.append((asked * given).mean(axis=0) ** 2 / (sizes[0] * sizes[1]))
        found[-1][~(sizes[0] > rough**2) | (sizes[1] <= DRIVEN**2 * sizes[0])] = np.nan
    best: np.ndarray = np.max(found, axis=0)
    best[spec.robot.driven] = np.nan
    return best


def read_session(
    spec: TwinSpec, flights: Sequence[Flight], criteria: Criteria = CRITERIA
) -> tuple[TwinSpec, list[Measurements]]:
    """What was measured on all flights, which is read here once, and the twin of which it is.

    Free bodies of that twin have their attitude from the log where inputs there do not tell what turned them. Where
    thrust points is then known, and what of it acts on where the body goes can be told; else nothing can.

    Raises:
        InputError: if a log lacks what the twin needs, or columns look misread (`vpptwin.estimation.checks.gate`).
    """
    measurements = [read_measurements(spec, flight) for flight in flights]
    check_columns(spec, flights, measurements)
    spec, measurements = follow_turned(spec, flights, measurements, criteria)
    check_moving(measurements)
    refuse_held(spec, measurements)
    refuse_efforts(spec, measurements)
    first, *others = measurements
    return spec, [replace(first, warnings=(*first.warnings, *list_overruled())), *others]


def follow_turned(
    spec: TwinSpec, flights: Sequence[Flight], measurements: list[Measurements], criteria: Criteria
) -> tuple[TwinSpec, list[Measurements]]:  # fmt: skip
    """The twin whose free bodies turn as logged where inputs do not tell what turned them, and what was measured."""
    model, signals = spec.model, spec.robot.signals
    joints = {each.name: each.joint for each in spec.robot.tracked if each.name in signals.bodies}
    flying = [b for b, joint in joints.items() if model.jnt_type[joint] == FREE and b not in signals.turned]
    if not flying:
        return spec, measurements
    told = measure_obedience(spec, measurements)
    shares = {body: told[int(model.jnt_dofadr[joints[body]]) + TURN] for body in flying}
    turned = [b for b in flying if np.isfinite(shares[b]).any() and np.nanmedian(shares[b]) < criteria.led]
    if not turned:
        return spec, measurements
    spec = spec.with_robot(signals=signals.model_copy(update={"turned": (*signals.turned, *turned)}))
    return spec, [read_measurements(spec, flight) for flight in flights]  # attitudes are inputs now


def describe_turned(spec: TwinSpec) -> list[str]:
    """A warning of every body whose attitude follows its log."""
    return [TURNED.format(body) for body in spec.robot.signals.turned]


def noise_of_rate(measurements: Sequence[Measurements], dof: int) -> float:
    """Standard deviation of a measured rate [m/s, rad/s]; nan where none is measured in all logs."""
    rates = [log.velocities.get(dof) for log in measurements]
    return float(np.sqrt(np.mean([np.nan if rate is None else rate.std**2 for rate in rates])))


def check_moving(measurements: Sequence[Measurements]) -> None:
    """Refuse logs in which nothing moves."""
    for flight in measurements:
        spread = max(float(np.ptp(series.value)) / series.std for series in flight.positions.values())
        if spread < 20.0:
            raise InputError(f"{flight.name}: nothing moves", "a log with motion", "log a manoeuvre")
