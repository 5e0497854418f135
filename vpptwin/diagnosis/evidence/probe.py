"""Which force each cause makes in the twin along the logs, and which one is missing there: by inverse dynamics."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.estimation.dynamics import REACH, Forces, measure_forces
from vpptwin.estimation.gaps import LOOK_BACK
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import cut_windows, join_windows
from vpptwin.twin.spec import TwinSpec

OFFSETS = np.linspace(-1.5, 1.5, 7) * REACH
"""Instants around each one over which the twin's forces are averaged, as differences of estimated velocities are [s].

A difference over twice `REACH` averages accelerations over that time, and what smooths the velocities over as much
again.
"""


@dataclass(frozen=True)
class Shares:
    """Generalised forces at n instants of the logs."""

    forces: Forces  # what moved the joints
    made: dict[str, np.ndarray]  # cause → force that it makes in the fitted twin, (n, nv) N, N m
    steady: dict[str, np.ndarray]  # cause → how much of that is left of it in the mean over `OFFSETS`, 0..1, (nv,)
    left: np.ndarray  # what motion asks for beyond what the fitted twin has for it, (n, nv) N, N m
    moved: np.ndarray  # mass times acceleration in the fitted twin, (n, nv) N, N m
    changing: np.ndarray  # how fast that changes, (n, nv) N/s, N m/s


def share_forces(
    spec: TwinSpec, measurements: Sequence[Measurements], values: Mapping[Key, float], causes: Collection[str]
) -> Shares:
    """Step the twin once from the logged states, as it was fitted and without each of its causes.

    Whatever law a cause has, the acceleration that goes with it, times the inertia, is its force.

    Args:
        spec: the twin that was diagnosed.
        measurements: its logs.
        values: of the fitted twin's causes, and what else differs from `spec`.
        causes: effects to take out one at a time; out of the twin is what it was in `spec`.
    """
    forces = measure_forces(spec, measurements)
    inside = [
        (forces.time > log.start + LOOK_BACK + REACH) & (forces.time < log.end - LOOK_BACK - REACH)
        for log in measurements
    ]
    forces = take(forces, np.choose(forces.flight, inside))
    without = [{key: v for key, v in values.items() if key[0] != cause} for cause in causes]
    runs = [Variation(dict(values)), *map(Variation, without)]
    step, found = float(spec.model.opt.timestep), []
    for offset in OFFSETS:
        parts = [
            cut_windows(spec, log, forces.time[forces.flight == i] + offset, step, False, i)
            for i, log in enumerate(measurements)
        ]
        velocity = Bench(spec, join_windows(parts), (), 1).simulate(runs).velocity
        found.append(np.diff(velocity, axis=2)[:, :, 0] / step)
    exerted = weigh(spec.model, forces.pose, np.concatenate(found)).reshape(
        len(OFFSETS), len(runs), *found[0].shape[1:]
    )
    every = {cause: exerted[:, 0] - exerted[:, k + 1] for k, cause in enumerate(causes)}
    moved = exerted[:, 0].mean(axis=0)
    changing = np.tensordot(OFFSETS, exerted[:, 0], 1) / (OFFSETS @ OFFSETS)
    made = {cause: force.mean(axis=0) for cause, force in every.items()}
    steady = {
        cause: (made[cause] ** 2).mean(axis=0) / np.maximum((force**2).mean(axis=(0, 1)), 1e-300)
        for cause, force in every.items()
    }
    return Shares(forces, made, steady, forces.inertial - moved, moved, changing)


def weigh(model: mujoco.MjModel, pose: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Mass times acceleration at poses (n, nq), of runs (V, n, nv)."""
    data, force = mujoco.MjData(model), np.zeros_like(acceleration)
    for i, here in enumerate(pose):
        data.qpos[:] = here
        mujoco.mj_fwdPosition(model, data)
        for run in range(len(acceleration)):
            mujoco.mj_mulM(model, data, force[run, i], acceleration[run, i])
    return force


def take(forces: Forces, rows: np.ndarray) -> Forces:
    """Some of the instants."""
    return replace(forces, **{name: value[rows] for name, value in vars(forces).items()})
