"""Factors of covariances: LAPACK's to the last bit, and one where rounding leaves a matrix indefinite."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from vpptwin.inference.covariance import factor, invert, logdet, solve
from vpptwin.system.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1] / "vpptwin"
ROWS = np.random.default_rng(0).standard_normal((5, 8))
SOUND = ROWS @ ROWS.T
UNEVEN = np.diag([1.0, 1e12, 1.0, 1e-12, 1.0]) @ SOUND @ np.diag([1.0, 1e12, 1.0, 1e-12, 1.0])
TWICE = np.concatenate([ROWS, ROWS])
MIXED = np.array([[1.0, 1e9], [0.0, 1e9]])
HARD = {
    "samples that are there twice": TWICE @ TWICE.T,
    "one sample and no noise": np.outer(ROWS[0], ROWS[0]),
    "nothing at all": np.zeros((4, 4)),
    "a joint without response": np.pad(SOUND, (0, 1)),
    "a joint a billion times as strong": np.eye(2) + MIXED @ MIXED.T,
    "rounded below zero": TWICE @ TWICE.T - 1e-12 * np.eye(10),
    "beyond what a product holds": 1e300 * TWICE @ TWICE.T,
}


@pytest.mark.parametrize("matrix", [SOUND, UNEVEN, np.stack([SOUND, UNEVEN])], ids=["sound", "uneven", "several"])
def test_what_is_definite_is_done_as_ever(matrix: np.ndarray) -> None:
    """To the last bit, whatever the units of its rows are."""
    np.testing.assert_array_equal(factor(matrix), np.linalg.cholesky(matrix))
    np.testing.assert_array_equal(invert(matrix), np.linalg.inv(matrix))
    np.testing.assert_array_equal(logdet(matrix), np.linalg.slogdet(matrix)[1])
    target = np.ones((*matrix.shape[:-1], 2))
    np.testing.assert_array_equal(solve(matrix, target), np.linalg.solve(matrix, target))


@pytest.mark.parametrize("matrix", HARD.values(), ids=HARD)
def test_what_rounding_leaves_indefinite_has_a_factor(matrix: np.ndarray) -> None:
    """Off by a millionth of a millionth of its diagonal at most; all that is made of it is finite."""
    root = factor(matrix)
    size = np.sqrt(np.abs(np.diag(matrix)))
    size[size == 0.0] = size.max() or 1.0
    assert (np.abs(root @ root.T - matrix) <= 1e-12 * np.outer(size, size)).all()
    np.testing.assert_array_equal(root, np.tril(root))
    assert (np.diag(root) > 0.0).all()
    for found in (invert(matrix), logdet(matrix), solve(matrix, np.ones(len(matrix)))):
        assert np.isfinite(found).all()
    assert (np.linalg.eigvalsh(invert(matrix)) > -1e-6 * np.abs(invert(matrix)).max()).all()


def test_one_that_is_mended_leaves_the_others_as_they_are() -> None:
    """Of several side by side."""
    several = np.stack([SOUND, HARD["one sample and no noise"][:5, :5], UNEVEN])
    for found, one in ((factor(several), np.linalg.cholesky), (invert(several), np.linalg.inv)):
        np.testing.assert_array_equal(found[[0, 2]], one(several[[0, 2]]))
        assert np.isfinite(found[1]).all()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_told(wrong: float) -> None:
    """And never handed on: a NaN on the right side of an equation neither."""
    matrix = SOUND.copy()
    matrix[2, 2] = wrong
    for use in (factor, invert, logdet, lambda m: solve(m, np.ones(5)), lambda m: solve(SOUND, m[:, 2])):
        with pytest.raises(InputError, match="does not stay finite; expected finite numbers; look for what runs away"):
            use(matrix)


def test_a_diagnosis_takes_no_factor_by_itself() -> None:
    """Every covariance goes through these functions, so that none fails elsewhere."""
    bare = re.compile(r"np\.linalg\.(cholesky|inv|slogdet)|cho_(factor|solve)")
    rooms = ("diagnosis", "drift", "robots/planar_drone/thrust_stand")
    files = [file for room in rooms for file in (PACKAGE / room).rglob("*.py") if file.name != "covariance.py"]
    assert len(files) > 30
    assert not [file.name for file in files if bare.search(file.read_text())]
