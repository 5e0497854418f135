"""Scores of answers: of one to a session, and of an entrant over many, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from proving.simgap.scores import (
    NOTHING,
    bootstrap,
    complete_answer,
    group_answer,
    is_confident_error,
    score_brier,
    score_log,
    score_prediction,
    score_sizes,
)  # fmt: skip
from proving.simgap.session import HORIZONS, Session, Truth

LIKELY, INTERVAL = 0.5, 0.9
"""Probability from which a cause is said to be there, and share of the samples that an interval holds."""
SILENT: dict[str, float] = {NOTHING: 1.0}
"""What counts as the answer of an entrant that fails or says nothing."""


@dataclass(frozen=True)
class Measure:
    """A column of the board: what it is called, how it is worked out of sessions' values, which way is better."""

    title: str
    less: bool
    about: str


MEASURES = {
    "log": Measure("log score", True, "surprise at the true cause, nats"),
    "brier": Measure("Brier", True, "squared distance from certainty of the truth, 0 to 2"),
    "log_group": Measure("log score, groups", True, "the same over causes of one kind at one place"),
    "brier_group": Measure("Brier, groups", True, "likewise"),
    "first": Measure("right first", False, "share of sessions whose truth has the highest probability"),
    "sizes": Measure("CRPS of sizes", True, "over all causes of a session, in typical sizes"),
    "confident": Measure("confident errors", True, "share of sessions where something else has 0.9 or more"),
    "alarm": Measure("false alarms", True, "share of sessions with nothing wrong where a cause has 0.5 or more"),
    "held": Measure("intervals hold", False, f"share of {INTERVAL:.0%} intervals of sizes that hold the truth"),
    "energy": Measure("energy score", True, "of forecasts up to a second ahead, in standard deviations of the motion"),
    "onset": Measure("CRPS of onset", True, "as a share of the run; no onset counts as one at its end"),
    "failed": Measure("failed", True, "share of sessions without a valid answer, scored as `nothing`"),
    "seconds": Measure("time [s]", True, "of a session, median, start of the program included"),
    "memory_mb": Measure("memory [MB]", True, "most that was held, median"),
}


def score_answer(answer: Mapping[str, Any] | None, session: Session, truth: Truth) -> dict[str, float]:
    """All scores of one answer; None for an entrant that failed. A track without an answer is scored as its baseline.

    The baseline names `nothing` and forecasts that the motion stays where the last sample has it.
    """
    given = dict(answer or {})
    scores = {"failed": float(answer is None)}
    for cost in ("seconds", "memory_mb"):
        if cost in given:
            scores[cost] = float(given[cost])
    if "name" in session.tracks:
        scores |= score_name(given, session, truth)
    if "predict" in session.tracks:
        told = given.get("forecasts") or stay(session)
        each = [
            score_prediction(np.array([m]), np.asarray(t, float)[None], np.array(list(session.scales.values())))
            for m, t in zip(truth.forecasts, told)
        ]
        scores["energy"] = float(np.mean(each))
    if "watch" in session.tracks:
        scores["onset"] = score_onset(given.get("onset", {"probability": 0.0}), session.runs[-1].time[-1], truth.onset)
    return scores


def score_name(given: Mapping[str, Any], session: Session, truth: Truth) -> dict[str, float]:
    """Scores of cause and size."""
    told = complete_answer(given.get("probabilities") or SILENT, list(session.causes))
    true, groups = truth.present, session.groups
    grouped, right = group_answer(told, groups), {groups.get(name, name) for name in true}
    there = {name: min(1.0, session.many * p) if name in session.causes else p for name, p in told.items()}
    samples = given.get("sizes", {})
    off, scales = ({k: getattr(c, name) for k, c in session.causes.items()} for name in ("off", "scale"))
    sizes = {cause: size for cause, size in truth.sizes.items() if cause in session.causes}
    scores = {
        "log": score_log(told, *true), "brier": score_brier(told, *true),
        "log_group": score_log(grouped, *right), "brier_group": score_brier(grouped, *right),
        "first": float(max(told, key=lambda name: told[name]) in true),
        "sizes": score_sizes(there, samples, sizes, off, scales),
        "confident": float(is_confident_error(told, *true)),
    }  # fmt: skip
    if truth.answer == NOTHING:
        scores["alarm"] = float(any(p >= LIKELY for name, p in told.items() if name in session.causes))
    held = []
    for name in true:
        if name in samples and there[name] >= LIKELY and len(samples[name]) > 1:
            low, high = np.quantile(samples[name], [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2])
            held.append(low <= truth.sizes[name] <= high)
    if held:
        scores["held"] = float(np.mean(held))
    return scores


def stay(session: Session) -> list[list[list[list[float]]]]:
    """Forecasts that the motion stays where the last sample before the start has it."""
    last = [
        [float(w.run.columns[c][np.isfinite(w.run.columns[c])][-1]) for c in session.predicted] for w in session.windows
    ]
    return [[[here] * len(HORIZONS)] for here in last]


def score_onset(onset: Mapping[str, Any], end: float, truth: float | None) -> float:
    """CRPS of the time at which something sets in, over the run's length; none counts as at its end."""
    from scoringrules import crps_ensemble

    chance, times = float(onset["probability"]), np.clip(np.asarray(onset.get("times", [0.5 * end]), float), 0.0, end)
    members = np.append(times, end)
    weights = np.append(np.full(len(times), chance / len(times)), 1.0 - chance)
    real = end if truth is None else truth
    return float(crps_ensemble(real, members, ens_w=weights, estimator="nrg", backend="numpy")) / end


def summarise(scores: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float, float]]:
    """Measure → its value over sessions and its 95 % interval when sessions are drawn anew; medians of costs."""
    found = {}
    for name in MEASURES:
        values = [one[name] for one in scores if name in one]
        if values:
            middle: Callable[[np.ndarray], float] = np.median if name in ("seconds", "memory_mb") else np.mean  # type: ignore[assignment]
            found[name] = bootstrap(values, middle)
    return found


def compare(ours: Sequence[float], theirs: Sequence[float]) -> tuple[float, float, float]:
    """Mean difference of scores on the same sessions, and its 95 % interval."""
    return bootstrap(np.subtract(ours, theirs).tolist())
