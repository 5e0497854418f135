"""MATLAB's and NumPy's files of arrays: as laboratories save them, damaged, and too large."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from tests.logs.bags import refuse
from tests.logs.test_foreign import read_joint, read_stream
from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.logs.spelling import list_flights, list_sources, stem_log
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry

TIME = 0.01 * np.arange(400)
SWING = np.sin(TIME)
TABLE = {"t": TIME, "swing": SWING, "other": np.ones(7)}


def save(path: Path, content: dict[str, Any], **options: Any) -> Path:  # noqa: ANN401
    """A file of arrays of the kind that its ending says."""
    if path.suffix == ".npz":
        np.savez_compressed(path, **content)
    else:
        savemat(path, content, **options)
    return path


def simulink(label: str) -> dict[str, Any]:
    """Simulink's structure with time of two signals."""
    signals = [{"values": SWING[:, None], "label": label}, {"values": np.stack([TIME, SWING], axis=1), "label": ""}]
    return {"time": TIME[:, None], "signals": np.array(signals, dtype=object), "blockName": "rig/log"}


@pytest.mark.parametrize(("content", "topic", "position"), [
    (TABLE, "log", "swing"),
    ({"time": TIME[None, :], "states": np.stack([TIME, SWING])}, "log", "states[1]"),  # rows, as MATLAB has them
    ({"t_ms": 1e3 * TIME, "swing": SWING}, "log", "swing"),
    ({"data": np.stack([TIME, SWING, TIME])}, "log", "data[0]"),  # To Host File: its first row is the time
    ({"rec": np.stack([TIME, TIME, SWING], axis=1)}, "log", "rec[1]"),
    ({"run": {"Time": TIME, "angle": SWING}, "gain": 2.0}, "log", "angle"),
    ({"out": simulink("swing")}, "log", "swing"),
    ({"out": simulink("swing")}, "log", "signal_2[1]"),
    ({"a": {"t": TIME, "q": SWING}, "b": {"t": TIME, "q": TIME}}, "a", "q"),
    ({"a": {"t": TIME, "q": TIME}, "b": {"t": TIME, "q": SWING}}, "b", "q"),
])  # fmt: skip
def test_what_laboratories_save_is_read(tmp_path: Path, content: dict, topic: str, position: str) -> None:
    """Vectors with their time, structures, Simulink's, matrices whose first row or column is the time."""
    joint = read_stream(save(tmp_path / "log.mat", content), topic, position=position)
    np.testing.assert_allclose(joint["position"], SWING)
    np.testing.assert_allclose(joint.time, TIME, atol=1e-9)


@pytest.mark.parametrize(("name", "options"), [("log.npz", {}), ("log.mat", {"format": "4"}),
                                               ("log.mat", {"do_compression": True})])  # fmt: skip
def test_either_kind_is_read(tmp_path: Path, name: str, options: dict) -> None:
    """NumPy's archive, MATLAB's version 4, compressed elements; a folder of them is its flights."""
    log = save(tmp_path / name, TABLE, **options)
    np.testing.assert_allclose(read_stream(log, "log", position="swing")["position"], SWING)
    assert list_flights(tmp_path) == [log]


@pytest.mark.parametrize(("content", "found"), [
    ({"swing": SWING, "gain": 2.0}, "holds swing 400, gain of float; expected a vector `t` or `time`"),
    ({"m": np.stack([SWING, TIME])}, "holds m 2 x 400; expected a vector"),
    ({"t": np.where(TIME[7] == TIME, np.nan, TIME), "swing": SWING}, "no time in row 7 of t"),
])  # fmt: skip
def test_what_has_no_time_is_refused(tmp_path: Path, content: dict, found: str) -> None:
    """In one line that says what the file has."""
    with pytest.raises(InputError, match=found):
        read_joint(save(tmp_path / "log.mat", content), "log", position="swing")


