"""What a joint's model lacks and another joint's motor foretells: drives by tendons, belts and differentials."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from vpptwin.estimation.checks.efforts import find_own_dof
from vpptwin.estimation.dynamics import Forces, invert, measure_forces
from vpptwin.estimation.measurements import Measurements
from vpptwin.twin.robot.manifold import chart
from vpptwin.twin.spec import TwinSpec

BLOCK, FOLDS = 1.0, 3
"""Stretches of log [s] that are learnt from, or not, as a whole; parts of all of them that are foretold in turn."""
SMOOTHED = 0.3
"""Over so long forces are compared as means [s]: motors know accelerations better than differences of rates do."""
FORETOLD = 0.8
"""Share of what nothing else explains that one other motor must foretell."""
RIDGES = (1e-6, 1e-3, 1.0)
"""How much masses and the like may differ from the MJCF's: freely, somewhat, hardly. What foretells best holds."""
MATERIAL, LEFT = 0.05, 0.01
"""Least shares of its own motor's force that others must add, and that nothing but them explains."""
ONE = 0.999
"""Correlation of two motors from which on they are asked for the same, and neither tells anything of the other."""
STEP = 1e-3
"""Change of the place of a centre of mass [m], over which forces are linear in it."""
SUDDEN = 0.05
"""Share of a joint's usual speed over which its dry friction turns round."""
HINT = (
    "what joint {}'s model lacks follows motor {}: {:.2g} {} per {} of it (r = {:.2f} on held-out "
    "data); is the drive a tendon, a belt or a differential?"
)


def describe_other_motors(spec: TwinSpec, measurements: Sequence[Measurements]) -> list[str]:
    """A sentence for every joint whose missing force follows the motor of another one, whatever else may be wrong.

    Masses, their places and inertias of all bodies, springs and dampers between joints, own friction, gain, offset and
    rotor explain first what they can: what is left of the motors cannot be theirs.
    """
    own = [find_own_dof(spec, i) for i in range(spec.model.nu)]
    if len([dof for dof in own if dof is not None]) < 2 or spec.model.neq:
        return []
    forces = measure_forces(spec, measurements)
    motors = [dof for dof in own if dof is not None and len(forces.time) and np.ptp(forces.actuator[:, dof]) > 0.0]
    bodies = respond_to_bodies(spec, forces) if len(motors) > 1 else np.zeros((0, spec.model.nv, 0))
    return [
        line for dof in motors if len(motors) > 1 for line in tell_followed(spec, forces, bodies[:, dof], dof, motors)
    ]


