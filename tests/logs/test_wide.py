"""Logs of very many channels or columns: work grows as they do. Work is counted, not timed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.logs.test_foreign import read_joint, write_csv
from vpptwin.logs.formats.decode import _make_decoder
from vpptwin.logs.formats.layout import parse_definition
from vpptwin.logs.formats.raw import Query, RawChannel, RawFile
from vpptwin.logs.formats.tables import make_unique
from vpptwin.logs.recording import Recording, open_recording
from vpptwin.mapping import inspect
from vpptwin.mapping.survey import survey


class Counted(list):
    """A list that counts how often it is walked through."""

    walks = 0

    def __iter__(self) -> Iterator:
        """Count."""
        type(self).walks += 1
        return super().__iter__()


class Name(str):
    """A name that counts what it is compared with."""

    compared = 0
    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        """Count."""
        type(self).compared += 1
        return str.__eq__(self, other)


def write_channels(path: Path, count: int) -> Path:
    """An MCAP of so many channels of one type, two messages each."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        for number in range(count):
            channel = writer.register_channel(f"/c{number}", "cdr", schema)
            for tick in range(2):
                payload = b"\0\1\0\0" + np.float64(number + tick).tobytes()
                writer.add_message(channel, 10**9 + tick * 10**7, payload, 10**9 + tick * 10**7)
        writer.finish()
    return path


def test_many_channels_are_each_looked_at_once(tmp_path: Path) -> None:
    """Whatever is asked of each topic, the list of channels is walked through once, and a type is understood once."""
    log = write_channels(tmp_path / "log.mcap", 300)
    (file,) = open_recording(log, Query(lambda channel: True)).files
    channels = Counted[RawChannel](file.channels)
    recording = Recording(log, (RawFile(log, "ros2", channels, file.log_time),))
    Counted.walks = 0
    for number in range(300):
        (batch,) = recording.decode(f"/c{number}", ["data"])
        assert batch.values["data"].tolist() == [number, number + 1.0]
        assert recording.check_type(f"c{number}") == "std_msgs/msg/Float64"
        assert not recording.is_table(f"/c{number}")
    assert Counted.walks == 1
    parse_definition.cache_clear()
    _make_decoder.cache_clear()
    assert len(survey(log)[1]) == 300
    assert parse_definition.cache_info().misses == _make_decoder.cache_info().misses == 1


@pytest.mark.parametrize("names", [[f"q{k}" for k in range(2000)], ["q"] * 2000])
def test_names_of_columns_are_told_apart_in_one_pass(names: list[str]) -> None:
    """Whether they are all others or all one."""
    Name.compared = 0
    apart = make_unique(map(Name, names))
    assert len(set(map(str, apart))) == 2000
    assert apart[1] in ("q1", "q_2")
    assert Name.compared < 10_000


def test_wide_tables_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lines longer than what tells the kind of CSV; of what a table cannot show each signal has a line."""
    rng = np.random.default_rng(1)
    values = np.round(rng.normal(size=(12, 6000)), 3)
    rows = [f"{0.01 * k:.2f}," + ",".join(map(str, row)) for k, row in enumerate(values)]
    heads = ",".join(f"a_column_with_quite_a_long_name_{k} [rad]" for k in range(6000))
    log = write_csv(tmp_path / "log.csv", f"time [s],{heads}\n" + "\n".join(rows) + "\n")
    flight = read_joint(log, "log", position="a_column_with_quite_a_long_name_4711")
    assert flight.joints["/joint_states"]["j"]["position"].tolist() == values[:, 4711].tolist()
    inspect.inspect_logs([log], None, None)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 6001
    assert "a_column_with_quite_a_long_name_4711  float64  100 Hz  -" in lines[4713]
    assert lines[4713].endswith(" rad")
