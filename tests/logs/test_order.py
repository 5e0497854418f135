"""Header stamps give the time: disorder is mended with a warning, clocks that cannot be right are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.logs.bags import EPOCH, IMU, POSE, Bag, make_imu, make_pose, make_poses, pose_bag, refuse
from tests.logs.test_foreign import read_joint
from vpptwin.logs import read_flight
from vpptwin.logs.streams.clocks import order_stamps
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError

MS = 10**6  # ns


def test_stamps_not_log_times_give_the_time(tmp_path: Path) -> None:
    """A message logged late, and at irregular times, counts from when it was measured."""
    bag = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(5))
    bag.entries = [(*entry[:3], entry[3] + 7 * MS * index**2, entry[4]) for index, entry in enumerate(bag.entries)]
    flight = read_flight(bag.write())
    assert flight.start_ns == EPOCH
    assert flight.streams["/mocap/pose"].time.tolist() == [0.0, 0.01, 0.02, 0.03, 0.04]
    assert flight.duration == 0.04
    assert flight.warnings == ()


def test_late_messages_are_sorted(tmp_path: Path) -> None:
    """A message up to half a second late takes its place, with one warning that counts such messages."""
    stamps = [EPOCH + k * 100 * MS for k in (0, 2, 3, 4, 5, 6, 1, 7, 8, 9)]
    flight = read_flight(pose_bag(tmp_path / "log.mcap", stamps))
    pose = flight.streams["/mocap/pose"]
    assert np.array_equal(pose.time, np.arange(10) / 10)
    assert pose["x"].tolist() == [0.01 * k for k in (0, 6, 1, 2, 3, 4, 5, 7, 8, 9)]  # x tells the place in record order
    assert flight.warnings == ("1 of 10 messages on /mocap/pose out of order by up to 0.5 s, sorted",)


def test_repeated_stamps_are_dropped(tmp_path: Path) -> None:
    """Of messages with one stamp the first recorded stays."""
    flight = read_flight(pose_bag(tmp_path / "log.mcap", [EPOCH + k * 10 * MS for k in (0, 1, 1, 2, 3, 2)]))
    assert flight.streams["/mocap/pose"]["x"].tolist() == [0.0, 0.01, 0.03, 0.04]
    assert flight.warnings == (
        "1 of 6 messages on /mocap/pose out of order by up to 0.01 s, sorted",
        "2 of 6 messages on /mocap/pose repeat a stamp, dropped",
    )


@settings(max_examples=50)
@given(stamps=st.lists(st.integers(1, 400), min_size=1, max_size=30, unique=True), jitter=st.randoms())
def test_any_disorder_within_half_a_second_is_undone(stamps: list[int], jitter: object) -> None:
    """Whatever the order within 0.4 s, the result is sorted and complete, unless most stamps fall."""
    record = np.array(stamps) * MS + EPOCH
    if np.count_nonzero(np.diff(record) < 0) > len(record) // 2:
        with pytest.raises(InputError, match="time runs backwards"):
            order_stamps(record, "log", "/t")
        return
    order, _ = order_stamps(record, "log", "/t")
    assert record[order].tolist() == sorted(record.tolist())


def test_gaps_are_warned_of(tmp_path: Path) -> None:
    """A lost second of tracking is told with its length and place, and does no other harm."""
    stamps = [EPOCH + k * 10 * MS for k in range(300) if not 100 < k < 200]
    flight = read_flight(pose_bag(tmp_path / "log.mcap", stamps))
    assert flight.warnings == ("1 gap over 0.05 s on /mocap/pose, the longest 1 s at 1.000 s",)
    assert len(flight.streams["/mocap/pose"]) == 201


def test_topics_on_change_have_no_gaps(tmp_path: Path) -> None:
    """Setpoints come when they change; pauses between them are no gaps."""
    poses = [make_pose(EPOCH + k * 10 * MS) for k in (0, 1, 2, 900)]
    flight = read_flight(Bag(tmp_path / "log.mcap").add("/setpoint/pose", POSE, poses).write())
    assert flight.warnings == ()


def test_time_starts_at_the_first_stamp_of_all_topics(tmp_path: Path) -> None:
    """Time zero is the first stamp of any topic, not of each."""
    bag = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(3))
    bag.add("/imu/data", IMU, [make_imu(EPOCH - 250 * MS + k * MS) for k in range(3)])
    flight = read_flight(bag.write())
    assert flight.start_ns == EPOCH - 250 * MS
    assert flight.streams["/mocap/pose"].time[0] == 0.25
    assert flight.streams["/imu/data"].time.tolist() == [0.0, 0.001, 0.002]


@pytest.mark.parametrize(("stamps", "message"), [
    ([100, 110, 120, 130, 40], "time runs backwards on /mocap/pose, message 5 of 5 is stamped 0.900 s before"),
    ([104, 103, 102, 101, 100], "time runs backwards on /mocap/pose, message 5 of 5 is stamped 0.040 s before"),
    ([100, 101, 102, 103, 0], "1 of 5 messages have no header stamp"),
    ([0, 0, 0], "3 of 3 messages have no header stamp"),
    ([100, 100, 100, 101], None),
    ([100, 100, 100], "2 of 3 messages repeat a stamp"),
])  # fmt: skip
def test_impossible_clocks_are_refused(tmp_path: Path, stamps: list[int], message: str | None) -> None:
    """Clocks that run backwards or were never set are refused with topic and count (stamps in 10 ms, 0: unset)."""
    path = pose_bag(tmp_path / "log.mcap", [EPOCH + stamp * 10 * MS if stamp else 0 for stamp in stamps])
    if message is None:  # half of the messages repeat a stamp: dropped, not refused
        assert len(read_flight(path).streams["/mocap/pose"]) == 2
        return
    with pytest.raises(InputError, match=message):
        read_flight(path)


def test_a_simulated_clock_may_start_at_zero(tmp_path: Path) -> None:
    """Zero is the start of simulated time when the stamps behind it are small too."""
    flight = read_flight(pose_bag(tmp_path / "log.mcap", [k * 10 * MS for k in range(5)]))
    assert flight.start_ns == 0
    assert flight.warnings == ()


def test_two_clocks_are_refused(tmp_path: Path) -> None:
    """A tracker on wall time and an IMU on time since boot cannot be put together."""
    bag = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(3))
    bag.add("/imu/data", IMU, [make_imu(10**9 + k * MS) for k in range(3)])
    refuse(bag.write(), "/mocap/pose is stamped 1699999999 s after /imu/data ends")


def write_rounded(path: Path, rate: float, spell: Callable[[int], str]) -> Path:
    """Twelve seconds of rows at a rate whose clock shows whole seconds only."""
    rows = "".join(f"{spell(int(0.4 + k / rate))},{0.01 * k}\n" for k in range(int(12 * rate)))
    path.write_text(f"date_time,q\n{rows}")
    return path


@pytest.mark.parametrize(("rate", "spell"), [
    (125.0, str), (40.0, lambda s: f"{1_700_000_000 + s}"), (50.0, lambda s: f"2026-01-31 12:00:{s:02d}"),
])  # fmt: skip
def test_a_clock_of_whole_seconds_is_refused_and_given_a_rate(
    tmp_path: Path, rate: float, spell: Callable[[int], str]
) -> None:
    """The line says how; with it rows are that far apart, and a rate that the stamps contradict is refused."""
    log = write_rounded(tmp_path / "log.csv", rate, spell)
    for read in (survey, lambda path: read_joint(path, "log", position="q")):
        with pytest.raises(InputError, match=rf"repeat a stamp.*give the rate .* `stamp: {{rate: {rate:g}}}`"):
            read(log)
    flight = read_joint(log, "log", position="q", stamp={"rate": rate})
    np.testing.assert_allclose(np.diff(flight.joints["/joint_states"]["j"].time), 1 / rate)
    assert flight.warnings == ()
    with pytest.raises(InputError, match=rf"a rate of 25 Hz makes .* give {rate:g}"):
        read_joint(log, "log", position="q", stamp={"rate": 25})


def test_runs_that_follow_one_another_are_not_laid_over_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that starts again is told by `inspect` too, however large the log is; other topics are shown."""
    log = tmp_path / "log.csv"
    log.write_text("t,q\n" + "".join(f"{k % 400 / 100},{k}\n" for k in range(1600)))
    refuse(log, "log.csv: time runs backwards on /log, message 401 of 1600", read=survey)
    monkeypatch.setattr("vpptwin.logs.formats.delimited._BLOCK", 2000)
    monkeypatch.setattr("vpptwin.logs.formats.raw.LARGE", 4000)
    refuse(log, "time runs backwards on /log", read=survey)
    poses = pose_bag(tmp_path / "poses.mcap", EPOCH + 10 * MS * np.arange(50))
    recording, signals = survey([log, poses])
    assert {signal.topic for signal in signals} == {"/mocap/pose"}
    assert any("time runs backwards on /log" in line and "left out" in line for line in recording.files[0].notes)
