"""Trained policies in the independent simulation: what a task asks of them, what is hidden, what comes of it.

Task and priors are vpptwin's, the flight is not: proving/drone shares no physics with it, nor the state estimate or the
observation. A flight depends on its seed and number alone, however many are flown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from proving.drone import EFFECTS, Recording, fly_policy
from proving.drone.flight import FlightPlan
from proving.drone.policy import Policy
from proving.firmware import VpptwinFirmware
from proving.thrust_tracking import draw_worn
from vpptwin.effects import Effect, Parameter
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import OBSERVATION, wrap_angle
from vpptwin.train.env.randomize import PAPER_EFFECTS
from vpptwin.train.env.rotors import strengthen
from vpptwin.train.env.tasks import TASKS, Task
from vpptwin.train.evaluate.evaluate import summarize
from vpptwin.train.evaluate.flights import TURN_GRACE, count_turns
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint
from vpptwin.twin import load_twin

PERIOD, TICK = 0.01, 10  # s, samples of a recording's truth: of the policy
CENTRAL = 2.0  # standard deviations of a prior that are flown: 95 % of what training draws
TOGETHER = 50  # flights of a batch: more take more memory and hardly less time
Effects = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Sky:
    """What flights go through.

    Attributes:
        effects: drawn from their priors for every flight, all of them together.
        gusts: blow.
        jitter: the rig is off nominal within its tolerance, and mocap frames come at any phase.
        dropouts: of mocap frames.
        rig: what one rig has, which then flies all flights; None for effects drawn for every flight.
        session: seed of that rig's tolerances; None for another rig every flight.
        worn: actuators are as bad as those on the thrust stand (`proving.thrust_tracking.draw_worn`).
        controller: of actuators, "map" or "adaptive" in vpptwin's firmware; "own" for the simulation's own firmware.
    """

    effects: Sequence[str] = PAPER_EFFECTS
    gusts: bool = True
    jitter: bool = True
    dropouts: bool = True
    rig: Effects | None = None
    session: int | None = None
    worn: bool = False
    controller: str = "own"


@dataclass(frozen=True)
class Assignment:
    """One flight: its plan, the targets x, z, θ of every tick (ticks, 3) m, m, rad, and what they had still to turn."""

    number: int
    plan: FlightPlan
    targets: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What became of one flight."""

    number: int  # of the flight among those of its seed
    effects: Effects  # hidden
    failed: bool  # a limit of the task was exceeded
    success: bool  # it did not fail and met the task's measure of success
    position_error: float  # mean distance over the last window of the task, m
    angle_error: float  # likewise, rad
    inverted: bool  # the last target is upside-down
    turns: tuple[int, int]  # full turns asked for and made


def load_flyer(checkpoint: Path | str, task: str | None = None) -> tuple[Policy, Task]:
    """The policy of a checkpoint as a function of numpy arrays, and the task to fly.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        task: name; None, or that of training, for the task of training with its overrides.

    Raises:
        InputError: if there is no such checkpoint, or it sees anything but the observation in docs/train.md.
    """
    module, trained = build_policy(read_checkpoint(checkpoint), checkpoint)
    if trained.observation.names != OBSERVATION:
        found = f"{checkpoint}: a policy that sees {', '.join(trained.observation.names)}"
        raise InputError(found, "the observation in docs/train.md", "train with setup=All paper_inputs=false")

    @torch.no_grad()
    def act(observation: np.ndarray) -> np.ndarray:
        return module(torch.from_numpy(observation)).numpy()

    return act, trained.task if task in (None, trained.task.name) else TASKS[task]


def read_drone() -> tuple[dict[str, Effect], Vehicle]:
    """The catalogue of effects and the nominal vehicle."""
    twin = load_twin()
    return {effect.id: effect for effect in twin.catalogue}, twin.vehicle


@cache
def read_strong(thrust_to_weight: float | None, commanded: float | None) -> Vehicle:
    """The nominal vehicle with rotors of that strength, commanded as a policy was trained."""
    return strengthen(load_twin(), thrust_to_weight, commanded).vehicle


