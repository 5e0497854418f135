"""SimGap installs and runs where vpptwin is not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCKED = """
import pkgutil, sys
class Block:
    def find_spec(self, name, *rest):
        if name.split(".")[0] in {blocked}:
            raise ImportError(f"{{name}} is blocked")
sys.meta_path.insert(0, Block())
sys.path.insert(0, {place!r})
import proving, importlib
for found in pkgutil.walk_packages(proving.__path__, "proving."):
    if not found.name.startswith({without}) and not found.name.endswith("__main__"):
        importlib.import_module(found.name)
from proving.drone.rig import load_nominal
print(proving.__file__, load_nominal()["gravity"])
"""


def test_wheel_imports_without_vpptwin(tmp_path: Path) -> None:
    """Every module of the wheel, apart from entrants, which bring tools of others; files of the drone come along."""
    pytest.importorskip("hatchling")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT / "proving", check=True, capture_output=True)
    (wheel,) = tmp_path.glob("simgap-*.whl")
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(tmp_path / "in")], check=True)
    names = {"vpptwin", "mujoco"}
    code = BLOCKED.format(blocked=names, place=str(tmp_path / "in"), without=("proving.simgap.entrants",))
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env={"PATH": ""})
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(tmp_path / "in"))
