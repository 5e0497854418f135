"""Where to look next: every suspect ranked in closed form from one linearisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.search.frame import Linearisation
from vpptwin.diagnosis.search.solution import Solution, solve_hypothesis
from vpptwin.diagnosis.search.suspects import Trial, Unknown


@dataclass(frozen=True)
class Start:
    """Where a refit starts: a suspect, its parameters, and the drop in cost that linearisation promises."""

    effect: str
    values: Mapping[Key, float]
    drop: float


def advance(
    about: Linearisation, unknowns: Sequence[Unknown], effects: frozenset[str], solution: Solution, stride: float = 1.0
) -> dict[Key, float]:
    """Parameters of `effects` a share `stride` of the way from a linearisation to its solution, inside their bounds."""
    moved = {}
    for unknown, at, step in zip(unknowns, about.at, solution.deviation):
        if unknown.effect.id in effects:
            moved[unknown.key] = float(unknown.parameter.clip(at + stride * step))
    return moved


def rank_effects(
    about: Linearisation, unknowns: tuple[Unknown, ...], base: Solution, effects: frozenset[str],
    barred: frozenset[str],
) -> list[Start]:  # fmt: skip
    """Every other effect freed beside `effects`: where the solution lies, and by how much its cost is lower.

    Args:
        about: linearisation about a fit of `effects`.
        unknowns: its parameters.
        base: its solution with `effects` freed.
        effects: ids of the fit.
        barred: ids that are left out.
    """
    starts = []
    limited = {u.effect.id for u in unknowns if u.is_limit}
    for effect in {u.effect.id for u in unknowns} - effects - barred - limited:
        freed = effects | {effect}
        solution = solve_hypothesis(about, unknowns, freed, near=base)
        starts.append(Start(effect, advance(about, unknowns, freed, solution), base.cost - solution.cost))
    return starts


def rank_trials(
    about: Linearisation, unknowns: Sequence[Unknown], trials: Sequence[Trial], base: Solution,
    barred: frozenset[str],
) -> list[Start]:  # fmt: skip
    """The same for trials: the drop in cost along each, everything else at its best beside it."""
    if not len(about.trials):
        return []
    tried, scale = about.whiten_trials(), about.frame.scale
    left = about.residual - about.columns.weigh(base.deviation)
    cross = (about.columns @ tried.T).T
    across = np.einsum("tn,tn->t", tried, tried) / scale
    across -= np.einsum("ti,ij,tj->t", cross, base.covariance, cross) / scale**2
    along = tried @ left / scale
    starts = []
    for trial, curvature, gradient in zip(trials, across, along):
        if trial.effect in barred or curvature <= 1e-6:
            continue
        times = 1.0 if trial.limit else float(np.clip(gradient / curvature, 0.0, 10.0))
        values = dict(trial.values)
        if not trial.limit:
            key = next(iter(trial.values))
            unknown = next(u for u in unknowns if u.key == key)
            moved = unknown.nominal + times * (trial.values[key] - unknown.nominal)
            values[key] = float(unknown.parameter.clip(np.array(moved)))
        starts.append(Start(trial.effect, values, float(2.0 * times * gradient - times**2 * curvature)))
    return starts


def start_from_look_alikes(
    about: Linearisation, unknowns: Sequence[Unknown], cause: str, at: Mapping[Key, float],
    beside: Mapping[Key, float],
) -> list[Start]:  # fmt: skip
    """Where the catalogue's look-alikes of a cause do most nearly what it does.

    Args:
        about: linearisation without the cause.
        unknowns: its parameters.
        cause: id of the cause.
        at: its parameters.
        beside: parameters of the effects that stay.
    """
    effect = next(u.effect for u in unknowns if u.effect.id == cause)
    moved = np.array([at.get(u.key, u.nominal) - u.nominal if u.effect.id == cause else 0.0 for u in unknowns])
    wanted = about.columns.weigh(moved)
    starts = []
    for other in {u.effect.id: u.effect for u in unknowns}.values():
        if other.id not in effect.look_alikes and cause not in other.look_alikes:
            continue
        rows = [i for i, u in enumerate(unknowns) if u.effect.id == other.id]
        units = np.array([unknowns[i].scale_at(unknowns[i].nominal) for i in rows])
        columns = about.columns.take(rows) * units[:, None]
        if not np.any(columns) or any(unknowns[i].is_limit for i in rows):
            continue
        times = np.linalg.lstsq(columns.T, wanted, rcond=1e-6)[0]
        values = dict(beside)
        for i, step in zip(rows, times * units):
            values[unknowns[i].key] = float(unknowns[i].parameter.clip(unknowns[i].nominal + step))
        starts.append(Start(other.id, values, 0.0))
    return starts