@pytest.mark.parametrize("name", ["log.mat", "log.npz"])
@pytest.mark.parametrize("share", [*(pytest.param(share, marks=pytest.mark.slow) for share in (0.0, 0.1, 0.5)), 0.9])
def test_a_damaged_file_is_refused(tmp_path: Path, name: str, share: float) -> None:
    """Cut off, and with bytes that make no sense: one line, whatever the library raised."""
    content = save(tmp_path / name, TABLE).read_bytes()
    rng = np.random.default_rng(1)
    spoilt = bytearray(content)
    for place in rng.integers(130, len(content), 40):
        spoilt[place] = int(rng.integers(256))
    for bad in (content[: max(int(share * len(content)), 1)], content[:20], bytes(spoilt), b"nonsense", b"x" * 400):
        (tmp_path / name).write_bytes(bad)
        refuse(tmp_path / name, read=lambda path: read_joint(path, "log", position="nowhere"))


def test_what_the_library_crashes_on_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files without checksums are tried by a process that may die; compressed ones need none."""
    monkeypatch.setattr("vpptwin.logs.formats.arrays._TRY", "import os; os.abort()")
    log = save(tmp_path / "log.mat", TABLE)
    with pytest.raises(InputError, match=r"is damaged \(what reads it crashes\)"):
        read_joint(log, "log", position="swing")
    assert read_joint(save(log, TABLE, do_compression=True), "log", position="swing").joints


def test_version_7_3_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """It is HDF5."""
    (tmp_path / "log.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match=r"version 7\.3, which is HDF5.*save\(file, '-v7'\)"):
        read_joint(tmp_path / "log.mat", "log", position="swing")


@pytest.mark.slow
def test_what_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    """A megabyte that is 1.3 GB of zeros, and not said to be damaged."""
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    packer = zlib.compressobj(9)
    zeros = b"".join(packer.compress(bytes(1 << 24)) for _ in range(80)) + packer.flush()
    (tmp_path / "log.mat").write_bytes(head + struct.pack("<II", 15, len(zeros)) + zeros)
    with pytest.raises(InputError, match=r"^\S+ holds arrays of more than 1 GB; expected less"):
        read_joint(tmp_path / "log.mat", "log", position="swing")


def list_of(*tests: dict[str, Any]) -> np.ndarray:
    """An array of structures, as MATLAB's tests(1:n)."""
    names = list(tests[0])
    return np.array([[tuple(test[name] for name in names) for test in tests]], dtype=[(name, "O") for name in names])


EMPTY = np.zeros((0, 0))
TESTS: dict[str, dict[str, Any]] = {
    "structures": {"tests": list_of({"t": TIME, "q": TIME}, {"t": TIME, "q": SWING})},
    "structures within one": {"day": {"tests": list_of({"t": TIME, "q": TIME}, {"t": TIME, "q": SWING})}},
    "cells": {"runs": np.array([{"t": TIME, "q": TIME}, {"t": TIME, "q": SWING}], dtype=object)},
    "with names, flags and gaps": {
        "tests": list_of(
            {"name": "slow", "t": TIME[:9], "q": TIME[:9], "ok": TIME[:9] > 1, "note": EMPTY},
            {"name": "fast", "t": TIME, "q": SWING, "ok": TIME > 1, "note": "windy"},
            {"name": "", "t": EMPTY, "q": EMPTY, "ok": EMPTY, "note": EMPTY},
        ),
        "who": np.array(["ab", "cde"]),
    },
    "a grid": {"grid": list_of({"t": TIME, "q": TIME}, {"t": TIME, "q": SWING}).T},
    "Simulink's": {"out": list_of(simulink("p") | {"n": 1}, simulink("q") | {"n": 2})},
}


@pytest.mark.parametrize("name", TESTS)
def test_a_file_of_several_tests_is_as_many_flights(tmp_path: Path, name: str) -> None:
    """FILE#0 is the first of an array of structures; where one flight is wanted the line lists them."""
    log = save(tmp_path / "log.mat", TESTS[name])
    assert list_flights(log) == [Path(f"{log}#0"), Path(f"{log}#1")]
    joint = read_stream(Path(f"{log}#1"), "log", position="q")
    np.testing.assert_allclose(joint["position"], SWING)
    several = r"holds [23] tests: #0 .*\(1\) \(.*times\), #1 .*\(2\) .*give one, such as .*log\.mat#0"
    with pytest.raises(InputError, match=several):
        read_joint(log, "log", position="q")
    with pytest.raises(InputError, match=r"log\.mat#7: [23] tests; expected #0 to #[12]; correct the number"):
        read_joint(Path(f"{log}#7"), "log", position="q")
    assert main(["inspect", f"{log}#1"]) == 0


