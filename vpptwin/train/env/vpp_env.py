"""The twin as a batched TorchRL environment. It works in place and shares nothing with what it takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from vpptwin.system.errors import InputError
from vpptwin.train.config import Lesson, TrainConfig
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.observe import Sight, accumulate_error, observe, wrap_angle
from vpptwin.train.env.onboard import Onboard
from vpptwin.train.env.privileged import privileged_size, see_everything
from vpptwin.train.env.randomize import IDENTIFIED, Priors, name_effects, randomize
from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, compute_reward
from vpptwin.train.env.rotors import load_trained_twin, strengthen
from vpptwin.train.env.starts import SOON, FailedStarts
from vpptwin.train.env.tasks import Task
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.health import MAX_FAULTS, find_diverged, save_faults, take_fault
from vpptwin.twin.sensors import read_sensors, sensor_noise
from vpptwin.twin.spec import TwinSpec, check_effects
from vpptwin.twin.stepping.past import history_depth, record_poses, start_sensors

if TYPE_CHECKING:
    from vpptwin.train.env.watch import Watcher

Rows = np.ndarray | slice
"""Which simulations: their numbers, or a slice of all."""
EVERY = slice(None)
NEAR = 0.3
"""Largest angle from the target at the start of an episode that is judged by its position only, rad."""


class VppEnv(EnvBase):
    """N drones on their rails flying one task, at the policy rate.

    Besides observation, reward and the done flags every step reports `position_error` [m], `success` (of an episode
    that ended there), `surprised` (a trigger came that values should not know of) and `episode_return`, (N, 1), and,
    for a critic, `critic_observation` (N, memory, width).
    An action (thrust, rate) in [-1, 1] is scaled with the vehicle's believed limits.

    The observation comes from the sensors (`vpptwin.twin.sensors`), with the twin's errors of them: position, angle and
    velocity from the motion capture, late as its poses are, the rate from the gyro. The velocity is the true one of the
    pose shown, with the noise of differencing over one capture interval. Reward and limits go by the truth.

    Args:
        twin: simulates the N rigs; `randomized` effects have to be switched on in it.
        task: what to fly.
        seed: of initial states, targets, noise and randomization.
        noise: multiplies the standard deviations of the vehicle's sensors; 0 for perfect ones.
        randomized: ids of effects whose parameters are drawn from their priors at every reset.
        sight: what the policy is shown; by default everything of SPEC 6.
        desynchronize: start at random clock times when all are reset at once, so that not all end together.
        lesson: of training; None for flying at full difficulty.
        memory: steps that are shown to a critic; 0 for none at all.
        privileged: a critic sees `privileged.py`'s state instead of the policy's observation.
        fault_folder: where the first steps in which a simulation diverges are written; None to only count them.
        estimator: `kalman` for a policy that is shown what the Kalman filter on board estimates, not sensor readings.
        narrowed: parameters that the twin has intervals of are drawn within those.
        count: N, where the twin's simulations are others (`vpptwin.train.env.device_env`).
        device: of what it takes and gives, likewise.

    Attributes:
        count: N.
        state: of the twin.
        sensors: of the motion capture, which may show the past.
        episodes: what evolves besides.
        failed_starts: to be flown again in training.
        rng: source of every random number here.
        duration: of an episode, s.
        flown: policy steps of each simulation so far, by which the curriculum goes.
        restored: the next full reset hands out the present observation instead of drawing new episodes.
        faults: number of simulations so far that diverged and were started afresh.
    """

    batch_locked = True

    def __init__(
        self, twin: Twin, task: Task, seed: int = 0, noise: float = 0.0, randomized: Sequence[str] = (),
        sight: Sight | None = None, desynchronize: bool = False, lesson: Lesson | None = None, memory: int = 0,
        privileged: bool = True, fault_folder: Path | None = None, estimator: str = "sensors", narrowed: bool = False,
        count: int | None = None, device: torch.device | None = None,
    ) -> None:  # fmt: skip
        self.count = twin.num_sims if count is None else count
        super().__init__(device=device or torch.device("cpu"), batch_size=torch.Size([self.count]))
        self.twin, self.task, self.faults, self.restored, self.flown = twin, task, 0, False, 0
        self.noise, self.randomized, self.sight = noise, tuple(randomized), sight or Sight()
        self.desynchronize, self.lesson, self.fault_folder = desynchronize, lesson, fault_folder
        self.privileged = privileged
        control = twin.vehicle.control
        self._scale = np.array([control.thrust_max, control.rate_max])
        self._period = 1.0 / control.policy_rate
        self._noise_std = noise * np.stack(sensor_noise(twin.vehicle))
        drawn = [twin.effects[effect] for effect in self.randomized]
        self._priors = Priors.of(drawn, twin.spec.effects, twin.spec.intervals if narrowed else None)
        self.rng = np.random.default_rng(seed)
        n, parameters = self.count, len(self._priors.keys)
        self.state = twin.initial_state()
        self._before = self.state.copy()
        self.duration = task.episode if lesson is None else task.training_episode or task.episode
        self._depth = history_depth(twin.effects.values(), self._period, self.duration)
        self.sensors = start_sensors(self.state.qpos, self.state.qvel, self._depth, self._period)
        width = privileged_size(parameters) if privileged else len(self.sight.names)
        self.onboard = Onboard(twin, noise) if estimator == "kalman" else None
        self.episodes = Episodes.allocate(n, len(self.sight.names), parameters, memory, width if memory else 0)
        self.failed_starts = FailedStarts.empty()
        self._watcher: Watcher | None = None
        self._make_specs(n)

    @property
    def difficulty(self) -> float:
        """Level of the curriculum, 0 to 1."""
        return 1.0 if self.lesson is None else self.lesson.difficulty_at(self.flown * self.count)

    def _make_specs(self, n: int) -> None:
        number = Unbounded(shape=(n, 1), dtype=torch.float32)
        shapes = {"observation": self.episodes.observation.shape}
        if self.episodes.seen.size:
            shapes["critic_observation"] = self.episodes.seen.shape
        shown = {key: Unbounded(shape=shape, dtype=torch.float32) for key, shape in shapes.items()}
        told = {key: number.clone() for key in ("position_error", "success", "surprised", "episode_return")}
        self.observation_spec = Composite(**shown, **told, shape=(n,))
        self.action_spec = Bounded(-1.0, 1.0, shape=(n, 2), dtype=torch.float32)
        self.reward_spec = number
        flags = {key: Binary(1, shape=(n, 1), dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(**flags, shape=(n,))

    @property
    def max_steps(self) -> int:
        """Policy steps of an episode; TorchRL's rlrender asks for it."""
        return round(self.duration / self._period)

    def render(self, mode: str = "rgb_array") -> np.ndarray:
        """The first simulation seen from the side, (400, 640, 3) uint8.

        Args:
            mode: `rgb_array`, the only one.

        Raises:
            InputError: on another mode.
        """
        if mode != "rgb_array":
            raise InputError(f"render mode {mode!r}", "rgb_array", "leave it out")
        if self._watcher is None:
            from vpptwin.train.env.watch import Watcher  # which brings the drawing

            self._watcher = Watcher(self.twin)
        target = np.asarray(self.episodes.target[0].tolist())
        return self._watcher.draw(self._show_first(), target, float(self.episodes.elapsed[0]))

    def _show_first(self) -> TwinState:
        """A state whose first row is the first simulation's."""
        return self.state

    def _set_seed(self, seed: int | None) -> None:
        self.rng = np.random.default_rng(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        false = np.zeros(self.count, dtype=bool)
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        if self.restored and mask is None:
            self.restored = False
            return self._pack(false, false)
        ids = np.arange(self.count) if mask is None else np.flatnonzero(mask.numpy().reshape(-1))
        self._begin(ids)
        if self.desynchronize and mask is None:
            self.episodes.elapsed[ids] = self.rng.uniform(0.0, self.duration, len(ids))
            self._schedule(ids)
        return self._pack(false, false)

    def _begin(self, ids: np.ndarray) -> None:
        """Start new episodes in the rows `ids`; the other rows stay as they are."""
        rng, episodes, task, count = self.rng, self.episodes, self.task, len(ids)
        drawn = randomize(self.twin, self._priors, ids, rng, self._draw_levels(count))
        target = task.target.draw(rng, count)
        pose, velocity = task.start.draw(rng, target)
        criterion = self._draw_criteria(count)
        if self.lesson is not None:
            self.failed_starts.replace(self.lesson.again(self.flown * self.count), rng, target, pose, velocity)
        episodes.started[ids] = np.column_stack([target, pose, velocity])
        near = criterion == POSITION
        pose[near, 2] = target[near, 2] + rng.uniform(-NEAR, NEAR, int(near.sum()))
        self.state.write_rows(ids, self.twin.initial_state(pose, velocity, ids=ids))
        self.sensors.write_rows(ids, start_sensors(pose, velocity, self._depth, self._period))
        if self.onboard is not None:
            self.onboard.begin(ids, pose, velocity)
        episodes.target[ids], episodes.criterion[ids] = target, criterion
        episodes.turn[ids] = episodes.elapsed[ids] = episodes.age[ids] = episodes.total[ids] = episodes.stage[ids] = 0
        episodes.integral[ids] = episodes.action[ids] = 0.0
        episodes.true_integral[ids] = (target - pose)[:, :2]
        episodes.closest[ids], episodes.missed[ids] = np.inf, False
        self._schedule(ids)
        if episodes.seen.size:
            episodes.drawn[ids] = np.clip(self._priors.standardize(drawn), -5.0, 5.0)
        self._measure(ids)
        episodes.seen[ids] = episodes.seen[ids, -1:]

    def _draw_levels(self, count: int) -> np.ndarray:
        """How far from nominal new episodes may be, (count,)."""
        level = np.full(count, self.difficulty)
        if self.lesson is not None and self.lesson.curriculum.nominal:
            level[self.rng.uniform(size=count) < self.lesson.curriculum.nominal] = 0.0
        return level

    def _draw_criteria(self, count: int) -> np.ndarray:
        """What new episodes are judged by, (count,): below the lesson's level one criterion each."""
        if self.lesson is None or not self.lesson.single(self.flown * self.count):
            return np.full(count, BOTH)
        return self.rng.choice([POSITION, ANGLE], count)

    def _schedule(self, ids: np.ndarray) -> None:
        """Draw when the next triggers come; none in an episode judged by its position, nor in the quiet of a flight."""
        episodes, target = self.episodes, self.task.target
        now, stage = episodes.elapsed[ids], episodes.stage[ids]
        time, soonest = now + target.draw_dwell(self.rng, stage), now + target.span_dwell(stage)[0]
        last = np.inf if self.lesson is not None else self.duration - target.quiet
        never = (time > last) | (episodes.criterion[ids] == POSITION)
        episodes.switch[ids], episodes.due[ids] = np.where(never, np.inf, [time, soonest])

    def _measure(self, rows: Rows = EVERY) -> None:
        """Advance the integral and take a fresh observation."""
        episodes, state = self.episodes, self.state
        pose, velocity = read_sensors(
            self.twin.constants[rows], self.sensors.take(rows), state.qpos[rows], state.qvel[rows], state.time[rows],
            self._period,
        )  # fmt: skip
        if self.noise:
            level = self.difficulty
            pose += level * self._noise_std[0] * self.rng.standard_normal(pose.shape)
            velocity += level * self._noise_std[1] * self.rng.standard_normal(velocity.shape)
        if self.onboard is not None:
            pose, velocity = self.onboard.correct(pose, rows)
        target = episodes.target[rows]
        integral = accumulate_error(episodes.integral[rows], (target - pose)[:, :2])
        episodes.integral[rows] = integral
        episodes.observation[rows] = observe(pose, velocity, target, integral, self.sight)
        if episodes.seen.size:
            # One step on: what was the second becomes the first.
            episodes.seen[rows, :-1] = episodes.seen[rows, 1:]
            now = episodes.observation[rows]
            if self.privileged:
                now = see_everything(state, episodes, self.twin.vehicle, rows, self._unmet())
            episodes.seen[rows, -1] = now

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = np.clip(tensordict.get("action").detach().numpy().astype(np.float64), -1.0, 1.0)
        broken = self._fly(action * self._scale)
        episodes, task = self.episodes, self.task
        episodes.action[:] = action
        episodes.elapsed += self._period
        episodes.age += self._period
        self.flown += 1
        pose, velocity = self.state.qpos, self.state.qvel
        delta = episodes.target - pose
        unbroken = np.flatnonzero(~broken) if broken.any() else EVERY
        earned = accumulate_error(episodes.true_integral[unbroken], delta[unbroken, :2])
        episodes.true_integral[unbroken] = earned
        np.minimum(episodes.closest, np.abs(wrap_angle(delta[:, 2])), out=episodes.closest)
        self._move_targets()
        self._measure(unbroken)
        reward = compute_reward(task.weights, delta, velocity, episodes.true_integral, episodes.criterion)
        reward[broken] = 0.0
        episodes.total += reward
        terminated = task.limits.exceeded(self.twin.vehicle, pose, velocity) | broken
        if self.lesson is not None:
            self._remember(terminated)
            terminated |= episodes.missed | ((episodes.elapsed >= episodes.due) & self._unmet())
        truncated = (episodes.elapsed > self.duration - 0.5 * self._period) & ~terminated
        return self._pack(terminated, truncated, reward)

    def _remember(self, failed: np.ndarray) -> None:
        """Keep the starts of episodes that failed soon, of `failed` (N,)."""
        ids = np.flatnonzero(failed & (self.episodes.age <= SOON))
        if len(ids):
            self.failed_starts.add(*np.split(self.episodes.started[ids], 3, axis=1))

    def _fly(self, command: np.ndarray) -> np.ndarray:
        """Advance the twin under commands (N, 2) [N, rad/s]; tell which rows diverged and began anew, (N,) bool."""
        self._before.overwrite(self.state)
        if self.onboard is None:
            self.twin.advance_policy(self.state, command, self._period)
        else:
            path = self.twin.trace_policy(self.state, command, self._period)
            self.onboard.follow(self.twin, path, self.state, self.difficulty, self.rng)
        record_poses(self.sensors, self.state.qpos, self.state.qvel)
        broken = find_diverged(self.state)
        ids = np.flatnonzero(broken)
        if len(ids):
            if self.fault_folder is not None:
                kept = ids[: max(MAX_FAULTS - self.faults, 0)]
                faults = (take_fault(self.twin, self._before, self.state, command, self._period, i) for i in kept)
                save_faults(self.fault_folder, dict(enumerate(faults, self.faults + 1)))
            self.faults += len(ids)
            self._begin(ids)
        return broken

    def _move_targets(self) -> None:
        """Turn the targets that are turning, and let triggers come."""
        episodes, target = self.episodes, self.task.target
        episodes.surprised[:] = False
        if target.turns:
            reach = target.turn_rate * self._period
            step = np.clip(episodes.turn, -reach, reach)
            episodes.target[:, 2] += step
            episodes.turn -= step
        ids = np.flatnonzero(episodes.elapsed >= episodes.switch)
        if not len(ids):
            return
        episodes.missed[ids] |= self._unmet()[ids]
        episodes.closest[ids] = np.inf
        episodes.stage[ids] += 1
        episodes.surprised[ids] = not target.expected
        now = wrap_angle(episodes.target[ids, 2])
        turn = target.draw_turn(self.rng, len(ids))
        other = target.draw_other_angle(self.rng, now, episodes.stage[ids])
        episodes.turn[ids] = turn
        episodes.target[ids, 2] = np.where(turn == 0.0, other, now)
        self._schedule(ids)

    def _unmet(self) -> np.ndarray:
        """Whose angle has not been met since the last trigger, (N,) bool."""
        return self.episodes.closest > (self.task.success.reach or np.inf)

    def _pack(self, terminated: np.ndarray, truncated: np.ndarray, reward: np.ndarray | None = None) -> TensorDict:
        """Fresh tensors of what an agent sees now, with the reward after a step."""
        episodes, wanted = self.episodes, self.task.success
        delta = episodes.target - self.state.qpos
        distance = np.hypot(delta[:, 0], delta[:, 1])
        there = (distance <= wanted.position) & (np.abs(wrap_angle(delta[:, 2])) <= wanted.angle) & ~episodes.missed
        told = {
            "observation": torch.from_numpy(episodes.observation.copy()),
            "position_error": as_column(distance),
            "success": as_column(there & truncated),
            "surprised": as_column(episodes.surprised),
            "episode_return": as_column(episodes.total),
            "terminated": torch.from_numpy(terminated[:, None].copy()),
            "truncated": torch.from_numpy(truncated[:, None].copy()),
            "done": torch.from_numpy((terminated | truncated)[:, None]),
        }
        if episodes.seen.size:
            told["critic_observation"] = torch.from_numpy(episodes.seen.copy())
        if reward is not None:
            told["reward"] = as_column(reward)
        # TorchRL would copy it all once more if it did not say where it is.
        return TensorDict(told, batch_size=self.batch_size, device=self.device)


def as_column(values: np.ndarray) -> torch.Tensor:
    """(N,) numbers as a fresh (N, 1) float32 tensor."""
    return torch.from_numpy(values.astype(np.float32)[:, None])


def make_env(config: TrainConfig, fault_folder: Path | None = None, lesson: Lesson | None = None) -> VppEnv:
    """The environment of a run.

    Args:
        config: of the run.
        fault_folder: where simulations that diverged are written; None to only count them.
        lesson: of training; None for flying at full difficulty.

    Raises:
        InputError: if the twin is unknown or not a drone, or an effect is not in its catalogue.
    """
    spec, randomized = load_randomized(config)
    twin = Twin(spec, config.num_envs, active=randomized, num_threads=config.sim_threads)
    return VppEnv(
        twin, config.task, config.seed, config.noise, randomized, config.sight, config.desynchronize, lesson,
        config.critic_memory, config.privileged, fault_folder, config.estimator, IDENTIFIED in config.randomize,
    )  # fmt: skip


def load_randomized(config: TrainConfig) -> tuple[TwinSpec, list[str]]:
    """The twin of a run, and the effects of it that are drawn.

    Raises:
        InputError: as `make_env`.
    """
    spec = load_trained_twin(config)
    _ = spec.vehicle  # refuses other rigs
    randomized = name_effects(config.randomize, spec.catalogue, spec.intervals)
    check_effects({effect: {} for effect in randomized}, spec.catalogue, "randomize")
    return strengthen(spec, config.task.thrust_to_weight, config.task.commanded), randomized
