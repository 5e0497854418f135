"""`vpptwin train`: from overrides to a run's folder."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from vpptwin.errors import InputError
from vpptwin.train.checkpoint import FILE_NAME, read_checkpoint
from vpptwin.train.config import RESUMABLE, TrainConfig, to_config, to_plain
from vpptwin.train.overrides import compose_config, describe_options, parse_overrides
from vpptwin.train.ppo import build_training


def run_train(overrides: Sequence[str]) -> Path:
    """Train a policy.

    Args:
        overrides: in Hydra's syntax, e.g. `["task=hover", "num_envs=256"]`; `--help` prints the options.

    Returns:
        The run's folder, which holds checkpoint.pt, config.yaml and log/scalars/*.csv.

    Raises:
        InputError: on overrides that make no sense, a run that cannot be resumed, or an unwritable folder.
    """
    if "--help" in overrides or "-h" in overrides:
        print(describe_options())
        raise SystemExit(0)
    config = compose_config(overrides)
    saved = None
    if config.resume is not None:
        config, saved = read_run(config, overrides)
    folder = open_folder(config)
    trim_logs(folder, saved["steps"] if saved else 0)
    training = build_training(config, folder, saved)
    OmegaConf.save(OmegaConf.create(to_plain(config)), folder / "config.yaml")
    started, begun = time.monotonic(), training.trainer.collected_frames
    training.trainer.train()
    seconds = time.monotonic() - started
    steps = training.trainer.collected_frames - begun
    print(f"{steps} steps in {seconds:.0f} s, checkpoint {folder / FILE_NAME}", file=sys.stderr)
    return folder


def read_run(config: TrainConfig, overrides: Sequence[str]) -> tuple[TrainConfig, dict[str, Any]]:
    """Configuration and last checkpoint of the run that `config.resume` names.

    Raises:
        InputError: if there is nothing to resume, or an override would make it another run.
    """
    given = set(parse_overrides(overrides))
    if not given <= set(RESUMABLE):
        found = f"resume together with {', '.join(sorted(given - set(RESUMABLE)))}"
        raise InputError(found, f"only {', '.join(RESUMABLE)}", "drop it, or start another run")
    content = read_checkpoint(str(config.resume))
    if content["training"] is None:
        raise InputError(f"{config.resume} holds a policy only", "a run's folder", "start another run")
    changes = {key: getattr(config, key) for key in given}
    resumed = replace(to_config(content["config"]), out=config.resume, **changes)
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        found = f"cannot write to {folder} ({error.strerror})"
        raise InputError(found, "a writable folder", "choose another out") from error
    return folder


def trim_logs(folder: Path, steps: int) -> None:
    """Drop what was logged after `steps`: those steps are about to be collected again."""
    for path in (folder / "log" / "scalars").glob("*.csv"):
        rows = [row for row in path.read_text().splitlines() if float(row.split(",")[0]) <= steps]
        path.write_text("".join(f"{row}\n" for row in rows))
