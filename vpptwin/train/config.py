"""Configuration of a training run: typed, checked, plain when saved."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from textwrap import shorten
from typing import Any

from pydantic import TypeAdapter, ValidationError

from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import SETUPS, ObservationTerms
from vpptwin.train.env.tasks import HOVER, Task, check_task

ESTIMATORS = ("sensors", "kalman")
"""What a policy can be shown: readings, or a filter's estimate from them."""
ENGINES = ("numba", "warp")
"""What can step the simulations of training."""
LOGGERS = ("csv", "tensorboard")
HELP = "`vpptwin train --help` lists every option"


@dataclass
class Ramp:
    """A value that is constant, then changes linearly, then is constant again, over the course of training."""

    start: float  # first value
    end: float  # last value
    begin: float = 0.1  # share of training at which the change starts
    finish: float = 0.7  # share of training at which it is over

    def at(self, progress: float) -> float:
        """Value at a share of training between 0 and 1."""
        span = max(self.finish - self.begin, 1e-9)
        part = min(max((progress - self.begin) / span, 0.0), 1.0)
        return self.start + part * (self.end - self.start)


@dataclass
class Curriculum:
    """What gets harder in the course of training (paper, Curriculum Learning).

    Attributes:
        enabled: whether anything does; else difficulty is 1 throughout.
        difficulty: multiplies sensor noise and the distance of randomized parameters from nominal.
        single_below: below this difficulty an episode is judged by its position or by its angle, not both.
        nominal: share of the episodes flown in the twin as it is, nothing drawn, whatever the difficulty: the nominal
            one lies in a corner of what is drawn, as no friction and no delay is below zero.
        again: share of the episodes, once they are judged by everything, that start as one did that failed soon after;
            null for the task's.
    """

    enabled: bool = True
    difficulty: Ramp = field(default_factory=lambda: Ramp(0.0, 1.0, begin=0.05, finish=0.3))
    single_below: float = 0.4
    nominal: float = 0.2
    again: float | None = None


@dataclass(frozen=True)
class Schedule:
    """A curriculum and the number of policy steps that it spans.

    Attributes:
        curriculum: the schedule.
        steps: policy steps of all training, over all simulations of one environment.
        repeats: share of episodes that start as one did that failed, where the curriculum does not say.
    """

    curriculum: Curriculum
    steps: int
    repeats: float = 0.0

    def difficulty_at(self, flown: int) -> float:
        """Difficulty after so many policy steps."""
        return self.curriculum.difficulty.at(flown / self.steps) if self.curriculum.enabled else 1.0

    def single(self, flown: int) -> bool:
        """Whether episodes are judged by one criterion each."""
        return self.curriculum.enabled and self.difficulty_at(flown) < self.curriculum.single_below

    def again(self, flown: int) -> float:
        """Share of new episodes that start where others failed."""
        if not self.curriculum.enabled or self.single(flown):
            return 0.0
        return self.repeats if self.curriculum.again is None else self.curriculum.again


