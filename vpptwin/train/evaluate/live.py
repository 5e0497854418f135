"""A policy flying in real time, while somebody triggers flips and pushes the craft."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint

HOUR = 3600.0
"""An episode; then the flight begins anew, s."""
KICK = 0.6
"""Change of velocity of a push, m/s."""
SPIN = 5.0
"""Change of rate of a push at an arm's end, rad/s."""
STEP = 0.2
"""By which a target is moved, m."""


class LiveFlight:
    """One craft under a policy, in the twin it was trained on with nothing randomized, with sensor noise.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        seed: of start, target and noise.

    Attributes:
        env: the environment, of one simulation.
        begun: number of times that the flight began, the first included.

    Raises:
        InputError: if the checkpoint is not what it should be.
    """

    def __init__(self, checkpoint: Path | str, seed: int = 0) -> None:
        content = read_checkpoint(checkpoint)
        self._policy, trained = build_policy(content, checkpoint)
        task = trained.task
        self._angles = task.target.angles
        calm = replace(task, episode=HOUR, target=replace(task.target, dwell=None, hold=None, turns=1.0))
        config = replace(trained, task=calm, num_envs=1, seed=seed, randomize=[], desynchronize=False, sim_threads=1)
        self.env = make_env(config)
        self.begun = 1
        self._now = self.env.reset()
        self.commands: dict[str, Callable[[], None]] = {
            "flip": self._flip,
            "turn left": lambda: self._turn(2.0 * math.pi), "turn right": lambda: self._turn(-2.0 * math.pi),
            "push left": lambda: self._push(-KICK, 0.0, 0.0), "push right": lambda: self._push(KICK, 0.0, 0.0),
            "push up": lambda: self._push(0.0, KICK, 0.0), "push down": lambda: self._push(0.0, -KICK, 0.0),
            "spin": lambda: self._push(0.0, 0.0, SPIN),
            "target left": lambda: self._move(-STEP, 0.0), "target right": lambda: self._move(STEP, 0.0),
            "target up": lambda: self._move(0.0, STEP), "target down": lambda: self._move(0.0, -STEP),
        }  # fmt: skip
        """What may be asked for, by name."""

    @property
    def period(self) -> float:
        """Time of a step, s."""
        return 1.0 / self.env.twin.vehicle.control.policy_rate

    @torch.no_grad()
    def step(self) -> None:
        """Fly one policy step; where a limit is exceeded the flight begins anew."""
        action = self._policy(self._now["observation"])
        last, self._now = self.env.step_and_maybe_reset(TensorDict({**self._now, "action": action}, batch_size=[1]))
        self.begun += int(last["next", "done"].item())

    def tell(self) -> dict[str, float]:
        """Time [s], distance from the target [m], angle from it [rad], how often the flight began."""
        episodes, pose = self.env.episodes, self.env.state.qpos[0]
        off = episodes.target[0] - pose
        return {
            "time": round(float(episodes.elapsed[0]), 2), "distance": round(float(np.hypot(off[0], off[1])), 4),
            "angle": round(float(abs(wrap_angle(off[2:])[0])), 3), "begun": self.begun,
        }  # fmt: skip

    def _flip(self) -> None:
        """Ask for the next of the task's angles; a task that has one asks for that turned over."""
        choices = np.asarray(self._angles if len(self._angles) > 1 else [self._angles[0], self._angles[0] + math.pi])
        target = self.env.episodes.target
        now = int(np.argmin(np.abs(wrap_angle(choices - target[0, 2]))))
        target[0, 2] = choices[(now + 1) % len(choices)]

    def _turn(self, angle: float) -> None:
        self.env.episodes.turn[0] += angle

    def _push(self, *change: float) -> None:
        self.env.state.qvel[0] += change

    def _move(self, right: float, up: float) -> None:
        """Move the target, within what the rig reaches."""
        travel = np.array([self.env.twin.vehicle.rig.travel_x, self.env.twin.vehicle.rig.travel_z])
        target, room = self.env.episodes.target, np.array([0.3, 0.5])
        target[0, :2] = np.clip(target[0, :2] + [right, up], travel[:, 0] + room, travel[:, 1] - room)
