"""The rule at the end: what predicts held-out log worse than the twin that was given is never written."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.conclusion import is_outweighed, is_unfelt, order_causes
from vpptwin.diagnosis.judgement.diagnose import Material, keep_better
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.selection import Selection
from vpptwin.diagnosis.judgement.verdict import Cause

KEY = ("rail_x.coulomb", "force")


def select(before: float, after: float, sticks: bool = False) -> tuple[Selection, Selection]:
    """A selection of one cause, and what is kept of it where held-out chi² is these without and with it."""

    class Judges(HeldOut):
        """Held-out windows on which these are known."""

        criteria = CRITERIA
        short = cast(Any, SimpleNamespace(guessed=False))

        def __init__(self) -> None:
            pass

        def chi2(self, values: Mapping[Any, float]) -> float:
            """One of the two."""
            return after if values else before

    start = SimpleNamespace(effects=frozenset(), values={})
    fit = SimpleNamespace(effects=frozenset({KEY[0]}), values={KEY: 0.3})
    search = SimpleNamespace(start=start, sticks=lambda effects: sticks)
    material = SimpleNamespace(search=search, held_out=Judges())
    selection = Selection(cast(Any, fit), cast(Any, None), {KEY[0]: []}, {KEY[0]: []}, {KEY[0]: 99.0})
    return selection, keep_better(cast(Material, material), selection)


@pytest.mark.parametrize(("before", "after"), [(4.46, 6.06), (1.0, 1.01), (0.9, 1.1), (40.0, 40.001)])
def test_a_twin_that_predicts_worse_is_not_kept(before: float, after: float) -> None:
    """Whatever the evidence; the cause is named as left out, and nothing is extended."""
    _, kept = select(before, after)
    assert kept.fit.effects == frozenset()
    assert kept.fit.values == {}
    assert kept.left_out == {KEY[0]}
    assert kept.rivals == kept.evidence == {}


@pytest.mark.parametrize(("before", "after"), [(6.06, 4.46), (1.01, 1.0), (0.8, 0.9), (2.0, 2.0)])
def test_a_twin_that_predicts_as_well_is_kept(before: float, after: float) -> None:
    """Below the sensors' noise nothing is worse."""
    given, kept = select(before, after)
    assert kept is given


@pytest.mark.parametrize(("after", "kept"), [(2.03, True), (2.05, False)])
def test_a_slip_may_cost_what_tests_allow(after: float, kept: bool) -> None:
    """Two percent where the twin sticks, as tests/sessions.py allows; no more."""
    assert bool(select(2.0, after, sticks=True)[1].fit.effects) == kept


@pytest.mark.parametrize(
    ("after", "farther"),
    [
        ([1.5, 2.0, 4.2, 9.0], True),
        ([1.0, 2.0, 4.0, 19.0], False),
        ([0.3, 2.5, 4.5, 8.0], False),
        ([0.5, 1.5, 3.5, 7.5], False),
    ],
)
@pytest.mark.parametrize("guessed", [True, False])
def test_one_window_that_is_disturbed_is_no_veto(after: list[float], farther: bool, guessed: bool) -> None:
    """Where disturbances are assumed: of ten held-out windows one alone was asked for, and a saturation left out."""

    class Judges(HeldOut):
        """Four windows of which this is known; without effects they cost 1, 2, 4 and 8."""

        criteria = CRITERIA
        short = cast(Any, SimpleNamespace(guessed=guessed))

        def __init__(self) -> None:
            pass

        def chi2_by_window(self, values: Mapping[Any, float]) -> tuple[np.ndarray, np.ndarray]:
            """Of one degree of freedom each."""
            return np.array(after if values else [1.0, 2.0, 4.0, 8.0]), np.ones(4)

    assert Judges().is_farther({}, {KEY: 0.3}, False) == (farther if guessed else sum(after) > 15.0)


@pytest.mark.parametrize(
    ("after", "gain", "outweighed"), [(140.0, 0.001, True), (140.0, 0.96, False), (0.9, 0.0, False)]
)
def test_what_explains_less_than_it_leaves_is_suggested(after: float, gain: float, outweighed: bool) -> None:
    """A small cause beside a large one of 4600 times the noise, of which 140 stay: it may be what mends the large."""
    assert is_outweighed(4600.0, after, gain) == outweighed


@pytest.mark.parametrize(
    ("before", "gain", "unfelt"), [(3.76, 0.0065, True), (427916.0, 1e-4, False), (2.2, 1.7, False)]
)
def test_a_cause_that_noise_hides_is_unfelt(before: float, gain: float, unfelt: bool) -> None:
    """Below the sensors' noise evidence tells of the model of noise; a ten thousandth of a large error is much."""
    assert is_unfelt(before, gain, CRITERIA) == unfelt


def test_what_held_out_log_does_not_show_comes_last() -> None:
    """Shares of 0.1, 0.3 and 0.2, of which held-out windows show the first and the last."""
    causes = [Cause(name, 0.89, {}, gain, [], "") for name, gain in (("a", 0.1), ("b", 0.3), ("c", 0.2))]
    assert [cause.effect for cause in order_causes(causes, {"b"})] == ["c", "a", "b"]
