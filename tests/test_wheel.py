"""The wheel, installed into an environment of its own: what a user gets from `pip install vpptwin`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from vpptwin.cli.demo import MOTIONS

ROOT = Path(__file__).resolve().parents[1]
DEPENDENCIES = Path(np.__file__).parents[1]  # site-packages of this environment
FIRST_EFFECTS = (
    *(f"{joint}.{kind}" for joint in ("rail_x", "rail_z") for kind in ("coulomb", "viscous", "bias")),
    *("airframe.mass", "airframe.inertia", "air.drag", "rotor.thrust_gain", "rotor.asymmetry"),
    *("servo.lag", "command.delay", "mocap.delay"),
)


@dataclass(frozen=True)
class Installation:
    """A virtual environment that holds the wheel, and borrows every other package from the environment of the tests."""

    folder: Path

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment from a folder outside the checkout."""
        program = self.folder / "bin" / command[0]
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        return subprocess.run([program, *command[1:]], cwd=self.folder, env=clean, capture_output=True, text=True)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel built from this checkout."""
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installation(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installation:
    """A new environment with the wheel in it."""
    folder = tmp_path_factory.mktemp("user") / "venv"
    venv.create(folder, with_pip=False)
    python = str(folder / "bin" / "python")
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)
    # A path in a .pth file is searched last, and the .pth files that lie there (our editable install) are not read.
    (site_packages,) = folder.glob("lib/python*/site-packages")
    (site_packages / "dependencies.pth").write_text(f"{DEPENDENCIES}\n")
    return Installation(folder)


def test_wheel_holds_models_and_package(wheel: Path) -> None:
    """Models, flights, every module and data file of the package are in the wheel, and nothing of the tests."""
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"vpptwin/models/{name}" for name in ("rail_rig.xml", "vpp_planar.xml", "vehicle.yaml")} <= names
    assert {f"vpptwin/flights/{path.name}" for path in (ROOT / "demo/flights").glob("*.mcap")} <= names
    arm = ("so101.xml", "rotation.yaml", "motions/LICENSE", *(f"motions/{name}.mcap" for name in MOTIONS))
    assert {f"vpptwin/so101/{name}" for name in arm} <= names
    files = (path for path in (ROOT / "vpptwin").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    assert {path.relative_to(ROOT).as_posix() for path in files} <= names
    assert all(name.startswith("vpptwin") for name in names)


def test_wheel_runs_its_own_code(installation: Installation) -> None:
    """Package, models and flights come from the new environment, not from this checkout."""
    script = (
        "import vpptwin as v, vpptwin.system.resources as r\n"
        "print(v.__file__, r.models_dir(), r.flights_dir(), r.so101_dir(), sep='\\n')"
    )
    done = installation.run("python", "-c", script)
    assert done.returncode == 0, done.stderr
    for path in done.stdout.splitlines():
        assert Path(path).exists()
        assert Path(path).is_relative_to(installation.folder)
    # `vpptwin effects` lists the effects.
    done = installation.run("vpptwin", "effects")
    assert done.returncode == 0, done.stderr
    missing = [effect for effect in FIRST_EFFECTS if effect not in done.stdout]
    assert not missing


def test_training_is_an_extra(wheel: Path) -> None:
    """The metadata asks for torch and what comes with it under an extra only."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        needs = re.findall(r"^Requires-Dist: (.+)$", archive.read(name).decode(), flags=re.MULTILINE)
    heavy = [need for need in needs if re.match("torch|tensordict|hydra|tensorboard|onnx|ray|gymnasium", need)]
    assert len(heavy) >= 9
    assert all("extra ==" in need for need in heavy)
    assert any(need.startswith("mujoco") and "extra" not in need for need in needs)