@dataclass
class TrainConfig:
    """Everything that decides how a run goes. The lines below are also the help of `vpptwin train`.

    Attributes:
        task: what to fly.
        preset: values to start from, fast, paper (what it says, nothing of ours), finetune (from init_from on) or card.
        twin: `nominal`, `typical` or a twin YAML.
        controller: of the actuators, map or adaptive; null for the twin's own.
        effects: Python files with effects of your own, e.g. '[cogging.py]'; not needed for a twin YAML that names them.
        out: folder of the run; null for runs/<task>-<date>-<time>.
        init_from: policy to start from, a checkpoint, a run's folder or a shipped one; null for random weights.
        resume: folder of a run to continue; besides, only total_steps, workers, threads, device, engine, progress.
        seed: the same seed gives the same run.
        total_steps: policy steps (0.01 s each) to collect, over all simulations.
        num_envs: simulations flown side by side.
        rollout: policy steps of every simulation between two updates.
        noise: sensor noise in the observation; 1 for that of vehicle.yaml.
        randomize: effects drawn from their priors at every reset, e.g. '[servo.lag,air.drag]'; paper or all for groups.
        estimator: what the policy is shown, sensors for their readings, kalman for a filter's estimate from them.
        setup: the policy's inputs, VA, TA, PI or All: angle in radians or as sine and cosine, integral or none.
        paper_inputs: observe the paper's inputs, without the target's angle.
        curriculum: what gets harder in the course of training.
        desynchronize: start the first episodes at random clock times.
        magnify: magnify position errors and integrals where they are small, on their way into the networks.
        hidden: actor, units of the ReLU layer and of the tanh layer.
        lipschitz: bound of the actor's Lipschitz constant, inputs scaled; null for none.
        critic: mlp, or lstm over the last five steps and then the layers of critic_hidden.
        critic_hidden: critic, units of its layers.
        critic_lstm: critic, units of its LSTM.
        privileged: the critic sees true states, actuators and randomized parameters instead of the observation.
        epochs: passes over every batch.
        minibatch: samples per gradient step; the whole batch, num_envs x rollout, if that is less.
        gamma: discount per policy step; null for the task's.
        lmbda: lambda of the generalized advantage estimate.
        advantage_groups: advantages are normalized within so many groups of steps of like value; 1 for all as one.
        clip: clip range of the policy ratio.
        critic_weight: weight of the critic's loss.
        max_grad_norm: gradients are clipped to this norm.
        learning_rate: over the course of training.
        exploration: standard deviation of the action before its squashing, over the course of training.
        learn_exploration: learn that standard deviation, from where it starts, instead of following a schedule.
        average: share of the averaged weights, those that fly, that stays at every update; 0 for no averaging.
        checkpoint_every: policy steps between checkpoints.
        exam_every: policy steps between evaluations on a fixed set, whose best policy is kept; 0 for none.
        exam_from: share of training before the first of them.
        exam_tracks: flights of that set.
        loggers: csv and tensorboard, or one of them.
        collector: local, or ray for workers that Ray starts.
        workers: Ray workers, which share the simulations.
        sim_threads: cores for the simulation.
        torch_threads: cores for the networks; small ones are fastest on one.
        device: of the networks in training, cpu or cuda; with engine=warp of the simulations too.
        engine: what steps simulations in training, numba on the CPU or warp on the device; null for warp on a card.
        progress: show a progress bar.
    """

    task: Task = field(default_factory=lambda: copy.deepcopy(HOVER))
    preset: str = "fast"
    twin: str = "nominal"
    controller: str | None = None
    effects: list[str] = field(default_factory=list)
    out: str | None = None
    init_from: str | None = None
    resume: str | None = None
    seed: int = 0
    total_steps: int = 3_000_000
    num_envs: int = 512
    rollout: int = 32
    noise: float = 1.0
    randomize: list[str] = field(default_factory=lambda: ["paper"])
    estimator: str = "sensors"
    setup: str = "All"
    paper_inputs: bool = False
    curriculum: Curriculum = field(default_factory=Curriculum)
    desynchronize: bool = True
    magnify: bool = True
    hidden: list[int] = field(default_factory=lambda: [96, 64])
    lipschitz: float | None = 30.0
    critic: str = "mlp"
    critic_hidden: list[int] = field(default_factory=lambda: [128, 128])
    critic_lstm: int = 64
    privileged: bool = True
    epochs: int = 5
    minibatch: int = 1024
    gamma: float | None = None
    lmbda: float = 0.95
    advantage_groups: int = 10
    clip: float = 0.2
    critic_weight: float = 1.0
    max_grad_norm: float = 1.0
    learning_rate: Ramp = field(default_factory=lambda: Ramp(1e-3, 5e-5, finish=0.95))
    exploration: Ramp = field(default_factory=lambda: Ramp(0.55, 0.06, finish=0.9))
    learn_exploration: bool = False
    average: float = 0.97
    checkpoint_every: int = 100_000
    exam_every: int = 200_000
    exam_from: float = 0.6
    exam_tracks: int = 100
    loggers: list[str] = field(default_factory=lambda: ["csv", "tensorboard"])
    collector: str = "local"
    workers: int = 2
    sim_threads: int = 2
    torch_threads: int = 1
    device: str = "cpu"
    engine: str | None = None
    progress: bool = True

    @property
    def on_device(self) -> bool:
        """Whether the simulations of training are stepped by Warp, where the networks are."""
        return (self.engine or ("numba" if self.device == "cpu" else "warp")) == "warp"

    @property
    def observation(self) -> ObservationTerms:
        """What the policy is shown."""
        return ObservationTerms(self.setup, not self.paper_inputs)

    @property
    def critic_memory(self) -> int:
        """Steps that the critic is shown."""
        return LSTM_STEPS if self.critic == "lstm" else 1

    @property
    def discount(self) -> float:
        """Discount per policy step."""
        return self.task.gamma if self.gamma is None else self.gamma

    def schedule(self, workers: int = 1) -> Schedule:
        """The curriculum over the share of the run that one of so many workers flies."""
        return Schedule(self.curriculum, max(self.total_steps // workers, 1), self.task.again)


MAX_NUMBER = 1e12
"""Numbers beyond make no sense in any option."""
MAX_UNITS = 4096
"""Units of a layer at most: two of them are 64 MB of weights."""
LSTM_STEPS = 5
"""Steps that the LSTM of the critic sees (paper, Asymmetric Network Structure)."""
PRESETS: dict[str, dict[str, Any]] = {
    "fast": {},
    "paper": {
        "critic": "lstm", "critic_hidden": [512, 512], "critic_lstm": 64, "total_steps": 4_400_000, "minibatch": 512,
        "exam_from": 0.8,
        "learning_rate": {"start": 3e-4, "end": 9e-5, "begin": 0.1, "finish": 0.7}, "torch_threads": 2,
        "curriculum": {
            "difficulty": {"start": 0.0, "end": 1.0, "begin": 0.1, "finish": 0.5}, "nominal": 0.0, "again": 0.0,
        },
        "magnify": False, "advantage_groups": 1, "average": 0.0, "learn_exploration": True,
        "task": {"weights": {"near": 0.0}, "target": {"expected": True}, "training_episode": None},
    },
    "finetune": {
        "init_from": "flip", "total_steps": 1_000_000, "randomize": ["identified"],
        "curriculum": {"difficulty": {"start": 1.0}},
        "learning_rate": {"start": 5e-4, "end": 5e-5, "begin": 0.0, "finish": 0.95},
        "exploration": {"start": 0.2, "end": 0.06, "begin": 0.0, "finish": 0.9}, "exam_from": 0.3,
    },
    "card": {
        "device": "cuda", "num_envs": 8192, "rollout": 16, "minibatch": 8192, "total_steps": 20_000_000,
        "exam_every": 4_000_000,
    },
}  # fmt: skip
"""What each preset changes."""
RESUMABLE = ("resume", "total_steps", "workers", "sim_threads", "torch_threads", "device", "engine", "progress")
"""What may be given besides `resume`; the rest comes from the run that is continued."""


def to_config(data: Mapping[str, Any]) -> TrainConfig:
    """Typed and checked configuration from plain data, as saved in a checkpoint; what it lacks is as by default.

    Raises:
        InputError: if a key is unknown, a value has the wrong type or makes no sense.
    """
    expected = "a configuration of this version"
    try:
        config = make_adapter().validate_json(json.dumps(complete(data, to_plain(TrainConfig()))), strict=True)
    except ValidationError as error:
        (first, *_) = error.errors(include_url=False)
        found = f"{'.'.join(map(str, first['loc']))}={first['input']!r:.60}"
        if first["type"] in ("missing", "too_long"):  # of all that is there, only ranges have a length
            expected = "[low, high]"
        raise InputError(f"{found}: {first['msg'][0].lower()}{first['msg'][1:]}", expected, HELP) from error
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(next(iter(str(error).splitlines()), "nothing that makes sense"), expected, HELP) from error
    check_values(config)
    return config


@cache
def make_adapter() -> TypeAdapter[TrainConfig]:
    """What checks types."""
    return TypeAdapter(TrainConfig)


def complete(data: Mapping[str, Any], defaults: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Nested plain data, what it lacks from `defaults`.

    Raises:
        ValueError: naming a key that they do not have.
    """
    for key in data:
        if key not in defaults:
            raise ValueError(f"unknown option {place}{key!s:.60}")
    filled = dict(defaults)
    for key, value in data.items():
        nested = isinstance(value, Mapping) and isinstance(defaults[key], Mapping)
        filled[key] = complete(value, defaults[key], f"{place}{key}.") if nested else value
    return filled


def to_plain(config: TrainConfig) -> dict[str, Any]:
    """The configuration as dicts, lists, numbers and strings."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(config)))
    return plain


def list_numbers(data: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Every number in plain data by its dotted name."""
    if isinstance(data, (dict, list, tuple)):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from list_numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(data, (int, float)):
        yield name, data


def check_values(config: TrainConfig) -> None:
    """Refuse numbers that make no sense.

    Raises:
        InputError: naming the first.
    """

    def check(names: Sequence[str], holds: Callable[[Any], bool], expected: str) -> None:
        for name in names:
            value = getattr(config, name)
            if not holds(value):
                raise InputError(f"{name}={value}", expected, HELP)

    positive = ("total_steps", "num_envs", "rollout", "epochs", "minibatch", "max_grad_norm", "checkpoint_every")
    counts = ("exam_tracks", "advantage_groups", "critic_lstm", "workers")
    check((*positive, *counts), lambda value: not value <= 0, "a number above 0")
    check(("sim_threads", "torch_threads"), lambda value: 1 <= value <= 1024, "1 to 1024")
    for name, share in (("gamma", config.discount), ("lmbda", config.lmbda)):
        if not 0.0 <= share <= 1.0:
            raise InputError(f"{name}={share}", "a number between 0 and 1", HELP)
    for name in ("learning_rate", "exploration"):
        ramp = getattr(config, name)
        if not (ramp.start > 0.0 and ramp.end > 0.0):
            raise InputError(f"{name} from {ramp.start} to {ramp.end}", "numbers above 0", HELP)
    check(("average",), lambda value: 0.0 <= value < 1.0, "from 0 to below 1")
    for name in ("nominal", "again"):
        share = getattr(config.curriculum, name)
        if share is not None and not 0.0 <= share <= 1.0:
            raise InputError(f"curriculum.{name}={share}", "a share from 0 to 1", HELP)
    check(("lipschitz",), lambda value: value is None or value > 0.0, "a number above 0, or null")
    choices = {
        "estimator": ESTIMATORS, "setup": SETUPS, "critic": ("mlp", "lstm"), "collector": ("local", "ray"),
        "preset": tuple(PRESETS),
    }  # fmt: skip
    for name, known in choices.items():
        check((name,), known.__contains__, f"one of {', '.join(known)}")
    check(("loggers",), set(LOGGERS).issuperset, "csv, tensorboard or both")
    check(("noise", "seed", "exam_every"), lambda value: value >= 0, "0 or more")
    sizes = [*config.hidden, *config.critic_hidden, config.critic_lstm]
    if (
        len(config.hidden) != 2
        or not 1 <= len(config.critic_hidden) <= 8
        or not 1 <= min(sizes) <= max(sizes) <= MAX_UNITS
    ):
        found = f"hidden={config.hidden} critic_hidden={config.critic_hidden} critic_lstm={config.critic_lstm}"
        raise InputError(shorten(found, 100), f"two, one to eight and one layer sizes up to {MAX_UNITS}", HELP)
    check(("device",), lambda value: bool(re.fullmatch(r"cpu|cuda(:\d+)?", value)), "cpu, cuda or cuda:N")
    if config.collector == "ray" and config.device != "cpu":
        raise InputError(f"device={config.device} with collector=ray", "device=cpu", "leave one of them out")
    check(("engine",), lambda value: value in (None, *ENGINES), f"{' or '.join(ENGINES)}, or null")
    if config.on_device:
        for name, only in (("estimator", "sensors"), ("collector", "local")):
            if getattr(config, name) != only:
                found = f"{name}={getattr(config, name)} with simulations on {config.device} by Warp"
                raise InputError(found, f"{name}={only}", "add engine=numba, which simulates on the processor")
    if config.collector == "ray" and config.num_envs % config.workers:
        found = f"num_envs={config.num_envs} for workers={config.workers}"
        raise InputError(found, "as many simulations for each worker", f"make num_envs a multiple of {config.workers}")
    check_task(config.task)
    for name, value in list_numbers(to_plain(config)):
        if not abs(value) <= MAX_NUMBER:
            raise InputError(f"{name}={value}", f"a number within ±{MAX_NUMBER:g}", HELP)
