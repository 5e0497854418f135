"""The twin and the independent simulation (proving/drone) under the same commands, and how far apart they may be."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from proving.drone.effects import COMPANIONS, CORE, EXTENDED, Size
from proving.drone.replay import Replay, replay_commands
from proving.drone.rig import ON_THE_RIG, PITCH, Rig, X, Z
from tests.twin.hover import share_kernel
from vpptwin.twin import Twin, TwinSpec

SENSORS = ("mocap.", "gyro.", "clock.")
DYNAMIC: dict[str, dict[str, Size]] = {
    effect: sizes for effect, sizes in (CORE | EXTENDED | COMPANIONS).items() if not effect.startswith(SENSORS)
}
"""Every effect of the independent simulation that acts on the motion."""
HOLD, EVERY = 0.05, 0.01
"""Commands are held, and states compared, for and every so many s."""
TWIN_STEP, STEP = 0.0005, 0.001
"""Coarser steps of the twin and of the independent simulation [s]; they are compared at half of them."""
LATE_OR_STOPPED = ("command.delay", "servo.backlash", "servo.rate_limit")
"""Effects that put a kink of their own into the path of a blade."""
START = 10.0
"""s since the start of the log, for effects that grow with it."""
ROTOR_SPEED = 540.0
"""rad/s that no rotor exceeds here: throttle below 0.48."""


@dataclass(frozen=True)
class Flights:
    """Random flights."""

    cases: np.ndarray  # what is switched on in each, (N,): "none", an effect or "all"
    hidden: tuple[dict[str, dict[str, float]], ...]  # effects of each
    state: np.ndarray  # x m, z m, theta rad and their rates at the start, (6, N)
    pitch: np.ndarray  # blade-pitch commands, (M, 2, N) rad
    throttle: np.ndarray  # (M, 2, N)

    def take(self, which: np.ndarray) -> Flights:
        """Some of them."""
        hidden = tuple(self.hidden[i] for i in which)
        return Flights(
            self.cases[which], hidden, self.state[:, which], self.pitch[..., which], self.throttle[..., which]
        )

    def fly(self, free: bool, step: float = STEP) -> Replay:
        """Fly the independent simulation."""
        rig = Rig(self.hidden, [None] * len(self.hidden), free)
        with np.errstate(over="ignore", invalid="ignore"):  # a free craft far below the floor, in the ground's effect
            return replay_commands(
                rig, self.state, self.pitch, self.throttle, HOLD, every=EVERY, start=START, step=step
            )

    def fly_twin(self, spec: TwinSpec, step: float) -> np.ndarray:
        """States of the twin, all flights in one batch, every effect switched on. (times, 6, N)."""
        model = copy.copy(spec.model)
        model.opt.timestep = step
        active = {effect for hidden in self.hidden for effect in hidden}
        with share_kernel():
            twin = Twin(spec.with_robot(model=model), len(self.hidden), active, num_threads=1)
        for effect in active:
            rows = np.array([row for row, hidden in enumerate(self.hidden) if effect in hidden])
            for parameter in twin.effects[effect].parameters:
                values = np.array([self.hidden[row][effect][parameter.name] for row in rows])
                twin.set_parameter(effect, parameter.name, values, rows)
        pose, velocity = self.state[:3].T, self.state[3:].T
        state = twin.initial_state(qpos=twin.pose_for_engine(pose, velocity), qvel=velocity, time=START)
        commands, throttle = (
            np.repeat(given.transpose(2, 0, 1), round(HOLD / step), axis=1) for given in (self.pitch, self.throttle)
        )
        _, qpos, qvel, _ = twin.replay_commands(state, commands, throttle=throttle)
        every = round(EVERY / step)
        qpos, qvel = qpos[:, every - 1 :: every], qvel[:, every - 1 :: every]
        later = np.concatenate([twin.pose_at_time(qpos, qvel), qvel], axis=2).transpose(1, 2, 0)
        return np.concatenate([self.state[None], later])

    def make_wrong(self, share: float) -> Flights:
        """The same with every parameter off by a share of itself, factors by a share of what they differ from 1."""

        def shift(size: Size, value: float) -> float:
            anchor = size.off if size.unit == "1" else 0.0
            return anchor + (1 + share) * (value - anchor)

        wrong = tuple(
            {e: {name: shift(DYNAMIC[e][name], value) for name, value in p.items()} for e, p in hidden.items()}
            for hidden in self.hidden
        )
        return replace(self, hidden=wrong)


def draw_effects(case: str, free: bool, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Draw the sizes of what a case switches on; asymmetry comes with friction to be asymmetric."""
    chosen = {"none": [], "all": [e for e in DYNAMIC if not (free and e in ON_THE_RIG)]}.get(case, [case])
    if case in COMPANIONS:
        chosen = [case, case.replace("asymmetry", "coulomb")]
    return {effect: {name: size.draw(rng) for name, size in DYNAMIC[effect].items()} for effect in chosen}


