"""Configuration of a training run: typed, checked, plain when saved."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vpptwin.errors import InputError
from vpptwin.train.tasks import Task, check_task

HELP = "`vpptwin train --help` lists every option"


@dataclass
class Ramp:
    """A value that is constant, then changes linearly, then is constant again, over the course of training.

    Attributes:
        start: first value.
        end: last value.
        begin: share of training at which the change starts.
        finish: share of training at which it is over.
    """

    start: float
    end: float
    begin: float = 0.1
    finish: float = 0.7

    def at(self, progress: float) -> float:
        """Value at a share of training between 0 and 1."""
        span = max(self.finish - self.begin, 1e-9)
        part = min(max((progress - self.begin) / span, 0.0), 1.0)
        return self.start + part * (self.end - self.start)


@dataclass
class TrainConfig:
    """Everything that decides how a run goes. The lines below are also the help of `vpptwin train`.

    Attributes:
        task: what to fly.
        twin: `nominal` or a twin YAML.
        effects: Python files with effects of your own, e.g. '[cogging.py]'; not needed for a twin YAML that names them.
        out: folder of the run; null for runs/<task>-<date>-<time>.
        resume: folder of a run to continue; besides it only total_steps, the threads and progress can be given.
        seed: the same seed gives the same run.
        total_steps: policy steps (0.01 s each) to collect, over all simulations.
        num_envs: simulations flown side by side.
        rollout: policy steps of every simulation between two updates.
        noise: sensor noise in the observation; 1 for that of vehicle.yaml.
        randomize: effects drawn from their priors at every reset, e.g. '[servo.lag,air.drag]'; all for every one.
        paper_inputs: observe the paper's nine inputs, without the target's angle.
        desynchronize: start the first episodes at random clock times.
        hidden: actor, units of the ReLU layer and of the tanh layer.
        critic_hidden: critic, units of its tanh layers.
        epochs: passes over every batch.
        minibatch: samples per gradient step.
        gamma: discount per policy step.
        lmbda: lambda of the generalized advantage estimate.
        clip: clip range of the policy ratio.
        critic_weight: weight of the critic's loss.
        max_grad_norm: gradients are clipped to this norm.
        learning_rate: over the course of training.
        exploration: standard deviation of the action before its squashing, over the course of training.
        checkpoint_every: policy steps between checkpoints.
        sim_threads: cores for the simulation.
        torch_threads: cores for the networks; small ones are fastest on one.
        progress: show a progress bar.
    """

    task: Task = MISSING
    twin: str = "nominal"
    effects: list[str] = field(default_factory=list)
    out: str | None = None
    resume: str | None = None
    seed: int = 0
    total_steps: int = 800_000
    num_envs: int = 256
    rollout: int = 32
    noise: float = 0.0
    randomize: list[str] = field(default_factory=list)
    paper_inputs: bool = False
    desynchronize: bool = True
    hidden: list[int] = field(default_factory=lambda: [96, 64])
    critic_hidden: list[int] = field(default_factory=lambda: [128, 128])
    epochs: int = 5
    minibatch: int = 1024
    gamma: float = 0.99
    lmbda: float = 0.95
    clip: float = 0.2
    critic_weight: float = 1.0
    max_grad_norm: float = 1.0
    learning_rate: Ramp = field(default_factory=lambda: Ramp(1e-3, 9e-5))
    exploration: Ramp = field(default_factory=lambda: Ramp(0.55, 0.1, finish=0.9))
    checkpoint_every: int = 100_000
    sim_threads: int = 2
    torch_threads: int = 1
    progress: bool = True


RESUMABLE = ("resume", "total_steps", "sim_threads", "torch_threads", "progress")
"""What may be given besides `resume`; the rest comes from the run that is continued."""


def to_config(data: DictConfig | dict[str, Any]) -> TrainConfig:
    """Typed and checked configuration from plain data, as saved in a checkpoint.

    Raises:
        InputError: if a key is unknown, a value has the wrong type or makes no sense.
    """
    try:
        config = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(TrainConfig), data))
    except OmegaConfBaseException as error:
        raise InputError(str(error).splitlines()[0], "a configuration of this version", HELP) from error
    assert isinstance(config, TrainConfig)
    check_values(config)
    return config


def to_plain(config: TrainConfig) -> dict[str, Any]:
    """The configuration as dicts, lists, numbers and strings."""
    plain = OmegaConf.to_container(OmegaConf.structured(config))
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def check_values(config: TrainConfig) -> None:
    """Refuse numbers that make no sense.

    Raises:
        InputError: naming the first.
    """
    for name in ("total_steps", "num_envs", "rollout", "epochs", "minibatch", "max_grad_norm", "checkpoint_every"):
        if getattr(config, name) <= 0:
            raise InputError(f"{name}={getattr(config, name)}", "a number above 0", HELP)
    for name in ("sim_threads", "torch_threads"):
        if not 1 <= getattr(config, name) <= 1024:
            raise InputError(f"{name}={getattr(config, name)}", "1 to 1024", HELP)
    for name in ("gamma", "lmbda"):
        if not 0.0 <= getattr(config, name) <= 1.0:
            raise InputError(f"{name}={getattr(config, name)}", "a number between 0 and 1", HELP)
    for name in ("learning_rate", "exploration"):
        ramp = getattr(config, name)
        if not (ramp.start > 0.0 and ramp.end > 0.0):
            raise InputError(f"{name} from {ramp.start} to {ramp.end}", "numbers above 0", HELP)
    for name in ("noise", "seed"):
        if not getattr(config, name) >= 0:
            raise InputError(f"{name}={getattr(config, name)}", "0 or more", HELP)
    if len(config.hidden) != 2 or not config.critic_hidden or min(config.hidden + config.critic_hidden) < 1:
        found = f"hidden={config.hidden} critic_hidden={config.critic_hidden}"
        raise InputError(found, "two and one or more layer sizes", HELP)
    if config.minibatch > config.num_envs * config.rollout:
        batch = config.num_envs * config.rollout
        raise InputError(f"minibatch={config.minibatch}", f"at most num_envs * rollout = {batch}", "lower it")
    check_task(config.task)
