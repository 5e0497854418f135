"""References: what a pilot is to follow, tick by tick, and the plan that fills them from front to back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

POP, POP_TIME = 7.0, 0.22
"""Before a turn the craft throws itself up: acceleration [m/s²] and for how long [s]."""
HEIGHT = 1.2
"""Where a plan starts [m]."""


@dataclass(frozen=True)
class Reference:
    """What a pilot is to follow, one row a policy tick, T ticks."""

    pose: np.ndarray  # x, z, θ, (T, 3) m, m, rad; between multiples of π θ is the path of a turn
    velocity: np.ndarray  # (T, 3) m/s, rad/s
    acceleration: np.ndarray  # of x and z, (T, 2) m/s²
    nudge: np.ndarray  # angle added to the lean, (T,) rad

    def __len__(self) -> int:
        """Number of ticks."""
        return len(self.pose)


def minimum_jerk(u: np.ndarray) -> np.ndarray:
    """The way covered at a share u of the time, both 0 to 1, with velocity and acceleration zero at both ends."""
    # s = 10 u³ - 15 u⁴ + 6 u⁵ (Flash and Hogan 1985)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


class Plan:
    """Fills a reference from front to back.

    Args:
        duration: s.
        period: between ticks [s].
        gravity: m/s².

    It starts above the middle of the rail, unless the first thing planned is a step.
    """

    def __init__(self, duration: float, period: float, gravity: float) -> None:
        count = round(duration / period)
        self.period, self.gravity, self.now = period, gravity, 0
        self.pose = np.tile([0.0, HEIGHT, 0.0], (count, 1))
        self.velocity = np.zeros((count, 3))
        self.acceleration = np.zeros((count, 2))
        self.nudged = np.zeros(count)

    @property
    def left(self) -> float:
        """Time left [s]."""
        return (len(self.pose) - self.now) * self.period

    def finish(self) -> Reference:
        """The reference as planned so far, holding the last target to its end."""
        return Reference(self.pose, self.velocity, self.acceleration, self.nudged)

    def wait(self, duration: float) -> None:
        """Hold the target [s]."""
        self.now = min(len(self.pose), self.now + max(round(duration / self.period), 1))

    def step(self, x: float | None = None, z: float | None = None) -> None:
        """Jump to another target [m], at once."""
        for axis, value in enumerate((x, z)):
            if value is not None:
                self.pose[self.now :, axis] = value

    def here(self) -> np.ndarray:
        """Target x, z as it is now, (2,) m."""
        here: np.ndarray = self.pose[min(self.now, len(self.pose) - 1), :2].copy()
        return here

    def follow(self, duration: float, path: Callable[[np.ndarray], np.ndarray]) -> None:
        """Follow a path with its velocity and acceleration.

        Args:
            duration: s.
            path: x, z over the time since now, (T,) s → (T, 2) m; defined a little beyond both ends.
        """
        first, count = self.now, max(round(duration / self.period), 1)
        time = self.period * np.arange(-2, count + 3)
        place = path(time)
        velocity = np.gradient(place, self.period, axis=0)
        acceleration = np.gradient(velocity, self.period, axis=0)
        self.wait(duration)
        done = slice(2, 2 + self.now - first)
        span = slice(first, self.now)
        self.pose[span, :2], self.velocity[span, :2] = place[done], velocity[done]
        self.acceleration[span] = acceleration[done]
        self.pose[self.now :, :2] = place[2 + count]

    def move(self, duration: float, x: float | None = None, z: float | None = None) -> None:
        """Go to another target [m] along a minimum-jerk path of `duration` [s]."""
        begin = self.here()
        end = np.array([begin[0] if x is None else x, begin[1] if z is None else z])
        self.follow(duration, lambda t: begin + minimum_jerk(np.clip(t / duration, 0.0, 1.0))[:, None] * (end - begin))
        self.step(*end)

    def cruise(self, x: float, speed: float, acceleration: float) -> None:
        """Go to x [m] at a constant speed [m/s], started and ended at an acceleration [m/s²]."""
        begin = self.here()
        way = abs(x - begin[0])
        speed = min(speed, np.sqrt(acceleration * way))
        ramp = speed / acceleration
        total = way / speed + ramp

        def path(time: np.ndarray) -> np.ndarray:
            t = np.clip(time, 0.0, total)
            rest = total - t
            covered = np.where(t < ramp, 0.5 * acceleration * t**2, speed * (t - 0.5 * ramp))
            covered = np.where(rest < ramp, way - 0.5 * acceleration * rest**2, covered)
            return begin + np.column_stack([np.sign(x - begin[0]) * covered, np.zeros_like(t)])

        self.follow(total, path)
        self.step(x)

    def nudge(self, angle: float, width: float) -> None:
        """Lean by `angle` [rad] for `width` [s], then the other way for as long."""
        for sign in (1.0, -1.0):
            begin = self.now
            self.wait(width)
            self.nudged[begin : self.now] = sign * angle

    def turn(self, angle: float, duration: float) -> None:
        """Throw the craft up, then turn it by `angle` [rad], a multiple of π, in `duration` [s]."""
        begin = self.now
        self.wait(POP_TIME)
        self.acceleration[begin : self.now, 1] += POP
        begin, start = self.now, self.pose[min(self.now, len(self.pose) - 1), 2]
        self.wait(duration)
        u = (np.arange(self.now - begin) + 1.0) * self.period / duration
        self.pose[begin : self.now, 2] = start + angle * minimum_jerk(np.minimum(u, 1.0))
        # ds/dt = 30 u² (1 - u)² / T
        self.velocity[begin : self.now, 2] = angle * 30.0 * u**2 * (1.0 - u) ** 2 / duration * (u < 1.0)
        self.pose[self.now :, 2] = start + angle