def draw_flights(cases: Mapping[str, int], free: bool, seconds: float, seed: int) -> tuple[Flights, Replay]:
    """Draw flights that touch nothing, so many of each case, with what the independent simulation makes of them.

    Half start upright, half inverted, up to 1 m/s in x, 3 m/s in z and 2 rad/s; each joint is at rest at first in a
    quarter of them. Blades are commanded to 0 to 0.2 rad, with the sign that carries the craft, and 0.02 rad apart.
    """
    rng, length = np.random.default_rng(seed), round(seconds / HOLD)
    labels = np.array([case for case, count in cases.items() for _ in range(count)])
    count = len(labels)
    sign = rng.choice((1.0, -1.0), count)
    pose = rng.uniform([-0.8, 0.35, -0.5], [0.8, 2.2, 0.5], (count, 3)).T
    pose[PITCH] += np.where(sign < 0, np.pi, 0.0)
    velocity = rng.uniform([-1.0, -1.0, -2.0], [1.0, 3.0, 2.0], (count, 3)).T
    velocity[rng.random((3, count)) < 0.25] = 0.0
    pitch = sign * rng.uniform(0.0, 0.2, (length, 1, count)) + rng.uniform(-0.02, 0.02, (length, 2, count))
    throttle = rng.uniform(0.35, 0.48, (length, 2, count))
    hidden = tuple(draw_effects(case, free, rng) for case in labels)
    flights = Flights(labels, hidden, np.concatenate([pose, velocity]), pitch, throttle)
    flown = flights.fly(free)
    x, z = flown.states[:, X], flown.states[:, Z]
    # End stops at 1.5 m and 2.5 m, wall at 1.7 m, floor: the arms reach 0.215 m.
    clear = np.flatnonzero((np.abs(x).max(0) < 1.4) & (z.min(0) > 0.27) & (z.max(0) < 2.4))
    return flights.take(clear), flown.take(clear)


@dataclass(frozen=True)
class Comparison:
    """How far the twin is from the independent simulation, both at their finer steps."""

    flights: Flights  # what was flown
    free: bool  # whether without the rig
    flown: Replay  # by the independent simulation, at STEP
    error: np.ndarray  # largest difference so far, (times, 6, N) m, rad, m/s, rad/s
    bound: np.ndarray  # what the steps explain of it, likewise

    def select(self, case: str, limit: int | None = None) -> np.ndarray:
        """Indices of the first flights of a case."""
        return np.flatnonzero(self.flights.cases == case)[:limit]

    def find_share(self, which: np.ndarray, other: np.ndarray | None = None) -> np.ndarray:
        """Largest error over its bound in each of some flights; that of other states of the flights if given."""
        error = self.error[..., which] if other is None else np.abs(other - self.flown.states[..., which])
        return (error[1:] / self.bound[1:, :, which]).max((0, 1))


def compare(spec: TwinSpec, cases: Mapping[str, int], free: bool, seconds: float, seed: int = 3) -> Comparison:
    """Fly both at their coarser and finer steps."""
    flights, flown = draw_flights(cases, free, seconds, seed)
    finer = flights.fly(free, STEP / 2).states
    twin, finer_twin = flights.fly_twin(spec, TWIN_STEP), flights.fly_twin(spec, TWIN_STEP / 2)
    gone = grow(flown.states - finer) + grow(twin - finer_twin)
    return Comparison(flights, free, flown, grow(finer_twin - finer), bound_error(flights, free, flown, gone))


