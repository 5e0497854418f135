"""Flying a policy over many tracks at once, and what is measured of each; exams while training keep the best policy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from vpptwin.train.config import TrainConfig
from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.train.learn.checkpoint import write_checkpoint
from vpptwin.train.learn.networks import Policy
from vpptwin.train.learn.progress import Hook
from vpptwin.train.stored import BEST_NAME

TURN_GRACE = 0.3
"""How long after the target has turned through 2π the craft may still be on its way, s."""
TURN_ERROR = 0.6
"""Angle that it may then be off, rad."""


SEED = 2_000_003
"""Of the flights, which are none of those that `vpptwin evaluate` flies by default."""
FAILED_ERROR = 0.5
"""What a failed flight counts as in the score, m."""


@dataclass
class Flights:
    """What N tracks came to."""

    position_error: np.ndarray  # mean distance over the last window of the task, (N,) m
    angle_error: np.ndarray  # likewise, (N,) rad
    failed: np.ndarray  # whether a limit was exceeded, (N,) bool
    missed: np.ndarray  # whether an angle that the task asks to be met was not, (N,) bool
    success: np.ndarray  # whether the task's measure of success is met, (N,) bool
    inverted: np.ndarray  # whether the last target is upside-down, (N,) bool
    turns: int  # number of full turns that were asked for in flights that did not fail
    turned: int  # number of those that the craft made

    def score(self, lost: float) -> float:
        """Mean position error, a flight that failed or missed an angle counted as `lost` and none as more, m."""
        return float(np.where(self.failed | self.missed, lost, np.minimum(self.position_error, lost)).mean())


@torch.no_grad()
def fly_tracks(env: VppEnv, policy: Policy) -> Flights:
    """Fly one episode in every simulation with the policy's most likely actions."""
    task, n = env.task, env.twin.num_sims
    period = 1.0 / env.twin.vehicle.control.policy_rate
    steps, window = round(task.episode / period), round(task.success.window / period)
    failed = np.zeros(n, dtype=bool)
    distance, angle = np.zeros((steps, n)), np.zeros((steps, n))
    theta, turn = np.zeros((steps, n)), np.zeros((steps, n))
    now = env.reset()
    for k in range(steps):
        now = env.step(TensorDict({"action": policy(now["observation"])}, batch_size=[n]))["next"]
        failed |= now["terminated"].numpy()[:, 0]
        delta = env.episodes.target - env.state.qpos
        distance[k], angle[k] = np.hypot(delta[:, 0], delta[:, 1]), np.abs(wrap_angle(delta[:, 2]))
        theta[k], turn[k] = env.state.qpos[:, 2], env.episodes.turn
    position_error, angle_error = distance[-window:].mean(axis=0), angle[-window:].mean(axis=0)
    limits = task.success
    missed = env.episodes.missed.copy()
    success = ~failed & (position_error <= limits.position) & (angle_error <= limits.angle) & ~missed
    turns, turned = count_turns(theta[:, ~failed], turn[:, ~failed], round(TURN_GRACE / period))
    inverted = np.abs(wrap_angle(env.episodes.target[:, 2])) > 0.5 * np.pi
    return Flights(position_error, angle_error, failed, missed, success, inverted, turns, turned)


def count_turns(theta: np.ndarray, turn: np.ndarray, grace: int) -> tuple[int, int]:
    """How many full turns were asked for, and how many were made.

    Args:
        theta: angle of the craft, unwrapped, (steps, n) rad.
        turn: what the target had still to turn through after each step, (steps, n) rad.
        grace: steps that the craft may need after the target has arrived.
    """
    begun = (turn[1:] != 0.0) & (np.abs(turn[1:]) > np.abs(turn[:-1]))
    arrived = (turn[1:] == 0.0) & (turn[:-1] != 0.0)
    turns = turned = 0
    for track in range(theta.shape[1]):
        starts, ends = np.flatnonzero(begun[:, track]).tolist(), np.flatnonzero(arrived[:, track]).tolist()
        for start, end in zip(starts, ends):
            asked = 2.0 * np.pi * np.sign(turn[start + 1, track])
            last = min(end + 1 + grace, len(theta) - 1)
            made = theta[last, track] - theta[start, track]
            turns, turned = turns + 1, turned + int(abs(made - asked) < TURN_ERROR)
    return turns, turned


class Exam(Hook):
    """Flies a fixed set at full difficulty every so many steps and keeps the best policy as best.pt.

    Logs `exam_score_m` (mean position error, `FAILED_ERROR` for a failed flight), `exam_error_m` (of those that did not
    fail; not a number if all did), `exam_failures` and `exam_success`. The random numbers of training are left as they
    are.

    Attributes:
        best: lowest score so far, m.
    """

    place, name = "post_steps_log", "exam"  # after the updates of a batch, before the checkpoint is written
    kept = ("best", "taken")

    def __init__(self, config: TrainConfig, policy: Policy, folder: Path) -> None:
        self.config, self.policy, self.path = config, policy, folder / BEST_NAME
        self.best, self.taken = float("inf"), 0
        self._env: VppEnv | None = None

    def __call__(self, batch: object = None) -> dict[str, float] | None:
        """Fly if it is time, and after the last update."""
        steps = self.trainer.collected_frames
        over = steps >= self.trainer.total_frames
        early = steps < self.config.exam_from * self.trainer.total_frames
        if not self.config.exam_every or ((early or steps - self.taken < self.config.exam_every) and not over):
            return None
        self.taken = steps
        flown = self._fly()
        score = flown.score(FAILED_ERROR)
        if score <= self.best:
            self.best = score
            write_checkpoint(self.path, self.config, self.policy, steps)
        kept = flown.position_error[~flown.failed]
        return {
            "exam_score_m": score, "exam_error_m": float(kept.mean()) if len(kept) else np.nan,
            "exam_failures": float(flown.failed.mean()), "exam_success": float(flown.success.mean()),
        }  # fmt: skip

    def _fly(self) -> Flights:
        if self._env is None:
            tracks = self.config.exam_tracks
            self._env = make_env(replace(self.config, num_envs=tracks, seed=SEED, desynchronize=False))
        self._env.set_seed(SEED)
        with torch.random.fork_rng():
            return fly_tracks(self._env, self.policy)
