"""The twin as a batched TorchRL environment. It works in place and shares nothing with what it takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from vpptwin.errors import InputError
from vpptwin.train.config import TrainConfig
from vpptwin.train.episodes import Episodes
from vpptwin.train.observe import accumulate_error, observation_size, observe
from vpptwin.train.randomize import ALL, Priors, randomize
from vpptwin.train.reward import compute_reward
from vpptwin.train.tasks import Task
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.health import MOST, find_diverged, save_faults, take_fault
from vpptwin.twin.past import history_depth, record_poses, start_sensors
from vpptwin.twin.sensors import read_sensors, sensor_noise
from vpptwin.twin.spec import check_effects

Rows = np.ndarray | slice
"""Which simulations: their numbers, or a slice of all."""
EVERY = slice(None)


class VppEnv(EnvBase):
    """N drones on their rails flying one task, at the policy rate.

    Besides observation, reward and the done flags every step reports `position_error` [m] and `episode_return`, (N, 1).
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
        paper_inputs: observe the paper's nine inputs, without the target's angle.
        desynchronize: start at random clock times when all are reset at once, so that not all end together.
        fault_folder: where the first steps in which a simulation diverges are written; None to only count them.

    Attributes:
        state: of the twin.
        sensors: of the motion capture, which may show the past.
        episodes: what evolves besides.
        rng: source of every random number here.
        restored: the next full reset hands out the present observation instead of drawing new episodes.
        faults: number of simulations so far that diverged and were started afresh.
    """

    batch_locked = True

    def __init__(
        self,
        twin: Twin,
        task: Task,
        seed: int = 0,
        noise: float = 0.0,
        randomized: Sequence[str] = (),
        paper_inputs: bool = False,
        desynchronize: bool = False,
        fault_folder: Path | None = None,
    ) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([twin.num_sims]))
        self.twin, self.task, self.faults, self.restored = twin, task, 0, False
        self.noise, self.randomized, self.paper_inputs = noise, tuple(randomized), paper_inputs
        self.desynchronize, self.fault_folder = desynchronize, fault_folder
        control = twin.vehicle.control
        self._scale = np.array([control.thrust_max, control.rate_max])
        self._period = 1.0 / control.policy_rate
        self._noise_std = noise * np.stack(sensor_noise(twin.vehicle))
        self._priors = Priors.of(twin.effects[effect] for effect in self.randomized)
        self.rng = np.random.default_rng(seed)
        n = twin.num_sims
        self.state = twin.initial_state()
        self._before = self.state.copy()
        self._depth = history_depth(twin.effects.values(), self._period, task.episode)
        self.sensors = start_sensors(self.state.qpos, self.state.qvel, self._depth, self._period)
        observation = np.zeros((n, observation_size(paper_inputs)), np.float32)
        self.episodes = Episodes(
            np.zeros((n, 3)), np.zeros((n, 2)), np.zeros(n), np.full(n, np.inf), np.zeros(n), observation
        )
        self._make_specs(n)

    def _make_specs(self, n: int) -> None:
        def scalar(dtype: torch.dtype) -> Unbounded:
            return Unbounded(shape=(n, 1), dtype=dtype)

        self.observation_spec = Composite(
            observation=Unbounded(shape=(n, observation_size(self.paper_inputs)), dtype=torch.float32),
            position_error=scalar(torch.float32),
            episode_return=scalar(torch.float32),
            shape=(n,),
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=(n, 2), dtype=torch.float32)
        self.reward_spec = scalar(torch.float32)
        flags = {key: Binary(1, shape=(n, 1), dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(**flags, shape=(n,))

    def _set_seed(self, seed: int | None) -> None:
        self.rng = np.random.default_rng(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        false = np.zeros(self.twin.num_sims, dtype=bool)
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        if self.restored and mask is None:
            self.restored = False
            return self._pack(false, false)
        ids = np.arange(self.twin.num_sims) if mask is None else np.flatnonzero(mask.numpy().reshape(-1))
        self._begin(ids)
        if self.desynchronize and mask is None:
            self.episodes.elapsed[ids] = self.rng.uniform(0.0, self.task.episode, len(ids))
            self.episodes.switch[ids] += self.episodes.elapsed[ids]
        return self._pack(false, false)

    def _begin(self, ids: np.ndarray) -> None:
        """Start new episodes in the rows `ids`; the other rows stay as they are."""
        rng, episodes, task = self.rng, self.episodes, self.task
        randomize(self.twin, self._priors, ids, rng)
        target = task.target.draw(rng, len(ids))
        pose, velocity = task.start.draw(rng, target)
        self.state.write_rows(ids, self.twin.initial_state(pose, velocity, ids=ids))
        self.sensors.write_rows(ids, start_sensors(pose, velocity, self._depth, self._period))
        episodes.target[ids] = target
        episodes.switch[ids] = task.target.draw_dwell(rng, len(ids))
        episodes.integral[ids] = episodes.elapsed[ids, None] = episodes.total[ids] = 0.0
        self._measure(ids)

    def _measure(self, rows: Rows = EVERY) -> None:
        """Advance the integral and take a fresh observation."""
        episodes, state = self.episodes, self.state
        pose, velocity = read_sensors(
            self.twin.constants[rows], self.sensors.take(rows), state.qpos[rows], state.qvel[rows], state.time[rows],
            self._period,
        )  # fmt: skip
        if self.noise:
            pose += self._noise_std[0] * self.rng.standard_normal(pose.shape)
            velocity += self._noise_std[1] * self.rng.standard_normal(velocity.shape)
        target = episodes.target[rows]
        integral = accumulate_error(episodes.integral[rows], (target - pose)[:, :2])
        episodes.integral[rows] = integral
        episodes.observation[rows] = observe(pose, velocity, target, integral, self.paper_inputs)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = np.clip(tensordict.get("action").detach().numpy().astype(np.float64), -1.0, 1.0)
        broken = self._fly(action * self._scale)
        episodes, task = self.episodes, self.task
        episodes.elapsed += self._period
        self._switch_targets()
        self._measure(np.flatnonzero(~broken) if broken.any() else EVERY)
        pose, velocity = self.state.qpos, self.state.qvel
        reward = compute_reward(task.weights, episodes.target - pose, velocity, episodes.integral)
        reward[broken] = 0.0
        episodes.total += reward
        terminated = task.limits.exceeded(self.twin.vehicle, pose, velocity) | broken
        truncated = (episodes.elapsed > task.episode - 0.5 * self._period) & ~terminated
        return self._pack(terminated, truncated, reward)

    def _fly(self, command: np.ndarray) -> np.ndarray:
        """Advance the twin under commands (N, 2) [N, rad/s]; tell which rows diverged and began anew, (N,) bool."""
        self._before.overwrite(self.state)
        self.twin.advance_policy(self.state, command, self._period)
        record_poses(self.sensors, self.state.qpos, self.state.qvel)
        broken = find_diverged(self.state)
        ids = np.flatnonzero(broken)
        if len(ids):
            if self.fault_folder is not None:
                kept = ids[: max(MOST - self.faults, 0)]
                faults = (take_fault(self.twin, self._before, self.state, command, self._period, i) for i in kept)
                save_faults(self.fault_folder, dict(enumerate(faults, self.faults + 1)))
            self.faults += len(ids)
            self._begin(ids)
        return broken

    def _switch_targets(self) -> None:
        episodes, target = self.episodes, self.task.target
        ids = np.flatnonzero(episodes.elapsed >= episodes.switch)
        if len(ids):
            episodes.target[ids, 2] = target.draw_other_angle(self.rng, episodes.target[ids, 2])
            episodes.switch[ids] += target.draw_dwell(self.rng, len(ids))

    def _pack(self, terminated: np.ndarray, truncated: np.ndarray, reward: np.ndarray | None = None) -> TensorDict:
        """Fresh tensors of what an agent sees now, with the reward after a step."""
        delta = self.episodes.target - self.state.qpos
        seen = {
            "observation": torch.from_numpy(self.episodes.observation.copy()),
            "position_error": as_column(np.hypot(delta[:, 0], delta[:, 1])),
            "episode_return": as_column(self.episodes.total),
            "terminated": torch.from_numpy(terminated[:, None].copy()),
            "truncated": torch.from_numpy(truncated[:, None].copy()),
            "done": torch.from_numpy((terminated | truncated)[:, None]),
        }
        if reward is not None:
            seen["reward"] = as_column(reward)
        # TorchRL would copy it all once more if it did not say where it is.
        return TensorDict(seen, batch_size=self.batch_size, device=self.device)


def as_column(values: np.ndarray) -> torch.Tensor:
    """(N,) numbers as a fresh (N, 1) float32 tensor."""
    return torch.from_numpy(values.astype(np.float32)[:, None])


def make_env(config: TrainConfig, fault_folder: Path | None = None) -> VppEnv:
    """The environment of a run.

    Raises:
        InputError: if the twin is unknown or not a drone, or an effect is not in its catalogue.
    """
    spec = load_twin(config.twin, config.effects)
    if spec.vehicle is None:
        raise InputError(f"twin {config.twin} is not the drone", "a twin that names a vehicle", "train on such a twin")
    randomized = [e.id for e in spec.catalogue] if ALL in config.randomize else config.randomize
    check_effects({effect: {} for effect in randomized}, spec.catalogue, "randomize")
    twin = Twin(spec, config.num_envs, active=randomized, num_threads=config.sim_threads)
    return VppEnv(
        twin, config.task, config.seed, config.noise, randomized, config.paper_inputs, config.desynchronize,
        fault_folder,
    )  # fmt: skip