def grow(difference: np.ndarray) -> np.ndarray:
    """Largest magnitude up to each time: an error may pass through zero by chance."""
    return np.maximum.accumulate(np.abs(difference), axis=0)


def bound_error(flights: Flights, free: bool, flown: Replay, halving: np.ndarray) -> np.ndarray:
    """What two integrators of the same equations may differ by at their finer steps, (times, 6, N).

    First, what halving the steps removed, in both together: an error of first order leaves as much again, one of second
    order a third of it. A tenth more for terms of higher order.

    Then what depends on where in a step h something happens, which halving shifts:

    - A blade whose speed jumps by v makes a kink in the thrust: up to v h²/8 of it go missing. A command is a jump by
      its change over the lag: one kink, as thrust and direction of a step are taken at its middle, and one more each
      where the command arrives late, takes up play, or leaves the rate limit, and where a push overcomes friction.
      Halving hides up to that much, and up to 4 times as much at the coarser step: 1 + 1 + 4.
    - A joint that reverses meets friction F of the wrong sign for part of a step: up to 2 F h. Halving hides up to that
      much, and twice as much at the coarser step: 1 + 1 + 2. Likewise the load of a joint that is arrested changes the
      friction of sliders that it jams one step late.

    Last, the same carried on: by an unbalanced mass from joint to joint, by the angle into the direction of the thrust,
    from velocities into positions.
    """
    rig, h = Rig(flights.hidden, [None] * len(flights.hidden), free), TWIN_STEP / 2
    switched_on = [np.array([effect in hidden for hidden in flights.hidden]) for effect in LATE_OR_STOPPED]
    kinks = 1 + sum(switched_on) + (rig.coulomb + rig.stiction > 0.0).any(0)
    jumps = np.abs(np.diff(flights.pitch, axis=0, prepend=0.0)).sum(1)
    for before, jump in pairwise(jumps):
        jump += before * np.exp(-HOLD / rig.servo_lag)  # what the servo still had to go
    jumps = np.cumsum(jumps / rig.servo_lag, axis=0)  # rad/s, up to the end of each command
    jumps = np.concatenate([jumps[:1], np.repeat(jumps, round(HOLD / EVERY), axis=0)])
    k_t = rig.k_t.max(0)
    missed = 6 * k_t * ROTOR_SPEED * kinks * jumps * h**2 / 8  # N s
    rubbed, jammed = (4 * 2 * h * force * rig.inverse for force in (flown.reversed, flown.arrested))

    speed = rubbed + missed[:, None] * np.stack([1 / rig.mass_x, 1 / rig.mass_z, rig.half_length / rig.inertia])
    off = rig.craft_mass * np.hypot(*rig.com)  # kg m
    speed[:, PITCH] += off / rig.inertia * (rubbed[:, X] + rubbed[:, Z])
    speed[:, :PITCH] += off * rig.inverse[:PITCH] * rubbed[:, PITCH, None]
    if not free:
        lever = 2.4 / rig.bearing_spacing  # up to the end of the travel
        loop = rig.hidden.get("rail_x.jamming", "mu") * lever * rig.mass_z / rig.mass_x
        speed[:, X] += jammed[:, X] * loop / (1 - loop)
        speed[:, Z] += jammed[:, X] * rig.hidden.get("rail_z.jamming", "mu")
    angle = np.cumsum(speed[:, PITCH], axis=0) * EVERY
    thrust = 1.15 * k_t * ROTOR_SPEED * np.abs(flights.pitch.sum(1)).max(0)  # N; the ground may add 15 %
    speed[:, :PITCH] += np.cumsum(thrust * angle, axis=0)[:, None] * EVERY * rig.inverse[:PITCH]
    place = np.cumsum(speed, axis=0) * EVERY
    return 1.1 * halving + np.concatenate([place, speed], axis=1)
