"""How each manoeuvre is flown: functions that fill a plan from its settings, until it is full."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from vpptwin.robots.planar_drone.pilot.reference import Plan

TURN_TIME = 0.6
"""Of half a turn [s]."""
LEVELLING = 3.0
"""Acceleration at the ends of a cruise [m/s²]."""
LIGHT_TIME, PUSH = 0.4, 6.0
"""Of a hop: how long the rotors are light [s], upward acceleration before and after [m/s²]."""
SWEEP_TIME = 10.0
"""From the slowest swing to the fastest [s]."""


def alternate(plan: Plan) -> Iterator[float]:
    """The sides of what comes next, 1 and -1 in turn, until the plan is full."""
    side = 1.0
    while plan.left > 0:
        yield side
        side = -side


def hover(plan: Plan, height: float) -> None:
    """Hold still."""
    plan.step(z=height)
    plan.wait(plan.left)


def steps(plan: Plan, axis: str, amplitude: float, period: float, height: float) -> None:
    """Jump along an axis, x or z, from side to side of the middle."""
    middle = {"x": 0.0, "z": height}[axis]
    plan.step(z=height)
    plan.wait(1.0)
    for side in alternate(plan):
        plan.step(**{axis: middle + side * amplitude})
        plan.wait(period)


def low_pass(plan: Plan, height: float, amplitude: float, period: float) -> None:
    """Come down at one end, pass near the floor, climb at the other end."""
    plan.step(x=-amplitude)
    for side in alternate(plan):
        plan.move(1.2, z=height)
        plan.wait(0.3)
        plan.move(period, x=side * amplitude)
        plan.move(1.0, z=1.2)


def aggressive_x(plan: Plan, amplitude: float, climb: float, period: float) -> None:
    """Large jumps along x, every second one along z too, a doublet of the angle now and then."""
    plan.step(z=1.35)
    plan.wait(0.8)
    for count, side in enumerate(alternate(plan)):
        plan.step(x=side * amplitude)
        if count % 2:
            plan.step(z=1.35 + (climb if count % 4 == 1 else -climb))
        plan.wait(period)
        if count % 3 == 2:
            plan.nudge(0.4 * side, 0.15)
            plan.wait(0.5)


def light_glide(plan: Plan, speed: float, lightness: float, amplitude: float) -> None:
    """Cruise along x in hops, on top of which the rotors carry only a share of the weight."""
    drop = lightness * plan.gravity
    rise = 0.5 * drop * LIGHT_TIME / PUSH
    hop = LIGHT_TIME + 2.0 * rise
    total = max(round(2.0 * amplitude / speed / hop), 1) * hop
    peak = 0.5 * PUSH * rise**2 + 0.125 * drop * LIGHT_TIME**2

    def glide(side: float, time: np.ndarray) -> np.ndarray:
        t = np.clip(time, 0.0, total)
        inside = t % hop
        from_top, from_end = np.abs(inside - 0.5 * hop), np.minimum(inside, hop - inside)
        height = np.where(from_top < 0.5 * LIGHT_TIME, peak - 0.5 * drop * from_top**2, 0.5 * PUSH * from_end**2)
        return np.column_stack([side * speed * (t - 0.5 * total), 1.1 + height])

    for side in alternate(plan):
        plan.move(1.5, x=-0.5 * side * speed * total, z=1.1)
        plan.follow(total, partial(glide, side))


def sweep(plan: Plan, axis: int, acceleration: float, slow: float, fast: float) -> None:
    """Swing along an axis at constant acceleration, ever faster, from `slow` to `fast` [Hz], then again."""
    plan.wait(1.0)
    centre, growth = plan.here(), np.log(fast / slow) / SWEEP_TIME

    def swing(time: np.ndarray) -> np.ndarray:
        t = np.clip(time, 0.0, SWEEP_TIME)
        rate = 2.0 * np.pi * slow * np.exp(growth * t)
        phase = 2.0 * np.pi * slow * np.expm1(growth * t) / growth  # exponential chirp, f = f_0 exp(k t)
        begun = np.clip(t, 0.0, 1.0)
        place = np.tile(centre, (len(t), 1))
        place[:, axis] += begun**2 * (3.0 - 2.0 * begun) * acceleration / rate**2 * np.sin(phase)
        return place

    while plan.left > 0:
        plan.follow(SWEEP_TIME, swing)
        plan.move(0.6, *centre)


def pitch_doublets(plan: Plan, angle: float, width: float, period: float) -> None:
    """Lean one way, then the other, and come to rest again."""
    plan.wait(1.0)
    for side in alternate(plan):
        plan.nudge(side * angle, width)
        plan.wait(period)


def inverted(plan: Plan, amplitude: float, height: float, period: float) -> None:
    """Turn over, jump along x and z upside down, turn back, and jump upright for comparison."""
    plan.step(z=height)
    plan.wait(1.2)
    for side in alternate(plan):
        plan.turn(side * np.pi, TURN_TIME)
        plan.wait(1.2)
        for x, z in ((amplitude, 0.0), (-amplitude, 0.2), (0.0, 0.0)):
            plan.step(x=x, z=height + z)
            plan.wait(period)


def flip(plan: Plan, period: float, height: float) -> None:
    """Half turns, and a whole one after every second of them."""
    plan.step(z=height)
    plan.wait(1.2)
    for count, side in enumerate(alternate(plan)):
        whole = count % 3 == 2
        plan.turn(-side * (2.0 if whole else 1.0) * np.pi, (1.7 if whole else 1.0) * TURN_TIME)
        plan.wait(period)


def rail_sweep(plan: Plan, speed: float, amplitude: float, height: float) -> None:
    """Creep along the whole rail and back."""
    plan.step(x=-amplitude, z=height)
    plan.wait(0.5)
    for side in alternate(plan):
        plan.cruise(side * amplitude, speed, LEVELLING)
        plan.wait(0.3)


def figure(plan: Plan, width: float, height: float, period: float) -> None:
    """A lying eight."""

    def eight(time: np.ndarray) -> np.ndarray:
        begun = np.clip(0.5 * time, 0.0, 1.0)
        swell = (begun**2 * (3.0 - 2.0 * begun))[:, None]
        phase = 2.0 * np.pi * time[:, None] / period
        return np.array([0.0, 1.3]) + swell * np.hstack([width * np.sin(phase), height * np.sin(2.0 * phase)])

    plan.step(z=1.3)
    plan.follow(plan.left, eight)
