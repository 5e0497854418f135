"""A small board from start to end, and scores that can be worked out by hand."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from proving.simgap.__main__ import main
from proving.simgap.entrants.settle import Settings, settle, tune
from proving.simgap.results import score_answer, score_onset
from proving.simgap.scores import MIXED, NOTHING, UNKNOWN
from proving.simgap.sets import list_sessions
from proving.simgap.storage import read_session, read_truth

pytest.importorskip("mujoco")

TOOL = """
import json, sys
from pathlib import Path
home, out = Path(sys.argv[1]), Path(sys.argv[2])
session = json.loads((home / "session.json").read_text())
if home.name == "carts-0001":
    sys.exit("no idea")
answer = {"simgap": 1, "entrant": "tool", "session": session["session"], "probabilities": {"nothing": 1.0}}
json.dump(answer, out.open("w"))
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two carts and a watched rig, answered by a baseline, by the spreadsheet and by a program of somebody else."""
    folder = tmp_path_factory.mktemp("board") / "set"
    assert main(["draw", str(folder), "--seed", "7", "--numbers", "carts=0:2,watched=0:2"]) == 0
    tool = folder / "tool.py"
    tool.write_text(TOOL)
    command = f"{sys.executable} {tool} {{session}} {{answer}}"
    assert main(["run", str(folder), "--entrants", "everything,spreadsheet"]) == 0
    assert main(["run", str(folder), "--entrants", "tool", "--command", command]) == 0
    return folder


def test_board_is_written(drawn: Path, tmp_path: Path) -> None:
    """JSON, page and pictures; the program of somebody else stands beside ours, with its failure counted."""
    assert main(["board", str(drawn), "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "board.json").read_text())
    assert set(content["all"]) == {"everything", "spreadsheet", "tool"}
    assert content["all"]["tool"]["failed"][0] == pytest.approx(0.25)
    assert (drawn / "answers/tool/carts-0001.failed").read_text() == "no idea\n"
    page = (tmp_path / "board.md").read_text()
    assert "| base rates |" in page
    assert "**carts**" in page
    assert all((tmp_path / name).stat().st_size > 5000 for name in ("reliability.png", "cost.png"))
    costs = json.loads((drawn / "answers/spreadsheet/carts-0000.json").read_text())
    assert costs["seconds"] > 0.1
    assert costs["memory_mb"] > 20.0


def test_scores_by_hand(drawn: Path) -> None:
    """Certain and right costs next to nothing; what fails counts as certain that nothing is wrong."""
    for home in list_sessions(drawn):
        session, truth = read_session(home), read_truth(drawn, home)
        if "name" not in session.tracks:
            continue
        answers = len(session.causes) + 2
        right = {"probabilities": {truth.answer: 1.0}, "forecasts": [[m] for m in truth.forecasts]}
        scores = score_answer(right, session, truth)
        share = 1.0 - MIXED + MIXED / answers
        assert scores["log"] == pytest.approx(-np.log(share))
        assert scores["first"] == 1.0
        assert scores["confident"] == 0.0
        assert scores["energy"] == pytest.approx(0.0, abs=1e-9)
        failed = score_answer(None, session, truth)
        wrong = truth.answer != NOTHING
        assert failed["failed"] == 1.0
        assert failed["confident"] == float(wrong)
        assert failed["log"] == pytest.approx(-np.log(MIXED / answers if wrong else share))


def test_command_names_the_worlds() -> None:
    """The command line knows them without importing their simulations, and takes numbers of each."""
    from proving.simgap import __main__, worlds

    assert list(__main__.WORLDS) == list(worlds.WORLDS)
    assert __main__.read_numbers("0:2") == {world: [0, 1] for world in worlds.WORLDS}
    assert __main__.read_numbers("carts=0:2,arms=3,carts=5") == {"carts": [0, 1, 5], "arms": [3]}


def test_onset_by_hand() -> None:
    """CRPS of a point is its distance; none counts as the end; half a chance is half of each, less their spread."""
    assert score_onset({"probability": 1.0, "times": [4.0]}, 10.0, 6.0) == pytest.approx(0.2)
    assert score_onset({"probability": 0.0}, 10.0, None) == pytest.approx(0.0)
    assert score_onset({"probability": 0.5, "times": [6.0]}, 10.0, 6.0) == pytest.approx(0.2 - 0.5 * 0.5 * 0.4)


def test_vpptwin_watches(tmp_path: Path) -> None:
    """What sets in is found to a tenth of a second; where nothing does, it is thought improbable."""
    from proving.simgap.entrants.onset import find_onset

    assert main(["draw", str(tmp_path), "--numbers", "watched=0,watched=8"]) == 0
    for home in list_sessions(tmp_path):
        told, truth = find_onset(read_session(home), home), read_truth(tmp_path, home)
        if truth.onset is None:
            assert told["probability"] < 0.1
        else:
            assert told["probability"] > 0.9
            assert np.median(told["times"]) == pytest.approx(truth.onset, abs=0.1)


def test_settings_are_found() -> None:
    """Evidence that is right three times in four, by ten nats: tuning beats five equal answers."""
    rng = np.random.default_rng(0)
    sessions = []
    for _ in range(40):
        causes = ["a.x", "b.x", "c.x"]
        truth = str(rng.choice([*causes, NOTHING, UNKNOWN]))
        told = truth if rng.random() < 0.75 and truth in causes else str(rng.choice(causes))
        sessions.append(({c: 10.0 * (c == told) for c in causes}, causes, truth))
    best, score = tune(sessions)
    assert score < np.log(5.0)
    assert sum(settle(sessions[0][0], best).values()) == pytest.approx(1.0)
    assert settle({"a.x": 1e5, UNKNOWN: 2e5}, Settings())[UNKNOWN] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["draw", "{}", "--numbers", "moon=0:2"], "no world moon"),
        (["draw", "{}", "--numbers", "carts=two"], "write 0:12 for all worlds"),
        (["run", "{}/nowhere"], "no manifest.json"),
        (["run", "{}", "--entrants", "oracle"], "no entrant oracle"),
        (["check", "{}/nowhere"], "no manifest.json"),
        (["validate", "{}/nowhere", "{}/nowhere"], "is no session"),
        (["board", "{}/nowhere", "--out", "{}"], "no manifest.json"),
    ],
)
def test_wrong_commands(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """One line, exit code 2."""
    assert main([a.format(tmp_path) for a in arguments]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.strip().splitlines()) == 1
