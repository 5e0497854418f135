"""Entrants that fit forces: an engineer's spreadsheet, least squares on Pinocchio's regressor, sparse regression."""

from __future__ import annotations

import tempfile

import numpy as np
import pinocchio as pin

from proving.simgap.entrants.corrections import Correction, find_dof, kind_of
from proving.simgap.entrants.lab import RATE, SMOOTHED, Lab

TEXTBOOK = ("coulomb", "viscous", "drag", "bias", "spring", "inertia", "gain", "wind", "twist", "mass")
"""Kinds that a spreadsheet plots a residual force against."""
MEMORY = 0.1
"""Time over which residual forces count as one observation [s]."""
DRAWS = 30


def draw_sizes(rng: np.random.Generator, size: float, std: float) -> list[float]:
    """Equally likely sizes."""
    return [float(size + std * z) for z in rng.standard_normal(DRAWS)]


def fit_spreadsheet(lab: Lab) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """Residual force against one textbook column at a time; evidence is n_eff / 2 times the log of squares' ratio."""
    lacking, pushes, noise = lab.table
    rng = np.random.default_rng(0)
    count = len(lacking) / (MEMORY * RATE)
    evidence, sizes, best = {}, {}, (0.0, Correction("", 0.0))
    target = (lacking / noise).ravel()
    for cause, push in pushes.items():
        if kind_of(cause) not in TEXTBOOK:
            continue
        column, spring = (push / noise).ravel(), kind_of(cause) == "spring"
        beside = [(np.abs(push).max(axis=0) > 0.0) / noise + 0.0 * lacking] if spring else []
        design = np.stack([column, *(b.ravel() for b in beside)], axis=1)
        fitted = np.linalg.lstsq(design, target, rcond=None)[0]
        left, before = float(np.sum((target - design @ fitted) ** 2)), float(target @ target)
        likelier = 0.5 * count * lab.model.nv * np.log(before / max(left, 1e-12 * before))
        worth = likelier - 0.5 * np.log(count) * len(fitted)
        size, off = float(fitted[0]), lab.session.causes[cause].off
        if kind_of(cause) in ("coulomb", "viscous", "drag", "spring") and size < 0.0:
            worth = -1.0
        std = float(np.sqrt(left / len(target) / max(float(column @ column), 1e-30) * MEMORY * RATE))
        evidence[cause], sizes[cause] = worth, draw_sizes(rng, off + size, std)
        rest = (
            float(np.mean([m.q[:, find_dof(lab.model, cause.split(".")[0])].mean() for m in lab.motions]))
            if spring
            else 0.0
        )
        other = rest + float(fitted[1]) / size if spring and size > 0.0 else 0.0
        if worth > best[0]:
            best = worth, Correction(cause, off + size, other)
    return evidence, sizes, [best[1]] if best[1].cause else []


def fit_regressor(lab: Lab) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """All base parameters, friction and drive gains at once; evidence is half of a change's squared standard score.

    Links' inertial parameters are Pinocchio's, as changes from the nominal; a change of them counts as `inertia` of the
    joint that carries the link. Columns that others make up are dropped (`pick_independent`).
    """
    model = lab.model
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(lab.session.model)
        file.flush()
        robot = pin.buildModelFromMJCF(file.name)
    data = robot.createData()
    lacking, pushes, noise = lab.table
    rows, kept = [], slice(SMOOTHED, -SMOOTHED)
    for motion, _, _ in lab.residuals:
        each = [
            pin.computeJointTorqueRegressor(robot, data, q, v, a).reshape(robot.nv, -1).copy()
            for q, v, a in zip(motion.q, motion.v, motion.a)
        ]
        rows.append(np.stack(each)[kept])
    inertial = np.concatenate(rows)
    joints = [model.joint(i).name for i in range(model.njnt)]
    owners = [f"{joints[k // 10]}.inertia" for k in range(inertial.shape[2])]
    columns = [(owner, -inertial[:, :, k]) for k, owner in enumerate(owners)]
    for cause, push in pushes.items():
        if kind_of(cause) in ("coulomb", "viscous", "bias", "gain", "inertia"):
            columns.append((cause, push))
    design = np.stack([(c / noise).ravel() for _, c in columns], axis=1)
    target, scale = (lacking / noise).ravel(), np.linalg.norm(design, axis=0)
    design = np.where(scale > 1e-9 * scale.max(), design, 0.0) / np.maximum(
        scale, 1e-12
    )  # what is rounding is left out
    keep = pick_independent(design)
    part = design[:, keep]
    fitted = np.linalg.lstsq(part, target, rcond=None)[0]
    left = float(np.sum((target - part @ fitted) ** 2)) / max(len(target) - len(keep), 1) * MEMORY * RATE
    std = np.sqrt(left * np.diag(np.linalg.inv(part.T @ part)))
    rng, evidence, sizes, found = np.random.default_rng(0), {}, {}, []
    for k, size, error in zip(keep, fitted, std):
        cause = columns[k][0]
        if cause not in lab.session.causes:
            continue
        worth = 0.5 * float(size / error) ** 2
        if worth > evidence.get(cause, -1.0):
            evidence[cause] = worth
        if k >= len(owners):
            off = lab.session.causes[cause].off
            value, spread = float(size / scale[k]), float(error / scale[k])
            sizes[cause] = draw_sizes(rng, off + value, spread)
            found.append(Correction(cause, off + value))
    return evidence, sizes, [c for c in found if evidence[c.cause] > 4.5]


def pick_independent(design: np.ndarray, least: float = 1e-3) -> list[int]:
    """Columns of unit norm that those behind them do not make up, by Gram-Schmidt from the last to the first."""
    basis: list[np.ndarray] = []
    kept = []
    for k in range(design.shape[1] - 1, -1, -1):
        left = design[:, k].copy()
        for b in basis:
            left -= b * (b @ left)
        size = np.linalg.norm(left)
        if size > least:
            basis.append(left / size)
            kept.append(int(k))
    return sorted(kept)


def fit_sparse(lab: Lab) -> tuple[dict[str, float], dict[str, list[float]], list[Correction]]:
    """PySINDy's STLSQ over all forces of one size; evidence of a kept term is what it explains that no other does."""
    import pysindy

    lacking, pushes, noise = lab.table
    target, names = (lacking / noise).ravel(), list(pushes)
    columns = np.stack([(pushes[name] / noise).ravel() for name in names], axis=1)
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    size = max(float(np.linalg.norm(target)), 1e-12)
    fitted = pysindy.STLSQ(threshold=0.1).fit(columns / scale, target[:, None] / size).coef_[0]
    kept = np.flatnonzero(fitted)
    count, evidence, sizes, found = len(lacking) / (MEMORY * RATE) * lab.model.nv, dict.fromkeys(names, 0.0), {}, []
    rng = np.random.default_rng(0)

    def left(some: np.ndarray) -> float:
        part = columns[:, some] / scale[some]
        return (
            float(np.sum((target - part @ np.linalg.lstsq(part, target, rcond=None)[0]) ** 2)) if len(some) else size**2
        )

    full = left(kept)
    for i in kept:
        evidence[names[i]] = 0.5 * count * np.log(left(kept[kept != i]) / max(full, 1e-12))
        off, value = lab.session.causes[names[i]].off, float(fitted[i] * size / scale[i])
        std = float(np.sqrt(full / len(target) * MEMORY * RATE) / scale[i])
        sizes[names[i]] = draw_sizes(rng, off + value, std)
        found.append(Correction(names[i], off + value))
    return evidence, sizes, found
