"""Scores are proper, and what is worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from proving.simgap.scores import (
    MIXED,
    NOTHING,
    UNKNOWN,
    bootstrap,
    complete_answer,
    group_answer,
    is_confident_error,
    score_brier,
    score_log,
    score_prediction,
    score_sizes,
)

CAUSES = ["a", "b"]


def test_scores_by_hand() -> None:
    """Four answers: 0.7 of a becomes 0.99 x 0.7 + 0.01 / 4 = 0.6955, of nothing 0.2995, of the others 0.0025 each."""
    answer = complete_answer({"a": 0.7, NOTHING: 0.3}, CAUSES)
    assert answer == pytest.approx({"a": 0.6955, "b": 0.0025, NOTHING: 0.2995, UNKNOWN: 0.0025})
    assert score_log(answer, "a") == pytest.approx(-math.log(0.6955))
    assert score_brier(answer, "a") == pytest.approx(0.3045**2 + 0.2995**2 + 2 * 0.0025**2)
    assert group_answer(answer, {"a": "ab", "b": "ab"})["ab"] == pytest.approx(0.698)
    assert is_confident_error(complete_answer({"b": 1.0}, CAUSES), "a")
    assert not is_confident_error(complete_answer({"a": 1.0}, CAUSES), "a")


@pytest.mark.parametrize("score", [score_log, score_brier])
def test_honest_probabilities_score_best(score) -> None:  # noqa: ANN001
    """For a belief q no other answer has a lower expected score."""
    rng, names = np.random.default_rng(1), [*CAUSES, NOTHING, UNKNOWN]
    for _ in range(50):
        q = rng.dirichlet(np.ones(4)) * (1.0 - MIXED) + MIXED / 4
        honest = dict(zip(names, (q - MIXED / 4) / (1.0 - MIXED)))
        other = dict(zip(names, rng.dirichlet(np.ones(4))))

        def expect(said: dict[str, float], q: np.ndarray = q) -> float:
            return sum(p * score(complete_answer(said, CAUSES), name) for p, name in zip(q, names))

        assert expect(honest) <= expect(other) + 1e-12


def test_two_causes_by_hand() -> None:
    """Half on each is best: 0.4975 with the spread; all on one leaves 0.0025 for the other."""
    halves, one = complete_answer({"a": 0.5, "b": 0.5}, CAUSES), complete_answer({"a": 1.0}, CAUSES)
    assert score_log(halves, "a", "b") == pytest.approx(-math.log(2 * 0.4975))
    assert score_log(one, "a", "b") == pytest.approx(-0.5 * (math.log(2 * 0.9925) + math.log(2 * 0.0025)))
    assert score_brier(halves, "a", "b") == pytest.approx(4 * 0.0025**2)
    assert not is_confident_error(one, "a", "b")


def test_sizes_by_hand() -> None:
    """A sure point misses by its distance; half a probability on it leaves 0.5 x 2 - 0.25 x 2 = 0.5 of a size of 2."""
    off, scales = {"a": 0.0}, {"a": 1.0}
    assert score_sizes({"a": 1.0}, {"a": [1.5]}, {"a": 2.0}, off, scales) == pytest.approx(0.5)
    assert score_sizes({"a": 0.5}, {"a": [2.0]}, {"a": 2.0}, off, scales) == pytest.approx(0.5)
    assert score_sizes({"a": 0.0}, {}, {}, off, scales) == 0.0


def test_overstated_causes_do_not_pay() -> None:
    """Where a cause is there with probability 0.3, saying 0.3 has the lowest expected score of sizes."""
    off, scales = {"a": 0.0}, {"a": 1.0}

    def expect(p: float) -> float:
        there, absent = ({"a": 2.0}, {})
        return 0.3 * score_sizes({"a": p}, {"a": [2.0]}, there, off, scales) + 0.7 * score_sizes(
            {"a": p}, {"a": [2.0]}, absent, off, scales
        )

    assert min(np.linspace(0.0, 1.0, 101), key=expect) == pytest.approx(0.3)


def test_predictions_by_hand() -> None:
    """One sample is its distance, 3-4-5 over the root of two; honest spread beats a point and a spread too wide."""
    assert score_prediction(np.zeros((1, 1, 2)), np.array([[[[3.0, 4.0]]]]), np.ones(2)) == pytest.approx(5 / 2**0.5)
    rng = np.random.default_rng(2)
    truth, told = rng.standard_normal((400, 3, 1)), rng.standard_normal((400, 60, 3, 1))
    scores = [score_prediction(truth, spread * told, np.ones(1)) for spread in (0.0, 1.0, 3.0)]
    assert scores[1] == min(scores)


def test_bootstrap_holds_the_mean() -> None:
    """Of equal values there is no doubt; of others the interval lies about the mean."""
    assert bootstrap([2.0, 2.0]) == (2.0, 2.0, 2.0)
    mean, low, high = bootstrap(list(np.arange(20.0)))
    assert low < mean == 9.5 < high


@pytest.mark.parametrize("said", [{"a": 0.5}, {"c": 1.0}, {"a": 1.5, "b": -0.5}])
def test_answers_that_are_none_are_refused(said: dict[str, float]) -> None:
    """Sums, names, signs."""
    with pytest.raises(ValueError, match="write"):
        complete_answer(said, CAUSES)
