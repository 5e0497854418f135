"""Flying exported policies: in the independent simulation, for measure and for the log, and in a twin, to predict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from loop.settings import Rig
from proving.drone import fly_policy, write_mcap
from proving.drone.flight import FlightPlan, fly_many
from proving.drone.policy import Policy
from proving.policy_flights import (
    PERIOD,
    Assignment,
    assign,
    draw_targets,
    judge_track,
    measure,
    read_drone,
    summarise,
)
from vpptwin.deploy.load import CompiledController
from vpptwin.robots.planar_drone.pilot.flight import fly
from vpptwin.robots.planar_drone.pilot.gusts import CARRIERS, GustProcess
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import find_manoeuvre
from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot
from vpptwin.train.env.observe import accumulate_error, observe
from vpptwin.train.env.tasks import Task
from vpptwin.twin import Twin, load_twin

LOGGED = 20.0
"""Length of a flight that is diagnosed [s]."""


def load_policy(library: Path) -> Policy:
    """An exported controller, compiled, as a function of numpy arrays (N, 11)."""
    controller = CompiledController(library)

    def act(observation: np.ndarray) -> np.ndarray:
        return np.stack([controller.act(row) for row in observation])

    return act


def fly_rig(policy: Policy, task: Task, rig: Rig, count: int, seed: int) -> dict[str, Any]:
    """Fly a rig of the independent simulation from wide random states; shares, errors and every flight."""
    return summarise(measure(policy, rig.choose_task(task), rig.sky, count, seed))


def log_flights(
    policy: Policy, task: Task, rig: Rig, seed: int, folder: Path, count: int = 2, duration: float = LOGGED
) -> list[Path]:
    """Flights of a rig that start in hover, with distractors, as logs."""
    task, rng = rig.choose_task(task), np.random.default_rng([seed, 5])
    long = Task(**{**vars(task), "episode": duration})
    targets = np.stack([draw_targets(long, rng)[0] for _ in range(count)])
    plans: list[FlightPlan] = [
        {"effects": rig.hidden, "manoeuvre": "flip", "duration": duration, "seed": int(rng.integers(2**31)),
         "session": rig.session, "distractors": True}
        for _ in range(count)
    ]  # fmt: skip
    recordings = fly_policy(policy, targets, plans)
    return [write_mcap(r, folder / f"flight_{i}.mcap") for i, r in enumerate(recordings)]


class Suggested:
    """The scripted pilot at the controls of the independent simulation, flying a manoeuvre of our library."""

    def __init__(self, manoeuvre: str, duration: float | None = None) -> None:
        _, vehicle = read_drone()
        self._pilot = ScriptedPilot(vehicle, [find_manoeuvre(LIBRARY, manoeuvre).plan(vehicle, {}, duration)])
        self._memory = np.zeros((1, 2))
        ticks = [*range(self._pilot.ticks), self._pilot.ticks - 1]  # a log has a tick at its very end
        self.setpoint = np.stack([self._pilot.target(tick).T for tick in ticks])

    @property
    def duration(self) -> float:
        """Of the manoeuvre, s."""
        return self._pilot.ticks * PERIOD

    def command(
        self, tick: int, pose: np.ndarray, speed: np.ndarray, rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Thrust N and rate rad/s, as `proving.drone.pilot.Commander` says."""
        now = min(max(tick, 0), self._pilot.ticks - 1)
        command, self._memory = self._pilot.command(now, pose.T, np.column_stack([*speed, rate]), self._memory)
        return command[:, 0], command[:, 1]


def log_manoeuvre(manoeuvre: str, rig: Rig, seed: int, folder: Path, duration: float | None = None) -> Path:
    """The suggested manoeuvre, flown by script for so long [s] or its own time, as a log."""
    pilot = Suggested(manoeuvre, duration)
    plan: FlightPlan = {
        "effects": rig.hidden, "manoeuvre": manoeuvre, "duration": pilot.duration, "seed": seed,
        "session": rig.session, "distractors": True,
    }  # fmt: skip
    return write_mcap(fly_many([plan], pilot)[0], folder / f"{manoeuvre}.mcap")


class Crew:
    """A policy as the pilot of N crafts, each with targets of its own."""

    def __init__(self, policy: Policy, targets: np.ndarray) -> None:
        self.policy, self.count, self.ticks = policy, len(targets), targets.shape[1] - 1
        self._targets = targets
        _, vehicle = read_drone()
        self._limit = np.array([vehicle.control.thrust_max, vehicle.control.rate_max])

    def target(self, tick: int) -> np.ndarray:
        """Target x, z, θ of a tick, (N, 3) m, m, rad."""
        target: np.ndarray = self._targets[:, max(tick, 0)]
        return target

    def command(
        self, tick: int, pose: np.ndarray, velocity: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Thrust [N] and rate [rad/s], (N, 2), and Γ, (N, 2) m, for the next tick."""
        target = self.target(tick)
        integral = accumulate_error(memory, (target - pose)[:, :2])
        action = self.policy(observe(pose, velocity, target, integral)).astype(float)
        return np.clip(action, -1.0, 1.0) * self._limit, integral


def predict(policy: Policy, task: Task, rig: Rig, twin: str | Path, count: int, seed: int) -> dict[str, Any]:
    """What a twin says that the flights of `fly_rig` will come to: the same starts and targets, gusts and noise.

    Of the rig it knows nothing: only where its flights begin and what they are asked for.
    """
    catalogue, vehicle = read_drone()
    flown = rig.choose_task(task)
    given: list[Assignment] = [assign(flown, rig.sky, i, seed, catalogue) for i in range(count)]
    spec = load_twin(twin)
    pilot = Crew(policy, np.stack([a.targets for a in given]))
    start = np.array([a.plan["initial"] for a in given])
    gusts = GustProcess(spec, count, pilot.ticks, seed)
    tracks = fly(Twin(spec, count, CARRIERS), pilot, seed, gusts, (start[:, :3], start[:, 3:]))
    poses, velocities = tracks.pose, tracks.velocity
    return summarise([judge_track(a, poses[i], velocities[i], {}, flown, vehicle) for i, a in enumerate(given)])
