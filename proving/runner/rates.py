"""The rates that count, with their 95 % intervals and what they should be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from scipy.stats import binom

from proving.runner.case import CONFIDENT, Case

Z_90, Z_95 = 1.645, 1.960
BINS = (0.0, 0.5, 0.7, CONFIDENT, 0.99, 1.01)
"""Edges of bins of confidence."""


@dataclass(frozen=True)
class Rate:
    """How often something was so."""

    name: str  # what
    hits: int  # how often it was
    of: int  # out of how many
    target: str = ""  # `>= 0.95` or the like; "" where none was set

    @property
    def share(self) -> float:
        """Hits over trials; NaN without a trial."""
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval."""
        if not self.of:
            return 0.0, 1.0
        n, p, z2 = self.of, self.share, Z_95**2
        centre, spread = p + z2 / (2 * n), Z_95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
        return max((centre - spread) / (1 + z2 / n), 0.0), min((centre + spread) / (1 + z2 / n), 1.0)

    @property
    def text(self) -> str:
        """The rate in words."""
        return f"{100 * self.share:.1f} % ({self.hits} of {self.of})" if self.of else "-"

    @property
    def spread(self) -> str:
        """Its interval in words."""
        return "{:.0f}-{:.0f} %".format(*(100 * end for end in self.interval)) if self.of else "-"


@dataclass(frozen=True)
class Figure:
    """A number that is no rate: what, its value in words, and what it should be."""

    name: str
    text: str
    target: str = ""
    spread: str = ""


def count(name: str, outcomes: Iterable[bool], target: str = "") -> Rate:
    """A rate from its outcomes."""
    listed = list(outcomes)
    return Rate(name, sum(listed), len(listed), target)


def summarise(cases: Sequence[Case]) -> list[Rate | Figure]:
    """Every measure of how often verdicts are right, and those of laws that differ from ours."""
    kinds = ("single", "form", "two", "three", "alien", "none")
    of_kind = {kind: [c for c in cases if c.plan.kind == kind] for kind in kinds}
    single, form, alien, none = (of_kind[kind] for kind in ("single", "form", "alien", "none"))
    bare = [c for c in none if not c.neither]
    plain = [c for c in single if c.plan.strength >= 1.0 - 1e-9]
    clear = [c for c in single if c.separable]
    return [
        count("one effect, a separating flight exists: named first", (c.all_named for c in clear), ">= 0.95"),
        count("one effect: named first", (c.all_named for c in single)),
        count("one effect, none fainter than strength 1: named first", (c.all_named for c in plain)),
        count("one effect: named or in the reported group", (c.all_suspected for c in single), ">= 0.98"),
        count("one effect, strength 1 on: named or in the reported group", (c.all_suspected for c in plain)),
        count("one effect whose law differs from ours: named first", (c.all_named for c in form)),
        count("one effect whose law differs from ours: in the group", (c.all_suspected for c in form), ">= 0.95"),
        count("two effects: both named", (c.all_named for c in of_kind["two"]), ">= 0.85"),
        count("two effects: both named or in a group", (c.all_suspected for c in of_kind["two"])),
        count("three effects: all named or in a group", (c.all_suspected for c in of_kind["three"])),
        count("missed effects: said not to be identifiable", chain(*(c.owned for c in cases))),
        count("no effect: something named", (bool(c.first) for c in none), "<= 0.01"),
        count("no effect, nor a small one: something said to be unexplained", (leaves_something(c) for c in bare)),
        count("confidently wrong", (bool(c.wrong) for c in cases if c.plan.kind != "alien"), "<= 0.02"),
        count("outside the catalogue: flagged unexplained", (leaves_something(c) for c in alien), ">= 0.85"),
        count("outside the catalogue: misnamed with confidence", (bool(c.wrong) for c in alien), "<= 0.05"),
        *measure_parameters(cases),
        *measure_gain(cases),
        measure_time(cases),
        count("diagnosis failed", (c.found is None for c in cases), "<= 0"),
    ]


BOUNDS = {
    "one effect, none fainter than strength 1: named first": (">=", 0.9),
    "one effect: named or in the reported group": (">=", 0.9),
    "two effects: both named": (">=", 0.8),
    "no effect: something named": ("<=", 0.05),
    "confidently wrong": ("<=", 0.05),
    "outside the catalogue: misnamed with confidence": ("<=", 0.1),
    "diagnosis failed": ("<=", 0.0),
}
"""What a night must keep: what 104 sessions of seed 8001 reached, less what as many others may differ by."""


def find_broken(rows: Sequence[Rate | Figure]) -> list[str]:
    """A line for every bound that rates break: a diagnosis that just keeps it does so badly in one night of forty."""
    broken = []
    for row in rows:
        if not isinstance(row, Rate) or row.name not in BOUNDS:
            continue
        side, bound = BOUNDS[row.name]
        chance = binom.cdf(row.hits, row.of, bound) if side == ">=" else binom.sf(row.hits - 1, row.of, bound)
        if chance < 0.025:
            broken.append(f"{row.name}: {row.text}, must be {side} {bound:g}")
    return broken


