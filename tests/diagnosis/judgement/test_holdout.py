"""What predictions are worth on windows that no fit has seen: arithmetic by hand, and a cart with friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.builders import lay_bench
from tests.diagnosis.carts import load_cart, measure_cart, open_judges
from tests.diagnosis.rigs import FRICTION, drive_cart
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.judgement.blocks import blocks_of, resample, sum_blocks, to_deviations
from vpptwin.diagnosis.judgement.errors import PredictionErrors, last_bins, mean_over
from vpptwin.diagnosis.judgement.holdout import HeldOut

TRUTH = {("slide.coulomb", "force"): FRICTION}
DOUBLE = {("slide.coulomb", "force"): 2.0 * FRICTION}


@pytest.mark.parametrize(("times", "number"), [(12.706, 2), (4.303, 3), (-2.571, 6), (2.042, 31), (1.960, 10**6)])
def test_few_must_agree_by_more(times: float, number: int) -> None:
    """What a table of Student's t has at 2.5 % is 1.96 normal deviations."""
    assert to_deviations(times, number) == pytest.approx(np.copysign(1.960, times), abs=1e-3)


def test_blocks_by_hand() -> None:
    """Windows within 1.5 s count as one block, those of another flight never do."""
    bench = lay_bench([0.0, 0.9 * CRITERIA.block, 1.1 * CRITERIA.block, 5.2 * CRITERIA.block, 0.1], [0, 0, 0, 0, 1])
    np.testing.assert_array_equal(blocks_of(bench.windows, CRITERIA.block), [0, 0, 1, 2, 3])
    # Rows 1, 2 and 4 of blocks 0, 1, 0: 5 and 2, column by column.
    rows = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    np.testing.assert_array_equal(sum_blocks(rows, np.array([0, 1, 0])), [[5.0, 50.0], [2.0, 20.0]])


def test_blocks_are_drawn_with_replacement() -> None:
    """Totals of four blocks: as many as there are, the same for all rows; mean and variance those of a draw.

    A draw of four from 1, 2, 4, 9 has mean 16 and variance 4 · 9.5; 4000 know them to 0.1 and 2.5 %.
    """
    sums = np.stack([np.ones((4, 1)), np.array([[1.0], [2.0], [4.0], [9.0]]), np.array([[2.0], [4.0], [8.0], [18.0]])])
    drawn = resample(sums, 4000)[..., 0]
    np.testing.assert_array_equal(drawn[:, 0], 4.0)
    np.testing.assert_array_equal(drawn[:, 2], 2.0 * drawn[:, 1])
    assert drawn[:, 1].mean() == pytest.approx(16.0, abs=0.4)
    assert drawn[:, 1].var() == pytest.approx(38.0, rel=0.1)


def test_errors_by_hand() -> None:
    """Squares 1 to 6 in bins of 10 ms: near 50 ms 4.5, near 10 ms the only bin's 1; empty bins do not count."""
    square = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [1.0, 2.0, 3.0, np.nan, 5.0, 6.0], [np.nan] * 6])
    np.testing.assert_array_equal(last_bins(square, 0.05), [4.5, 5.0, np.nan])
    np.testing.assert_array_equal(last_bins(square, 0.01), [1.0, 1.0, np.nan])
    # Squares 9 and 16 and a gap: √12.5; nothing but gaps: nothing.
    squares = np.array([[9.0, np.nan], [np.nan, np.nan], [16.0, np.nan]])
    np.testing.assert_allclose(mean_over(squares), [np.sqrt(12.5), np.nan])


class Given(PredictionErrors):
    """Errors that are given: parameter value → squares of (K,) windows."""

    noise = {"m": np.zeros(len(HORIZONS_S))}  # noqa: RUF012 (a property there)

    def __init__(self, bench: Bench, squares: dict[float, np.ndarray]) -> None:
        super().__init__(bench)
        self._given = squares

    def squares(self, values: dict) -> dict[str, np.ndarray]:
        """The same squares at every horizon, of positions."""
        return {"m": np.repeat(self._given[values["size"]][:, None], len(HORIZONS_S), axis=1)}


class Scored(HeldOut):
    """Judges whose squares are given in the same way."""

    def __init__(self, start: np.ndarray, squares: dict[float, np.ndarray]) -> None:
        self.short, self.criteria = lay_bench(start), CRITERIA
        self._given = squares

    def chi2_by_window(self, values: dict) -> tuple[np.ndarray, np.ndarray]:
        """Ten values in every window."""
        square = self._given[values["size"]]
        return square, np.full(len(square), 10)