def test_an_array_of_signals_is_one_flight(tmp_path: Path) -> None:
    """Each with a name, a time and values of its own; a file with one test has one flight."""
    signals = list_of({"name": "q", "time": TIME, "data": SWING}, {"name": "u", "time": TIME[:5], "data": TIME[:5]})
    log = save(tmp_path / "log.mat", {"logs": signals})
    np.testing.assert_allclose(read_stream(log, "q", position="data")["position"], SWING)
    one = save(tmp_path / "one.mat", {"tests": list_of({"t": TIME, "q": SWING}, {"t": EMPTY, "q": EMPTY})})
    assert list_flights(one) == [one]
    np.testing.assert_allclose(read_stream(one, "one", position="q")["position"], SWING)


def test_records_of_numpy_are_a_table(tmp_path: Path) -> None:
    """As a structure is."""
    records = np.rec.fromarrays([TIME, SWING], names="t,q")
    np.testing.assert_allclose(
        read_joint(save(tmp_path / "log.npz", {"log": records}), "log", position="q").duration, TIME[-1]
    )


def test_what_has_another_length_than_its_time_is_left_out_and_told(tmp_path: Path) -> None:
    """33 times 0.5 s apart, which are seconds, and 3201 values; refused where it is what is wanted."""
    signals = [{"values": np.arange(33.0), "label": "slow"}, {"values": np.arange(3201.0), "label": "fast"}]
    content = {"out": {"time": 0.5 * np.arange(33), "signals": np.array(signals, dtype=object), "gain": np.eye(3)}}
    log = save(tmp_path / "log.mat", content)
    recording, found = survey(log)
    assert recording.files[0].notes == ["/log: fast has 3201 values for 33 times: left out"]
    assert found[0].time[-1] == 16.0
    assert read_joint(log, "log", position="slow").duration == 16.0
    with pytest.raises(InputError, match="/log: fast has 3201 values for 33 times; expected one at each time"):
        read_joint(log, "log", position="fast")


@pytest.mark.parametrize(
    "head", ["{'descr': [", "{'descr': '<f8', 'fortran_order': (", "'''", "{'a': lambda: 1}", "\\x", "1" * 900]
)
def test_a_head_of_an_array_that_makes_no_sense_is_refused(tmp_path: Path, head: str) -> None:
    """Whatever Python's own parser raises on it."""
    text = head.encode().ljust(118) + b"\n"
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        archive.writestr("t.npy", b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + bytes(80))
    with pytest.raises(InputError, match=r"log\.npz is damaged"):
        read_joint(tmp_path / "log.npz", "log", position="q")


def test_tests_of_a_file_are_told_apart_by_name(tmp_path: Path) -> None:
    """What is written of each, and what a stretch of one is; in a folder too."""
    log = save(tmp_path / "log.mat", TESTS["structures"])
    assert [stem_log(test) for test in list_flights(tmp_path)] == ["log_0", "log_1"]
    assert list_sources(f"{log}#1") == [log]
    part = read_flight(f"{log}#1@1-2", None, {"/joint_states": {"j": SignalEntry(topic="log", position="q")}})
    assert part.joints["/joint_states"]["j"]["position"].tolist() == SWING[100:200].tolist()


def test_the_next_run_is_called_as_the_twin_says(tmp_path: Path) -> None:
    """As of CSV: a twin of one run takes the others."""
    flight = read_joint(save(tmp_path / "run_2.mat", TABLE), "run_1", position="swing")
    np.testing.assert_allclose(flight.joints["/joint_states"]["j"]["position"], SWING)
    assert not any("run_1" in warning for warning in flight.warnings)
