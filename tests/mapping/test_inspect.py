"""`vpptwin inspect` writes a twin; models by name, and `--model` in place of a twin YAML."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco_menagerie
import pytest

from vpptwin.cli.main import main
from vpptwin.mapping.guess import guess_signals
from vpptwin.mapping.inspect import ask, list_entries
from vpptwin.mapping.models import find_model
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[2]


def test_a_log_without_doubt_needs_no_twin(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mapping is printed first, and the twin kept, for other logs too; replacing it by another is refused."""
    monkeypatch.chdir(tmp_path)
    log, model = shared_data / "antx/rail_velocity_doublets_1.mcap", ROOT / "examples/antx/antx.xml"
    assert main(["compare", str(log), "--model", str(model)]) == 0
    shown = capsys.readouterr().out
    assert shown.index("slide (joint)") < shown.index("prediction error of twin antx_twin.yaml")
    assert main(["compare", str(log), "--twin", "antx_twin.yaml"]) == 0
    text = "# another log\n" + Path("antx_twin.yaml").read_text()
    Path("antx_twin.yaml").write_text(text)
    assert main(["compare", str(log), "--model", str(model)]) == 0
    assert Path("antx_twin.yaml").read_text() == text
    capsys.readouterr()
    one, other = (f"signals: {{joints: {{j: {{topic: {topic}, position: q}}}}}}" for topic in ("run_1", "run_2"))
    assert list_entries(one) == list_entries(f"# of a table\n{other}") != list_entries(one.replace(" q", " v"))
    Path("antx_twin.yaml").write_text("mine")
    assert main(["compare", str(log), "--model", str(model)]) == 2
    assert "antx_twin.yaml is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("extra", "part"),
    [([], "doubts about"), (["--twin", "typical"], "--twin typical and --model")],
)
def test_doubts_are_refused(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    extra: list[str], part: str,
) -> None:  # fmt: skip
    """In one line that says what to run, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    log, model = shared_data / "double_pendulum/design_A_02.csv", ROOT / "examples/double_pendulum/double_pendulum.xml"
    assert main(["compare", str(log), "--model", str(model), *extra]) == 2
    assert part in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "robot", "entry"),
    [("trs_so_arm100", "trs_so_arm100", "so_arm100"), ("ur10e", "universal_robots_ur10e", "ur10e")],
)
def test_names_of_the_menagerie(monkeypatch: pytest.MonkeyPatch, name: str, robot: str, entry: str) -> None:
    """A robot's whole name or that of its model; the package downloads the files, so here they stand in."""
    monkeypatch.setattr(mujoco_menagerie.Robot, "xml", lambda self, entry=None: Path(self.name) / f"{entry}.xml")
    assert find_model(name) == Path(robot) / f"{entry}.xml"


@pytest.mark.parametrize(
    ("name", "part"), [("scene", "'scene' is none of"), ("ur10", "universal_robots_ur10e"), ("x.xml", "no file")]
)
def test_unknown_models_are_refused(name: str, part: str) -> None:
    """With what comes near."""
    with pytest.raises(InputError) as caught:
        find_model(name)
    assert part in str(caught.value)


def test_no_network_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the download says is passed on."""

    def fail(self: object, entry: str | None = None) -> Path:
        raise mujoco_menagerie.DownloadError("no route")

    monkeypatch.setattr(mujoco_menagerie.Robot, "xml", fail)
    with pytest.raises(InputError, match=r"could not be downloaded \(no route\); expected a download, once"):
        find_model("ur10e")


def test_robot_descriptions(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the library's own names; without it a line says how to get it."""
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(InputError, match=r"needs robot_descriptions, which .*pip install 'vpptwin\[menagerie\]'"):
        find_model("ur10e_mj_description")
    monkeypatch.setitem(sys.modules, "robot_descriptions", SimpleNamespace(__path__=[]))
    found = SimpleNamespace(MJCF_PATH="/cache/ur10e.xml")
    monkeypatch.setitem(sys.modules, "robot_descriptions.ur10e_mj_description", found)
    assert find_model("ur10e_mj_description") == Path("/cache/ur10e.xml")


def test_the_order_is_asked_once(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who says yes has no more to look at; who says no keeps the doubts."""
    model = load_twin(ROOT / "examples/double_pendulum/both.yaml").model
    for answer, sure in (("n", 0), ("y", 2)):
        guesses = guess_signals(model, survey(shared_data / "double_pendulum/design_A_02.csv")[1])
        questions: list[str] = []
        monkeypatch.setattr("builtins.input", lambda text, a=answer, q=questions: q.append(text) or a)
        assert sum(guess.sure for guess in ask(guesses)) == sure
        assert questions == ["Is this the order of the columns: pos_meas1 = shoulder, pos_meas2 = elbow? [y/n] "]


def test_the_twin_that_is_written_works(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A CSV and an MJCF become a twin that `compare` takes, every doubt stands in it."""
    monkeypatch.setenv("COLUMNS", "200")
    log, out = shared_data / "double_pendulum/design_A_02.csv", tmp_path / "twin.yaml"
    model = ROOT / "examples/double_pendulum/double_pendulum.xml"
    assert main(["inspect", str(log), "--model", str(model), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"/design_A_02 tau_fric1 +│ float64 │ +500 Hz │ 0 +│ +│ constant", shown)
    assert "DOUBT: only the order says that pos_meas1 is shoulder" in out.read_text()
    spec = load_twin(out)
    assert spec.robot.signals.entries["/joint_states"]["elbow"].position.path == "pos_meas2"
    assert main(["compare", str(log), "--twin", str(out)]) == 0


@pytest.mark.parametrize(
    ("arguments", "part"),
    [(["--out", "twin.yaml"], "without --model"), (["--model", "none.xml"], "none.xml"), ([], "no file")],
)
def test_bad_inspections_are_refused(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], part: str
) -> None:
    """In one line, with exit code 2."""
    log = shared_data / "simple_pendulum/ilqr.csv" if arguments else tmp_path / "missing.csv"
    assert main(["inspect", str(log), *arguments]) == 2
    error = capsys.readouterr().err
    assert part in error
    assert error.count("\n") == 1
