"""What looks odd about a log is said by every command that is given it, once, in the words of the verdict."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import vpptwin
from tests.diagnosis.made_up import FLIP, find_nothing, fit_nothing
from vpptwin.cli.main import main
from vpptwin.diagnosis.evidence.flights import list_starts
from vpptwin.estimation.measurements import Measurements
from vpptwin.logs.flight import Stream
from vpptwin.logs.read import read_flight
from vpptwin.logs.write import write_flight

POSE, IMU, ROTOR, COMMAND = "/mocap/pose", "/imu/data", "/rotor/state", "/rotor/command"


def hold(stream: Stream, columns: Sequence[str], rows: slice) -> Stream:
    """A stream whose columns repeat the first of some rows throughout them."""
    held = {name: values.copy() for name, values in stream.values.items()}
    for name in columns:
        held[name][rows] = held[name][rows][0]
    return Stream(stream.time, held)


def blank(stream: Stream, columns: Sequence[str]) -> Stream:
    """A stream whose columns are zero."""
    return Stream(stream.time, stream.values | {name: 0.0 * stream[name] for name in columns})


def double(stream: Stream) -> Stream:
    """A stream of which every message comes twice."""
    return Stream(np.repeat(stream.time, 2), {name: np.repeat(v, 2, axis=0) for name, v in stream.values.items()})


def break_log(path: Path, *faults: str) -> Path:
    """Six seconds of the demo's flip with some faults."""
    streams = dict(read_flight(f"{FLIP}@-6").streams)
    imu, rotor = streams[IMU], streams[ROTOR]
    most, gyro, felt = slice(len(imu) // 3, None), ["rate"], ["accel_x", "accel_z"]
    broken = {
        "one message throughout": {IMU: hold(imu, gyro + felt, slice(None))},
        "zero gyro": {IMU: blank(imu, gyro)},
        "zero accelerometer": {IMU: blank(imu, felt)},
        "stuck for most of it": {IMU: hold(imu, gyro, most)},
        "stuck at the end": {IMU: hold(imu, gyro, slice(-400, None))},
        "dead command": {COMMAND: hold(streams[COMMAND], ["blade_pitch"], slice(None))},
        "dead rotor state": {ROTOR: hold(rotor, ["speed"], slice(None))},
        "rotor state stuck for half of it": {ROTOR: hold(rotor, ["speed"], slice(len(rotor) // 2, None))},
        "doubled": {POSE: double(streams[POSE])},
    }
    for fault in faults:
        streams |= broken[fault]
    write_flight(path, streams)
    return path


@pytest.mark.parametrize(
    "faults",
    [
        {"one message throughout": "/imu/data: the rate is .* throughout while the craft turns, the IMU is left out",
         "rotor state stuck for half of it": r"/rotor/state: \d+ of \d+ samples repeat a value to the last digit"},
        {"zero gyro": "/imu/data: the rate is 0 throughout while the craft turns, the IMU is left out",
         "dead rotor state": "/rotor/state: a rotor speed never changes, left out"},
        {"zero accelerometer": "no accelerometer on /imu/data: forces come from /mocap/pose alone",
         "dead command": "/rotor/command: blade pitch never changes, left out"},
        {"stuck for most of it": r"/imu/data: \d+ of \d+ samples repeat a value to the last digit, left out",
         "doubled": r"\d+ of \d+ messages on /mocap/pose repeat a stamp, dropped"},
    ],
    ids=", ".join,
)  # fmt: skip
def test_a_log_that_is_plotted_is_looked_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], faults: dict[str, str]
) -> None:
    """Also where no twin is asked for; each fault is told once."""
    log = break_log(tmp_path / "log.mcap", *faults)
    assert main(["plot", str(log), "--out", str(tmp_path / "log.svg")]) == 0
    said = capsys.readouterr().err
    for told in faults.values():
        assert len(re.findall(f"^warning: log.mcap: {told}", said, re.MULTILINE)) == 1


def test_a_sound_log_is_plotted_without_a_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the craft logged it."""
    assert main(["plot", str(break_log(tmp_path / "log.mcap")), "--out", str(tmp_path / "log.svg")]) == 0
    assert capsys.readouterr().err == ""


def test_every_command_says_what_the_verdict_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the same words, each once; in Python results carry them."""

    def list_first(flights: Sequence[Measurements], window: float) -> list[np.ndarray]:
        return [starts[:1] for starts in list_starts(flights, window)]

    monkeypatch.setattr("vpptwin.report.result.judge", find_nothing)
    monkeypatch.setattr("vpptwin.report.compare.list_starts", list_first)
    for place in ("history", "identify"):
        monkeypatch.setattr(f"vpptwin.drift.{place}.fit_flights", fit_nothing)
    log = str(break_log(tmp_path / "log.mcap", "stuck at the end", "dead rotor state", "doubled"))
    named = ["--parameters", "air.drag"]
    out = str(tmp_path / "out")
    assert main(["diagnose", log, "--out", out]) == 0
    warnings = json.loads((tmp_path / "out/verdict.json").read_text())["warnings"]
    for told in ("repeat a stamp", "/imu/data: .* repeat a value", "/rotor/state: .* never changes"):
        assert len([warning for warning in warnings if re.search(told, warning)]) == 1
    assert vpptwin.compare(log, ["nominal", "typical"], progress=False).warnings == warnings
    assert vpptwin.history(log, "nominal", "air.drag", progress=False).warnings == warnings
    for command in (
        ["compare", log, "--json", str(tmp_path / "compared.json")], ["history", log, *named, "--out", out],
        ["identify", log, *named, "--out", str(tmp_path / "found.yaml")],
        ["play", log, "--html", str(tmp_path / "log.html")],
        ["plot", log, "--twin", "nominal", "--out", str(tmp_path / "both.svg")],
    ):  # fmt: skip
        capsys.readouterr()
        assert main(command) == 0
        said = [line for line in re.split("[\r\n]", capsys.readouterr().err) if line.startswith("warning: ")]
        assert said == [f"warning: {warning}" for warning in warnings], command[0]
    assert json.loads((tmp_path / "compared.json").read_text())["warnings"] == warnings
