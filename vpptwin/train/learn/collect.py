"""Who flies the simulations of a run: this process, or workers that Ray starts, here or on other machines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import BaseCollector, Collector

from vpptwin.train.config import TrainConfig
from vpptwin.train.env.base_env import BaseEnv
from vpptwin.train.env.environments import open_env
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.learn.progress import Simulations
from vpptwin.train.learn.workers import OPTIONS, start_workers


@dataclass(frozen=True)
class Collection:
    """What a trainer collects from."""

    collector: BaseCollector  # gives batches (num_envs, rollout)
    simulations: Simulations  # what the hooks report of them
    env: BaseEnv | None  # the environment, if its simulations are in this process, where a checkpoint can take them in


def start_env(config: TrainConfig, fault_folder: Path, saved: dict[str, Any] | None, device: torch.device) -> BaseEnv:
    """The environment of this process: all simulations, as they were saved, or a single one to look at with Ray.

    Args:
        config: of the run.
        fault_folder: where simulations that diverged are written.
        saved: content of the checkpoint to continue from.
        device: of the networks.

    Raises:
        InputError: as `make_env`, and if workers are wanted and Ray is not installed.
    """
    if config.collector == "ray":
        import ray  # noqa: F401  # refused here, before anything is made

        return make_env(replace(config, num_envs=1, sim_threads=1))
    env = open_env(config, device, fault_folder, config.lesson())
    if saved is not None:
        # Before the collector exists, which resets the environment as it is made.
        env.restore_snapshot(saved["training"]["env"])
    return env


def make_collector(
    config: TrainConfig, actor: TensorDictModuleBase, env: BaseEnv, fault_folder: Path, begun: int = 0
) -> Collection:
    """The collector of a run.

    Args:
        config: of the run.
        actor: explores, on the device where it is; its weights and its exploration are those of the moment in every
            batch.
        env: from `start_env`.
        fault_folder: where simulations that diverged are written.
        begun: steps that were collected before, by the run that is continued.

    Raises:
        InputError: if Ray cannot be reached, has too few cores, or a worker cannot make its environment.
    """
    if config.collector == "ray":
        workers = start_workers(config, actor, fault_folder, begun)
        return Collection(workers, workers, None)
    batch, device = config.num_envs * config.rollout, next(actor.parameters()).device
    apart = {"env_device": "cpu", "policy_device": device, "storing_device": device}
    places: dict[str, Any] = {} if env.device == device else apart
    if config.on_device:
        places["track_traj_ids"] = False  # which would ask the device at every step whether an episode has ended
    return Collection(Collector(env, actor, frames_per_batch=batch, total_frames=-1, **places, **OPTIONS), env, env)
