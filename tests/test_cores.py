"""Work in parts: in order, whatever the parts, and in forks of a process that has worked so before."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from vpptwin.system.cores import in_parts, map_rows


def double(rows: int) -> float:
    """The sum of so many doubled rows."""
    return float(map_rows(lambda part: 2.0 * part, np.arange(float(rows))).sum())


@pytest.mark.parametrize(("count", "workers", "least"), [(0, 2, 1), (1, 4, 1), (7, 3, 1), (7, 3, 4), (100, 0, 1)])
def test_parts_cover_every_row_once(count: int, workers: int, least: int) -> None:
    """In no more parts than asked for."""
    done: list[tuple[int, int]] = []
    in_parts(lambda *part: done.append(part), count, workers, least)
    assert sorted(row for first, end in done for row in range(first, end)) == list(range(count))
    assert len(done) <= max(count // least, 1)


def test_rows_stay_in_order() -> None:
    """Of several arrays."""
    left, right = np.arange(1001.0), np.linspace(1.0, 2.0, 1001)
    np.testing.assert_array_equal(map_rows(np.multiply, left, right), left * right)


def test_a_fork_has_threads_of_its_own() -> None:
    """It would wait for its parent's, which it does not have."""
    assert double(1000) == 999_000.0
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(double, (1000,)).get(timeout=60.0) == 999_000.0
