"""Who flies the simulations of a run: this process, or workers that Ray starts, here or on a cluster."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import BaseCollector, Collector
from torchrl.collectors.distributed import RayCollector

from vpptwin.system.errors import InputError
from vpptwin.system.installed import locate_effects
from vpptwin.system.jobs import connect, explain_failures
from vpptwin.system.trust import trust, trusted
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.base_env import BaseEnv
from vpptwin.train.env.environments import open_env
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.train.learn.memory import check_share
from vpptwin.train.learn.progress import Simulations
from vpptwin.twin.spec import locate_twin

CONTINUE = "see that they have the memory and files they need; `vpptwin train resume=RUN` goes on from the checkpoint"
OPTIONS = {"auto_register_policy_transforms": False}
"""Of every collector: the policy holds no state that an environment would have to reset."""


@dataclass(frozen=True)
class WorkerEnv:
    """Makes one worker's environment, in that worker."""

    config: TrainConfig  # of the run
    worker: int  # number of the worker, 0 the first
    begun: int  # steps that the whole run had collected before
    fault_folder: Path  # of the run; each worker writes into a folder of its own in it, on its machine
    trusted: frozenset[Path]  # Python files that the user lets run

    @property
    def seed(self) -> int:
        """Of this worker, another one after every resume: no episode is flown twice."""
        return int(np.random.SeedSequence((self.config.seed, self.worker, self.begun)).generate_state(1)[0])

    def __call__(self) -> VppEnv:
        """The environment with this worker's share of the simulations."""
        config = self.config
        trust(self.trusted)
        torch.set_num_threads(config.torch_threads)
        torch.manual_seed(self.seed)
        check_share(config)
        share = replace(config, num_envs=config.num_envs // config.workers, seed=self.seed)
        folder = self.fault_folder / f"worker-{self.worker}"
        env = make_env(share, folder, config.schedule(config.workers))
        env.flown = self.begun // config.num_envs
        return env


class RayWorkers(RayCollector):
    """TorchRL's Ray collector, synchronous: every worker flies its simulations with the same weights.

    Batches are (num_envs, rollout), the first worker's simulations first.

    Args:
        config: of the run.
        actor: whose weights and exploration go out before every batch.
        makers: of the workers' environments.
        started: Ray was started for this run and stops with it.

    Attributes:
        faults: number of simulations that diverged since the workers started.
    """

    def __init__(
        self, config: TrainConfig, actor: TensorDictModuleBase, makers: list[WorkerEnv], started: bool
    ) -> None:
        self.faults, self.started = 0, started
        self.begun, self.schedule = makers[0].begun, config.schedule()
        super().__init__(
            makers, actor, frames_per_batch=config.num_envs * config.rollout, total_frames=sys.maxsize, sync=True,
            update_after_each_batch=True, weight_sync_schemes={}, postproc=lambda batches: batches.flatten(0, 1),
            collector_kwargs=[dict(OPTIONS) for _ in makers], remote_configs={"num_cpus": config.sim_threads},
        )  # fmt: skip
        self._weight_sync_initialized = True  # by update_policy_weights_, not by one of TorchRL's schemes

    @property
    def difficulty(self) -> float:
        """Level of the curriculum, 0 to 1."""
        return self.schedule.difficulty_at(self.begun + self.collected_frames)

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches without end.

        Raises:
            InputError: if a worker ends.
        """
        with explain_failures(CONTINUE):
            for batch in super().iterator():
                self.faults = sum(self.get_distant_attr("env.faults"))
                yield batch

    def update_policy_weights_(self, policy_or_weights: object = None, **kwargs: object) -> None:
        """Send weights and exploration to all workers, which they have when this returns.

        Only `iterator` asks for it, right before every batch. What the trainer's own hook sends (an argument) is left
        out: it comes before the hook that schedules the exploration.
        """
        import ray

        if policy_or_weights is None:
            weights = ray.put(TensorDict.from_module(self.policy).data)
            ray.get([worker.update_policy_weights_.remote(weights) for worker in self.remote_collectors])

    def state_dict(self) -> dict[str, Any]:
        """Nothing: the trainer has the weights, and workers start afresh when a run is continued."""
        return {}

    def load_state_dict(self, state_dict: object) -> None:
        """Nothing to restore."""

    def shutdown(self, timeout: float | None = None, shutdown_ray: bool = False) -> None:
        """End the workers, and Ray if it was started for them."""
        super().shutdown(timeout, shutdown_ray or self.started)


def start_workers(config: TrainConfig, actor: TensorDictModuleBase, fault_folder: Path, begun: int) -> RayWorkers:
    """Start the workers of a run in the Ray that RAY_ADDRESS names, or in one of its own on this machine.

    Raises:
        InputError: if Ray cannot be reached, has too few cores, or a worker cannot make its environment.
    """
    import ray

    # Workers run in folders of their own.
    config = replace(
        config, twin=locate_twin(config.twin), effects=[str(locate_effects(file).resolve()) for file in config.effects]
    )
    makers = [WorkerEnv(config, worker, begun, fault_folder.resolve(), trusted()) for worker in range(config.workers)]
    started = not ray.is_initialized()
    try:
        if started:
            connect(config.workers * config.sim_threads)
        check_cores(config)
        with explain_failures(CONTINUE):
            return RayWorkers(config, actor, makers, started)
    except BaseException:
        if started:
            ray.shutdown()
        raise


def check_cores(config: TrainConfig) -> None:
    """Refuse what would wait for cores for ever, and tell if others use them now.

    Raises:
        InputError: if Ray has fewer cores than the workers need.
    """
    import ray

    needed = config.workers * config.sim_threads
    total, free = (int(resources.get("CPU", 0)) for resources in (ray.cluster_resources(), ray.available_resources()))
    wanted = f"{needed} for workers={config.workers} with sim_threads={config.sim_threads}"
    if total < needed:
        advice = "lower one of them, or add machines with `ray start --address=HEAD:6379`"
        raise InputError(f"Ray has {total} cores", wanted, advice)
    if free < needed:
        print(f"Ray has {free} cores free of {total}; training starts when {wanted} are", file=sys.stderr)


@dataclass(frozen=True)
class Collection:
    """What a trainer collects from."""

    collector: BaseCollector  # gives batches (num_envs, rollout)
    simulations: Simulations  # what the hooks report of them
    env: BaseEnv | None  # the environment, if its simulations are in this process, where a checkpoint can take them in


def start_env(config: TrainConfig, fault_folder: Path, saved: dict[str, Any] | None, device: torch.device) -> BaseEnv:
    """The environment of this process: all simulations, as they were saved, or a single one to look at with Ray.

    Raises:
        InputError: as `make_env`, and if workers are wanted and Ray is not installed.
    """
    if config.collector == "ray":
        import ray  # noqa: F401  # refused here, before anything is made

        return make_env(replace(config, num_envs=1, sim_threads=1))
    env = open_env(config, device, fault_folder, config.schedule())
    if saved is not None:
        # Before the collector exists, which resets the environment as it is made.
        env.restore_snapshot(saved["training"]["env"])
    return env


def make_collector(
    config: TrainConfig, actor: TensorDictModuleBase, env: BaseEnv, fault_folder: Path, begun: int = 0
) -> Collection:
    """The collector of a run.

    The actor explores on the device where it is, with the weights and the exploration of the moment in every batch.

    Args:
        config: of the run.
        actor: explores.
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
