"""The folder of results: complete or as it was, whatever goes wrong; verdicts as JSON wherever they are asked for."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.diagnosis.made_up import FLIP, make_up
from vpptwin.cli.main import main
from vpptwin.report import result
from vpptwin.report.command import diagnose_logs
from vpptwin.report.html import pictures
from vpptwin.report.output import stage_results
from vpptwin.system.errors import InputError
from vpptwin.system.files import exchange
from vpptwin.twin.spec import load_twin

RESULTS = ["prediction.mcap", "report.html", "twin.yaml", "verdict.json"]
OURS = '\x07\0\0\0vpptwin "horizons_s" vpptwin diagnose'
"""By which files that vpptwin wrote are known."""
Fault = type[BaseException] | BaseException


@pytest.fixture(autouse=True)
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Diagnoses are made up: these tests are about files."""
    make_up(monkeypatch)


def run(out: Path, *more: str) -> int:
    """`vpptwin diagnose` of the demo flight."""
    return main(["diagnose", str(FLIP), "--out", str(out), *more])


def list_files(folder: Path) -> dict[str, bytes]:
    """Everything in a folder, hidden files too."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_all_results_are_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Four files and no rest of the work; each is named where the summary ends; the twin is one for every command."""
    assert run(tmp_path / "out") == 0
    assert sorted(list_files(tmp_path / "out")) == RESULTS
    said = capsys.readouterr().out
    for name in RESULTS:
        assert str(tmp_path / "out" / name) in said
    effects = load_twin(tmp_path / "out/twin.yaml").effects
    assert effects == {"rail_x.coulomb": {"force": 0.306}, "gyro.bias": {"bias": 0.012}}