def assign(task: Task, sky: Sky, number: int, seed: int, catalogue: Mapping[str, Effect]) -> Assignment:
    """Draw a flight.

    Args:
        task: what to fly.
        sky: what it goes through.
        number: of the flight.
        seed: of all flights.
        catalogue: of effects.
    """
    rng = np.random.default_rng([seed, number])
    targets, turn = draw_targets(task, rng)
    pose, velocity = task.start.draw(rng, targets[:1])
    hidden = sky.rig
    if hidden is None:
        hidden = {effect: draw_values(catalogue[effect], rng) for effect in sky.effects if effect in EFFECTS}
    if sky.worn:
        hidden = hidden | draw_worn(0.8 + 0.4 * (number % 2), np.random.default_rng([seed, number, 1]))
    plan: FlightPlan = {
        "effects": hidden,
        "session": sky.session,
        "manoeuvre": task.name,
        "duration": task.episode,
        "seed": int(rng.integers(2**31)),
        "gusts": sky.gusts,
        "jitter": sky.jitter,
        "dropouts": sky.dropouts,
        "initial": [*pose[0], *velocity[0]],
        "strength": read_strong(task.thrust_to_weight, task.commanded).rotor.k_t / load_vehicle().rotor.k_t,
    }
    return Assignment(number, plan, targets, turn)


