"""However a log is spelled, every command takes it: LOG@a-b, A+B, FOLDER#n, a folder, a pattern in quotes."""

from __future__ import annotations

import json
import os
from hashlib import sha256
from math import inf
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import yaml
from pyarrow import parquet

from tests.diagnosis.made_up import find_nothing, fit_nothing
from tests.diagnosis.rigs import TWIN, UNDRIVEN, let_swing
from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.logs.spelling import find_files, list_flights, list_parts, name_log, split_sum, stem_log
from vpptwin.logs.write import FlightWriter
from vpptwin.report.sources import open_flights
from vpptwin.system.errors import InputError

RATE, COUNT = 50, 400
"""Of a log [Hz], and its rows."""
SET_TWIN = """model: rig.xml
signals:
  joints: {swing: {topic: episode, position: observation.state.q, velocity: observation.state.w}}
"""
ALONE = [
    "runs/a.mcap@2-", "first.mcap+second.mcap", "first.mcap+second.mcap@1-7", "bag/@-6", "set#1", "set/#0@1-7",
    "runs/a*@-6",
]  # fmt: skip
SEVERAL = ["set", "runs@1-7", "runs/[ab].mcap@2-"]
"""What stands for two flights."""


def write_states(path: Path, track: np.ndarray) -> None:
    """A log of the pendulum's joint; time, angle, rate (n, 3)."""
    path.parent.mkdir(exist_ok=True)
    with FlightWriter(path) as writer:
        for time, angle, rate in track.tolist():
            writer.write_joints("/joint_states", time, {"swing": {"position": angle, "velocity": rate}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pendulum let go twice: a log a file, a log in two files, a rosbag2 folder, a LeRobot data set."""
    folder, rng = tmp_path_factory.mktemp("spelled"), np.random.default_rng(5)
    tracks = []
    for seed in (1, 2):
        angle, rate, _ = let_swing(0.03, seed, COUNT / RATE)
        noise = rng.standard_normal((COUNT, 2)) * [1e-3, 1e-2]
        tracks.append(np.column_stack([np.arange(COUNT) / RATE, np.stack([angle, rate], axis=1)[::4] + noise]))
    (folder / "rig.xml").write_text(UNDRIVEN)
    (folder / "twin.yaml").write_text(TWIN % "swing")
    (folder / "set.yaml").write_text(SET_TWIN)
    for name, track in zip("ab", tracks):
        write_states(folder / f"runs/{name}.mcap", track)
    for part, rows in {"first": slice(COUNT // 2), "second": slice(COUNT // 2, None)}.items():
        write_states(folder / f"{part}.mcap", tracks[0][rows])
        write_states(folder / f"bag/{part}.mcap", tracks[0][rows])
    metadata = {"rosbag2_bagfile_information": {"relative_file_paths": ["first.mcap", "second.mcap"]}}
    (folder / "bag/metadata.yaml").write_text(yaml.safe_dump(metadata))
    for part in ("meta", "data/chunk-000"):
        (folder / "set" / part).mkdir(parents=True)
    feature = {"dtype": "float64", "shape": [2], "names": ["q", "w"]}
    about = {"fps": RATE, "total_episodes": 2, "features": {"observation.state": feature}}
    (folder / "set/meta/info.json").write_text(json.dumps(about))
    both = np.concatenate(tracks)
    rows = {
        "observation.state": pa.array(both[:, 1:].tolist(), pa.list_(pa.float64(), 2)), "timestamp": both[:, 0],
        "frame_index": np.tile(np.arange(COUNT), 2), "episode_index": np.repeat([0, 1], COUNT),
    }  # fmt: skip
    parquet.write_table(pa.table(rows), folder / "set/data/chunk-000/file-000.parquet")
    return folder


@pytest.fixture
def quick(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder, to work in; nothing is searched for, fitted or drawn there, all else is as it is."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr("vpptwin.report.result.judge", find_nothing)
    for place in ("history", "identify"):
        monkeypatch.setattr(f"vpptwin.drift.{place}.fit_flights", fit_nothing)
    return folder


def find_twin(spelled: str) -> str:
    """The twin whose joint lies where this log has it."""
    return "set.yaml" if spelled.startswith("set") else "twin.yaml"


def hash_files(*files: str) -> str:
    """Of one file, or of the hashes of several."""
    hashes = [sha256(Path(file).read_bytes()).hexdigest() for file in files]
    return hashes[0] if len(files) == 1 else sha256("".join(hashes).encode()).hexdigest()


def find_hash(spelled: str) -> str:
    """Of the files that a spelling reads."""
    if "+" in spelled:
        return hash_files("first.mcap", "second.mcap")
    if spelled.startswith("bag"):
        return hash_files("bag/first.mcap", "bag/second.mcap")
    if spelled.startswith("set"):
        return hash_files("set/meta/info.json", "set/data/chunk-000/file-000.parquet")
    return hash_files("runs/b.mcap" if "b.mcap" in spelled else "runs/a.mcap")


OFTEN = ("first.mcap+second.mcap@1-7", "bag/@-6", "set/#0@1-7", "runs@1-7")
"""Each kind of place, with a stretch; the others are `slow`."""


@pytest.mark.parametrize(
    "spelled", [each if each in OFTEN else pytest.param(each, marks=pytest.mark.slow) for each in (*ALONE, *SEVERAL)]
)
def test_every_command_takes_it(quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], spelled: str) -> None:
    """From its start to what it writes at its end: provenance, hashes, predictions named after the log."""
    twin, flights = ["--twin", find_twin(spelled)], [str(flight) for flight in list_flights(spelled)]
    assert len(flights) == (2 if spelled in SEVERAL else 1)
    assert main(["inspect", spelled]) == 0
    assert main(["compare", spelled, *twin, "--json", str(tmp_path / "compared.json")]) == 0
    assert json.loads((tmp_path / "compared.json").read_text())["logs"] == flights
    assert main(["diagnose", spelled, *twin, "--out", str(tmp_path / "out")]) == 0
    written = yaml.safe_load((tmp_path / "out/twin.yaml").read_text())
    assert written["provenance"]["logs"] == {flight: find_hash(flight) for flight in flights}
    predictions = sorted(file.name for file in (tmp_path / "out").glob("*.mcap"))
    names = [f"prediction_{stem_log(flight)}.mcap" for flight in flights]
    assert predictions == (["prediction.mcap"] if len(flights) == 1 else sorted(names))
    named = ["--parameters", "swing.viscous"]
    assert main(["history", spelled, *twin, *named, "--out", str(tmp_path / "history")]) == 0
    followed = json.loads((tmp_path / "history/history.json").read_text())
    assert [flight["log"] for flight in followed["flights"]] == flights
    assert main(["identify", spelled, *twin, *named, "--out", str(tmp_path / "found.yaml")]) == 0
    assert yaml.safe_load((tmp_path / "found.yaml").read_text())["provenance"]["logs"].keys() == set(flights)
    capsys.readouterr()
    for command in (
        ["plot", spelled, *twin, "--out", str(tmp_path / "flight.svg")],
        ["play", spelled, *twin, "--html", str(tmp_path / "flight.html")],
        ["convert", spelled, str(tmp_path / "log.mcap")],
    ):
        if spelled in ALONE:
            assert main(command) == 0
        elif command[0] == "convert" or "/" not in spelled:  # what is looked at a pattern may find in several files
            assert main(command) == 2
            told = f"holds 2 recordings; expected one recording here; give one, such as {flights[0]}\n"
            assert capsys.readouterr().err.endswith(told)


def test_what_a_spelling_stands_for(quick: Path) -> None:
    """The same stretch of every file, what is there whole before what its signs mean, links seen through."""
    assert find_files("bag@1-7") == [Path("bag/first.mcap@1-7"), Path("bag/second.mcap@1-7")]
    assert find_files("first.mcap@1-+second.mcap@-7") == [Path("first.mcap@1-"), Path("second.mcap@-7")]
    assert list_flights("runs@2-") == [Path("runs/a.mcap@2-"), Path("runs/b.mcap@2-")]
    assert list_flights("s*t#1@-3") == [Path("set#1@-3")]
    for name in ("a+b.mcap", "a@1-2", "set#7", "run[1].mcap"):
        (quick / name).symlink_to("first.mcap")
        assert find_files(name) == [Path(name)]
    assert split_sum("a+b.mcap@1-2+first.mcap+set#0") == ["a+b.mcap@1-2", "first.mcap", "set#0"]
    assert list_parts("a+b.mcap@2-") == [((quick / "first.mcap").resolve(), 2.0, inf)]
    for name in ("a+b.mcap", "a@1-2", "set#7", "run[1].mcap"):
        (quick / name).unlink()


def test_stretches_are_cut_from_one_origin(quick: Path) -> None:
    """With one end left out as with both; of several files since the first message of all."""
    whole = read_flight("first.mcap+second.mcap").joints["/joint_states"]["swing"]
    for stretch, rows in {
        "@2-": whole.time >= 2.0,
        "@-6": whole.time < 6.0,
        "@.5-4.5": (whole.time >= 0.5) & (whole.time < 4.5),
    }.items():
        cut = read_flight(f"first.mcap+second.mcap{stretch}").joints["/joint_states"]["swing"]
        assert np.array_equal(cut["position"], whole["position"][rows])


def test_names_are_short_and_safe(quick: Path) -> None:
    """In messages without folders; of files in signs that links take, never longer than file systems allow."""
    many = "+".join(f"logs/part_{k}_of_a_recording.mcap" for k in range(40))
    assert name_log("x/first.mcap@1-7") == "first.mcap@1-7"
    assert name_log("bag/first.mcap+bag/second.mcap@1-7") == "first.mcap+second.mcap@1-7"
    assert name_log(many) == "part_0_of_a_recording.mcap+39 more"
    assert name_log(".") == quick.name
    assert stem_log("set#1@1.5-7") == "set_1_1.5-7"
    assert stem_log("first.mcap+second.mcap") == "first_second"
    assert stem_log(many) == "part_0_of_a_recording_and_39_more"
    assert len(stem_log("x/" + "ä" * 120 + ".mcap").encode()) == 200
    with pytest.raises(InputError, match=r"no file logs/part_0_of_a_recording.mcap;"):
        find_files(many)


@pytest.mark.parametrize(
    ("spelled", "told"),
    [
        ("first.mcap@2", "@2 of first.mcap; expected LOG@START-END in seconds, one of them at least; correct it"),
        ("first.mcap@-", "@- of first.mcap; expected LOG@START-END in seconds"),
        ("first.mcap@5-2", "first.mcap@5-2: from 5 to 2 s; expected a start before the end"),
        ("first.mcap#1", "#1 of first.mcap; expected FOLDER#EPISODE of LeRobot; correct it, or give first.mcap"),
        ("set#2", "set#2: no rows of episode 2; expected 0 to 1"),
        ("first.mcap+", "first.mcap+ has a plus with nothing beside it; expected FILE+FILE"),
        ("first.mcap+third.mcap", "no file third.mcap; expected a log"),
        ("runs/*.csv", "no file matches runs/*.csv; expected a log"),
        ("-", "- as a log; expected a file, as logs are read more than once; write it to a file first"),
        ("pipe", "pipe is a pipe or a device; expected a file, as logs are read more than once; write it to a file"),
    ],
)  # fmt: skip
def test_what_is_misspelled_is_told(quick: Path, capsys: pytest.CaptureFixture[str], spelled: str, told: str) -> None:
    """In a line, by the part that is not understood; nothing waits for whoever fills a pipe."""
    if not (quick / "pipe").exists():
        os.mkfifo(quick / "pipe")
    assert main(["inspect", spelled]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_stretches_that_overlap_do_not_judge_each_other(
    quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Data that are fitted are not held out; stretches beside each other are two flights, in a history also others."""
    for second in ("runs/a.mcap@3-8", "runs/../runs/a.mcap"):
        logs = ["runs/a.mcap@-4.5", second]
        assert main(["diagnose", *logs, "--twin", "twin.yaml", "--out", str(tmp_path)]) == 2
        assert f"{logs[0]} and {second} overlap; expected every log once" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"bag@1- is given twice"):
        open_flights(["bag@1-", "bag/@1-"])
    assert len(open_flights(["runs/a.mcap@-4", "runs/a.mcap@4-"], apart=True)) == 2
    assert len(open_flights(["runs/a.mcap@-5", "runs/a.mcap@2-"])) == 2


def test_a_stretch_is_diagnosed_to_the_end(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With nothing left out: what the pendulum loses is found, and the command that says so again names the stretch."""
    monkeypatch.chdir(folder)
    log = "first.mcap+second.mcap@.5-7.5"
    assert main(["diagnose", log, "--twin", "twin.yaml", "--out", str(tmp_path / "out")]) == 0
    verdict = json.loads((tmp_path / "out/verdict.json").read_text())
    assert verdict["logs"] == [log]
    assert verdict["causes"][0]["effect"] == "swing.viscous"
    assert len(read_flight(tmp_path / "out/prediction.mcap").joints["/twin/before/joint_states"]["swing"]) > 200
    command = yaml.safe_load((tmp_path / "out/twin.yaml").read_text())["provenance"]["command"]
    assert command.startswith(f"vpptwin diagnose {log} --twin ")
