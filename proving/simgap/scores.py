"""Proper scores of what an entrant says of a session: which cause, what size, what comes next. Less is better.

scoringrules is imported where it is used: it compiles for seconds, and entrants need none of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

NOTHING, UNKNOWN = "nothing", "unknown"
"""Answers beside the causes of a session: the model is right; something that is not listed is wrong with it."""
MIXED = 0.01
"""Share of every answer that is spread evenly over all answers, so that the logarithm stays finite. The score is
proper for whoever believes none of N answers less probable than `MIXED` / N."""


def complete_answer(said: Mapping[str, float], causes: Sequence[str]) -> dict[str, float]:
    """Probabilities of all causes, nothing and unknown, which sum to one; what is not named has none but its share.

    Raises:
        ValueError: where a name is unknown, or the probabilities are none or do not sum to one.
    """
    answers = [*causes, NOTHING, UNKNOWN]
    if strange := sorted(set(said) - set(answers)):
        raise ValueError(f"probabilities of {', '.join(strange)}: write ids of known.json, {NOTHING} or {UNKNOWN}")
    total = float(sum(said.values()))
    if not all(0.0 <= p <= 1.0 for p in said.values()) or abs(total - 1.0) > 1e-3:
        raise ValueError(f"probabilities that sum to {total:g}: write numbers from 0 to 1 that sum to 1")
    return {name: (1.0 - MIXED) * said.get(name, 0.0) / total + MIXED / len(answers) for name in answers}


def group_answer(answer: Mapping[str, float], groups: Mapping[str, str]) -> dict[str, float]:
    """Probabilities of groups, of a complete answer; cause → group, what has none is its own."""
    found: dict[str, float] = {}
    for name, p in answer.items():
        group = groups.get(name, name)
        found[group] = found.get(group, 0.0) + p
    return found


def score_log(answer: Mapping[str, float], *truths: str) -> float:
    """Mean surprise at what is true, less that of equal shares of it [nats]."""
    return -float(np.mean([np.log(len(truths) * answer[truth]) for truth in truths]))


def score_brier(answer: Mapping[str, float], *truths: str) -> float:
    """Squared distance from equal shares of what is true: 0 to 2."""
    return float(sum((p - (name in truths) / len(truths)) ** 2 for name, p in answer.items()))


def score_sizes(
    answer: Mapping[str, float], samples: Mapping[str, Sequence[float]], sizes: Mapping[str, float],
    off: Mapping[str, float], scales: Mapping[str, float],
) -> float:  # fmt: skip
    """Sum of the CRPS of all causes' sizes, each over its scale.

    A cause has its samples with its probability, and else its off value. Causes that are absent are scored too: a
    score of those alone that are there would pay for overstatement.

    Args:
        answer: complete, of the causes and more.
        samples: cause → sizes, equally likely; a cause without any keeps its off value.
        sizes: cause → true size, of those that are there.
        off: cause → size without it.
        scales: cause → typical difference from that.
    """
    from scoringrules import crps_ensemble

    total = 0.0
    for cause, none in off.items():
        given = np.asarray(samples.get(cause, [none]), float)
        weights = np.append(np.full(len(given), answer[cause] / len(given)), 1.0 - answer[cause])
        members, truth = np.append(given, none), sizes.get(cause, none)
        total += float(crps_ensemble(truth, members, ens_w=weights, estimator="nrg", backend="numpy")) / scales[cause]
    return total


def score_prediction(measured: np.ndarray, samples: np.ndarray, scale: np.ndarray) -> float:
    """Energy score of predicted windows, per root of what is predicted, mean over windows.

    Args:
        measured: (K, T, n).
        samples: trajectories, equally likely, (K, S, T, n).
        scale: of each column, (n,).
    """
    from scoringrules import es_ensemble

    windows, many = len(measured), samples.shape[1]
    truth, told = (measured / scale).reshape(windows, -1), (samples / scale).reshape(windows, many, -1)
    return float(np.mean(es_ensemble(truth, told, backend="numpy")) / np.sqrt(truth.shape[1]))


def is_confident_error(answer: Mapping[str, float], *truths: str, confident: float = 0.9) -> bool:
    """Whether something else than the truth is given that much."""
    return any(p >= confident for name, p in answer.items() if name not in truths)


def bootstrap(
    values: Sequence[float], measure: Callable[[np.ndarray], float] = np.mean, draws: int = 2000, seed: int = 0
) -> tuple[float, float, float]:
    """A measure of sessions' values, and its 95 % interval when sessions are drawn anew."""
    listed = np.asarray(values, float)
    rows = np.random.default_rng(seed).integers(len(listed), size=(draws, len(listed)))
    low, high = np.quantile([measure(listed[row]) for row in rows], [0.025, 0.975])
    return float(measure(listed)), float(low), float(high)
