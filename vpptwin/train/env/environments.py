"""Environments by what steps them and where, and by a task's name."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path

import torch

from vpptwin.system.errors import InputError
from vpptwin.train.config import Schedule, TrainConfig, check_values
from vpptwin.train.env.base_env import BaseEnv
from vpptwin.train.env.device_env import make_device_env
from vpptwin.train.env.tasks import TASKS, check_task_name
from vpptwin.train.env.vpp_env import make_env
from vpptwin.twin.spec import TwinSpec


def find_device(name: str) -> torch.device:
    """Where networks are trained, of `cpu`, `cuda` or `cuda:1`.

    Raises:
        InputError: if torch finds no such device.
    """
    device, count = torch.device(name), torch.cuda.device_count()
    if device.type == "cpu":
        return device
    device = torch.device("cuda", device.index or 0)
    if device.index >= count:
        found = f"device={name}, and torch {torch.__version__} finds {count} CUDA devices"
        raise InputError(found, "one that it finds", "say device=cpu, or install a torch for your GPU's driver")
    return device


def open_env(
    config: TrainConfig,
    device: torch.device,
    fault_folder: Path | None = None,
    schedule: Schedule | None = None,
    spec: TwinSpec | None = None,
) -> BaseEnv:
    """The environment of a run, as `make_env`: on the device, by Warp, or on the processor's cores, by numba."""
    if config.on_device:
        return make_device_env(config, device, schedule, spec)
    return make_env(config, fault_folder, schedule, spec)


def make_task_env(
    task: str = "flip", twin: str | Path | TwinSpec = "nominal", num_envs: int = 1, seed: int = 0, noise: float = 1.0,
    randomize: Sequence[str] = (), device: str = "cpu", engine: str | None = None,
) -> BaseEnv:  # fmt: skip
    """The TorchRL environment of a task, at full difficulty; `make_env` takes all that a run can be told.

    Args:
        task: one of `vpptwin.train.env.tasks.TASKS`.
        twin: `nominal`, `typical`, a twin YAML, or what `load_twin` or a diagnosis' `result.twin` gives.
        num_envs: simulations flown side by side.
        seed: of everything random.
        noise: of the sensors; 1 for that of vehicle.yaml, 0 for none.
        randomize: effects drawn from their priors at every reset; `paper` and `all` stand for groups.
        device: of what it takes and gives, `cpu` or `cuda`.
        engine: `numba`, or `warp` for simulations on the device; None for `warp` on a card.

    Raises:
        InputError: if there is no such task, twin or effect, or the device is missing.
    """
    check_task_name(task)
    spec = twin if isinstance(twin, TwinSpec) else None
    name = str(twin) if spec is None else spec.name
    config = TrainConfig(
        copy.deepcopy(TASKS[task]), twin=name, num_envs=num_envs, seed=seed, noise=noise, randomize=list(randomize),
        desynchronize=False, device=device, engine=engine,
    )  # fmt: skip
    check_values(config)
    return open_env(config, find_device(device), spec=spec)