def draw_values(effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Values of an effect within the central range of what training draws."""
    return {p.name: float(np.clip(p.draw(rng, 1)[0], *find_centre(p))) for p in effect.parameters}


def find_centre(parameter: Parameter) -> tuple[float, float]:
    """Ends of the central range of a parameter's prior, within its bounds."""
    prior = parameter.prior
    reach = CENTRAL * prior.b
    low, high = {
        "uniform": (prior.a, prior.b),
        "normal": (prior.a - reach, prior.a + reach),
        "halfnormal": (prior.a, prior.a + reach),
    }[prior.kind]
    return max(low, parameter.low), min(high, parameter.high)


def draw_targets(task: Task, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Targets of one episode as training asks for them, and what they have still to turn.

    Returns:
        x, z, θ of every tick from 0 to the end, (ticks, 3) m, m, rad, and (ticks,) rad.
    """
    wanted, stage, turn = task.target, np.zeros(1, int), np.zeros(1)
    ticks, reach = round(task.episode / PERIOD) + 1, task.target.turn_rate * PERIOD
    now = wanted.draw(rng, 1)
    switch = wanted.draw_dwell(rng, stage)
    targets, turns = np.empty((ticks, 3)), np.zeros(ticks)
    for tick in range(ticks):
        step = np.clip(turn, -reach, reach)
        now[:, 2] += step
        turn = turn - step
        if switch[0] <= task.episode - wanted.quiet and tick * PERIOD >= switch[0]:
            stage += 1
            turn = wanted.draw_turn(rng, 1)
            if not turn[0]:
                now[:, 2] = wanted.draw_other_angle(rng, now[:, 2], stage)
            switch = tick * PERIOD + wanted.draw_dwell(rng, stage)
        targets[tick], turns[tick] = now[0], turn[0]
    return targets, turns


def fly_assignments(
    policy: Policy, task: Task, sky: Sky, count: int, seed: int, first: int = 0
) -> Iterator[tuple[Assignment, Recording]]:
    """Fly the flights number `first` to `first + count` of a seed, some at a time."""
    catalogue, nominal = read_drone()
    vehicle = read_strong(task.thrust_to_weight, task.commanded)
    strength = vehicle.control.thrust_max / nominal.control.thrust_max
    for start in range(first, first + count, TOGETHER):
        numbers = range(start, min(start + TOGETHER, first + count))
        batch = [assign(task, sky, number, seed, catalogue) for number in numbers]
        ours = partial(VpptwinFirmware, adaptive=sky.controller == "adaptive", vehicle=vehicle)
        firmware = None if sky.controller == "own" else ours
        targets, plans = np.stack([a.targets for a in batch]), [a.plan for a in batch]
        recordings = fly_policy(policy, targets, plans, firmware, strength)
        yield from zip(batch, recordings)


def judge(assignment: Assignment, recording: Recording, task: Task, vehicle: Vehicle) -> Outcome:
    """Measure a flight by its true states, as `vpptwin evaluate` measures one in the twin."""
    truth = recording.truth
    return judge_track(assignment, truth["position"], truth["velocity"], recording.effects, task, vehicle)


def judge_track(
    assignment: Assignment, position: np.ndarray, velocity: np.ndarray, effects: Effects, task: Task, vehicle: Vehicle
) -> Outcome:
    """Measure a flight.

    Args:
        assignment: what was asked for.
        position: true x, z, θ every ms, (K, 3) m, m, rad.
        velocity: (K, 3) m/s, m/s, rad/s.
        effects: hidden.
        task: flown.
        vehicle: whose limits count.
    """
    limits = task.success
    broken = not (np.isfinite(position).all() and np.isfinite(velocity).all())
    failed = broken or bool(task.limits.exceeded(vehicle, position, velocity).any())
    pose = position[::TICK]
    window = slice(-round(limits.window / PERIOD), None)
    left = (assignment.targets[: len(pose)] - pose)[window]
    met = limits.reach is None or meets_angles(assignment.targets[: len(pose), 2], pose[:, 2], limits.reach)
    distance, angle = np.hypot(left[:, 0], left[:, 1]).mean(), np.abs(wrap_angle(left[:, 2])).mean()
    return Outcome(
        number=assignment.number,
        effects=effects,
        failed=failed,
        success=bool(not failed and distance <= limits.position and angle <= limits.angle and met),
        position_error=float(distance),
        angle_error=float(angle),
        inverted=bool(np.cos(assignment.targets[-1, 2]) < 0.0),
        turns=count_turns(pose[:, 2:], assignment.turn[: len(pose), None], round(TURN_GRACE / PERIOD)),
    )


def meets_angles(asked: np.ndarray, theta: np.ndarray, reach: float) -> bool:
    """Whether every angle that was taken away again had been met, of all ticks (ticks,) rad each."""
    changes = np.flatnonzero(np.diff(asked)) + 1
    spans = zip([0, *changes], changes)
    return all(np.abs(wrap_angle(asked[start] - theta[start : end + 1])).min() <= reach for start, end in spans)


def measure(
    policy: Policy,
    task: Task,
    sky: Sky,
    count: int,
    seed: int,
    first: int = 0,
    tell: Callable[[Outcome], object] | None = None,
) -> list[Outcome]:
    """Fly and judge the flights number `first` to `first + count` of a seed; `tell` hears of each."""
    _, vehicle = read_drone()
    outcomes = []
    for assignment, recording in fly_assignments(policy, task, sky, count, seed, first):
        outcomes.append(judge(assignment, recording, task, vehicle))
        if tell:
            tell(outcomes[-1])
    return outcomes


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Shares, errors of the flights that did not fail, and every flight, as plain data."""
    kept = [o for o in outcomes if not o.failed]
    asked, made = np.sum([o.turns for o in kept], axis=0) if kept else (0, 0)
    upright, inverted = ([o for o in kept if o.inverted == way] for way in (False, True))
    return {
        "flights": len(outcomes),
        "success_share": float(np.mean([o.success for o in outcomes])),
        "fail_rate": float(np.mean([o.failed for o in outcomes])),
        "position_error_m": summarize(np.array([o.position_error for o in kept])),
        "upright_error_m": summarize(np.array([o.position_error for o in upright])),
        "inverted_error_m": summarize(np.array([o.position_error for o in inverted])),
        "angle_error_rad": summarize(np.array([o.angle_error for o in kept])),
        "full_turns": {"asked": int(asked), "made": int(made)},
        "each": [asdict(o) for o in outcomes],
    }