def test_removed_share_by_hand() -> None:
    """Squares of 50, 30 and 10 a window against ten values: of an excess of 40, 20 are due to the cause: a half."""
    start = 0.3 * np.arange(40)
    judges = Scored(start, {0.0: np.full(40, 50.0), 1.0: np.full(40, 30.0), 2.0: np.full(40, 10.0)})
    share, interval = judges.share_removed({"size": 1.0}, {"size": 2.0}, {"size": 0.0})
    assert share == pytest.approx(0.5)
    assert interval == pytest.approx((0.5, 0.5))


def test_what_helps_in_one_block_alone_is_not_sure() -> None:
    """Eight blocks of which one holds all of the gain: a third of the draws miss it, and the interval reaches 0."""
    start = CRITERIA.block * np.arange(8) + 0.1
    without = np.full(8, 50.0)
    after = without.copy()
    after[3] = 10.0
    judges = Scored(start, {0.0: without, 1.0: without, 2.0: after})
    share, (low, high) = judges.share_removed({"size": 1.0}, {"size": 2.0}, {"size": 0.0})
    assert share == pytest.approx(40.0 / 320.0)
    assert low == 0.0
    assert high > share


def test_intervals_of_the_change_bracket_it() -> None:
    """Errors that halve in truth: 90 % intervals from 40 blocks of three alike windows hold -0.5 for about nine in ten.

    Of 60 intervals 54 are expected, give or take 2.3.
    """
    start = CRITERIA.block * np.repeat(np.arange(40), 3) + np.tile([0.1, 0.5, 0.9], 40)
    held = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        errors = [np.repeat(rng.standard_normal(40), 3) + 0.5 * rng.standard_normal(120) for _ in range(2)]
        squares = {0.0: errors[0] ** 2, 1.0: (0.5 * errors[1]) ** 2}
        change = Given(lay_bench(start), squares).compare({"size": 0.0}, {"size": 1.0}).change
        assert list(change) == ["position_rmse_m"]
        assert len(change["position_rmse_m"]) == len(HORIZONS_S)
        low, high = change["position_rmse_m"][2]
        assert low < high < 0.0
        held += low <= -0.5 <= high
    assert 47 <= held <= 60


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> HeldOut:
    """Ten windows of a cart with 1.1 N of dry friction, and a twin without any."""
    return open_judges(load_cart(tmp_path_factory.mktemp("cart")), measure_cart(drive_cart(FRICTION, 5), 7))


def test_a_twin_that_diverges_is_no_better(rubbing: HeldOut, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is not a number is as far off as can be told, not without an error."""
    predict = rubbing.errors.bench.predict

    def diverge(variations: Sequence[Variation], sensors_of: Mapping[Key, float]) -> np.ndarray:
        return np.full_like(predict(variations, sensors_of), np.nan)

    judges = HeldOut(rubbing.short, rubbing.errors.bench)
    assert not judges.errors.compare({}, TRUTH).rise
    monkeypatch.setattr(judges.errors.bench, "predict", diverge)
    assert judges.errors.compare(TRUTH, DOUBLE).rise > 1.0
    assert all(np.isfinite(errors[:, :2]).all() for errors in judges.errors.by_channel(DOUBLE).values())


def test_truth_predicts_better(rubbing: HeldOut) -> None:
    """The true friction lowers chi2 and the error of every horizon from 0.1 s; twice as much overshoots."""
    nothing, truth, double = (rubbing.score(values) for values in ({}, TRUTH, DOUBLE))
    assert truth.chi2 < 0.1 * min(nothing.chi2, double.chi2)
    assert nothing.position_rmse_m is not None
    assert truth.position_rmse_m is not None
    assert truth.angle_rmse_rad is None
    for before, after in zip(nothing.position_rmse_m[1:], truth.position_rmse_m[1:]):
        assert after < before
    for low, high in rubbing.errors.compare({}, TRUTH).change["position_rmse_m"][2:]:
        assert low < high < 0.0


def test_a_right_twin_reaches_the_noise_floor(tmp_path: Path) -> None:
    """A cart without friction and its twin: chi2 is 1 to what 1000 values know, 2 √(2/1000) or so.

    The motor's commands act half a sample early or late at most, which adds a little.
    """
    judges = open_judges(load_cart(tmp_path), measure_cart(drive_cart(0.0, 5), 7))
    assert judges.chi2({}) == pytest.approx(1.0, abs=0.15)
