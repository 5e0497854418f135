"""Whatever a user gives that cannot work: exit code 2, one line that helps, and nothing left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.bad_files import LOGS, MAPS, SHORT, TWINS, fill_shelf
from vpptwin.cli.main import main

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sound log and every bad log, twin and topic map."""
    folder = tmp_path_factory.mktemp("bad")
    fill_shelf(folder)
    return folder


def list_files(folder: Path) -> dict[str, bytes]:
    """Every file and folder below, with content."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in sorted(folder.rglob("*"))}


def check_line(text: str, parts: Sequence[str]) -> None:
    """One line from us that says what was found, what was expected and what to do, and holds these parts."""
    assert text.endswith("\n")
    assert text.count("\n") == 1, text
    assert "\r" not in text
    assert text.startswith("vpptwin: ")
    assert len(text.split("; ")) >= 3, text
    assert "; expected " in text
    for part in parts:
        assert part in text


class Refusals:
    """Runs commands that must be refused in a folder that must stay as it is."""

    def __init__(self, folder: Path, capture: pytest.CaptureFixture[str]) -> None:
        self.folder, self.capture = folder, capture

    def check(self, *arguments: object, parts: Sequence[str]) -> None:
        """Run a command in this process."""
        before = list_files(self.folder)
        assert main([str(argument) for argument in arguments]) == 2
        out, err = self.capture.readouterr()
        assert out == ""
        check_line(err, parts)
        assert list_files(self.folder) == before

    def check_diagnose(self, *arguments: object, parts: Sequence[str]) -> None:
        """Run diagnose into a new folder and into one with an earlier verdict; neither may change."""
        for out in ("new/out", "old"):
            self.check("diagnose", *arguments, "--out", self.folder / out, parts=parts)

    def check_process(self, *arguments: object, parts: Sequence[str]) -> None:
        """Run a command as a user does, from another folder."""
        before = list_files(self.folder)
        command = [sys.executable, "-m", "vpptwin", *map(str, arguments)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(command, capture_output=True, text=True, cwd=self.folder, env=environment)
        assert done.returncode == 2, done.stderr
        assert done.stdout == ""
        check_line(done.stderr, parts)
        assert list_files(self.folder) == before


@pytest.fixture
def refusals(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Refusals:
    """A folder with a good verdict of an earlier day, where commands run."""
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "verdict.json").write_text('{"gap": true, "horizons_s": []}')
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    return Refusals(tmp_path, capfd)


@pytest.mark.parametrize("name", [*LOGS, *SHORT])
def test_diagnose_refuses_bad_logs(name: str, shelf: Path, refusals: Refusals) -> None:
    """Damaged, empty or useless logs, alone and behind a sound one."""
    parts = {**LOGS, **SHORT}[name][1]
    refusals.check_diagnose(shelf / f"{name}.mcap", parts=parts)
    out = refusals.folder / "new"
    refusals.check("diagnose", shelf / "sound.mcap", shelf / f"{name}.mcap", "--out", out, parts=parts)


@pytest.mark.parametrize("name", TWINS)
def test_diagnose_refuses_bad_twins(name: str, shelf: Path, refusals: Refusals) -> None:
    """Twin files with mistakes in keys, effects, numbers, MJCF or signals."""
    refusals.check_diagnose(shelf / "sound.mcap", "--twin", shelf / f"{name}.twin.yaml", parts=TWINS[name][1])


@pytest.mark.parametrize("name", MAPS)
def test_diagnose_refuses_bad_topic_maps(name: str, shelf: Path, refusals: Refusals) -> None:
    """Topic maps with mistakes, and one that leads to a topic that is not there."""
    refusals.check_diagnose(shelf / "sound.mcap", "--topic-map", shelf / f"{name}.map.yaml", parts=MAPS[name][1])


def test_missing_twins_and_a_log_twice_are_refused(shelf: Path, refusals: Refusals) -> None:
    """Paths that lead nowhere; the same log under two names, which must not judge itself."""
    refusals.check_diagnose(shelf / "sound.mcap", "--twin", "rig.yaml", parts=["no readable twin rig.yaml", "nominal"])
    refusals.check_diagnose(shelf / "sound.mcap", "--topic-map", "m.yaml", parts=["no topic map m.yaml"])
    again = shelf / ".." / shelf.name / "sound.mcap"
    refusals.check_diagnose(shelf / "sound.mcap", again, parts=["sound.mcap is given twice", "leave one out"])


@pytest.mark.parametrize("out", ["file", "file/out", "/proc/vpptwin/out"])
def test_diagnose_refuses_an_unwritable_folder(out: str, shelf: Path, refusals: Refusals) -> None:
    """--out is tried before minutes of work: a file, a folder below a file, a file system that takes none."""
    parts = [f"cannot write to {out}", "a folder", "--out"]
    refusals.check("diagnose", shelf / "sound.mcap", "--out", out, parts=parts)


@pytest.mark.parametrize("name", ["truncated", "no_pose", "nan", "folder_of_videos"])
def test_compare_and_play_refuse_damaged_logs(name: str, shelf: Path, refusals: Refusals) -> None:
    """The same line for every command that reads logs."""
    log, parts = shelf / f"{name}.mcap", LOGS[name][1]
    refusals.check("compare", log, "--json", "new.json", parts=parts)
    refusals.check("play", log, "--twin", "nominal", "--html", "new.html", parts=parts)


@pytest.mark.parametrize("name", ["one_second", "few_poses", "apart"])
def test_compare_refuses_useless_logs(name: str, shelf: Path, refusals: Refusals) -> None:
    """What cannot be predicted is not scored."""
    refusals.check("compare", shelf / f"{name}.mcap", "--json", "new.json", parts=SHORT[name][1])


@pytest.mark.parametrize("name", TWINS)
def test_other_commands_refuse_bad_twins(name: str, shelf: Path, refusals: Refusals) -> None:
    """compare, play and effects read twins as diagnose does."""
    twin, parts = shelf / f"{name}.twin.yaml", TWINS[name][1]
    refusals.check("compare", shelf / "sound.mcap", "--twin", twin, "--json", "new.json", parts=parts)
    refusals.check("play", shelf / "sound.mcap", "--twin", twin, "--html", "new.html", parts=parts)
    refusals.check("effects", "--twin", twin, parts=parts)


@pytest.mark.parametrize("path", ["file/new.json", "/proc/vpptwin.json", "folder", "nowhere/new.json"])
def test_compare_refuses_an_unwritable_file(path: str, shelf: Path, refusals: Refusals) -> None:
    """--json is tried before the work, and no table is printed."""
    refusals.check("compare", shelf / "sound.mcap", "--json", path, parts=[path.split("/")[0], "--json"])


@pytest.mark.parametrize("path", ["file/new.html", "/proc/vpptwin.html", "folder"])
def test_play_refuses_an_unwritable_page(path: str, shelf: Path, refusals: Refusals) -> None:
    """--html below a file, on a file system that takes none, or a folder."""
    refusals.check("play", shelf / "sound.mcap", "--html", path, parts=[f"cannot write {path}", "a writable path"])


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["diagnose", "flight.mcap"], ["required: --out", "diagnose --help"]),
        (["diagnoze"], ["invalid choice: 'diagnoze'", "did you mean diagnose?"]),
        (["diagnose", "flight.mcap", "--out", "x", "--twyn", "y"], ["--twyn", "did you mean --twin?"]),
        (["export", "flip", "--format", "onx"], ["invalid choice: 'onx'", "did you mean onnx?"]),
        (["export", "flip", "--format", "rust"], ["'mjlab'); expected vpptwin export"]),
        (["play", "flight.mcap", "--restart", "soon"], ["--restart: invalid float value: 'soon'"]),
        (["effects", "--colour"], ["unrecognized arguments: --colour"]),
    ],
)
def test_a_wrong_command_line_is_refused(
    arguments: list[str], parts: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    """Options that are missing, unknown or no numbers: one line with the usage."""
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    out, err = capfd.readouterr()
    assert out == ""
    check_line(err, parts)


def test_a_failing_disk_is_one_line_too(refusals: Refusals, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of the file system that no check foresaw."""

    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device", "/data/out")

    monkeypatch.setattr("vpptwin.twin.spec.load_twin", fail)
    refusals.check("effects", parts=["/data/out: No space left on device"])


def test_the_program_itself_exits_with_two(shelf: Path, refusals: Refusals) -> None:
    """As a process: an empty file, and a twin that does not compile, found after reading."""
    out = refusals.folder / "new" / "out"
    refusals.check_process("diagnose", shelf / "empty.mcap", "--out", out, parts=LOGS["empty"][1])
    twin = shelf / "not_compiling.twin.yaml"
    refusals.check_process("compare", shelf / "sound.mcap", "--twin", twin, parts=TWINS["not_compiling"][1])
