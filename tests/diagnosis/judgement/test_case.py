"""Two twins on the same held-out data, and the rules of a cause."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.search.test_trials import PLACE
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.case import Case, Pair, judge_cause, judge_twin
from vpptwin.diagnosis.judgement.inferred import sum_gains
from vpptwin.diagnosis.search.simulator import name_unknown
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import Parameter, Prior
from vpptwin.effects.joint import bias
from vpptwin.robots.planar_drone.effects.catalogue import RATE_LIMIT

FORCE = Unknown(
    bias(PLACE),
    Parameter(name="force", unit="N", off=0.0, low=-4.0, high=4.0, prior=Prior("normal", 0.0, 1.0), size=0.1,
              tolerance=0.1),
    0.0,
)  # fmt: skip
RATE = Unknown(RATE_LIMIT, RATE_LIMIT.parameters[0], 1000.0)


def compare(times: float) -> Case:
    """Eight blocks in which an error is so many times as large after as before, at five horizons."""
    before = np.full((8, 5), 4.0)
    return Case({"m": Pair(before, times**2 * before, np.zeros(5), np.arange(8))}, CRITERIA)


def test_a_case_by_hand() -> None:
    """An error that doubles: growth 2, a rise of 100 %, a gain of -3 log 2 in each of 8 blocks, +100 % for certain."""
    case = compare(2.0)
    assert case.growth == pytest.approx(2.0)
    assert case.rise == pytest.approx(1.0)
    assert case.gain == pytest.approx(-24.0 * np.log(2.0))
    assert np.allclose(case.change["position_rmse_m"], 1.0)
    assert compare(0.5).rise == 0.0


@pytest.mark.parametrize(
    ("value", "gain", "times", "passed"),
    [(1.0, 5.0, 1.3, [True, True, True]), (0.2, 5.0, 1.3, [True, False, True]), (1.0, 5.0, 1.05, [True, True, False]),
     (1.0, -5.0, 1.3, [False, True, True]), (1.0, -5.0, 1.6, [True, True, True])],
)  # fmt: skip
def test_rules_of_a_cause(value: float, gain: float, times: float, passed: list[bool]) -> None:
    """It predicts, it leaves its build tolerance of 0.1 N by 2.5 times that, it matters; each with its number."""
    rules = judge_cause([FORCE], {FORCE.key: value}, gain, compare(times), CRITERIA.tolerances)
    assert [rule.passed for rule in rules] == passed
    assert [rule.statistic for rule in rules] == pytest.approx([gain, 10.0 * value, times])
    assert [rule.threshold for rule in rules] == [0.0, CRITERIA.tolerances, 1.1]


def test_the_rule_of_a_twin() -> None:
    """No error may grow by more than 2 %."""
    assert judge_twin(compare(1.01)).passed
    assert not judge_twin(compare(1.1)).passed


def test_one_window_does_not_outvote_all_others() -> None:
    """Twenty windows gain 1 each, one loses 1000, which counts as six: 14 in all."""
    assert sum_gains(np.array([1.0] * 20 + [-1000.0])) == pytest.approx(14.0)


def test_a_limit_is_expected_where_it_acts() -> None:
    """Its prior lies about what it typically is, not about the value that nothing reaches."""
    unknown = name_unknown(RATE, CRITERIA)
    assert unknown.middle == RATE.typical < 0.03 * unknown.mean
    assert name_unknown(FORCE, CRITERIA).middle == FORCE.nominal
