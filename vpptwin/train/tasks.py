"""Tasks as data: where an episode starts, what it asks for, what it pays, when it ends and what counts as success.

A task is a value, not a class: every number of it can be overridden on the command line (`task.episode=8`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from vpptwin.errors import InputError
from vpptwin.train.reward import RewardWeights
from vpptwin.vehicle import Vehicle

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

    def draw(self, rng: np.random.Generator, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
        dwell: uniform distribution of the time after which another angle is drawn, s; null for never.
    """

    x: Range = (-0.4, 0.4)
    z: Range = (1.0, 1.5)
    angles: list[float] = field(default_factory=lambda: [0.0])
    dwell: Range | None = None

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Targets x, z, θ, (count, 3) m, m, rad."""
        low, high = np.array([self.x, self.z]).T
        return np.column_stack([rng.uniform(low, high, (count, 2)), rng.choice(self.angles, count)])

    def draw_dwell(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Times until the next change of the angle, (count,) s; infinite when it never changes."""
        return np.full(count, math.inf) if self.dwell is None else rng.uniform(*self.dwell, count)

    def draw_other_angle(self, rng: np.random.Generator, angle: np.ndarray) -> np.ndarray:
        """For each current angle (n,) another of the choices, (n,) rad."""
        choices = np.asarray(self.angles)
        now = np.argmin(np.abs(choices[None, :] - angle[:, None]), axis=1)
        return choices[(now + rng.integers(1, len(choices), len(angle))) % len(choices)]


@dataclass
class Limits:
    """States that end an episode as a failure; leaving the rig's travel is always one.

    Attributes:
        speed: m/s.
        rate: rad/s.
        floor: height of the lower arm tip, m; high enough that a bounce between two steps is not missed.
    """

    speed: float = 8.0
    rate: float = 40.0
    floor: float = 0.05

    def exceeded(self, vehicle: Vehicle, pose: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Which rows of pose and velocity, both (N, 3), have failed, (N,) bool."""
        travel = np.array([vehicle.rig.travel_x, vehicle.rig.travel_z])
        at_stop = ((pose[:, :2] <= travel[:, 0]) | (pose[:, :2] >= travel[:, 1])).any(axis=1)
        tip = pose[:, 1] - vehicle.airframe.half_length * np.abs(np.sin(pose[:, 2]))
        too_fast = (np.hypot(velocity[:, 0], velocity[:, 1]) > self.speed) | (np.abs(velocity[:, 2]) > self.rate)
        return at_stop | (tip < self.floor) | too_fast


@dataclass
class Success:
    """When an episode that did not fail counts as a success, from means over its last `window`.

    Attributes:
        position: largest mean distance, m.
        angle: largest mean angle error, rad.
        window: s.
    """

    position: float = 0.05
    angle: float = 0.2
    window: float = 1.0


@dataclass
class Task:
    """A task.

    Attributes:
        name: as on the command line.
        episode: length, s.
        start: initial states.
        target: what to reach.
        weights: reward.
        limits: failures.
        success: measure.
    """

    name: str
    episode: float = 5.0
    start: Start = field(default_factory=Start)
    target: Target = field(default_factory=Target)
    weights: RewardWeights = field(default_factory=RewardWeights)
    limits: Limits = field(default_factory=Limits)
    success: Success = field(default_factory=Success)


HOVER = Task("hover")
TASKS: dict[str, Task] = {task.name: task for task in (HOVER,)}
"""Every task by name."""


def check_task(task: Task) -> None:
    """Refuse numbers that make no sense.

    Raises:
        InputError: naming the first.
    """
    for part, ranges in (("start", task.start), ("target", task.target)):
        for f in fields(ranges):
            value = getattr(ranges, f.name)
            if f.name != "angles" and value is not None and (len(value) != 2 or value[0] > value[1]):
                raise InputError(f"task.{part}.{f.name}={list(value)}", "[low, high]", "correct the range")
    if task.episode < task.success.window or task.success.window <= 0.0:
        found = f"task.episode={task.episode} task.success.window={task.success.window}"
        raise InputError(found, "a positive window within the episode", "lengthen the episode")
    if len(task.target.angles) < (1 if task.target.dwell is None else 2):
        found = f"task.target.angles={list(task.target.angles)} task.target.dwell={task.target.dwell}"
        raise InputError(found, "one angle, or two and more to change between", "add angles, or set dwell=null")
    if task.target.dwell is not None and task.target.dwell[0] <= 0.0:
        raise InputError(f"task.target.dwell={list(task.target.dwell)}", "times above 0", "correct the range")
