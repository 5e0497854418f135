"""Tasks as data: where an episode starts, what it asks for, what it pays, when it ends and what counts as success.

A task is a value, not a class: every number of it can be overridden on the command line (`task.episode=8`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from vpptwin.engine.arrays import Array, beside, library
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError, suggest
from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.env.reward import RewardWeights

Range = tuple[float, float]
"""Low and high end of a uniform distribution."""


@dataclass
class Start:
    """Uniform distributions of the state at the start of an episode.

    Attributes:
        x: m.
        z: m.
        theta: angle away from the first target's, rad.
        velocity_x: m/s.
        velocity_z: m/s.
        rate: rad/s.
    """

    x: Range = (-0.8, 0.8)
    z: Range = (0.7, 1.9)
    theta: Range = (-0.8, 0.8)
    velocity_x: Range = (-0.5, 0.5)
    velocity_z: Range = (-0.5, 0.5)
    rate: Range = (-2.0, 2.0)

    def draw(self, rng: np.random.Generator, target: Array) -> tuple[Array, Array]:
        """Poses and velocities for targets (n, 3): (n, 3) [m, m, rad] and (n, 3) [m/s, m/s, rad/s]."""
        low, high = np.array([self.x, self.z, self.theta]).T
        pose = rng.uniform(low, high, (len(target), 3))
        pose[:, 2] += target[:, 2]
        low, high = np.array([self.velocity_x, self.velocity_z, self.rate]).T
        return pose, rng.uniform(low, high, (len(target), 3))


@dataclass
class Target:
    """What an episode asks for.

    Attributes:
        x: uniform distribution of the position, m; drawn once per episode.
        z: likewise.
        angles: angles to choose from, each as likely as the other, rad.
        in_order: take the angles from first to last, once, instead of at random.
        dwell: uniform distribution of the time until the next trigger, s; null for no trigger.
        hold: in order, the same for the angles between first and last, s; null for as long as `dwell`.
        turns: share of triggers that ask for a full turn instead of another angle.
        turn_rate: of the target's angle during a full turn, in either direction, rad/s.
        quiet: no trigger in so much of the end of an episode, s; in training there may be.
        expected: triggers count in what a state is worth. Else a flight is valued as if its target stayed: a policy
            that reckons with a flip at any time hovers off its target, where the flip will carry it back (by 15 mm when
            every episode had triggers: the paper's reward is flat there).
    """

    x: Range = (-0.4, 0.4)
    z: Range = (1.0, 1.5)
    angles: list[float] = field(default_factory=lambda: [0.0])
    in_order: bool = False
    dwell: Range | None = None
    hold: Range | None = None
    turns: float = 0.0
    turn_rate: float = 12.0
    quiet: float = 2.0
    expected: bool = False

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Targets x, z, θ, (count, 3) m, m, rad."""
        low, high = np.array([self.x, self.z]).T
        place = rng.uniform(low, high, (count, 2))
        angle = 0.0 * place[:, 0] + self.angles[0] if self.in_order else rng.choice(self.angles, count)
        return library(place).column_stack([place, angle])

    def span_dwell(self, stage: Array) -> Array:
        """Shortest and longest time until the next trigger after so many (n,), (2, n) s; infinite without one."""
        xp = library(stage)
        whole = xp.stack([stage, stage]) * 0.0
        if self.dwell is None:
            return whole + math.inf
        first, later = (beside(whole, span)[:, None] for span in (self.dwell, self.hold or self.dwell))
        span = xp.where(stage > 0, later, first) if self.in_order else first + whole
        return xp.where(stage < len(self.angles) - 1, span, math.inf) if self.in_order else span

    def draw_dwell(self, rng: np.random.Generator, stage: Array) -> Array:
        """Times until the next trigger after so many (n,), (n,) s; infinite when there is none."""
        span = self.span_dwell(stage)
        xp = library(span)
        return xp.where(xp.isinf(span[0]), math.inf, rng.uniform(*xp.nan_to_num(span, posinf=0.0)))

    def draw_other_angle(self, rng: np.random.Generator, angle: Array, stage: Array) -> Array:
        """The angles that follow on `angle` at trigger number `stage`, each (n,): the next in order, or any other."""
        choices = beside(angle, self.angles)
        if self.in_order:
            return choices[stage.clip(0, len(choices) - 1)]
        now = abs(wrap_angle(choices[None, :] - angle[:, None])).argmin(1)
        return choices[(now + rng.integers(1, len(choices), len(angle))) % len(choices)]

    def draw_turn(self, rng: np.random.Generator, count: int) -> Array:
        """Angles that triggers ask to turn through before anything else: 2π, -2π or 0, (count,) rad."""
        turning = rng.uniform(size=count) < self.turns
        return library(turning).where(turning, rng.choice([-2.0 * np.pi, 2.0 * np.pi], count), 0.0)


@dataclass
class Limits:
    """States that end an episode as a failure.

    Attributes:
        speed: m/s.
        rate: rad/s.
        floor: height of the lower arm tip, m; high enough that a bounce between two steps is not missed.
        ends: reaching the ends of the horizontal rail is a failure; reaching those of the vertical guide always is.
    """

    speed: float = 8.0
    rate: float = 40.0
    floor: float = 0.05
    ends: bool = True

    def exceeded(self, vehicle: Vehicle, pose: Array, velocity: Array) -> Array:
        """Which rows of pose and velocity, both (N, 3), have failed, (N,) bool."""
        xp, spans = library(pose), (vehicle.rig.travel_x, vehicle.rig.travel_z)
        over_x, over_z = ((pose[:, i] <= low) | (pose[:, i] >= high) for i, (low, high) in enumerate(spans))
        at_stop = over_x | over_z if self.ends else over_z
        tip = pose[:, 1] - vehicle.airframe.half_length * abs(xp.sin(pose[:, 2]))
        too_fast = (xp.hypot(velocity[:, 0], velocity[:, 1]) > self.speed) | (abs(velocity[:, 2]) > self.rate)
        return at_stop | (tip < self.floor) | too_fast


@dataclass
class Success:
    """When an episode that did not fail counts as a success.

    Attributes:
        position: largest mean distance over the last `window`, m.
        angle: largest mean angle error over the last `window`, rad.
        window: s.
        reach: every angle that was asked for has to be met within this at some time while it was, rad; null for no such
            condition. A flight of training that has not when a trigger may come at the earliest ends there: by the
            paper's reward alone a craft that can't stay at an angle had better not go there, and one that can had
            better climb first, too late for the sixth of all flights that ask for it back within 0.45 s.
    """

    position: float = 0.05
    angle: float = 0.2
    window: float = 1.0
    reach: float | None = None


@dataclass
class Task:
    """A task.

    Attributes:
        name: as on the command line.
        episode: length, s.
        training_episode: length in training, s: many starts teach more than long holds; null for the same.
        gamma: discount per policy step in training: how far ahead what is asked for has to be prepared.
        again: share of the episodes of training that start as one did that failed within a second: where starts are
            wild, few of them decide.
        thrust_to_weight: largest commanded thrust over the weight of craft and slider; null for the vehicle's own. The
            rotors are made stronger by as much.
        commanded: largest commanded thrust over that weight where the rotors are others than in training; null for
            what they give.
        start: initial states.
        target: what to reach.
        weights: reward.
        limits: failures.
        success: measure.
    """

    name: str
    episode: float = 5.0
    training_episode: float | None = None
    gamma: float = 0.98
    again: float = 0.0
    thrust_to_weight: float | None = None
    commanded: float | None = None
    start: Start = field(default_factory=Start)
    target: Target = field(default_factory=Target)
    weights: RewardWeights = field(default_factory=RewardWeights)
    limits: Limits = field(default_factory=Limits)
    success: Success = field(default_factory=Success)


WIDE = Start(
    z=(0.9, 1.9), theta=(-math.pi, math.pi), velocity_x=(-1.0, 1.0), velocity_z=(-1.0, 1.0), rate=(-4.0, 4.0)
)  # fmt: skip
"""Any attitude, moving and turning: what a craft can just recover from above the floor."""

HOVER = Task("hover")
FLIP = Task(
    "flip", episode=6.0, training_episode=2.5, again=0.2, start=WIDE,
    target=Target(angles=[0.0, math.pi], dwell=(0.8, 3.0), turns=0.2),
)  # fmt: skip
WALL_BACKTRACK = Task(
    "wall-backtrack", episode=6.0, training_episode=3.5, gamma=0.99, thrust_to_weight=2.5,
    start=Start(x=(0.95, 1.3), z=(1.0, 1.5), theta=(-0.5, 0.5)),
    target=Target(
        x=(1.15, 1.25), z=(1.2, 1.3), angles=[0.0, 0.5 * math.pi, 0.0], in_order=True, expected=True,
        dwell=(1.0, 2.0), hold=(0.4, 0.7),
    ),
    weights=RewardWeights(position=0.5, orientation=1.0, velocity=0.1, rate=0.1, integral=0.1, near=0.0),
    limits=Limits(ends=False), success=Success(reach=math.radians(15.0)),
)  # fmt: skip
MAX_EPISODE = 600.0
"""Longest episode [s]."""
MAX_ANGLES = 100
TASKS: dict[str, Task] = {task.name: task for task in (HOVER, FLIP, WALL_BACKTRACK)}
"""Every task by name."""


def check_task(task: Task) -> None:
    """Refuse numbers that make no sense.

    Raises:
        InputError: naming the first.
    """
    target = task.target
    if len(target.angles) > MAX_ANGLES:
        raise InputError(f"{len(target.angles)} task.target.angles", f"at most {MAX_ANGLES}", "drop some")
    for part, ranges in (("start", task.start), ("target", target)):
        for f in fields(ranges):
            value = getattr(ranges, f.name)
            if isinstance(value, (list, tuple)) and f.name != "angles" and (len(value) != 2 or value[0] > value[1]):
                raise InputError(f"task.{part}.{f.name}={list(value)}", "[low, high]", "correct the range")
    if not 0.0 < task.success.window <= task.episode <= MAX_EPISODE:
        found = f"task.episode={task.episode} task.success.window={task.success.window}"
        raise InputError(found, f"a positive window within an episode of at most {MAX_EPISODE:g} s", "correct them")
    if len(target.angles) < (1 if target.dwell is None else 2):
        found = f"task.target.angles={list(target.angles)} task.target.dwell={target.dwell}"
        raise InputError(found, "one angle, or two and more to change between", "add angles, or set dwell=null")
    for name in ("dwell", "hold"):
        times = getattr(target, name)
        if times is not None and times[0] <= 0.0:
            raise InputError(f"task.target.{name}={list(times)}", "times above 0", "correct the range")
    if not 0.0 <= target.turns <= 1.0 or target.turn_rate <= 0.0 or target.quiet < 0.0:
        found = f"task.target.turns={target.turns} turn_rate={target.turn_rate} quiet={target.quiet}"
        raise InputError(found, "a share from 0 to 1, a rate above 0, a time from 0", "correct it")
    for f in fields(task.weights):
        value = getattr(task.weights, f.name)
        if not 0.0 <= value < math.inf or (f.name == "width" and value == 0.0):
            expected = "a width above 0" if f.name == "width" else "0 or more"
            raise InputError(f"task.weights.{f.name}={value}", expected, "correct it")
    if task.training_episode is not None and task.training_episode <= 0.0:
        raise InputError(f"task.training_episode={task.training_episode}", "a time above 0, or null", "correct it")
    if not 0.0 <= task.again <= 1.0:
        raise InputError(f"task.again={task.again}", "a share from 0 to 1", "correct it")
    for name in ("thrust_to_weight", "commanded"):
        ratio = getattr(task, name)
        if ratio is not None and not 1.0 < ratio <= 10.0:
            raise InputError(f"task.{name}={ratio}", "more than 1, at most 10", "correct it")


def check_task_name(task: str | None) -> None:
    """Refuse a task that there is none of.

    Raises:
        InputError: naming those that there are.
    """
    if task is not None and not isinstance(task, str):
        found, expected = f"a {type(task).__name__} for a task", f"a name, one of {', '.join(TASKS)}"
        raise InputError(found, expected, "give a whole configuration to vpptwin.train.env.vpp_env.make_env")
    if task is not None and task not in TASKS:
        raise InputError(f"unknown task {task!r}", f"one of {', '.join(TASKS)}", suggest(task, TASKS))
