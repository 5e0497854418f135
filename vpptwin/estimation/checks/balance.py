"""Columns against the MJCF: do inertia, weight and friction ask for the force that the efforts make?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from vpptwin.estimation.checks.readings import Misread, Reading, list_readings
from vpptwin.estimation.dynamics import find_driven_joint, measure_log
from vpptwin.estimation.joints import Collected, read_efforts
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import Measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.actuation import tell_control
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.spec import TwinSpec

LOOSE, TIGHT, EXACT = (0.2, 5.0), (0.75, 1.33), (0.9, 1.1)
"""Factors that inertia and weight, and efforts, may be wrong by: as the columns are read, and as another reading has
them, of which an effort in another unit is believed to be right but for the third. A gain, a load or a mass within the
first is for the diagnosis."""
POOR, GOOD, BETTER = 0.1, 0.12, 8.0
"""Share of the force that stays unexplained: from which on, below which, and how many times as much of the first."""
MOVED, SLACK = 0.5, 0.02
"""Share of mass times acceleration that another reading may leave; how much worse it may be with `TIGHT` than `LOOSE`:
else its factor is not that of the unit."""
HOPELESS = 0.6
"""Share from which on a reading is not looked at any closer."""
LATE = (0.0, 0.03, 0.06)
"""By which efforts may act late [s]."""
MIN_ROWS, ROWS, FEW, MIN_MOVING = 40, 250, 80, 15
"""Instants at which forces are looked at: at least, closely, and at a glance; at least of those with motion."""
RESTLESS = 0.7
"""Share of the time for which a joint moves, below which the instants at which it rests are left out."""
SMOOTH = 0.05
"""Share of the usual speed over which Coulomb friction turns round."""


class Explained(NamedTuple):
    """Of every degree of freedom (nv,) the share of what moves it that the MJCF, efforts and friction do not explain.

    Attributes:
        loose, tight: where inertia and weight, and efforts, may be wrong by `LOOSE`, by `TIGHT`.
        idle: as `tight`, were there no efforts.
        motion: `tight` as a share of mass times acceleration alone.
    """

    loose: np.ndarray
    tight: np.ndarray
    idle: np.ndarray
    motion: np.ndarray


def compare_forces(
    spec: TwinSpec, flights: Sequence[Flight], measurements: Sequence[Measurements]
) -> tuple[Flight, Misread | None]:  # fmt: skip
    """The log of which the MJCF explains least, and a reading with which it does; None where that is enough."""
    judged = list_judged(spec)
    logs = zip(flights, measurements, strict=True) if judged.any() and not spec.model.neq else ()
    told = [(flight, log, given) for flight, log in logs if (given := explain(spec, log)) is not None]
    if not told:
        return flights[0], None
    flight, log, given = max(told, key=lambda each: float(np.minimum(each[2].loose, 1.0)[judged].sum()))
    poor = judged & (given.loose > POOR)
    best: tuple[float, Reading, np.ndarray] | None = None
    for reading in list_readings(spec, flight) if poor.any() else ():
        other = explain_otherwise(spec, flight, log, reading, poor)
        if other is None:
            continue
        mended = find_mended(given, other)
        if reading.columns[0].quantity == "effort":  # efforts so small that they don't matter are no explanation
            mended &= 2.0 * other.tight < other.idle
        if 2 * np.count_nonzero(mended & poor) < np.count_nonzero(poor) or makes_worse(given, other, judged):
            continue
        left = float(np.minimum(other.tight, 1.0)[judged].mean())
        if best is None or left < 0.5 * best[0] - 0.005:
            best = left, reading, other.tight
    if best is None:
        return flight, None
    _, reading, tight = best
    most = int(np.argmax(np.where(poor, given.loose - tight, -1.0)))
    shares = f"{1.0 - tight[most]:.0%} of the force on {spec.robot.name_dof(most)}, "
    return flight, Misread(reading, f"the MJCF explains {shares}{max(1.0 - given.loose[most], 0.0):.0%} as given")


def find_mended(given: Explained, other: Explained) -> np.ndarray:
    """Degrees of freedom (nv,) bool that another reading explains, and far better than the given one."""
    left = np.minimum(given.loose, given.tight)
    good = (other.tight < GOOD) & (BETTER * other.tight < left) & (other.motion < MOVED)
    return np.asarray(good & (other.tight < 2.0 * other.loose + SLACK))


def makes_worse(given: Explained, other: Explained, judged: np.ndarray) -> bool:
    """Whether another reading explains some degree of freedom of those `judged` (nv,) badly, and worse."""
    return bool((judged & (other.tight > np.maximum(given.loose, POOR))).any())


def explain_otherwise(
    spec: TwinSpec, flight: Flight, measured: Measurements, reading: Reading, poor: np.ndarray
) -> Explained | None:
    """What is explained of the columns as a reading has them; None where that says nothing, or nothing new."""
    taken, pushed = reading.read(spec.robot.signals, flight), [c for c in reading.columns if c.quantity == "effort"]
    rescaled = bool(pushed) and abs(reading.changes[0].scale) != 1.0
    try:
        if pushed:
            read = Collected(positions=measured.positions, driven=measured.driven)
            other = replace(measured, command=read_efforts(spec, taken, spec.robot.signals.actuators, read))
        else:
            other = read_measurements(spec, taken)
    except InputError:
        return None
    quick = explain(spec, other, LATE[:1], rescaled, FEW)
    return None if quick is None or (quick.tight[poor] > HOPELESS).all() else explain(spec, other, exact=rescaled)


def list_judged(spec: TwinSpec) -> np.ndarray:
    """Degrees of freedom that are simulated, and not held by a servo whose gains nobody knows, (nv,) bool."""
    model = spec.model
    judged = np.ones(model.nv, dtype=bool)
    judged[list(spec.robot.driven)] = False
    for i in range(model.nu):
        if tell_control(model, i) != "effort":
            joint = find_driven_joint(model, i)
            if joint is None or model.jnt_type[joint] in (FREE, BALL):
                return np.zeros(model.nv, dtype=bool)
            judged[model.jnt_dofadr[joint]] = False
    return judged


def explain(
    spec: TwinSpec, measured: Measurements, late: Sequence[float] = LATE, exact: bool = False, count: int = ROWS,
    level: bool = True,
) -> Explained | None:  # fmt: skip
    """What explains a log's motion, by least squares of every degree of freedom alone; None where it is too short.

    M a = -β rest + α effort + offset + viscous + Coulomb friction, where α and β may be wrong, and efforts `late` [s].
    With `exact` α may be wrong by `EXACT` instead of `TIGHT`. It looks at `count` instants. Without `level` there is no
    offset, and β is within `EXACT`.
    """
    weight = TIGHT if level else EXACT
    found, bounds = [], ((LOOSE, LOOSE), (weight, EXACT if exact else TIGHT), (weight, (0.0, 0.0)))
    for delay in late:
        rows = measure_log(spec, measured, 0, count, delay)
        velocity, inertial, actuator, missing = (rows[i] for i in (3, 5, 6, 7))
        if len(inertial) < MIN_ROWS:
            return None
        rest, left = missing + actuator - inertial, np.zeros((4, spec.model.nv))
        sizes = inertial.std(axis=0), rest.std(axis=0)
        for dof in np.flatnonzero((sizes[0] > 0.0) & np.isfinite(sum(sizes))):
            size, speed = float(sizes[0][dof]), max(float(velocity[:, dof].std()), 1e-9)
            rate = velocity[:, dof] / speed
            used = choose_moving(rate)
            beside = np.column_stack([*[np.ones(len(rate))] * level, rate, np.tanh(rate / SMOOTH)])[used]
            bounded = (np.column_stack([-rest[:, dof], actuator[:, dof]]) / size)[used]
            for i, within in enumerate(bounds):
                (weight, _), square = fit_bounded(bounded, beside, inertial[used, dof] / size, within)
                left[i, dof] = square / max(1.0, (weight * sizes[1][dof] / size) ** 2)
                left[3, dof] = square if i == 1 else left[3, dof]
        found.append(left)
    return Explained(*np.min(found, axis=0))


def choose_moving(rate: np.ndarray) -> np.ndarray:
    """Instants (n,) bool at which a joint moves, where it rests often: at rest friction is any force up to a level.

    Args:
        rate: (n,) as a share of the usual speed.
    """
    moving = np.abs(rate) > 2.0 * SMOOTH
    rests = np.mean(moving) < RESTLESS and np.count_nonzero(moving) >= MIN_MOVING
    return moving if rests else np.ones(len(rate), dtype=bool)


def fit_bounded(
    bounded: np.ndarray, free: np.ndarray, target: np.ndarray, within: Sequence[tuple[float, float]]
) -> tuple[np.ndarray, float]:
    """Least squares of a target (n,), coefficients of two columns (n, 2) bounded: these (2,), and the mean square left.

    It is convex: of all fits with some coefficients at a bound that keep within bounds the best is the best of all.
    """
    q = np.linalg.qr(free)[0]
    a, b = (values - q @ (q.T @ values) for values in (bounded, target))
    gram, moment, square = a.T @ a, a.T @ b, float(b @ b)
    tried = [np.array(pair) for pair in product(*within)]
    for i in range(2):  # one at a bound, the other free
        for at in within[i]:
            rest = np.clip((moment[1 - i] - gram[0, 1] * at) / max(gram[1 - i, 1 - i], 1e-300), *within[1 - i])
            tried.append(np.array([at, rest] if i == 0 else [rest, at]))
    both = np.linalg.lstsq(gram, moment, rcond=None)[0]
    tried += [both] if all(low <= x <= high for x, (low, high) in zip(both, within)) else []
    squares = [square - 2.0 * float(x @ moment) + float(x @ gram @ x) for x in tried]
    return tried[int(np.argmin(squares))], max(min(squares), 0.0) / len(target)
