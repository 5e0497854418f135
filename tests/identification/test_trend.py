"""Whether a parameter changes from flight to flight: named where it does, and hardly ever where it does not."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.drift.trend import CLEAR, STAYS, Trend, judge_trend, list_shapes

WEEKS = 7.0 * np.arange(8)


def judge(value: list[float], std: float = 0.01, time: np.ndarray | None = None) -> Trend:
    """Weekly flights, each as uncertain as the others."""
    every = WEEKS[: len(value)] if time is None else time
    return judge_trend(every, np.array(value), np.full(len(value), std))


def test_courses_by_hand() -> None:
    """Four flights: a line, three steps, one bend; each from 0 at the first to 1 at the last."""
    shapes = list_shapes(np.array([0.0, 1.0, 3.0, 4.0]))
    assert [(s.kind, s.since, s.course.tolist()) for s in shapes] == [
        ("line", 0, [0.0, 0.25, 0.75, 1.0]),
        ("step", 1, [0.0, 1.0, 1.0, 1.0]), ("step", 2, [0.0, 0.0, 1.0, 1.0]), ("step", 3, [0.0, 0.0, 0.0, 1.0]),
        ("bend", 1, [0.0, 0.0, pytest.approx(2.0 / 3.0), 1.0]),
    ]  # fmt: skip


def test_a_steady_change() -> None:
    """Of 0.05 a week: its size within its deviation, since the first flight, no scatter beyond the intervals."""
    found = judge([0.300, 0.352, 0.398, 0.451, 0.499])
    assert (found.kind, found.since) == ("line", 0)
    assert found.evidence > CLEAR
    assert found.change[0] == pytest.approx(0.2, abs=2.0 * found.change[1])
    assert found.first[0] == pytest.approx(0.3, abs=2.0 * found.first[1])
    assert found.last[0] == pytest.approx(0.5, abs=2.0 * found.last[1])
    assert found.scatter < 0.01
    assert np.all(np.diff(found.fitted) > 0.0)


def test_time_is_what_counts_not_the_number() -> None:
    """What is steady over uneven dates is a line there, and not over the flights' numbers."""
    time = np.array([0.0, 1.0, 2.0, 20.0, 21.0, 40.0])
    value = (0.3 + 0.01 * time).tolist()
    dated, numbered = judge(value, 0.003, time), judge(value, 0.003)
    assert dated.kind == "line"
    assert dated.evidences["line"] > numbered.evidences["line"] + 10.0


def test_a_jump_and_when() -> None:
    """From the fourth flight on and from no other; the twin of it downwards."""
    found = judge([0.30, 0.31, 0.30, 0.50, 0.49, 0.50])
    assert (found.kind, found.since, found.between) == ("step", 3, (3, 3))
    down = judge([-0.30, -0.31, -0.30, -0.50, -0.49, -0.50])
    assert down.kind == "step"
    assert down.change[0] == pytest.approx(-found.change[0])
    assert down.evidence == pytest.approx(found.evidence)


def test_a_change_that_begins_later() -> None:
    """It stays over four flights, then grows: the bend is named within a flight."""
    found = judge([0.30, 0.30, 0.31, 0.30, 0.35, 0.40, 0.46, 0.50])
    assert found.kind == "bend"
    assert abs(found.since - 3) <= 1
    assert found.between[0] <= found.since <= found.between[1]


def test_one_odd_flight_is_no_trend() -> None:
    """Nor are flights that scatter more than their intervals say: that is told as scatter."""
    for value in ([0.30, 0.31, 0.50, 0.30, 0.31, 0.30], [0.30, 0.40, 0.28, 0.41, 0.33, 0.29, 0.39, 0.32]):
        found = judge(value)
        assert found.kind == "constant"
        assert found.evidence < STAYS
        assert 0.5 * np.std(value) < found.scatter < 2.0 * np.std(value)
        assert found.change == (0.0, 0.0)


def test_vague_flights_do_not_count() -> None:
    """A flight that says nothing changes nothing, wherever its value lies."""
    value, std = np.array([0.30, 0.35, 0.40, 0.45, 0.50]), np.full(5, 0.01)
    with_vague = judge_trend(WEEKS[:6], np.append(value, -3.0), np.append(std, 5.0))
    assert with_vague.kind == judge(value.tolist()).kind == "line"


@pytest.mark.parametrize("number", [1, 2])
def test_two_flights_tell_no_trend(number: int) -> None:
    """However far apart."""
    found = judge([0.3, 0.9][:number])
    assert found.kind == "constant"
    assert found.evidence == -np.inf


@pytest.mark.parametrize("number", [3, 5, *(pytest.param(number, marks=pytest.mark.slow) for number in (8, 20))])
@pytest.mark.parametrize("scatter", [0.0, 1.0, 3.0, 10.0])
def test_what_stays_is_hardly_ever_said_to_change(number: int, scatter: float) -> None:
    """In one of a hundred at most (of 300: 6 are two standard errors above), however much flights scatter."""
    rng = np.random.default_rng(round(number + 100 * scatter))
    false = 0
    for _ in range(300):
        std = np.exp(rng.uniform(np.log(0.5), np.log(2.0), number))
        value = 5.0 + np.hypot(std, scatter) * rng.standard_normal(number)
        false += judge_trend(np.cumsum(rng.uniform(0.5, 10.0, number)), value, std).kind != "constant"
    assert false <= 6
