"""A trained policy as a pilot: one flight of its task, for `vpptwin fly`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from vpptwin.robots.planar_drone.pilot.manoeuvre import SHORTEST, check_duration
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.observe import accumulate_error, observe
from vpptwin.train.env.rotors import strengthen
from vpptwin.train.env.tasks import TASKS, Task, check_task_name
from vpptwin.train.learn.actor import build_actor
from vpptwin.train.stored import open_checkpoint
from vpptwin.twin.spec import TwinSpec


class PolicyPilot:
    """Flies one craft by a policy, which sees what it was trained on.

    Args:
        policy: from observations (N, inputs) to actions (N, 2), as an `Actor`; None for those who decide otherwise.
        trained: how it was trained.
        task: whose targets are flown, drawn from `seed`.
        vehicle: believed numbers, which scale its actions.
        duration: s; None for an episode, or the shortest flight that can be diagnosed.
        seed: of the targets.
    """

    def __init__(
        self, policy: Callable[[np.ndarray], np.ndarray] | None, trained: TrainConfig, task: Task, vehicle: Vehicle,
        duration: float | None, seed: int,
    ) -> None:  # fmt: skip
        self.task = task.name
        self.count, period = 1, 1.0 / vehicle.control.policy_rate
        self.ticks = round(check_duration(max(task.episode, SHORTEST) if duration is None else duration) / period)
        self.policy, self.trained = policy, trained
        self._limit = np.array([vehicle.control.thrust_max, vehicle.control.rate_max])
        self._targets = plan_targets(task, self.ticks, period, np.random.default_rng(seed))

    def target(self, tick: int) -> np.ndarray:
        """Target x, z, θ of a tick, (1, 3) m, m, rad; before the first tick the first target."""
        target: np.ndarray = self._targets[max(tick, 0)]
        return target

    def command(
        self, tick: int, pose: np.ndarray, velocity: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Thrust [N] and rate [rad/s], (1, 2), from estimates (1, 3), and Γ, (1, 2) m, for the next tick."""
        target = self.target(tick)
        integral = accumulate_error(memory, (target - pose)[:, :2])
        seen = observe(pose, velocity, target, integral, self.trained.observation)
        assert self.policy is not None
        action = self.policy(seen).astype(np.float64)
        return np.clip(action, -1.0, 1.0) * self._limit, integral


def plan_targets(task: Task, ticks: int, period: float, rng: np.random.Generator) -> np.ndarray:
    """Targets x, z, θ of every tick of one flight, (ticks, 1, 3) m, m, rad: triggers, full turns, quiet at the end."""
    wanted, stage = task.target, np.zeros(1, int)
    now = wanted.draw(rng, 1)
    switch, turn = wanted.draw_dwell(rng, stage), np.zeros(1)
    planned = np.empty((ticks, 1, 3))
    for tick in range(ticks):
        step = np.clip(turn, -wanted.turn_rate * period, wanted.turn_rate * period)
        now[:, 2] += step
        turn -= step
        if tick * period >= switch[0] and tick < ticks - round(wanted.quiet / period):
            stage += 1
            turn = wanted.draw_turn(rng, 1)
            if not turn[0]:
                now[:, 2] = wanted.draw_other_angle(rng, now[:, 2], stage)
            switch = switch + wanted.draw_dwell(rng, stage)
        planned[tick] = now
    return planned


def load_pilot(
    checkpoint: Path, task: str | None, spec: TwinSpec, duration: float | None, seed: int
) -> tuple[PolicyPilot, TwinSpec]:
    """The pilot of a checkpoint, and the twin with rotors as strong as its task wants them.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        task: whose targets to fly; None, or the same name, for that of training with its overrides.
        spec: the twin to fly, a drone.
        duration: s; None for an episode.
        seed: of the targets.

    Raises:
        InputError: if the file is no checkpoint of this version, there is no such task, or the duration is not allowed.
    """
    check_task_name(task)
    actor, trained = build_actor(open_checkpoint(checkpoint), checkpoint)
    chosen = choose_task(trained, task)
    spec = strengthen(spec, chosen.thrust_to_weight, chosen.commanded)
    return PolicyPilot(actor, trained, chosen, spec.vehicle, duration, seed), spec


def choose_task(trained: TrainConfig, task: str | None) -> Task:
    """The task of a known name; that of training, with its overrides, for None or the same name."""
    return trained.task if task in (None, trained.task.name) else TASKS[str(task)]
