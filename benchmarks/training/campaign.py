"""Running and evaluating: finished runs are kept, in a folder each and in a file, so that a campaign can go on."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from vpptwin.viz.plots.curves import PANELS, read_curve

ROOT = Path(__file__).resolve().parents[2]
SETUPS = {name: [f"setup={name}"] for name in ("VA", "TA", "PI", "All")}
"""The paper's four."""
ABLATIONS = {
    "no spectral normalization": ["lipschitz=null"],
    "no curriculum": ["curriculum.enabled=false"],
    "MLP critic": ["critic=mlp", "critic_hidden=[512,512]"],
    "LSTM critic": ["critic=lstm", "critic_hidden=[128,128]"],
    "critic without privileges": ["privileged=false"],
    "nine inputs": ["paper_inputs=true"],
    "no randomization": ["randomize=[]"],
    "no averaging": ["average=0"],
    "paper's reward": ["task.weights.near=0"],
    "no magnified inputs": ["magnify=false"],
    "no failed starts again": ["curriculum.again=0"],
    "no groups of advantages": ["advantage_groups=1"],
    "no cut at surprises": ["task.target.expected=true"],
    "no nominal share": ["curriculum.nominal=0"],
    "exploration learned": ["learn_exploration=true"],
    "whole episodes": ["task.training_episode=null"],
    "paper's learning rate": [
        "learning_rate.start=3e-4",
        "learning_rate.end=9e-5",
        "learning_rate.begin=0.1",
        "learning_rate.finish=0.7",
        "minibatch=512",
    ],
    "paper's curriculum": ["curriculum.difficulty.begin=0.1", "curriculum.difficulty.finish=0.5"],
    "estimated states": ["estimator=kalman"],
}
"""One thing left out or exchanged, the rest as `All`: with the preset `fast` every difference to `paper` by itself."""
TASKS = {
    "hover": ["task=hover", "total_steps=800000"],
    "wall-backtrack": ["task=wall-backtrack"],
    "wall-backtrack, thrust-to-weight 2": ["task=wall-backtrack", "task.thrust_to_weight=2.0"],
}
"""The other tasks, wall-backtrack at 2.5 and at the real thrust-to-weight."""
VARIANTS = SETUPS | ABLATIONS | TASKS


@dataclass(frozen=True)
class Run:
    """One run of training."""

    variant: str  # a name of `VARIANTS`
    seed: int  # of training
    folder: Path  # of the campaign
    options: tuple[str, ...]  # overrides that all runs of the campaign share

    @property
    def out(self) -> Path:
        """Folder of the run."""
        return self.folder / f"{re.sub(r'[^A-Za-z0-9.-]+', '_', self.variant)}-{self.seed}"

    @property
    def overrides(self) -> list[str]:
        """Everything given to `vpptwin train`."""
        own = [f"seed={self.seed}", f"out={self.out}", "progress=false"]
        return [*self.options, *VARIANTS[self.variant], *own]


def run_campaign(
    runs: list[Run], jobs: int, tracks: int, known: Sequence[dict] = (), tell: Callable[[list[dict]], object] = list
) -> list[dict]:
    """Train and evaluate every run, `jobs` at a time.

    Args:
        runs: to finish.
        jobs: side by side.
        tracks: of each evaluation.
        known: results of an earlier campaign, whose runs are not flown again.
        tell: hears of all results after every run.

    Returns:
        Results in the order of `runs`, then those of `known` that are none of them.
    """
    found = {(result["variant"], result["seed"]): result for result in known}
    order = [(run.variant, run.seed) for run in runs]
    left = [run for run, key in zip(runs, order) if key not in found]

    def gather() -> list[dict]:
        return [found[key] for key in dict.fromkeys([*order, *found]) if key in found]

    with ThreadPoolExecutor(jobs) as pool, tqdm(total=len(left), unit="run") as bar:
        for done in as_completed([pool.submit(finish, run, tracks) for run in left]):
            result = done.result()
            found[result["variant"], result["seed"]] = result
            tell(gather())
            bar.update()
    return gather()


def finish(run: Run, tracks: int) -> dict:
    """Train a run unless that is done, evaluate it, and add its curve."""
    timing = run.out / "timing.json"
    if not timing.exists():
        resumed = (run.out / "checkpoint.pt").exists()
        began = time.monotonic()
        overrides = [f"resume={run.out}", "progress=false"] if resumed else run.overrides
        call(["train", *overrides], run.folder / f"{run.out.name}.log")
        spent = {"wall_s": time.monotonic() - began, "resumed": resumed, "load": os.getloadavg()[0]}
        timing.write_text(json.dumps(spent))
    judged = run.out / f"evaluation_{tracks}.json"
    if not judged.exists():
        call(["evaluate", str(run.out), "--tracks", str(tracks), "--json", str(judged)], run.folder / "evaluate.log")
    result = json.loads(judged.read_text())
    curve = {name: read_curve(run.out, name) for name in PANELS}
    result["evaluation_seed"] = result["seed"]
    return {**result, "variant": run.variant, "seed": run.seed, "curve": curve, **json.loads(timing.read_text())}


def call(arguments: list[str], log: Path) -> None:
    """Run vpptwin, everything it says into a file; raise with the end of it if it fails."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with log.open("a") as file:
        command = [sys.executable, "-m", "vpptwin", *arguments]
        done = subprocess.run(command, cwd=ROOT, env=environment, stdout=file, stderr=subprocess.STDOUT)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: exit {done.returncode}\n{log.read_text()[-800:]}")
