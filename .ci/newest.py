"""Run tests/engine against the newest MuJoCo of the index, where that is another than the pinned one.

A failure counts only if pyproject.toml allows that release; without an index there is nothing to try. Another release
than the newest: python .ci/newest.py mujoco==3.17.0
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--retries", "1", "--timeout", "10", "install")


def pip(*arguments: str) -> str | None:
    """What `pip install` prints; None, and its last line printed, where it fails."""
    done = subprocess.run([*PIP, *arguments], capture_output=True, text=True)
    if done.returncode:
        print(*(done.stderr.strip().splitlines() or ["no reason given"])[-1:])
    return None if done.returncode else done.stdout


def main(wanted: str = "mujoco") -> int:
    """Find the release, install it beside the environment, test; the exit code."""
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    report = pip("--dry-run", "--ignore-installed", "--no-deps", "--quiet", "--report", "-", wanted)
    if report is None:
        print("the index gives no MuJoCo: nothing to try")
        return 0
    newest = json.loads(report)["install"][0]["metadata"]["version"]
    pinned = next(pin.removeprefix("mujoco==") for pin in pins if pin.startswith("mujoco=="))
    if wanted == "mujoco" and Version(newest) <= Version(pinned):
        print(f"the index has no newer MuJoCo than the pinned one, {pinned}")
        return 0
    print(f"tests/engine with MuJoCo {newest}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        others = Path(folder, "constraints.txt")
        others.write_text("\n".join(pin for pin in pins if not pin.startswith("mujoco")))
        if pip("--target", folder, "--constraint", str(others), f"mujoco=={newest}") is None:
            print(f"MuJoCo {newest} does not go beside the other pinned versions: not tried")
            return 0
        path = os.pathsep.join([folder, str(ROOT)])
        command = [sys.executable, "-m", "pytest", "tests/engine", "-q", "-n", "2", "--dist", "loadfile"]
        status = subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": path}).returncode
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    ranges = next(each for each in map(Requirement, project["dependencies"]) if each.name == "mujoco").specifier
    allowed = newest in ranges
    if status:
        print(
            f"!!! tests/engine FAILS with MuJoCo {newest}, which pyproject.toml {'allows' if allowed else 'excludes'}"
        )
    return status if allowed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