def test_json_is_a_copy_or_all_that_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--json FILE` holds what verdict.json holds, beside the summary; `--json -` prints it alone, for a pipe."""
    assert run(tmp_path / "out", "--json", str(tmp_path / "copy.json")) == 0
    assert (tmp_path / "copy.json").read_bytes() == (tmp_path / "out/verdict.json").read_bytes()
    assert "Dry friction" in capsys.readouterr().out
    assert run(tmp_path / "out", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "out/verdict.json").read_text())
    assert not (tmp_path / "-").exists()


def test_a_json_that_cannot_be_written_is_told_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before minutes of work: exit code 2, one line, no folder made."""
    assert run(tmp_path / "out", "--json", str(tmp_path / "nowhere/v.json")) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def refuse(fault: Fault) -> Callable[..., None]:
    """A function that fails in this way whatever it is given."""

    def fail(*arguments: object, **named: object) -> None:
        raise fault

    return fail


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


FAULTS = pytest.mark.parametrize(
    "fault", [KeyboardInterrupt(), FULL, ValueError("a bug")], ids=["ctrl-c", "full disk", "bug"]
)


def fill(folder: Path) -> dict[str, bytes]:
    """Results of an earlier run."""
    old = {name: f"old {name} {OURS}".encode() for name in RESULTS}
    for name, content in old.items():
        (folder / name).write_bytes(content)
    return old


@FAULTS
@pytest.mark.parametrize("step", ["judge", "write_json", "write_whole"])
def test_a_run_that_fails_leaves_the_old_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, fault: Fault
) -> None:
    """Before there is a new verdict the old files stay, with nothing half-made beside them."""
    old = fill(tmp_path)
    monkeypatch.setattr(result, step, refuse(fault))
    with pytest.raises(type(fault)):
        diagnose_logs([FLIP], "nominal", tmp_path)
    assert list_files(tmp_path) == old


PIECES = {
    "predict_flight": ["prediction.mcap"], "write_prediction": ["prediction.mcap"], "draw_pictures": [],
    "render_report": ["report.html"], "compose_twin": ["twin.yaml"],
}  # fmt: skip
"""What fails → the files that are not there for it."""


@pytest.mark.parametrize(
    ("step", "fault"),
    [
        pytest.param(step, fault, id=f"{step}-{name}", marks=[] if step in often else [pytest.mark.slow])
        for name, fault, often in (
            ("ctrl-c", KeyboardInterrupt(), ("write_prediction", "render_report")),
            ("full disk", FULL, ("write_prediction",)), ("bug", ValueError("a bug"), PIECES),
        )
        for step in PIECES
    ],
)  # fmt: skip
def test_what_fails_beside_the_verdict_costs_only_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], step: str, fault: Fault
) -> None:
    """The new verdict is there; it and a line on stderr say what is missing and why; nothing old lies beside it."""
    fill(tmp_path)
    monkeypatch.setattr(result, step, refuse(fault))
    if isinstance(fault, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            diagnose_logs([FLIP], "nominal", tmp_path)
        if step not in ("predict_flight", "write_prediction", "draw_pictures"):
            return  # it came before the verdict
        missing, why = ["prediction.mcap"], "the run ended before they were made"
    else:
        diagnose_logs([FLIP], "nominal", tmp_path)
        missing, why = PIECES[step], "No space left" if fault is FULL else "ValueError: a bug (test_output.py:"
        assert why in capsys.readouterr().err
    assert sorted(list_files(tmp_path)) == sorted(set(RESULTS) - set(missing))
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert [cause["effect"] for cause in verdict["causes"]] == ["rail_x.coulomb", "gyro.bias"]
    assert any(why in warning for warning in verdict["warnings"])
    if "report.html" not in missing:
        report = (tmp_path / "report.html").read_text()
        assert why in report
        assert not any(f'href="{name}"' in report for name in missing)


def test_one_picture_that_fails_leaves_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sketch fails: the report has every other picture, and says so."""
    monkeypatch.setattr(pictures, "sketch_rig", refuse(IndexError("no such geom")))
    monkeypatch.setattr(result, "draw_pictures", pictures.draw_pictures)
    found = diagnose_logs([FLIP], "nominal", tmp_path)
    assert found.lost == [warning for warning in found.verdict.warnings if "IndexError: no such geom" in warning]
    assert "sketch" not in found.figures
    assert {"errors", "flight", "force rail_x.coulomb", "left over"} <= set(found.figures)
    assert len(found.lost) == 1


def test_a_full_disk_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, the reason, and no folder left behind."""
    monkeypatch.setattr(Path, "write_bytes", refuse(FULL))
    assert run(tmp_path / "a/b") == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("vpptwin: ")
    assert "No space left on device" in last
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("failing", range(3))
def test_an_exchange_that_fails_midway_is_undone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int) -> None:
    """Whichever of the renames fails, the folder is as before: old files back, new ones gone."""
    staged = tmp_path / "staged"
    staged.mkdir()
    for name in ("a", "b", "c"):
        (staged / name).write_text(f"new {name}")
    for name in ("a", "b"):
        (tmp_path / name).write_text(f"old {name}")
    replace, count = os.replace, iter(range(100))

    def replace_some(source: Path, target: Path) -> None:
        if next(count) == failing:
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr(os, "replace", replace_some)
    with pytest.raises(KeyboardInterrupt):
        exchange(staged, tmp_path, [])
    kept = {file.name: file.read_text() for file in tmp_path.iterdir() if file.is_file()}
    assert kept == {"a": "old a", "b": "old b"}


def test_predictions_of_other_logs_do_not_stay(tmp_path: Path) -> None:
    """A folder used before for two other logs loses their predictions, and nothing that is not ours."""
    (tmp_path / "verdict.json").write_text(json.dumps({"logs": ["a.mcap", "b.mcap"], "horizons_s": []}))
    for name in ("prediction_a.mcap", "prediction_b.mcap", "prediction_mine.mcap", "notes.txt"):
        (tmp_path / name).write_text("something")
    assert run(tmp_path) == 0
    assert sorted(list_files(tmp_path)) == sorted([*RESULTS, "notes.txt", "prediction_mine.mcap"])


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"logs": 3}', "\x00"])
def test_an_old_verdict_that_makes_no_sense_is_replaced(tmp_path: Path, content: str) -> None:
    """It tells nothing about old predictions; the run goes on."""
    (tmp_path / "verdict.json").write_text(content)
    assert result.list_stale(tmp_path) == []


def test_what_stands_in_the_way_is_refused(tmp_path: Path) -> None:
    """A folder in the place of a result, a file in that of the folder: neither replaced nor emptied."""
    (tmp_path / "report.html").mkdir()
    (tmp_path / "report.html/keep").write_text("mine")
    with pytest.raises(InputError, match=r"report\.html is a folder"):
        diagnose_logs([FLIP], "nominal", tmp_path)
    assert list_files(tmp_path) == {"report.html/keep": b"mine"}
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="cannot write to"), stage_results(tmp_path / "out", []):
        pass
    assert (tmp_path / "out").read_text() == "mine"
