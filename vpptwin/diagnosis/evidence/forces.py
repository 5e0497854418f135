"""What moved the joints, by inverse dynamics along the logs: the scales of a rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from vpptwin.effects import Parameter
from vpptwin.estimation.dynamics import REACH, Forces, measure_forces
from vpptwin.estimation.gaps import LOOK_BACK, usable_starts
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import average_held
from vpptwin.twin.robot.manifold import FREE, chart
from vpptwin.twin.robot.model import hold_joints, inertia_at_rest
from vpptwin.twin.robot.robot import Loads
from vpptwin.twin.spec import TwinSpec

MOST_STATES, STEP = 120, 1e-6
"""Instants at which the growth of errors is looked at, and steps of its differences."""
USUAL = 90.0
"""Percentile of a load that is called typical."""
SLIGHT = 1e-3
"""Scales of what never moved, as a share of what would move it typically."""


def measure_growth(spec: TwinSpec, measurements: Sequence[Measurements]) -> float:
    """Rate at which small errors of a state grow in the twin's MJCF, typical along the logs [1/s]; 0 for none."""
    model, rates = hold_joints(spec.model, spec.robot.driven), list[float]()
    data, moved = mujoco.MjData(model), np.zeros((2 * model.nv, 2 * model.nv))
    for log in measurements:
        times = np.linspace(log.start + LOOK_BACK, log.end - LOOK_BACK, MOST_STATES // len(measurements))
        times = times[usable_starts(log, times - REACH, 2.0 * REACH)]
        control = average_held(log.command, times[:, None] + np.array([-REACH, REACH]))[:, 0]
        for pose, velocity, inputs in zip(*estimate_states(log.in_eights(), times, model, False), control, strict=True):
            data.qpos[:], data.qvel[:], data.ctrl[:] = pose, velocity, inputs
            mujoco.mjd_transitionFD(model, data, STEP, True, moved, None, None, None)
            rates.append(np.log(np.abs(np.linalg.eigvals(moved)).max()) / model.opt.timestep)
    return float(max(np.percentile(rates, USUAL), 0.0)) if rates else 0.0


def measure_turning(spec: TwinSpec, measurements: Sequence[Measurements]) -> float:
    """Time in which what usually turns a free body turns it by half a radian from rest [s]; infinite without one.

    Forces turn with the body: a twin that is wrong by as much knows nothing of its motion beyond.
    """
    bodies = (joint for joint in spec.robot.list_free() if spec.model.jnt_type[joint] == FREE)
    turning = [int(spec.model.jnt_dofadr[joint]) + 3 + i for joint in bodies for i in range(3)]
    turning = [dof for dof in turning if dof not in spec.robot.driven]
    if not turning:
        return float("inf")
    forces = measure_forces(spec, measurements)
    faster = np.abs(forces.inertial[:, turning]) / np.diag(inertia_at_rest(spec.model))[turning]
    return float(np.sqrt(1.0 / max(np.percentile(faster, USUAL, axis=0).max(), 1e-9)))


def scale_twin(spec: TwinSpec, measurements: Sequence[Measurements]) -> TwinSpec:
    """The twin with sizes, bounds and disturbances of effects that suit what the logs show of its rig."""
    if spec.robot.disturbance.known:  # and its scales with it
        return spec
    return scale_to(spec, measure_loads(spec, measure_forces(spec, measurements)))


def scale_to(spec: TwinSpec, loads: Loads) -> TwinSpec:
    """The twin with sizes, bounds and disturbances of effects by the scales of a rig."""
    robot = spec.robot.scale(loads)
    scaled = {effect.id: effect for effect in robot.list_effects()}
    catalogue = []
    for effect in spec.catalogue:
        values, found = spec.effects.get(effect.id, {}), scaled.get(effect.id, effect)
        parameters = tuple(
            limit_search(p, possible, values.get(p.name, p.off))
            for p, possible in zip(found.parameters, effect.parameters)
        )
        catalogue.append(replace(found, parameters=parameters))
    return replace(spec, robot=robot, catalogue=tuple(catalogue))


def limit_search(parameter: Parameter, possible: Parameter, value: float) -> Parameter:
    """A parameter with bounds for a search: what logs ask for, and the twin's own `value`, within what a twin may have.

    Whatever is found there the next command takes.
    """
    low, high = min(parameter.low, value), max(parameter.high, value)
    return replace(parameter, low=max(low, possible.low), high=min(high, possible.high))


def measure_loads(spec: TwinSpec, forces: Forces) -> Loads:
    """A rig's scales along its logs."""
    model, rotary = spec.model, spec.robot.rotary
    carried = np.diag(inertia_at_rest(model)).copy()
    weight = forces.missing + forces.actuator - forces.inertial
    loads = np.max([np.abs(part) for part in (forces.inertial, forces.actuator, weight)], axis=0)
    low, high = np.percentile(chart(model, forces.pose), [2.0, 98.0], axis=0)
    reach = np.where(rotary, 1.0, 0.3)
    return Loads(
        force=np.maximum(np.percentile(loads, USUAL, axis=0), SLIGHT * 10.0 * carried),
        speed=np.maximum(np.percentile(np.abs(forces.velocity), USUAL, axis=0), SLIGHT * reach),
        travel=np.maximum(0.5 * (high - low), SLIGHT * reach),
        middle=0.5 * (low + high),
        carried=carried,
        control=usual_input(forces.control),
    )


def usual_input(control: np.ndarray) -> np.ndarray:
    """A typical input of every actuator, (nu,), of inputs (n, nu); 1 where nothing was ever asked for."""
    if not control.size:
        return np.ones(control.shape[1])
    found, most = np.percentile(np.abs(control), USUAL, axis=0), np.abs(control).max(axis=0)
    return np.asarray(np.where(found > 0.0, found, np.where(most > 0.0, most, 1.0)))
