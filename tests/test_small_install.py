"""What `pip install vpptwin` gives without its extras: all but training; a line says what is missing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from vpptwin.system.errors import EXTRAS, explain_missing

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = """
import contextlib, io, json, sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in sys.argv[1].split(','):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Refuse())
from vpptwin.cli.main import main
for command in json.load(sys.stdin):
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = main(command)
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([code, said.getvalue()]))
"""
WORKING = {
    "effects": ["effects"],
    "scripted pilot": ["fly", "--manoeuvre", "hover", "--duration", "6", "--out", "hover.mcap"],
    "shipped policy": ["fly", "flip", "--duration", "6", "--out", "flip.mcap"],
    "c": ["export", "flip", "--format", "c"],
    "compare": ["compare", "flip.mcap"],
    "plot": ["plot", "flip.mcap", "--twin", "nominal"],
    "play": ["play", "flip.mcap", "--twin", "nominal", "--html", "flip.html"],
    "layouts": ["layouts", "layouts"],
    "csv": ["inspect", "flight.csv"],
    "diagnose": ["diagnose", "--help"],
    "identify": ["identify", "--help"],
    "history": ["history", "--help"],
    "demo": ["demo", "--help"],
}
REFUSED = {
    "train": (["train", "task=hover"], "train"),
    "train --help": (["train", "--help"], "train"),
    "evaluate": (["evaluate", "flip"], "train"),
    "live": (["play", "--live", "flip"], "train"),
    "onnx": (["export", "flip", "--format", "onnx"], "deploy"),
    "rrd": (["diagnose", "flip.mcap", "--out", "out", "--rrd"], "rerun"),
    "plot page": (["plot", "flip.mcap", "--out", "flip.html"], "interactive"),
    "mp4": (["play", "flip.mcap", "--video", "flip.mp4"], "video"),
    "parquet": (["inspect", "flight.parquet"], "logs"),
    "menagerie": (["inspect", "flip.mcap", "--model", "ur10e"], "menagerie"),
    "fly onnx": (["fly", "--policy", "empty.onnx", "--out", "a.mcap"], "deploy"),
}


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    said: str


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ended]:
    """Every command above, one after the other where no module of an extra can be imported."""
    modules = ",".join(module for extra in EXTRAS.values() for module in extra if module != "psutil")
    commands = [*WORKING.values(), *(command for command, _ in REFUSED.values())]
    folder = tmp_path_factory.mktemp("small")
    (folder / "empty.onnx").touch()
    (folder / "flight.csv").write_text("t,q\n0.0,1.0\n0.1,1.1\n")
    (folder / "flight.parquet").write_bytes(b"PAR1")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, modules], input=json.dumps(commands), cwd=folder, capture_output=True, text=True,
        check=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    return {name: Ended(*json.loads(line)) for name, line in zip([*WORKING, *REFUSED], done.stdout.splitlines())}


@pytest.mark.parametrize("name", WORKING)
def test_what_needs_no_extra(small: dict[str, Ended], name: str) -> None:
    """Looking, comparing, flying the policy that ships and writing it as C."""
    assert small[name].code == 0, small[name].said


@pytest.mark.parametrize("name", REFUSED)
def test_what_needs_one_says_which(small: dict[str, Ended], name: str) -> None:
    """In one line, exit code 2."""
    assert small[name].code == 2
    assert small[name].said.endswith(f"pip install 'vpptwin[{REFUSED[name][1]}]'\n")
    assert small[name].said.count("\n") == 1


def test_the_extras_are_those_of_the_package() -> None:
    """Each brings the modules that it is named for, none of them comes with the package itself, `dev` has them all."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    own = ("hydra", "omegaconf")  # omegaconf comes with hydra-core
    for extra, modules in EXTRAS.items():
        for module in modules:
            assert module in own or any(need.replace("-", "_").startswith(module) for need in extras[extra]), module
            assert not any(need.startswith(module) for need in project["dependencies"])
    assert f"vpptwin[{','.join(EXTRAS)}]" in extras["dev"]


def test_a_module_of_nobodys_is_a_mistake() -> None:
    """What no extra brings is not explained away."""
    assert explain_missing(ModuleNotFoundError("No module named 'mujoco'", name="mujoco")) is None
    line = str(explain_missing(ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")))
    assert line == "torch is not installed; expected vpptwin[train]; pip install 'vpptwin[train]'"
