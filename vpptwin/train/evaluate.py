"""`vpptwin evaluate`: fly a policy from many random initial states at once and measure."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from vpptwin.errors import InputError
from vpptwin.train.checkpoint import build_policy, find_commit, find_versions, read_checkpoint
from vpptwin.train.config import TrainConfig
from vpptwin.train.env import VppEnv, make_env
from vpptwin.train.networks import Policy
from vpptwin.train.tasks import TASKS


def load_policy(checkpoint: Path | str) -> Policy:
    """The policy of a checkpoint: a torch module from observations (N, 11 or 9) to actions (N, 2) in [-1, 1].

    Raises:
        InputError: if the file is no checkpoint of this version.
    """
    return build_policy(read_checkpoint(checkpoint), checkpoint)[0]


@torch.no_grad()
def fly_tracks(env: VppEnv, policy: Policy) -> dict[str, np.ndarray]:
    """Fly one episode in every simulation with the policy's most likely actions.

    Returns:
        Per track: `position_error` [m] and `angle_error` [rad], means over the last window of the task, and `failed`.
    """
    task, n = env.task, env.twin.num_sims
    period = 1.0 / env.twin.vehicle.control.policy_rate
    steps, window = round(task.episode / period), round(task.success.window / period)
    failed = np.zeros(n, dtype=bool)
    distance, angle = np.zeros((steps, n)), np.zeros((steps, n))
    now = env.reset()
    for k in range(steps):
        now = env.step(TensorDict({"action": policy(now["observation"])}, batch_size=[n]))["next"]
        failed |= now["terminated"].numpy()[:, 0]
        delta = env.episodes.target - env.state.qpos
        distance[k] = np.linalg.norm(delta[:, :2], axis=1)
        angle[k] = np.abs((delta[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return {
        "position_error": distance[-window:].mean(axis=0), "angle_error": angle[-window:].mean(axis=0), "failed": failed
    }  # fmt: skip


def evaluate(
    checkpoint: Path | str,
    task: str | None = None,
    tracks: int = 100,
    seed: int = 1_000_000,
    twin: str | None = None,
    noise: float = 0.0,
    effects: Sequence[str] = (),
) -> dict[str, Any]:
    """Measure a policy on random initial states.

    Args:
        checkpoint: file, or folder of a run.
        task: by default, and if it is the same, the task of training with its overrides.
        tracks: number of flights, one episode each.
        seed: of the initial states.
        twin: `nominal` or a twin YAML; by default that of training.
        noise: sensor noise, 1 = that of vehicle.yaml.
        effects: Python files with effects of the user's own; those of training come with the twin of training.

    Returns:
        Plain data: position errors [m] of the flights that did not fail, fail rate, success share and provenance.

    Raises:
        InputError: if the checkpoint, the task or the twin is not what it should be.
    """
    if tracks < 1:
        raise InputError(f"tracks={tracks}", "at least 1", "ask for more, e.g. --tracks 100")
    content = read_checkpoint(checkpoint)
    policy, trained = build_policy(content, checkpoint)
    config = configure_flights(trained, task, tracks, seed, twin, noise)
    env = make_env(replace(config, effects=[*(config.effects if twin is None else ()), *effects]))
    measured = fly_tracks(env, policy)
    flown = measured["position_error"][~measured["failed"]]
    limits = env.task.success
    success = ~measured["failed"] & (measured["position_error"] <= limits.position)
    success &= measured["angle_error"] <= limits.angle
    return {
        "task": env.task.name, "twin": twin or trained.twin, "tracks": tracks, "seed": seed, "noise": noise,
        "window_s": limits.window, "success_distance_m": limits.position, "success_angle_rad": limits.angle,
        "fail_rate": float(measured["failed"].mean()), "success_share": float(success.mean()),
        "position_error_m": summarize(flown),
        "checkpoint": {"path": str(checkpoint), "steps": content["steps"], "commit": content["commit"]},
        "commit": find_commit(), "versions": find_versions(), "evaluated": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }  # fmt: skip


def configure_flights(
    trained: TrainConfig, task: str | None, tracks: int, seed: int, twin: str | None, noise: float
) -> TrainConfig:
    """The configuration of training with everything that evaluation decides for itself."""
    if task is not None and task not in TASKS:
        raise InputError(f"unknown task {task!r}", f"one of {', '.join(TASKS)}", "check the name")
    chosen = trained.task if task in (None, trained.task.name) else TASKS[str(task)]
    return replace(
        trained, task=chosen, num_envs=tracks, seed=seed, twin=twin or trained.twin, noise=noise,
        randomize=[], desynchronize=False,
    )  # fmt: skip


def summarize(errors: np.ndarray) -> dict[str, float | None]:
    """Median, mean and worst; None when no flight is left to measure."""
    if not len(errors):
        return {"median": None, "mean": None, "worst": None}
    return {"median": float(np.median(errors)), "mean": float(errors.mean()), "worst": float(errors.max())}


def run_evaluate(
    checkpoint: Path | str, task: str | None, tracks: int, seed: int, twin: str | None, json_path: Path | str | None,
    effects: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """`evaluate`, and write the result as JSON unless `json_path` is None.

    Raises:
        InputError: as `evaluate`, and if the file cannot be written.
    """
    result = evaluate(checkpoint, task, tracks, seed, twin, effects=effects)
    if json_path is not None:
        path = Path(json_path)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            temporary.write_text(json.dumps(result, indent=2) + "\n")
            os.replace(temporary, path)
        except OSError as error:
            raise InputError(f"cannot write {path} ({error.strerror})", "a writable path", "choose another") from error
    return result
