"""Which windows gaps spoil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.estimation.synthetic import Sensors
from vpptwin.estimation.gaps import find_gaps, overlap, tell_cut, tell_gaps, touch, usable_starts
from vpptwin.estimation.series import Measurements, Series

WHOLE = Sensors().measure(6.0)
STARTS = np.arange(0.51, 5.0, 0.05)


def punch(series: Series, begin: float, end: float) -> Series:
    """A series without the samples from begin to end [s]."""
    rows = (series.time <= begin) | (series.time >= end)
    return replace(series, time=series.time[rows], value=series.value[rows])


def spoilt(measurements: Measurements) -> tuple[float, float]:
    """First and last of the starts that are not usable for windows of 0.3 s."""
    bad = STARTS[~usable_starts(measurements, STARTS, 0.3)]
    return float(bad[0]), float(bad[-1])


def test_a_whole_flight_is_usable() -> None:
    """Nothing is left out, nothing is said."""
    assert usable_starts(WHOLE, STARTS, 0.3).all()
    assert tell_gaps(WHOLE) == []


def test_commands_count_from_before_a_window_to_its_end() -> None:
    """Held from 2 to 2.05 s, a command is unknown until 2.5 s, which spoils starts from 1.75 to 2.65 s."""
    first, last = spoilt(replace(WHOLE, command=punch(WHOLE.command, 2.0, 2.5)))
    assert (round(first, 2), round(last, 2)) == (1.76, 2.61)


def test_poses_count_about_the_start() -> None:
    """Without poses from 2 to 2.5 s the state is unknown from 1.95 to 2.65 s; 50 ms are bridged."""
    gap = replace(WHOLE, positions={i: punch(s, 2.0, 2.5) for i, s in WHOLE.positions.items()})
    first, last = spoilt(gap)
    assert (round(first, 2), round(last, 2)) == (1.86, 2.61)  # from 1.85 on most of the window would be blind
    short = replace(WHOLE, positions={i: punch(s, 2.0, 2.06) for i, s in WHOLE.positions.items()})
    assert usable_starts(short, STARTS, 0.3).all()


def test_inertial_gaps_count_where_they_carry_the_state() -> None:
    """Gyro and accelerometer are integrated for 0.15 s on either side of a start."""
    assert WHOLE.specific_force is not None
    first, last = spoilt(replace(WHOLE, specific_force=punch(WHOLE.specific_force, 2.0, 2.1)))
    assert (round(first, 2), round(last, 2)) == (1.86, 2.21)


def test_streams_that_speak_on_change_have_no_gaps() -> None:
    """A command may stand for seconds; one message lost of a steady stream in the same time may not."""
    changes = np.array([0.0, 0.02, 0.9, 0.95, 3.0, 3.1, 5.5])
    assert len(find_gaps(changes, 0.05)) == 0
    rng = np.random.default_rng(0)
    steady = np.arange(0.0, 6.0, 0.001)[rng.random(6000) > 0.3]  # a third lost here and there
    np.testing.assert_allclose(find_gaps(steady[(steady < 2.0) | (steady > 2.2)], 0.05), [[2.0, 2.2]], atol=0.01)


def test_intervals_overlap_gaps() -> None:
    """Of gaps 1 to 2 and 4 to 5: which intervals touch one, and how much of them is covered."""
    gaps = np.array([[1.0, 2.0], [4.0, 5.0]])
    begins, ends = np.array([0.0, 0.5, 1.2, 2.0, 0.0]), np.array([1.0, 1.5, 1.4, 4.0, 9.0])
    np.testing.assert_array_equal(touch(gaps, begins, ends), [False, True, True, False, True])
    np.testing.assert_allclose(overlap(gaps, begins, ends), [0.0, 0.5, 0.2, 0.0, 2.0])
    assert not touch(np.zeros((0, 2)), begins, ends).any()
    assert not overlap(np.zeros((0, 2)), begins, ends).any()


def test_short_topics_are_told() -> None:
    """What costs more than a tenth of the flight is named; the milliseconds between streams are not."""
    assert tell_cut({"/a": (0.0, 60.0), "/b": (0.5, 59.0)}) == []
    (line,) = tell_cut({"/a": (0.0, 60.0), "/b": (10.0, 60.0), "/c": (0.0, 40.0)})
    assert line == "only 30.0 of 60.0 s are common to all topics: /b starts 10.0 s late, /c ends 20.0 s early"
