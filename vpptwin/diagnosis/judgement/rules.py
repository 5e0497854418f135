"""Why an effect becomes a cause and another does not: rules, each a number against a threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.case import Case
from vpptwin.diagnosis.search.suspects import Unknown

FELT = 1.1
"""Error without a cause over that with it, at one horizon at least."""


class Rule(NamedTuple):
    """A number that a decision rests on."""

    name: str
    statistic: float
    threshold: float
    passed: bool


def need_more(name: str, statistic: float, threshold: float) -> Rule:
    """A rule that is passed above its threshold."""
    return Rule(name, float(statistic), float(threshold), bool(statistic > threshold))


def judge_cause(
    own: Sequence[Unknown], values: Mapping[Key, float], gain: float, without: Case, tolerances: float
) -> list[Rule]:
    """Rules that an effect has to pass beside the other causes, on stretches of log that no fit has seen.

    Args:
        own: its parameters.
        values: of all parameters.
        gain: log weight of predictions of held-out data that it brings.
        without: twins with it and without.
        tolerances: build tolerances by which one of its parameters must leave its nominal value.
    """
    off = max(abs(values[u.key] - u.nominal) / max(u.parameter.tolerance, 1e-12) for u in own)
    return [
        need_more("log predictive density of held-out data that it adds", gain, 0.0),
        need_more("distance from nominal, in build tolerances", off, tolerances),
        need_more("largest error without it, over the error with it", without.growth, FELT),
    ]


def judge_twin(extended: Case) -> Rule:
    """The rule that the extended twin has to pass against the twin as it was."""
    rise, even = extended.rise, extended.criteria.even
    return Rule("largest growth of an error with all causes", rise, even, rise <= even)
