"""One run of training: its folder, what it continues from, and the training itself."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from vpptwin.system.errors import InputError
from vpptwin.system.files import check_own, replace_files, write_whole
from vpptwin.train.config import RESUMABLE, TrainConfig, check_values, to_config, to_plain
from vpptwin.train.env.environments import find_device
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.memory import check_run, explain_exhaustion
from vpptwin.train.learn.ppo import FAULTS, build_training
from vpptwin.train.stored import FILE_NAME

NEXT = """next: vpptwin evaluate {0}
      vpptwin play --live {0}
      vpptwin fly {0} --out flight.mcap
      vpptwin plot {0} --out curves.png"""
"""What to do with a run that is over."""
MARK = "# Written by vpptwin train.\n"
"""By which a configuration of ours is known."""


def start_run(config: TrainConfig, given: Collection[str]) -> Path:
    """Train from the start, or from the last checkpoint of the run to resume.

    Raises:
        InputError: if a run cannot be resumed, does not fit into memory, the folder not be written, or the twin not be
            made.
    """
    saved = None
    if config.resume is not None:
        config, saved = read_run(config, given)
    find_device(config.device)
    check_run(config)
    folder = open_folder(config)
    with explain_exhaustion(config):
        training = build_training(config, folder, saved)
    trim_logs(folder, saved["steps"] if saved else 0)
    write_whole(folder / "config.yaml", MARK + yaml.safe_dump(to_plain(config), sort_keys=False))
    started, begun = time.monotonic(), training.trainer.collected_frames
    try:
        with explain_exhaustion(config):
            training.trainer.train()
    except KeyboardInterrupt:
        training.bar.close()
        if (folder / FILE_NAME).exists():
            print(f"continue with `vpptwin train resume={folder}`", file=sys.stderr)
        raise
    finally:
        training.bar.close()
        training.trainer.collector.shutdown()
    seconds = time.monotonic() - started
    steps = training.trainer.collected_frames - begun
    print(f"{steps} steps in {seconds:.0f} s, checkpoint {folder / FILE_NAME}", file=sys.stderr)
    print(NEXT.format(shlex.quote(str(folder))), file=sys.stderr)
    if training.simulations.faults:
        found = f"{training.simulations.faults} simulations diverged; the first are in {folder / FAULTS}"
        print(f"{found}, `python -m vpptwin.twin.health FILE` replays one", file=sys.stderr)
    return folder


def read_run(config: TrainConfig, given: Collection[str]) -> tuple[TrainConfig, dict[str, Any]]:
    """Configuration and last checkpoint of the run that `config.resume` names.

    Raises:
        InputError: if there is nothing to resume, or an override would make it another run.
    """
    others = sorted(set(given) - set(RESUMABLE))
    if others:
        found = f"resume together with {', '.join(others)}"
        raise InputError(found, f"only {', '.join(RESUMABLE)}", "drop it, or start another run")
    content = read_checkpoint(str(config.resume), flying=False)
    if content["training"] is None:
        raise InputError(f"{config.resume} holds a policy only", "a run's folder", "start another run")
    changes = {key: getattr(config, key) for key in given}
    run = Path(str(config.resume))
    folder = run.parent if run.is_file() else run
    resumed = replace(to_config(content["config"]), out=str(folder), **changes)
    check_values(resumed)
    if content["steps"] >= resumed.total_steps:
        found = f"{config.resume} has finished its {content['steps']} steps"
        raise InputError(found, "an unfinished run", f"give more, e.g. total_steps={2 * content['steps']}")
    return resumed, content


def open_folder(config: TrainConfig) -> Path:
    """Create the run's folder.

    Raises:
        InputError: if it cannot be written or holds another run.
    """
    folder = Path(config.out or f"runs/{config.task.name}-{time.strftime('%Y%m%d-%H%M%S')}")
    if config.resume is None and (folder / FILE_NAME).exists():
        advice = f"resume={folder} continues it; else choose another out"
        raise InputError(f"{folder} holds a run", "a new folder", advice)
    if config.resume is None:
        check_own([folder / "config.yaml"], "choose another out")
    try:
        with replace_files(folder, [FILE_NAME]):
            pass
    except OSError as error:
        found = f"cannot write to {folder} ({error.strerror})"
        raise InputError(found, "a writable folder", "choose another out") from error
    return folder


def trim_logs(folder: Path, steps: int) -> None:
    """Drop what was logged after `steps`: those steps are about to be collected again."""
    for path in (folder / "log" / "scalars").glob("*.csv"):
        # A row without its line end is one that a kill cut short.
        rows = [row for row in path.read_text().splitlines(keepends=True) if row.endswith("\n")]
        write_whole(path, "".join(row for row in rows if float(row.split(",")[0]) <= steps))
