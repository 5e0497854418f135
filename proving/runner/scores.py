"""The figures of the diagnostic competitions (DX), and rates group by group; of any list of cases, whatever the rig.

A fault is whatever is hidden, in the catalogue or not; it is *detected* when something is named or said to be left
unexplained. Small deviations that nobody asks for count on neither side (`Case.neither`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from proving.runner.case import Case
from proving.runner.rates import Figure, Rate, confidence_bins, count, is_flagged, leaves_something, list_claims


def is_detected(case: Case) -> bool:
    """Whether the verdict says that something is wrong, with a name or without."""
    return bool(case.first) or leaves_something(case)


def is_false_alarm(case: Case) -> bool:
    """Whether a verdict on a rig with nothing hidden says so; what small deviations leave unexplained is none."""
    return bool(case.first) or (leaves_something(case) and not case.neither)


def find_probability(case: Case, effect: str) -> float:
    """Probability that a verdict gives an effect: its confidence, or as a rival its share of what the cause leaves."""
    causes = case.found.causes if case.found else []
    said = [cause.confidence for cause in causes if cause.effect == effect]
    shared = [(1.0 - cause.confidence) / len(cause.rivals) for cause in causes if effect in cause.rivals]
    return max(said or shared, default=0.0)


def list_isolations(cases: Iterable[Case]) -> list[float]:
    """Mean probability given to the truth, of each session with an effect of the catalogue and something detected."""
    faulty = (case for case in cases if case.plan.known and is_detected(case))
    return [float(np.mean([find_probability(case, effect) for effect in case.plan.known])) for case in faulty]


def list_bets(cases: Iterable[Case]) -> list[tuple[float, bool]]:
    """Probability and truth of every cause that counts, and of every hidden effect that is no cause."""
    missed = [
        (find_probability(case, effect), True)
        for case in cases
        for effect in sorted(case.plan.known - set(case.found.named if case.found else ()))
    ]
    return list_claims(cases) + missed


def measure_brier(bets: Sequence[tuple[float, bool]]) -> float:
    """Mean squared difference of probability and truth: 0 is perfect, 50 % on everything gets 0.25. NaN for none."""
    return float(np.mean([(p - hit) ** 2 for p, hit in bets])) if bets else float("nan")


def score(cases: Sequence[Case]) -> list[Rate | Figure]:
    """The competitions' figures."""
    faulty, sound = ([c for c in cases if bool(c.plan.hidden) is hidden] for hidden in (True, False))
    isolations, claims, bets = list_isolations(cases), list_claims(cases), list_bets(cases)
    mean = f"{np.mean(isolations):.3f} ({len(isolations)} sessions)" if isolations else "-"
    return [
        count("detection rate: something hidden, something named or unexplained", map(is_detected, faulty)),
        count("false alarm rate: nothing hidden, something named or unexplained", map(is_false_alarm, sound)),
        Figure("isolation accuracy: mean probability given to the truth where something was detected", mean),
        Figure("Brier score of the causes named", f"{measure_brier(claims):.4f} ({len(claims)})" if claims else "-"),
        Figure("Brier score of these and of hidden effects not named", f"{measure_brier(bets):.4f} ({len(bets)})"
               if bets else "-"),
    ]  # fmt: skip


def format_reliability(cases: Sequence[Case]) -> str:
    """Claimed confidence against how often that was right, as a Markdown table."""
    lines = ["| claimed confidence, mean of a bin | right | 95 % interval |", "|---:|---:|---:|"]
    lines += [f"| {100 * p:.1f} % | {rate.text} | {rate.spread} |" for p, rate in confidence_bins(cases)]
    return "\n".join(lines)


def group_by(cases: Iterable[Case], attribute: str) -> dict[str, list[Case]]:
    """Cases by an attribute of theirs or of their plan, in the order of its values; those without it are left out."""
    groups: dict[str, list[Case]] = {}
    for case in cases:
        owner = case if hasattr(case, attribute) else case.plan
        if value := str(getattr(owner, attribute, "")):
            groups.setdefault(value, []).append(case)
    return dict(sorted(groups.items()))


def rate_group(cases: Sequence[Case]) -> list[str]:
    """What became of a group's sessions: a text for every column of `format_groups` but the first."""
    of_kind = {kind: [c for c in cases if c.plan.kind == kind] for kind in ("form", "alien", "none")}
    single, two = ([c for c in cases if c.plan.kind == kind and c.separable is not False] for kind in ("single", "two"))
    inside = [c for c in cases if c.plan.kind != "alien"]
    isolations = list_isolations(cases)
    rates = [
        count("named first", (c.all_named for c in single)),
        count("in the group", (c.all_suspected for c in single)),
        count("other law, in the group", (c.all_suspected for c in of_kind["form"])),
        count("both", (c.all_named for c in two)),
        count("false alarm", map(is_false_alarm, of_kind["none"])),
        count("confidently wrong", (bool(c.wrong) for c in inside)),
        count("outside flagged", map(is_flagged, of_kind["alien"])),
        count("outside misnamed", (bool(c.wrong) for c in of_kind["alien"])),
    ]
    texts = [f"{rate.hits} of {rate.of}" if rate.of else "-" for rate in rates]
    return [str(len(cases)), *texts, f"{np.mean(isolations):.2f}" if isolations else "-"]


COLUMNS = (
    "sessions", "one: named first", "one: in the group", "other law: in the group", "two: both named", "false alarm",
    "confidently wrong", "outside: flagged", "outside: misnamed", "isolation",
)  # fmt: skip
"""Of `rate_group`; one and two effects only where logs tell them, or a separating flight exists, if that was asked."""
ATTRIBUTES = {
    "version": "code",
    "family": "rig",
    "gusts": "gusts",
    "gust_strength": "strength of gusts (rms)",
    "gust_time": "correlation of gusts",
    "jitter": "jitter",
    "outside": "outside the catalogue",
    "form": "law of another form",
}
"""Attributes of drawn sessions that rates are broken down by → heading of their table."""


def format_groups(cases: Sequence[Case], attribute: str, heading: str = "") -> str:
    """Rates group by group, Markdown; "" where no case has the attribute, or all are of one version.

    Columns without a case are left out.
    """
    rows = [(name, rate_group(group)) for name, group in group_by(cases, attribute).items()]
    if not rows or (attribute == "version" and len(rows) < 2):
        return ""
    used = [i for i in range(len(COLUMNS)) if any(row[i] != "-" for _, row in rows)]
    lines = [
        f"| {heading or attribute} | {' | '.join(COLUMNS[i] for i in used)} |",
        f"|---|{'---:|' * len(used)}",
        *(f"| {name} | {' | '.join(row[i] for i in used)} |" for name, row in rows),
    ]
    return "\n".join(lines)