def leaves_something(case: Case) -> bool:
    """Whether the verdict says that something is left unexplained."""
    return case.found is not None and case.found.unexplained


def is_flagged(case: Case) -> bool:
    """Whether a verdict says that something is left; of other rigs, that there is a gap too, or is sure of no cause."""
    if case.found is None or not case.plan.family:
        return leaves_something(case)
    unsure = all(cause.confidence <= CONFIDENT for cause in case.found.causes)
    return case.found.gap and (case.found.unexplained or unsure)


def list_estimates(case: Case) -> list[tuple[float, float, float, float]]:
    """Truth, value, std and nominal of the fitted strengths of the hidden effects that were named."""
    found = []
    for cause in case.found.causes if case.found else []:
        for name in list(case.plan.hidden.get(cause.effect, {}))[:1]:
            fitted = cause.parameters[name]
            truth = case.plan.find_truth(cause.effect, name)
            found.append((truth, fitted["value"], fitted["std"], fitted["nominal"]))
    return found


def measure_parameters(cases: Sequence[Case]) -> list[Rate | Figure]:
    """Error of the named effects' strengths against what the rig has, tolerance included, and their intervals."""
    estimates = [e for c in cases for e in list_estimates(c)]
    errors = [abs(value - truth) / abs(truth - nominal) for truth, value, _, nominal in estimates]
    text = "-"
    if errors:
        text = f"{100 * np.median(errors):.1f} % (90 % of them below {100 * np.quantile(errors, 0.9):.0f} %)"
    inside = (abs(value - truth) <= Z_90 * std for truth, value, std, _ in estimates)
    return [
        Figure("strength of named effects: median error", text, "<= 0.05"),
        count("strength of named effects: inside the 90 % interval", inside, "0.86-0.94"),
    ]


def measure_gain(cases: Sequence[Case]) -> list[Rate | Figure]:
    """Held-out gain against that of the true structure."""
    ratios = [ratio for c in cases if (ratio := c.relative_gain) is not None]
    text = f"{np.median(ratios):.3f} (mean {np.mean(ratios):.3f})" if ratios else "-"
    return [
        Figure("held-out gain over the oracle's: median", text, ">= 0.95"),
        count("held-out gain at least 0.95 of the oracle's", (ratio >= 0.95 for ratio in ratios)),
    ]


def measure_time(cases: Sequence[Case]) -> Figure:
    """Seconds of a diagnosis."""
    seconds = [c.found.seconds for c in cases if c.found]
    text = f"{np.median(seconds):.0f} s (longest {max(seconds):.0f} s)" if seconds else "-"
    return Figure("time of a diagnosis, 48 s of flight: median", text)


def list_failures(cases: Sequence[Case]) -> list[str]:
    """A line for every session that went wrong: what was hidden, what was said."""
    lines = []
    for case in sorted(cases, key=lambda c: c.plan.number):
        none_found = not case.plan.known and not case.first
        unmarked = case.plan.kind == "alien" and not leaves_something(case)
        if not case.error and not case.wrong and not unmarked and (none_found or (case.plan.known and case.all_named)):
            continue
        said = [f"{c.effect} {c.confidence:.2f}{f' or {list(c.rivals)}' * bool(c.rivals)}" for c in
                (case.found.causes if case.found else [])]  # fmt: skip
        about = getattr(case.plan, "about", "")
        about += {True: ", separable", False: ", not separable", None: ""}[case.separable] if case.plan.known else ""
        left = " + unexplained" if leaves_something(case) else ""
        claim = " CONFIDENTLY WRONG" if case.wrong else ""
        lines.append(
            f"{case.plan.number:4d} {case.plan.kind} {case.plan.hidden} ({about})"
            f" -> {case.error or ', '.join(said) or 'nothing'}{left}{claim}"
        )
    return lines


def format_table(rows: Sequence[Rate | Figure]) -> str:
    """The measures as a Markdown table."""
    lines = ["| measure | result | 95 % interval | wanted |", "|---|---:|---:|---:|"]
    lines += [f"| {row.name} | {row.text} | {row.spread} | {row.target.replace('>=', '≥').replace('<=', '≤')} |"
              for row in rows]  # fmt: skip
    return "\n".join(lines)


def list_claims(cases: Iterable[Case]) -> list[tuple[float, bool]]:
    """Confidence of every cause that counts, and whether it is hidden."""
    return [(cause.confidence, cause.effect in case.plan.known) for case in cases for cause in case.claims]


def confidence_bins(cases: Iterable[Case]) -> list[tuple[float, Rate]]:
    """Mean confidence and hit rate of causes, in bins of confidence."""
    said = list_claims(cases)
    bins = [[(p, hit) for p, hit in said if low <= p < high] for low, high in pairwise(BINS)]
    return [(float(np.mean([p for p, _ in b])), count("", (hit for _, hit in b))) for b in bins if b]
