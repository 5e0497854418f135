"""A verdict in sentences, the same for the terminal and the report."""

from __future__ import annotations

from dataclasses import dataclass

from vpptwin.diagnosis.holdout import HORIZONS_S, Score
from vpptwin.diagnosis.verdict import Cause, Estimate, Verdict

MILLI = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


@dataclass(frozen=True)
class ErrorTable:
    """Errors over the horizon: a title and rows of (horizon, before, after)."""

    title: str
    rows: list[tuple[str, str, str]]


def format_value(estimate: Estimate) -> str:
    """Value ± standard deviation with unit, to the digits that the deviation leaves meaningful."""
    unit = f" {estimate.unit}" if estimate.unit else ""
    if not 0.0 < estimate.std < float("inf"):
        return f"{estimate.value:.4g}{unit}"
    digits = max(0, -int(f"{estimate.std:.0e}".split("e")[1]) + (1 if f"{estimate.std:.0e}"[0] == "1" else 0))
    return f"{estimate.value:.{digits}f} ± {estimate.std:.{digits}f}{unit}"


def describe_cause(cause: Cause) -> str:
    """One sentence: what, how much, and what it explains."""
    sizes = ", ".join(f"{name} {format_value(e)}" for name, e in cause.parameters.items())
    if all(e.nominal == 0.0 for e in cause.parameters.values()):
        beside = "which the twin lacks, "
    else:
        beside = "where the twin has " + ", ".join(f"{e.nominal:g}" for e in cause.parameters.values()) + ", "
    what = cause.summary[0].upper() + cause.summary[1:]
    share = 100.0 * min(max(cause.gain, 0.0), 1.0)
    return f"{what} ({cause.effect}), {sizes}, {beside}explains {share:.0f} % of the error."


def headline(verdict: Verdict) -> str:
    """The sentence to read if one reads no other."""
    if verdict.causes:
        return describe_cause(verdict.causes[0])
    if verdict.unexplained.significant:
        return "Something that no known effect explains separates the twin from these flights."
    return "The twin explains these flights as well as sensor noise and gusts allow; nothing is accused."


def describe_rivals(cause: Cause) -> str:
    """How sure the naming is, and what else it could be."""
    text = f"{cause.effect}: {100 * cause.confidence:.1f} % sure"
    if cause.also_explained_by:
        others = ", ".join(f"{r.effect} ({100 * r.confidence:.0f} %)" for r in cause.also_explained_by)
        return f"{text}; these flights cannot tell it from {others}"
    return f"{text}; no other effect of the catalogue comes close"


def describe_leftover(verdict: Verdict) -> str:
    """What remains unexplained."""
    left = verdict.unexplained
    if not left.significant:
        return "Nothing beyond noise and gusts is left unexplained."
    follows = f", follows {', '.join(left.depends_on)}" if left.depends_on else ""
    return f"Left unexplained: {100 * left.share:.0f} % of the error, most of it in {left.channel}{follows}."


def tabulate_errors(before: Score, after: Score | None) -> list[ErrorTable]:
    """Errors over the horizon as tables, before and after."""
    tables = []
    for title, unit, name in (("position error", "m", "position_rmse_m"), ("angle error", "rad", "angle_rmse_rad")):
        first = getattr(before, name)
        second = getattr(after, name) if after is not None else None
        if first is not None:
            small, factor = MILLI[unit]
            tables.append(tabulate(f"{title} [{small}]", first, second, factor))
    for joint, first in before.velocity_rmse.items():
        tables.append(tabulate(f"{joint} error [SI]", first, after.velocity_rmse[joint] if after else None, 1.0))
    return tables


def tabulate(title: str, before: list[float], after: list[float] | None, factor: float) -> ErrorTable:
    """One table: horizon, error before, error after."""
    rows = [
        (f"{horizon:g} s", f"{factor * b:.3g}", f"{factor * after[i]:.3g}" if after is not None else "")
        for i, (horizon, b) in enumerate(zip(HORIZONS_S, before))
    ]
    return ErrorTable(title, rows)
