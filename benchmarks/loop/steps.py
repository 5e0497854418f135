"""The steps of the loop as commands that a user would type; a step whose result is there is not done again."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from loop.flights import fly_rig, load_policy, log_flights, log_manoeuvre, predict
from loop.settings import TASK, Rig, tell_truth
from vpptwin.system.files import write_whole
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint
from vpptwin.train.stored import FILE_NAME, find_checkpoint

ROOT = Path(__file__).resolve().parents[2]
COMPILE = ("gcc", "-O2", "-std=c99", "-shared", "-fPIC")
POLICIES = {
    "nominal": "nominal twin",
    "adaptive": "the same, flown by the adaptive controller",
    "randomized": "nominal twin, the paper's randomization",
    "extended": "extended twin, identified intervals",
    "oracle": "the truth",
}
"""Those that fly, and what each was trained on."""


@dataclass(frozen=True)
class Budget:
    """How much is trained and flown."""

    steps: int = 3_000_000  # policy steps of every training
    flights: int = 200  # of every policy on every rig
    threads: int = 2  # cores of one training


def call(arguments: Sequence[str], log: Path) -> None:
    """Run vpptwin, everything it says into a file; raise with the end of it if it fails."""
    with log.open("a") as file:
        command = [sys.executable, "-m", "vpptwin", *arguments]
        done = subprocess.run(command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: exit {done.returncode}\n{log.read_text()[-800:]}")


def train(folder: Path, twin: str | Path, randomize: str, seed: int, budget: Budget) -> Path:
    """Steps 1 and 4: train into a folder, by one recipe whatever the twin; a run that was interrupted goes on."""
    if not (folder / "done").exists():
        begun = (folder / FILE_NAME).exists()
        recipe = [*TASK, f"out={folder}", f"twin={twin}", f"randomize={randomize}", f"seed={seed}"]
        options = [f"resume={folder}"] if begun else [*recipe, f"total_steps={budget.steps}"]
        call(["train", *options, f"sim_threads={budget.threads}", "progress=false"], folder.with_suffix(".log"))
        (folder / "done").touch()
    return folder


def adopt(name: str, folder: Path) -> Path:
    """A policy that is there, one that ships or a run's, as the run that it came from."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(find_checkpoint(name), folder / FILE_NAME)
    return folder


def export(run: Path) -> Path:
    """The policy of a run as C, compiled: what flies."""
    library = run / "policy.so"
    if not library.exists():
        call(["export", str(run), "--format", "c", "--out", str(run / "c")], run.with_suffix(".log"))
        subprocess.run([*COMPILE, *map(str, (run / "c").glob("*.c")), "-o", str(library)], check=True)
    return library


def write_truth(rig: Rig, path: Path) -> Path:
    """The rig as a twin YAML, for the oracle."""
    content = {"model": "rail_rig.xml", "vehicle": "vehicle.yaml", "effects": tell_truth(rig)}
    write_whole(path, yaml.safe_dump(content))
    return path


def diagnose(home: Path, run: Path, rig: Rig, seed: int) -> Path:
    """Steps 2 and 3: two flights by the exported policy, a diagnosis; if it suggests a manoeuvre, that, and one of all.

    Returns:
        Folder of the last diagnosis.
    """
    first, last = home / "first_diagnosis", home / "diagnosis"
    if (last / "twin.yaml").exists():
        return last
    policy, task = load_policy(export(run)), build_policy(read_checkpoint(run), run)[1].task
    flown = log_flights(policy, task, rig, seed, home)
    if not (first / "twin.yaml").exists():
        call(["diagnose", *map(str, flown), "--twin", "nominal", "--out", str(first)], home / "diagnose.log")
    suggested = json.loads((first / "verdict.json").read_text())["suggested_experiment"]
    if suggested is None:
        return first
    flown.append(log_manoeuvre(suggested, rig, seed, home))
    call(["diagnose", *map(str, flown), "--twin", "nominal", "--out", str(last)], home / "diagnose.log")
    return last


def measure(path: Path, run: Path, rig: Rig, twin: str | Path, seed: int, flights: int) -> dict[str, Any]:
    """Steps 2 and 5: flights of a policy on a rig, and what a twin predicts of them."""
    if path.exists():
        result: dict[str, Any] = json.loads(path.read_text())
        return result
    policy, task = load_policy(export(run)), build_policy(read_checkpoint(run), run)[1].task
    result = {
        "flown": fly_rig(policy, task, rig, flights, seed),
        "predicted": predict(policy, task, rig, twin, flights, seed),
    }
    write_whole(path, json.dumps(result))
    return result


def read_verdict(folder: Path) -> dict[str, Any]:
    """Named causes with values and intervals, and what was suggested, of a diagnosis."""
    verdict = json.loads((folder / "verdict.json").read_text())
    first = json.loads((folder.parent / "first_diagnosis" / "verdict.json").read_text())
    causes = [{key: cause[key] for key in ("effect", "confidence", "parameters")} for cause in verdict["causes"]]
    return {
        "causes": causes, "first": [cause["effect"] for cause in first["causes"]],
        "suggested": first["suggested_experiment"],
    }  # fmt: skip
