"""`import vpptwin`: nothing is loaded before it is asked for, and the commands go through the same functions."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import vpptwin
from tests.diagnosis.made_up import FLIP, make_diagnosis
from vpptwin.cli.main import main

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def result() -> vpptwin.Result:
    """A made-up diagnosis of the demo's flip: these tests are about how it is given back."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("vpptwin.report.result.judge", lambda *given, **named: make_diagnosis())
        return vpptwin.diagnose(FLIP, progress=False)


def test_importing_it_loads_nothing() -> None:
    """Neither numpy nor a module of ours; what the tools of editors see is all there."""
    script = "import sys, vpptwin; print(*(n for n in sys.modules if n.startswith(('vpptwin.', 'numpy', 'mujoco'))))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout.strip() == ""
    assert set(vpptwin.__all__) <= set(dir(vpptwin))
    assert (ROOT / "vpptwin/py.typed").is_file()
    # `vpptwin effects` and every refusal of a twin wait for numba otherwise.
    script = "import sys, vpptwin; vpptwin.load_twin('strong'); sys.exit('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert done.returncode == 0


@pytest.mark.parametrize("name", [name for name in vpptwin.__all__ if name != "__version__"])
def test_every_name_leads_somewhere(name: str) -> None:
    """To a class or a function with a docstring, as the type checker is told."""
    found = getattr(vpptwin, name)
    assert found.__doc__
    written = (ROOT / "vpptwin/__init__.py").read_text()
    assert f"import {found.__name__} as {name}\n" in written


def test_what_cannot_be_had_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong name as of any module; what takes an extra in a line, as the commands do."""
    with pytest.raises(AttributeError, match="no attribute 'diagnoze'"):
        _ = vpptwin.diagnoze  # type: ignore[attr-defined]
    # In a line, as the commands do; for whoever asks whether it is there, it is not.
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "vpptwin.train.env.environments", raising=False)
    monkeypatch.delitem(vars(vpptwin), "make_env", raising=False)
    with pytest.raises(vpptwin.InputError, match=r"make_env needs torch, .* pip install 'vpptwin\[train\]'"):
        _ = vpptwin.make_env
    assert not hasattr(vpptwin, "make_env")
    assert {"diagnose", "compare"} <= dict(inspect.getmembers(vpptwin)).keys()
    # The reason stays in the message of the AttributeError.

    def load(name: str) -> None:
        raise ImportError("libtorch.so: cannot open shared object file")

    monkeypatch.setattr(vpptwin, "import_module", load)
    monkeypatch.delitem(vars(vpptwin), "make_env", raising=False)
    with pytest.raises(AttributeError, match=r"make_env cannot be imported: libtorch.so"):
        _ = vpptwin.make_env


@pytest.mark.parametrize(("module", "extra"), [("gymnasium", "gymnasium"), ("torch", "train")])
def test_a_module_that_takes_an_extra_says_which(monkeypatch: pytest.MonkeyPatch, module: str, extra: str) -> None:
    """It cannot be imported, as `try: import` expects it."""
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "vpptwin.gym", raising=False)
    with pytest.raises(ModuleNotFoundError, match=rf"vpptwin.gym needs {module}, .* pip install 'vpptwin\[{extra}\]'"):
        import_module("vpptwin.gym")


def test_a_result_prints_in_ten_lines(result: vpptwin.Result) -> None:
    """The headline first, whole; no other line longer than a wide terminal, even if its last words are left out."""
    lines = str(result).splitlines()
    assert result.summary.headline == lines[0]
    assert lines[0].startswith("Dry friction of 0.306 ± 0.006 N on the horizontal rail and a bias of the gyro")
    assert len(lines) <= 10
    assert max(map(len, lines[1:])) <= 160
    assert repr(result) == str(result)


def test_a_result_shows_itself_in_a_notebook(result: vpptwin.Result) -> None:
    """The report, in a frame; its pictures one by one."""
    page = result._repr_html_()
    assert page.startswith("<iframe srcdoc=")
    assert result.summary.headline.split(",")[0] in page
    assert {"errors", "flight"} <= set(result.figures)
    assert all(picture._repr_svg_().startswith("<svg") for drawn in result.figures.values() for picture in drawn)


def test_a_result_is_saved_as_the_command_saves_it(
    result: vpptwin.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same files; but for the moment they hold the same; its twin is the one that is written."""
    monkeypatch.setattr("vpptwin.report.result.judge", lambda *given, **named: make_diagnosis())
    result.save(tmp_path / "mine")
    assert main(["diagnose", str(FLIP), "--out", str(tmp_path / "its")]) == 0
    names = sorted(file.name for file in (tmp_path / "its").iterdir())
    assert names == sorted(file.name for file in (tmp_path / "mine").iterdir()) == sorted(result.files)
    verdicts = [json.loads((tmp_path / who / "verdict.json").read_text()) for who in ("mine", "its")]
    assert verdicts[0] == verdicts[1]
    assert vpptwin.load_twin(tmp_path / "mine/twin.yaml").effects == result.twin.effects


def test_twins_are_compared_side_by_side(
    result: vpptwin.Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By name, file, or as they were read; one column each, and the figures of `compare` with one of them."""
    both = vpptwin.compare(vpptwin.read_log(FLIP), ["nominal", result.twin], progress=False)
    assert [line.split(":")[0] for line in str(both).splitlines()] == ["nominal", result.twin.name]
    result.save(tmp_path)
    twins = ["--twin", "nominal", "--twin", str(tmp_path / "twin.yaml")]
    assert main(["compare", str(FLIP), *twins, "--json", str(tmp_path / "both.json")]) == 0
    told = json.loads((tmp_path / "both.json").read_text())
    assert [entry["error"] for entry in told["twins"]] == [entry.score.as_dict() for entry in both.twins]
    said = capsys.readouterr().out
    assert "position error [mm]" in said
    assert "twin.yaml" in said
    assert main(["compare", str(FLIP), "--json", "-"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert alone["error"] == told["twins"][0]["error"]
    assert alone["twin"] == "nominal"


@pytest.mark.parametrize("function", ["diagnose", "compare"])
def test_logs_that_make_no_sense_are_refused(function: str) -> None:
    """None, one twice, one that is not there."""
    for logs, found in (([], "no logs"), ([FLIP, FLIP], "given twice"), ("none.mcap", "no file none.mcap")):
        with pytest.raises(vpptwin.InputError, match=found):
            getattr(vpptwin, function)(logs, "nominal", progress=False)


def test_an_environment_by_the_name_of_its_task() -> None:
    """As TorchRL has them; a task that there is none of is refused."""
    env = vpptwin.make_env("hover", num_envs=3, seed=1)
    assert env.rollout(4).batch_size == (3, 4)
    with pytest.raises(vpptwin.InputError, match="unknown task 'hovr'"):
        vpptwin.make_env("hovr")
    with pytest.raises(vpptwin.InputError, match="a dict for a task; expected a name"):
        vpptwin.make_env({})