def tell_followed(spec: TwinSpec, forces: Forces, bodies: np.ndarray, dof: int, motors: Sequence[int]) -> list[str]:
    """The sentence of one joint, if any; `bodies` (n, k) is what a change of each of their numbers asks for there.

    Its own motor's force is what masses and laws of the joint ask for, whatever their sizes, less what others add.
    """
    own, every = forces.actuator[:, dof], np.corrcoef(forces.actuator[:, motors].T)
    others = [motor for motor, like in zip(motors, np.abs(every[motors.index(dof)])) if like < ONE]
    if not others:
        return []
    sure = np.column_stack([np.ones(len(own)), own + forces.missing[:, dof], *list_friction(forces, dof).T])
    loose = np.column_stack([bodies, chart(spec.model, forces.pose), forces.velocity, forces.acceleration])
    sure, loose, given = (smooth(forces, part) for part in (sure, loose, forces.actuator[:, others]))
    own, fold = smooth(forces, own[:, None])[:, 0], ((forces.time // BLOCK).astype(int) + forces.flight) % FOLDS
    before = min(foretell(sure, loose, own, fold, ridge) for ridge in RIDGES)
    tried = []
    for i, other in enumerate(others):
        beside = np.column_stack([sure, given[:, i]])
        after, ridge = min((foretell(beside, loose, own, fold, ridge), ridge) for ridge in RIDGES)
        tried.append((after, -float(solve(beside, loose, own, ridge)[sure.shape[1]]), float(given[:, i].std()), other))
    after, slope, size, other = min(tried)
    share = 1.0 - (after / max(before, 1e-300)) ** 2
    if share < FORETOLD or before < LEFT * own.std() or abs(slope) * size < MATERIAL * own.std():
        return []
    name, units = spec.robot.name_dof, ["N m" if turns else "N" for turns in spec.robot.rotary]
    return [HINT.format(name(dof), name(other), slope, units[dof], units[other], np.sqrt(share))]


def list_friction(forces: Forces, dof: int) -> np.ndarray:
    """What friction of a joint goes by, (n, 3): its sense, that times the load, and speed."""
    rate = forces.velocity[:, dof]
    sense = np.tanh(rate / max(SUDDEN * float(rate.std()), 1e-12))
    return np.column_stack([sense, sense * np.abs(forces.actuator[:, dof]), rate])


def respond_to_bodies(spec: TwinSpec, forces: Forces) -> np.ndarray:
    """What a change of each body's mass, centre of mass and inertia asks for, (n, nv, k)."""
    given = forces.pose, forces.velocity, forces.acceleration, forces.control
    plain, found = invert(spec.model, *given)[2], []
    for body in range(1, spec.model.nbody):
        for name, size in (("body_mass", 0.0), ("body_ipos", STEP), ("body_inertia", 0.0)):
            for axis in range(1 if name == "body_mass" else 3):
                model = copy(spec.model)
                values = getattr(model, name)[body : body + 1].reshape(1, -1)
                values[0, axis] += size or max(0.1 * float(values.max()), 1e-6)
                found.append(invert(model, *given)[2] - plain)
    return np.stack(found, axis=-1)


def smooth(forces: Forces, columns: np.ndarray) -> np.ndarray:
    """Means of columns (n, k) over `SMOOTHED`, in which noise of accelerations cancels and laws stay as they are."""
    wide = max(round(SMOOTHED / max(float(np.median(np.diff(forces.time))), 1e-9)), 1)
    found = np.empty_like(columns)
    for flight in np.unique(forces.flight):
        rows = np.flatnonzero(forces.flight == flight)
        summed = np.cumsum(np.vstack([np.zeros((1, columns.shape[1])), columns[rows]]), axis=0)
        ends = np.clip(np.arange(len(rows))[:, None] + [-(wide // 2), wide - wide // 2], 0, len(rows))
        found[rows] = (summed[ends[:, 1]] - summed[ends[:, 0]]) / np.diff(ends, axis=1)
    return found


def foretell(sure: np.ndarray, loose: np.ndarray, force: np.ndarray, fold: np.ndarray, ridge: float) -> float:
    """What is missed of a force (n,), root mean square, on folds other than those that it was learnt from."""
    missed = np.zeros(len(force))
    for i in range(FOLDS):
        test = fold == i
        found = solve(sure[~test], loose[~test], force[~test], ridge)
        missed[test] = force[test] - np.column_stack([sure, loose])[test] @ found
    return float(np.sqrt(np.mean(missed**2)))


def solve(sure: np.ndarray, loose: np.ndarray, force: np.ndarray, ridge: float) -> np.ndarray:
    """Least squares, in which what columns `loose` (n, k) make is small: by `ridge`, of what is left of the force."""
    size = np.maximum(loose.std(axis=0), 1e-12 * max(float(np.abs(loose).max()), 1e-300))
    penalty = np.sqrt(ridge * len(force)) * np.eye(loose.shape[1])
    rows = np.block([[sure, loose / size], [np.zeros((len(penalty), sure.shape[1])), penalty]])
    found = np.linalg.lstsq(rows, np.append(force, np.zeros(len(penalty))), rcond=None)[0]
    return np.append(found[: sure.shape[1]], found[sure.shape[1] :] / size)
