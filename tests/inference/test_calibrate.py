"""The map from log odds to confidence: monotone, fair on claims that it was not fitted to, and the one that ships."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from vpptwin.diagnosis.judgement.selection import CALIBRATION
from vpptwin.inference.calibrate import Calibration, fit_calibration


def draw_claims(seed: int, number: int, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Log odds between -2 and 15 and whether claims are right, whose true log odds are `slope` times as large."""
    rng = np.random.default_rng(seed)
    odds = rng.uniform(-2.0, 15.0, number)
    return odds, rng.random(number) < expit(slope * odds)


def test_overconfident_claims_are_calibrated() -> None:
    """True log odds are a third: of other claims, in fifths by confidence, as many are right as is said.

    A share of 400 claims is known to 0.025: 0.1 is four of its standard deviations.
    """
    found = fit_calibration(*draw_claims(1, 2000, 1.0 / 3.0), most=20.0)
    odds, right = draw_claims(2, 2000, 1.0 / 3.0)
    said = np.array([found.apply(each) for each in odds])
    for rows in np.array_split(np.argsort(said), 5):
        assert said[rows].mean() == pytest.approx(right[rows].mean(), abs=0.1)


def test_highest_is_what_so_many_claims_can_tell() -> None:
    """Nineteen that are sure and right: 20 of 21, however large their log odds; none is beyond it."""
    found = fit_calibration([50.0] * 19 + [-50.0] * 19, [True] * 19 + [False] * 19, most=20.0)
    assert found.highest == pytest.approx(20.0 / 21.0)
    assert found.apply(np.inf) == pytest.approx(found.highest)


def test_what_is_wrong_more_often_the_surer_it_seems_makes_no_falling_map() -> None:
    """The slope is not negative."""
    assert fit_calibration([0.0, 1.0, 5.0, 6.0], [True, True, False, False], most=20.0).slope == 0.0


def test_the_map_that_ships_rises() -> None:
    """From hardly to nearly sure; what was not compared is as sure as can be said."""
    said = [CALIBRATION.apply(odds) for odds in (-np.inf, -5.0, 0.0, 3.0, 10.0, np.inf)]
    assert said == sorted(said)
    assert said[0] == 0.0
    assert said[-1] == CALIBRATION.highest < 1.0
    assert Calibration(0.0, 1.0, 1.0).apply(np.log(9.0)) == pytest.approx(0.9)
