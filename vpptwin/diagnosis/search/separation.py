"""How far apart two explanations of the same flights are, each given the freedom to fit them as well as it can."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.search.likelihood import build_likelihood
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.inference.covariance import solve


class Hypothesis(Protocol):
    """An explanation of the flights, such as a `fits.Fit`: effects that are freed, and their fitted parameters."""

    @property
    def effects(self) -> frozenset[str]:
        """Ids of the effects that it frees."""

    @property
    def values(self) -> Mapping[Key, float]:
        """Their parameters, (effect id, parameter) → value."""


def separate(
    bench: Bench, hypotheses: Sequence[Hypothesis], unknowns: Sequence[Unknown], windows: np.ndarray | None = None
) -> np.ndarray:
    """How far every rival is from the named hypothesis on every flight of a bench, if the named one is true.

    Args:
        bench: windows of F flights.
        hypotheses: the named one first, then R rivals.
        unknowns: parameters that may be wrong.
        windows: how many windows each flight has, of which those on the bench are a sample, (F,); None for no more.

    Returns:
        Sigma: root of the drop in cost between a rival, refitted, and the named one, (R, F).
    """
    named, rivals = hypotheses[0], hypotheses[1:]
    held = [u for u in unknowns if u.effect.id in relate(hypotheses, unknowns) and is_tolerated(u)]
    freed = [[u for u in unknowns if u.effect.id in rival.effects] for rival in rivals]
    moves = [move(u, named.values) for u in held]
    changed = [values for values, _ in moves]
    for rival, own in zip(rivals, freed):
        changed += [dict(rival.values), *(move(u, rival.values)[0] for u in own)]
    white = whiten_changes(bench, named.values, changed)

    slopes = {u.key: white[i] / step for i, (u, (_, step)) in enumerate(zip(held, moves))}
    flights = bench.windows.flight
    sigma = np.zeros((len(rivals), flights.max() + 1))
    at = len(held)
    for i, (rival, own) in enumerate(zip(rivals, freed)):
        base = white[at]
        turned = {u.key: (white[at + 1 + j] - base) / move(u, rival.values)[1] for j, u in enumerate(own)}
        at += 1 + len(own)
        loose = [(slopes[u.key], u.parameter.tolerance) for u in held if u.effect.id not in rival.effects]
        loose += [(turned[u.key], 0.5 * (u.parameter.high - u.parameter.low)) for u in own]
        columns, width = np.stack([column for column, _ in loose]), np.array([w for _, w in loose])
        for flight in range(sigma.shape[1]):
            mine = flights == flight
            share = 1.0 if windows is None else windows[flight] / max(mine.sum(), 1)
            part = columns[:, mine].reshape(len(columns), -1)
            sigma[i, flight] = np.sqrt(refit_misfit(base[mine].ravel(), part, width, share))
    return sigma


def refit_misfit(misfit: np.ndarray, columns: np.ndarray, width: np.ndarray, share: float) -> float:
    """What is left of a whitened misfit (M,) once parameters with columns (P, M) and priors `width` (P,) are refitted.

    The windows count `share` times, as if the flight had so many more like them.
    """
    scaled = columns * width[:, None]
    along = share * scaled @ misfit
    hessian = np.eye(len(width)) + share * scaled @ scaled.T
    return max(float(share * misfit @ misfit - along @ solve(hessian, along)), 0.0)


def relate(hypotheses: Sequence[Hypothesis], unknowns: Sequence[Unknown]) -> set[str]:
    """Effects that matter between hypotheses: theirs, their look-alikes, and the look-alikes of those."""
    alike = {u.effect.id: set(u.effect.look_alikes) for u in unknowns}
    related: set[str] = set().union(*(h.effects for h in hypotheses))
    for _ in range(2):
        related |= {other for effect in related for other in alike.get(effect, ())}
    return related


def is_tolerated(unknown: Unknown) -> bool:
    """Whether a parameter may be a little off without blame; a limit that nothing reaches is not felt at all."""
    parameter = unknown.parameter
    return parameter.tolerance > 0.0 and unknown.nominal < parameter.high


def move(unknown: Unknown, values: Mapping[Key, float]) -> tuple[dict[Key, float], float]:
    """The values with one parameter moved by its secant step, and the step."""
    at = values.get(unknown.key, unknown.nominal)
    moved = float(unknown.parameter.clip(np.array(at + unknown.step_from(at))))
    return {**values, unknown.key: moved}, moved - at


def whiten_changes(bench: Bench, named: Mapping[Key, float], changed: Sequence[Mapping[Key, float]]) -> np.ndarray:
    """What every twin of `changed` predicts beyond the named one, in units of what noise and gusts do, (V, K, M)."""
    predicted = bench.predict([Variation(dict(values)) for values in (named, *changed)], named)
    change = np.where(bench.valid, predicted[1:] - predicted[0], 0.0)
    return build_likelihood(bench, dict(named)).whiten(change)
