"""The environment of a task, whoever steps its simulations: targets, episodes, observation, reward, termination.

It is written once for numpy's arrays and torch's tensors (`vpptwin.engine.arrays`); `vpp_env` steps simulations by
numba, `device_env` by Warp.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from vpptwin.engine.arrays import Array, MaskedRows, Rows, library, select
from vpptwin.system.errors import InputError
from vpptwin.train.config import Schedule
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.observe import (
    ObservationTerms,
    accumulate_error,
    observe,
    observe_critic,
    privileged_size,
    wrap_angle,
)
from vpptwin.train.env.randomize import Priors
from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, compute_reward
from vpptwin.train.env.tasks import Task
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.sensors import sensor_noise
from vpptwin.twin.stepping.past import history_depth

if TYPE_CHECKING:
    from vpptwin.train.env.renderer import Renderer

MAX_START_ANGLE = 0.3
"""Largest angle from the target at the start of an episode that is judged by its position only, rad."""
EARLY_FAILURE = 1.0
"""How long after its start a failure is put down to it, s."""


@dataclass(frozen=True)
class EnvConfig:
    """What an environment flies.

    Attributes:
        task: what to fly.
        seed: of initial states, targets, noise and randomization.
        noise: multiplies the standard deviations of the vehicle's sensors; 0 for perfect ones.
        randomized: ids of effects whose parameters are drawn from their priors at every reset.
        narrowed: parameters that the twin has intervals of are drawn within those.
        observation: what the policy is shown.
        estimator: `kalman` for a policy that is shown what the Kalman filter on board estimates, not sensor readings.
        desynchronize: start at random clock times when all are reset at once, so that not all end together.
        schedule: of training; None for flying at full difficulty.
        memory: steps that are shown to a critic; 0 for none at all.
        privileged: a critic sees the privileged state of `observe.observe_critic` instead of the policy's observation.
        fault_folder: where the first steps in which a simulation diverges are written; None to only count them.
    """

    task: Task
    seed: int = 0
    noise: float = 0.0
    randomized: Sequence[str] = ()
    narrowed: bool = False
    observation: ObservationTerms = field(default_factory=ObservationTerms)
    estimator: str = "sensors"
    desynchronize: bool = False
    schedule: Schedule | None = None
    memory: int = 0
    privileged: bool = True
    fault_folder: Path | None = None


class BaseEnv(EnvBase):
    """N drones on their rails flying one task, at the policy rate, as a batched TorchRL environment.

    Besides observation, reward and the done flags every step reports `position_error` [m], `success` (of an episode
    that ended there), `surprised` (a trigger came that values should not know of) and `episode_return`, (N, 1), and,
    for a critic, `critic_observation` (N, memory, width).
    An action (thrust, rate) in [-1, 1] is scaled with the vehicle's believed limits.

    The observation comes from the sensors (`vpptwin.twin.sensors`), with the twin's errors of them: position, angle and
    velocity from the motion capture, late as its poses are, the rate from the gyro. The velocity is the true one of the
    pose shown, with the noise of differencing over one capture interval. Reward and limits go by the truth.
    It works in place and shares nothing with what it takes and gives.

    Args:
        twin: simulates rigs; the effects that are randomized have to be switched on in it.
        config: what to fly.
        count: simulations N.
        device: of what it takes and gives.

    Attributes:
        count: N.
        state: of the twin.
        sensors: of the motion capture, which may show the past.
        episodes: what evolves besides.
        failed_starts: to be flown again in training.
        rng: source of the numbers drawn on the processor.
        draws: source of those drawn for episodes, where those are.
        duration: of an episode, s.
        flown: policy steps of each simulation so far, by which the curriculum goes.
        restored: the next full reset hands out the present observation instead of drawing new episodes.
    """

    batch_locked = True
    state: Any
    sensors: Any
    failed_starts: Any
    draws: Any
    _everyone: Rows | MaskedRows

    def __init__(self, twin: Twin, config: EnvConfig, count: int, device: torch.device) -> None:
        super().__init__(device=device, batch_size=torch.Size([count]))
        self.twin, self.config, self.count = twin, config, count
        self.task, self.schedule, self.randomized = config.task, config.schedule, tuple(config.randomized)
        self._faults: Any = 0
        self.restored, self.flown = False, 0
        control = twin.vehicle.control
        self._period = 1.0 / control.policy_rate
        self._scale: Any = np.array([control.thrust_max, control.rate_max])
        self._noise_std: Any = config.noise * np.stack(sensor_noise(twin.vehicle))
        drawn = [twin.effects[effect] for effect in self.randomized]
        self._priors = Priors.of(drawn, twin.spec.effects, twin.spec.intervals if config.narrowed else None)
        self.rng = np.random.default_rng(config.seed)
        self.duration = self.task.episode
        if self.schedule is not None:
            self.duration = self.task.training_episode or self.task.episode
        self._depth = history_depth(twin.effects.values(), self._period, self.duration)
        inputs, parameters = len(config.observation.names), len(self._priors.keys)
        width = privileged_size(parameters) if config.privileged else inputs
        self.episodes: Any = Episodes.allocate(count, inputs, parameters, config.memory, width if config.memory else 0)
        self._renderer: Renderer | None = None
        self._make_specs(count)

    def _make_specs(self, n: int) -> None:
        number = Unbounded(shape=(n, 1), dtype=torch.float32)
        shapes = {"observation": self.episodes.observation.shape}
        if self.config.memory:
            shapes["critic_observation"] = self.episodes.seen.shape
        shown = {key: Unbounded(shape=shape, dtype=torch.float32) for key, shape in shapes.items()}
        values = {key: number.clone() for key in ("position_error", "success", "surprised", "episode_return")}
        self.observation_spec = Composite(**shown, **values, shape=(n,))
        self.action_spec = Bounded(-1.0, 1.0, shape=(n, 2), dtype=torch.float32)
        self.reward_spec = number
        flags = {key: Binary(1, shape=(n, 1), dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(**flags, shape=(n,))

    @abstractmethod
    def _read(self, tensor: torch.Tensor) -> Array:
        """A tensor as an array of the environment's library."""

    @abstractmethod
    def _draw_parameters(self, rows: Any) -> None:  # noqa: ANN401
        """Draw parameters for new episodes, before anything else is drawn for them."""

    @abstractmethod
    def _start_rigs(self, rows: Any, pose: Array, velocity: Array) -> None:  # noqa: ANN401
        """Put rigs and sensors to the start of new episodes, (n, 3) each."""

    @abstractmethod
    def _fly(self, command: Array) -> tuple[Array, Array]:
        """Advance the rigs under commands (N, 2) [N, rad/s]: which diverged, and which failed, (N,) bool."""

    @abstractmethod
    def _sense(self, rows: Any) -> tuple[Array, Array]:  # noqa: ANN401
        """Pose and velocity by the sensors, without their noise, (n, 3) each."""

    @abstractmethod
    def _show_first(self) -> TwinState:
        """A state whose first row is the first simulation's."""

    @abstractmethod
    def take_snapshot(self) -> dict[str, Any]:
        """Everything that evolves, as tensors and plain data, so that a resumed run goes on as if never interrupted."""

    @property
    def faults(self) -> int:
        """Number of simulations so far that diverged and were started afresh."""
        return int(self._faults)

    @property
    def difficulty(self) -> float:
        """Level of the curriculum, 0 to 1."""
        return 1.0 if self.schedule is None else self.schedule.difficulty_at(self.flown * self.count)

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
        if self._renderer is None:
            from vpptwin.train.env.renderer import Renderer  # which brings the drawing

            self._renderer = Renderer(self.twin)
        target = np.asarray(self.episodes.target[0].tolist())
        return self._renderer.draw(self._show_first(), target, float(self.episodes.elapsed[0]))

    def _set_seed(self, seed: int | None) -> None:
        self.rng = np.random.default_rng(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        if self.restored and mask is None:
            self.restored = False
        elif mask is None:
            self._begin(self._everyone)
            if self.config.desynchronize:
                self.episodes.elapsed[:] = self.draws.uniform(0.0, self.duration, self.count)
                self._schedule(self._everyone)
        else:
            self._begin(select(self._read(mask.reshape(-1))))
        never = library(self.episodes.missed).zeros_like(self.episodes.missed)
        return self._pack(never, never)

    def _begin(self, rows: Any) -> None:  # noqa: ANN401
        """Start new episodes in some rows; the others stay as they are."""
        episodes, task, draws, schedule = self.episodes, self.task, self.draws, self.schedule
        self._draw_parameters(rows)
        target = task.target.draw(draws, rows.count)
        pose, velocity = task.start.draw(draws, target)
        single = schedule is not None and schedule.single(self.flown * self.count)
        rows.put(episodes.criterion, draws.choice([POSITION, ANGLE], rows.count) if single else BOTH)
        if schedule is not None:
            share = schedule.again(self.flown * self.count)
            target, pose, velocity = self.failed_starts.replace(share, draws, target, pose, velocity)
        rows.put(episodes.started, library(pose).column_stack([target, pose, velocity]))
        near = select(rows.take(episodes.criterion) == POSITION)
        near.put(pose[:, 2], near.take(target[:, 2]) + draws.uniform(-MAX_START_ANGLE, MAX_START_ANGLE, near.count))
        self._start_rigs(rows, pose, velocity)
        for name in ("turn", "stage", "missed", "integral", "age", "elapsed", "total", "action"):
            rows.put(getattr(episodes, name), 0)
        rows.put(episodes.target, target)
        rows.put(episodes.true_integral, (target - pose)[:, :2])
        rows.put(episodes.closest, math.inf)
        self._schedule(rows)
        self._measure(rows)
        if self.config.memory:
            rows.put(episodes.seen, rows.take(episodes.seen)[:, -1:])

    def _draw_levels(self, count: int) -> np.ndarray:
        """How far from nominal new episodes may be, (count,)."""
        level = np.full(count, self.difficulty)
        if self.schedule is not None and self.schedule.curriculum.nominal:
            level[self.rng.uniform(size=count) < self.schedule.curriculum.nominal] = 0.0
        return level

    def _schedule(self, rows: Any) -> None:  # noqa: ANN401
        """Draw when the next triggers come; none in an episode judged by its position, nor in the quiet of a flight."""
        episodes, target = self.episodes, self.task.target
        now, stage = rows.take(episodes.elapsed), rows.take(episodes.stage)
        time, soonest = now + target.draw_dwell(self.draws, stage), now + target.span_dwell(stage)[0]
        last = math.inf if self.schedule is not None else self.duration - target.quiet
        never = (time > last) | (rows.take(episodes.criterion) == POSITION)
        rows.put(episodes.switch, library(time).where(never, math.inf, time))
        rows.put(episodes.due, library(time).where(never, math.inf, soonest))

    def _measure(self, rows: Any) -> None:  # noqa: ANN401
        """Advance the integral and take a fresh observation."""
        episodes, draws, level = self.episodes, self.draws, self.difficulty
        pose, velocity = self._sense(rows)
        if self.config.noise:
            pose = pose + level * self._noise_std[0] * draws.standard_normal(pose.shape)
            velocity = velocity + level * self._noise_std[1] * draws.standard_normal(velocity.shape)
        pose, velocity = self._filter(rows, pose, velocity)
        target = rows.take(episodes.target)
        integral = accumulate_error(rows.take(episodes.integral), (target - pose)[:, :2])
        rows.put(episodes.integral, integral)
        rows.put(episodes.observation, observe(pose, velocity, target, integral, self.config.observation))
        if self.config.memory:
            now = rows.take(episodes.observation)
            if self.config.privileged:
                now = observe_critic(self.state, episodes, self.twin.vehicle, rows.key, self._unmet())
            earlier = rows.take(episodes.seen)[:, 1:]
            rows.put(episodes.seen, library(now).concatenate([earlier, now[:, None]], 1))

    def _filter(self, rows: Any, pose: Array, velocity: Array) -> tuple[Array, Array]:  # noqa: ANN401
        """What is made of the readings on board."""
        return pose, velocity

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = self._read(tensordict.get("action").detach()).clip(-1.0, 1.0)
        diverged, failed = self._fly(action * self._scale)
        episodes, task, flying = self.episodes, self.task, select(~diverged)
        xp, pose, velocity = library(diverged), self.state.qpos, self.state.qvel
        episodes.action[:] = action
        episodes.elapsed += self._period
        episodes.age += self._period
        self.flown += 1
        delta = episodes.target - pose
        error = flying.take(delta)[:, :2]
        flying.put(episodes.true_integral, accumulate_error(flying.take(episodes.true_integral), error))
        episodes.closest[:] = xp.minimum(episodes.closest, abs(wrap_angle(delta[:, 2])))
        self._move_targets()
        self._measure(flying)
        reward = compute_reward(task.weights, delta, velocity, episodes.true_integral, episodes.criterion)
        reward = xp.where(diverged, 0.0, reward)
        episodes.total += reward
        terminated = task.limits.exceeded(self.twin.vehicle, pose, velocity) | failed
        if self.schedule is not None:
            self.failed_starts.add(terminated & (episodes.age <= EARLY_FAILURE), episodes.started)
            terminated = terminated | episodes.missed | ((episodes.elapsed >= episodes.due) & self._unmet())
        truncated = (episodes.elapsed > self.duration - 0.5 * self._period) & ~terminated
        return self._pack(terminated, truncated, reward)

    def _move_targets(self) -> None:
        """Turn the targets that are turning, and let triggers come."""
        episodes, target = self.episodes, self.task.target
        episodes.surprised[:] = False
        if target.turns:
            reach = target.turn_rate * self._period
            step = episodes.turn.clip(-reach, reach)
            episodes.target[:, 2] += step
            episodes.turn -= step
        rows = select(episodes.elapsed >= episodes.switch)
        if target.dwell is None or not rows.count:
            return
        rows.put(episodes.missed, rows.take(episodes.missed | self._unmet()))
        rows.put(episodes.closest, math.inf)
        rows.put(episodes.stage, rows.take(episodes.stage) + 1)
        rows.put(episodes.surprised, not target.expected)
        now = wrap_angle(rows.take(episodes.target[:, 2]))
        turn = target.draw_turn(self.draws, rows.count)
        other = target.draw_other_angle(self.draws, now, rows.take(episodes.stage))
        rows.put(episodes.turn, turn)
        rows.put(episodes.target[:, 2], library(turn).where(turn == 0.0, other, now))
        self._schedule(rows)

    def _unmet(self) -> Array:
        """Whose angle has not been met since the last trigger, (N,) bool."""
        return self.episodes.closest > (self.task.success.reach or math.inf)

    def _pack(self, terminated: Array, truncated: Array, reward: Array | None = None) -> TensorDict:
        """Fresh tensors of what an agent sees now, with the reward after a step."""
        episodes, wanted = self.episodes, self.task.success
        delta = episodes.target - self.state.qpos
        distance = library(delta).hypot(delta[:, 0], delta[:, 1])
        there = (distance <= wanted.position) & (abs(wrap_angle(delta[:, 2])) <= wanted.angle) & ~episodes.missed
        numbers = {"position_error": distance, "success": there & truncated, "surprised": episodes.surprised,
                   "episode_return": episodes.total}  # fmt: skip
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        values = {"observation": torch.as_tensor(episodes.observation).clone()}
        values |= {name: copy_column(value, torch.float32) for name, value in numbers.items()}
        values |= {name: copy_column(value, torch.bool) for name, value in flags.items()}
        if self.config.memory:
            values["critic_observation"] = torch.as_tensor(episodes.seen).clone()
        if reward is not None:
            values["reward"] = copy_column(reward, torch.float32)
        # TorchRL would copy it all once more if it did not say where it is.
        return TensorDict(values, batch_size=self.batch_size, device=self.device)


def copy_column(values: Array, dtype: torch.dtype) -> torch.Tensor:
    """(N,) values as a fresh (N, 1) tensor."""
    return torch.as_tensor(values).to(dtype, copy=True)[:, None]
