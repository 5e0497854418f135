"""What the scripted pilot flies: timelines at 100 Hz, deterministic per seed with random variations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

PERIOD = 0.01  # s


@dataclass
class Script:
    """A timeline of `ticks` policy periods."""

    setpoint: np.ndarray  # x m, z m, theta rad as published on /setpoint/pose. (ticks, 3)
    reference: np.ndarray  # x, z the position loop follows, m. (ticks, 2)
    velocity: np.ndarray  # Feed-forward, m/s. (ticks, 2)
    accel: np.ndarray  # Feed-forward, m/s^2. (ticks, 2)
    base: np.ndarray  # Body angle about which the position loop tilts, rad. (ticks,)
    nudge: np.ndarray  # Angle added to the tilt, rad. (ticks,)
    turning: np.ndarray  # Whether `base` alone commands the angle. (ticks,)
    haste: np.ndarray  # Largest position error that the position loop answers to, m. (ticks,)


class Choreographer:
    """Fills a timeline from front to back."""

    def __init__(self, duration: float, rng: np.random.Generator, x: float, z: float, haste: float = 0.6) -> None:
        ticks = round(duration / PERIOD)
        self.rng, self.ticks, self.tick = rng, ticks, 0
        self.angle = 0.0
        self.script = Script(
            setpoint=np.zeros((ticks, 3)),
            reference=np.zeros((ticks, 2)),
            velocity=np.zeros((ticks, 2)),
            accel=np.zeros((ticks, 2)),
            base=np.zeros(ticks),
            nudge=np.zeros(ticks),
            turning=np.zeros(ticks, dtype=bool),
            haste=np.full(ticks, haste),
        )
        self.go(x, z)

    @property
    def left(self) -> float:
        """Time left, s."""
        return (self.ticks - self.tick) * PERIOD

    def go(self, x: float | None = None, z: float | None = None) -> None:
        """Set a new target from now on, m."""
        script, now = self.script, slice(self.tick, None)
        for axis, value in enumerate((x, z)):
            if value is not None:
                script.reference[now, axis] = script.setpoint[now, axis] = value

    def wait(self, duration: float) -> None:
        """Let the craft fly towards its target for `duration` s."""
        self.tick = min(self.ticks, self.tick + round(duration / PERIOD))

    def hurry(self, haste: float) -> None:
        """Change the largest position error answered to, m."""
        self.script.haste[self.tick :] = haste

    def nudge(self, angle: float, width: float) -> None:
        """Angle doublet: `angle` rad for `width` s, then its opposite."""
        for sign in (1.0, -1.0):
            stop = self.tick + round(width / PERIOD)
            self.script.nudge[self.tick : stop] = sign * angle
            self.wait(width)

    def crawl(self, axis: int, speed: float, duration: float) -> None:
        """Move the target along an axis (0 is x, 1 is z) at `speed` m/s for `duration` s, and back again."""
        script, there = self.script, round(duration / PERIOD)
        left = script.reference[self.tick : self.tick + 2 * there, axis]
        path = speed * PERIOD * np.minimum(np.arange(1, 2 * there + 1), 2 * there - np.arange(1, 2 * there + 1))
        left += path[: len(left)]
        script.setpoint[self.tick : self.tick + 2 * there, axis] = left
        script.velocity[self.tick : self.tick + 2 * there, axis] = np.gradient(left, PERIOD) if len(left) > 1 else 0.0
        self.wait(2 * duration)

    def turn(self, angle: float, duration: float) -> None:
        """Pop up, then turn by `angle` rad in `duration` s along a minimum-jerk path; the thrust changes sign."""
        climb = round(0.22 / PERIOD)
        self.script.accel[self.tick : self.tick + climb, 1] = 7.0
        self.wait(climb * PERIOD)
        start, length = self.tick, round(duration / PERIOD)
        u = (np.arange(length) + 1) / length
        path = self.angle + angle * (10 * u**3 - 15 * u**4 + 6 * u**5)
        stop = min(self.ticks, start + length)
        self.script.base[start:stop] = path[: stop - start]
        self.script.turning[start:stop] = True
        self.angle += angle
        self.script.base[stop:] = self.angle
        self.script.setpoint[start:, 2] = self.angle
        self.wait(duration)

    def sign(self) -> float:
        """Draw a sign."""
        return float(self.rng.choice((-1.0, 1.0)))


def _hover(duration: float, rng: np.random.Generator) -> Script:
    return Choreographer(duration, rng, rng.uniform(-0.4, 0.4), rng.uniform(0.8, 1.3)).script


def _x_steps(duration: float, rng: np.random.Generator) -> Script:
    plan = Choreographer(duration, rng, rng.uniform(-0.2, 0.2), rng.uniform(0.8, 1.4))
    side = plan.sign()
    plan.wait(1.0)
    while plan.left > 0:
        plan.go(x=side * rng.uniform(0.25, 0.95))
        side = -side
        plan.wait(rng.uniform(1.6, 2.6))
    return plan.script


def _z_steps(duration: float, rng: np.random.Generator) -> Script:
    plan = Choreographer(duration, rng, rng.uniform(-0.4, 0.4), 1.2)
    up = bool(rng.integers(2))
    plan.wait(1.0)
    while plan.left > 0:
        plan.go(z=rng.uniform(1.5, 2.1) if up else rng.uniform(0.5, 1.0))
        up = not up
        plan.wait(rng.uniform(1.4, 2.4))
    return plan.script


def _aggressive(duration: float, rng: np.random.Generator) -> Script:
    plan = Choreographer(duration, rng, rng.uniform(-0.2, 0.2), rng.uniform(1.0, 1.4), haste=1.5)
    side = plan.sign()
    plan.wait(0.8)
    kinds = ["both"] * 4 + ["x"] * 3 + ["z"] + ["doublet"] * 2
    while plan.left > 0:
        for kind in rng.permutation(kinds):  # dealt from a pack, so that every flight is rich
            if kind in ("both", "x"):
                plan.go(x=side * rng.uniform(0.5, 0.95))
                side = -side
            if kind in ("both", "z"):
                low = plan.script.reference[plan.tick - 1, 1] < 1.3
                plan.go(z=rng.uniform(1.6, 2.0) if low else rng.uniform(0.65, 1.0))
            if kind == "doublet":
                plan.nudge(plan.sign() * rng.uniform(0.35, 0.6), rng.uniform(0.12, 0.2))
            plan.wait(rng.uniform(0.9, 1.6))
    return plan.script


def _figure(duration: float, rng: np.random.Generator) -> Script:
    centre = np.array([rng.uniform(-0.1, 0.1), rng.uniform(1.1, 1.3)])
    plan = Choreographer(duration, rng, *centre)
    size = np.array([rng.uniform(0.6, 0.85), rng.uniform(0.3, 0.5)])
    omega = np.array([rng.uniform(1.6, 2.3), rng.uniform(2.5, 3.6)])
    time = np.arange(plan.ticks)[:, None] * PERIOD
    phase = rng.uniform(0, 2 * np.pi, 2)
    swell = np.minimum(time / 2.0, 1.0) ** 2 * (3 - 2 * np.minimum(time / 2.0, 1.0))  # no jump at the start
    script = plan.script
    script.reference[:] = centre + swell * size * np.sin(omega * time + phase)
    script.velocity[:] = np.gradient(script.reference, PERIOD, axis=0)
    script.accel[:] = np.gradient(script.velocity, PERIOD, axis=0)
    script.setpoint[:, :2] = script.reference
    return script


def _flip(duration: float, rng: np.random.Generator) -> Script:
    plan = Choreographer(duration, rng, rng.uniform(-0.15, 0.15), rng.uniform(1.35, 1.5))
    plan.wait(1.2)
    whole = False
    while plan.left > 3.5:
        side = plan.sign()
        if whole:
            plan.turn(side * 2 * np.pi, rng.uniform(0.95, 1.1))
            plan.wait(rng.uniform(1.8, 2.4))
        else:
            plan.turn(side * np.pi, rng.uniform(0.55, 0.65))
            plan.wait(rng.uniform(1.6, 2.2))
            plan.turn(plan.sign() * np.pi, rng.uniform(0.55, 0.65))
            plan.wait(rng.uniform(1.6, 2.2))
        whole = not whole
    return plan.script


def _mixed(duration: float, rng: np.random.Generator) -> Script:
    plan = Choreographer(duration, rng, rng.uniform(-0.2, 0.2), rng.uniform(0.9, 1.3), haste=1.2)
    plan.wait(0.8)
    acts = ["pause", "low pass", "high pass", "inverted", "doublets", "steps"]
    while plan.left > 0:
        for act in rng.permutation(acts):
            _act(plan, str(act), rng)
    return plan.script


def _creep(duration: float, rng: np.random.Generator) -> Script:
    """Holds, slow moves that turn back, small dithers, now and then a step: where breakaway friction decides."""
    plan = Choreographer(duration, rng, rng.uniform(-0.3, 0.3), rng.uniform(0.8, 1.4))
    plan.wait(0.8)
    acts = ["hold", "crawl x", "crawl z", "crawl x", "dither", "step"]
    while plan.left > 0:
        for act in rng.permutation(acts):
            if act == "hold":
                plan.wait(rng.uniform(1.2, 2.0))
            elif act == "step":
                side = -np.sign(plan.script.reference[plan.tick - 1, 0]) or 1.0
                plan.go(x=side * rng.uniform(0.3, 0.8), z=rng.uniform(0.7, 1.7))
                plan.wait(rng.uniform(1.2, 1.6))
            elif act == "dither":
                for _ in range(3):
                    plan.nudge(plan.sign() * rng.uniform(0.03, 0.09), rng.uniform(0.15, 0.3))
                    plan.wait(rng.uniform(0.1, 0.3))
            else:
                plan.crawl("xz".index(act[-1]), plan.sign() * rng.uniform(0.04, 0.20), rng.uniform(0.8, 1.4))
    return plan.script


def _knock(duration: float, rng: np.random.Generator) -> Script:
    """Knocks at the wall now and then, nearly level, with another speed along and across it each time."""
    plan = Choreographer(duration, rng, rng.uniform(0.6, 0.9), rng.uniform(1.0, 1.4))
    plan.wait(0.8)
    while plan.left > 0:
        speed, now = rng.uniform(0.5, 1.6), plan.tick
        there = (1.5 - plan.script.reference[now - 1, 0]) / speed
        plan.wait(max(there - 0.25, 0.0))
        plan.go(z=rng.uniform(0.8, 1.8))  # up or down along the wall as it is met
        plan.tick = now
        plan.crawl(0, speed, there + 0.05)
        plan.go(x=rng.uniform(0.4, 0.9), z=rng.uniform(0.9, 1.6))
        plan.wait(rng.uniform(3.4, 4.4))
    return plan.script


def _act(plan: Choreographer, act: str, rng: np.random.Generator) -> None:
    if act == "inverted" and plan.left < 5.5:
        act = "steps"
    if act == "pause":
        plan.wait(rng.uniform(1.0, 1.6))
    elif act in ("low pass", "high pass"):
        side = plan.sign()
        plan.go(x=-side * 0.8, z=rng.uniform(0.33, 0.40) if act == "low pass" else rng.uniform(1.9, 2.1))
        plan.wait(1.6)
        plan.go(x=side * 0.8)
        plan.wait(1.5)
        plan.go(z=1.2)
        plan.wait(0.9)
    elif act == "inverted":
        plan.go(x=rng.uniform(-0.2, 0.2), z=1.25)
        plan.wait(1.2)
        plan.turn(plan.sign() * np.pi, rng.uniform(0.55, 0.65))
        plan.wait(1.0)
        plan.go(x=plan.sign() * rng.uniform(0.3, 0.6))
        plan.wait(1.3)
        plan.turn(plan.sign() * np.pi, rng.uniform(0.55, 0.65))
        plan.wait(1.0)
    elif act == "doublets":
        plan.nudge(plan.sign() * rng.uniform(0.35, 0.6), rng.uniform(0.12, 0.2))
        plan.wait(rng.uniform(0.7, 1.1))
    else:
        plan.go(x=-np.sign(plan.script.reference[plan.tick - 1, 0]) * rng.uniform(0.4, 0.9), z=rng.uniform(0.7, 1.8))
        plan.wait(rng.uniform(1.2, 1.8))


MANOEUVRES: dict[str, Callable[[float, np.random.Generator], Script]] = {
    "hover": _hover,
    "x_steps": _x_steps,
    "z_steps": _z_steps,
    "aggressive": _aggressive,
    "figure": _figure,
    "flip": _flip,
    "mixed": _mixed,
    "creep": _creep,
    "knock": _knock,
}


def write_script(manoeuvre: str, duration: float, seed: int) -> Script:
    """Write the timeline of a manoeuvre, `duration` s long."""
    if manoeuvre not in MANOEUVRES:
        raise ValueError(f"unknown manoeuvre {manoeuvre!r}; there are {', '.join(MANOEUVRES)}")
    return MANOEUVRES[manoeuvre](duration, np.random.default_rng([seed, 11]))
