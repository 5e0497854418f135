"""Configuration of a training run: typed, every field overridable from the command line with Hydra's syntax."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from hydra import compose, initialize
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vpptwin.errors import InputError
from vpptwin.train.tasks import TASKS, Task

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


def option(default: Any, text: str) -> Any:  # noqa: ANN401
    """A field with a default and its line of help."""
    if isinstance(default, (str, int, float, bool, type(None))):
        return field(default=default, metadata={"help": text})
    return field(default_factory=lambda: copy.deepcopy(default), metadata={"help": text})


@dataclass
class TrainConfig:
    """Everything that decides how a run goes; saved beside it as config.yaml."""

    task: Task = field(default=MISSING, metadata={"help": f"what to fly: {', '.join(TASKS)}"})
    twin: str = option("nominal", "`nominal` or a twin YAML")
    out: str | None = option(None, "folder of the run (default runs/<task>-<date>-<time>)")
    resume: str | None = option(None, "folder of a run to continue; of the rest only total_steps, threads, progress")
    seed: int = option(0, "the same seed gives the same run")
    total_steps: int = option(1_500_000, "policy steps of 0.01 s to collect, over all simulations")
    num_envs: int = option(256, "simulations flown side by side")
    rollout: int = option(32, "policy steps of every simulation between two updates")
    noise: float = option(0.0, "sensor noise in the observation, 1 = that of vehicle.yaml")
    randomize: list[str] = option([], "effects drawn from their priors at every reset, e.g. '[airframe.mass,servo.lag]'")
    paper_inputs: bool = option(False, "observe the paper's nine inputs, without the target's angle")
    desynchronize: bool = option(True, "start the first episodes at random clock times")
    hidden: list[int] = option([96, 64], "actor: units of the ReLU layer and of the tanh layer")
    critic_hidden: list[int] = option([128, 128], "critic: units of its tanh layers")
    epochs: int = option(5, "passes over every batch")
    minibatch: int = option(1024, "samples per gradient step")
    gamma: float = option(0.99, "discount per policy step")
    lmbda: float = option(0.95, "lambda of the generalized advantage estimate")
    clip: float = option(0.2, "clip range of the policy ratio")
    critic_weight: float = option(1.0, "weight of the critic's loss")
    max_grad_norm: float = option(1.0, "gradients are clipped to this norm")
    learning_rate: Ramp = option(Ramp(3e-4, 9e-5), "learning rate over the course of training")
    exploration: Ramp = option(Ramp(0.55, 0.25), "standard deviation of the action before its squashing")
    checkpoint_every: int = option(100_000, "policy steps between checkpoints")
    threads: int = option(2, "cores for torch and the simulation")
    progress: bool = option(True, "show a progress bar")


RESUMABLE = ("resume", "total_steps", "threads", "progress")
"""What may be given besides `resume`; the rest comes from the run that is continued."""


def compose_config(overrides: Sequence[str]) -> TrainConfig:
    """Build the configuration from Hydra overrides such as `task=hover` and `learning_rate.end=1e-4`.

    Raises:
        InputError: on an unknown key or task, a value of the wrong type, or numbers that make no sense.
    """
    store = ConfigStore.instance()
    store.store(name="schema", node=TrainConfig)
    store.store(name="train", node={"defaults": ["schema", {"task": "hover"}, "_self_"]})
    for task in TASKS.values():
        store.store(group="task", name=task.name, node=task)
    check_keys(overrides)
    try:
        with initialize(version_base="1.3", config_path=None):
            return to_config(compose(config_name="train", overrides=list(overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        raise InputError(f"{' '.join(overrides)}: {reason}", "overrides such as task=hover num_envs=256", HELP) from error


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


def list_keys(node: object = TrainConfig, prefix: str = "") -> list[str]:
    """Dotted names of every option."""
    known = []
    template = TASKS["hover"] if node is TrainConfig else node
    for f in fields(node):  # type: ignore[arg-type]
        name = f"{prefix}{f.name}"
        known.append(name)
        value = template if name == "task" else getattr(node, f.name, None)
        if value is None and callable(f.default_factory):
            value = f.default_factory()
        if is_dataclass(value):
            known += list_keys(value, f"{name}.")
    return known


def override_keys(overrides: Sequence[str]) -> set[str]:
    """Names of the options that overrides set."""
    return {override.key_or_group for override in OverridesParser.create().parse_overrides(list(overrides))}


def check_keys(overrides: Sequence[str]) -> None:
    """Refuse overrides of options that do not exist, naming the closest that do."""
    known = list_keys()
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise InputError(f"{' '.join(overrides)}: not overrides", "key=value, separated by spaces", HELP) from error
    for override in parsed:
        key = override.key_or_group
        if key not in known or override.is_delete() or override.is_add():
            close = difflib.get_close_matches(key, known, n=3, cutoff=0.4) or known[:4]
            raise InputError(f"unknown option {override.input_line!r}", f"one such as {', '.join(close)}", HELP)
        if key == "task" and override.value() not in TASKS:
            raise InputError(f"unknown task {override.value()!r}", f"one of {', '.join(TASKS)}", HELP)


def check_values(config: TrainConfig) -> None:
    """Refuse numbers that make no sense."""
    positive = ("total_steps", "num_envs", "rollout", "epochs", "minibatch", "threads", "max_grad_norm", "checkpoint_every")
    for name in positive:
        if getattr(config, name) <= 0:
            raise InputError(f"{name}={getattr(config, name)}", "a number above 0", HELP)
    for name in ("gamma", "lmbda"):
        if not 0.0 <= getattr(config, name) <= 1.0:
            raise InputError(f"{name}={getattr(config, name)}", "a number between 0 and 1", HELP)
    if config.noise < 0.0:
        raise InputError(f"noise={config.noise}", "0 or more", HELP)
    if len(config.hidden) != 2 or not config.critic_hidden or min(config.hidden + config.critic_hidden) < 1:
        raise InputError(f"hidden={config.hidden} critic_hidden={config.critic_hidden}", "two and one or more sizes", HELP)
    if config.minibatch > config.num_envs * config.rollout:
        batch = config.num_envs * config.rollout
        raise InputError(f"minibatch={config.minibatch}", f"at most num_envs * rollout = {batch}", "lower it")
    if config.task.target.dwell is not None and len(config.task.target.angles) < 2:
        raise InputError("task.target.dwell with one angle", "two or more task.target.angles", "add one, or dwell=null")


def describe_options() -> str:
    """Every option with its default, for `vpptwin train --help`."""
    lines = ["Options (Hydra overrides, key=value):", ""]
    for f in fields(TrainConfig):
        default = f.default_factory() if callable(f.default_factory) else f.default
        if f.name == "task":
            shown = "hover"
        elif isinstance(default, Ramp):
            shown = f"{default.start:g} → {default.end:g}"
        else:
            shown = str(default).replace(" ", "").replace("'", "")
        lines.append(f"  {f.name + '=' + shown:<34} {f.metadata['help']}")
    lines += ["", "Numbers inside a task or a ramp, for example:", ""]
    lines += [f"  {key}" for key in ("task.episode=8", "'task.start.theta=[-3,3]'", "task.weights.integral=0.4")]
    lines += [f"  {key}" for key in ("learning_rate.end=5e-5", "exploration.finish=0.9")]
    return "\n".join(lines)
