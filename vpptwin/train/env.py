"""The twin as a batched TorchRL environment. Stepping copies in and out; nothing of it is shared with its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from vpptwin.errors import InputError
from vpptwin.train.config import TrainConfig
from vpptwin.train.observe import accumulate_error, observation_size, observe, sensor_noise
from vpptwin.train.randomize import randomize
from vpptwin.train.reward import compute_reward
from vpptwin.train.tasks import Task
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.spec import check_effects


@dataclass
class Episodes:
    """What evolves besides the twin, one row per simulation; arrays are replaced or written by row, never handed out.

    Attributes:
        target: x, z, θ, (N, 3) m, m, rad.
        integral: Γ, (N, 2) m.
        elapsed: (N,) s.
        switch: when the target's angle changes next, (N,) s.
        total: sum of rewards so far, (N,).
        observation: last one given out, (N, 11) or (N, 9).
    """

    target: np.ndarray
    integral: np.ndarray
    elapsed: np.ndarray
    switch: np.ndarray
    total: np.ndarray
    observation: np.ndarray


class VppEnv(EnvBase):
    """N drones on their rails flying one task, at the policy rate.

    Besides observation, reward and the done flags every step reports `position_error` [m] and `episode_return`, (N, 1).
    An action (thrust, rate) in [-1, 1] is scaled with the vehicle's believed limits.

    Args:
        twin: simulates the N rigs; `randomized` effects have to be switched on in it.
        task: what to fly.
        seed: of initial states, targets, noise and randomization.
        noise: multiplies the standard deviations of the vehicle's sensors; 0 for perfect ones.
        randomized: ids of effects whose parameters are drawn from their priors at every reset.
        paper_inputs: observe the paper's nine inputs, without the target's angle.
        desynchronize: start at random clock times when all are reset at once, so that not all end together.

    Attributes:
        state: of the twin.
        episodes: what evolves besides.
        rng: source of every random number here.
        restored: the next full reset hands out the present observation instead of drawing new episodes.
        faults: number of simulations so far that went non-finite and were started afresh.
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
    ) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([twin.num_sims]))
        self.twin, self.task, self.faults, self.restored = twin, task, 0, False
        self.noise, self.randomized, self.paper_inputs = noise, tuple(randomized), paper_inputs
        control = twin.vehicle.control
        self._scale = np.array([control.thrust_max, control.rate_max])
        self._period = 1.0 / control.policy_rate
        self._noise_std = sensor_noise(twin.vehicle)
        self.desynchronize = desynchronize
        self.rng = np.random.default_rng(seed)
        n = twin.num_sims
        self.state = twin.initial_state()
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
        if self.randomized:
            randomize(self.twin, self.randomized, ids, rng)
        target = task.target.draw(rng, len(ids))
        pose, velocity = task.start.draw(rng, target)
        qpos, qvel = np.zeros_like(self.state.qpos), np.zeros_like(self.state.qvel)
        qpos[ids], qvel[ids] = pose, velocity
        self.state.write_rows(ids, self.twin.initial_state(qpos, qvel).take(ids))
        episodes.target[ids] = target
        episodes.switch[ids] = task.target.draw_dwell(rng, len(ids))
        episodes.integral[ids] = episodes.elapsed[ids, None] = episodes.total[ids] = 0.0
        self._measure(ids)

    def _measure(self, ids: np.ndarray) -> None:
        """Advance the integral and take a fresh observation in the rows `ids`."""
        episodes = self.episodes
        pose, velocity = self.state.qpos[ids], self.state.qvel[ids]
        if self.noise:
            pose = pose + self.noise * self._noise_std[0] * self.rng.standard_normal(pose.shape)
            velocity = velocity + self.noise * self._noise_std[1] * self.rng.standard_normal(velocity.shape)
        target = episodes.target[ids]
        integral = accumulate_error(episodes.integral[ids], (target - pose)[:, :2])
        episodes.integral[ids] = integral
        episodes.observation[ids] = observe(pose, velocity, target, integral, self.paper_inputs)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = np.clip(tensordict.get("action").detach().numpy().astype(np.float64), -1.0, 1.0)
        self.twin.advance_policy(self.state, action * self._scale, self._period)
        broken = ~self.state.finite()
        if broken.any():
            self.faults += int(broken.sum())
            self._begin(np.flatnonzero(broken))
        episodes, task = self.episodes, self.task
        episodes.elapsed += self._period
        self._switch_targets()
        self._measure(np.flatnonzero(~broken))
        pose, velocity = self.state.qpos, self.state.qvel
        reward = compute_reward(task.weights, episodes.target - pose, velocity, episodes.integral)
        reward[broken] = 0.0
        episodes.total += reward
        terminated = task.limits.exceeded(self.twin.vehicle, pose, velocity) | broken
        truncated = (episodes.elapsed > task.episode - 0.5 * self._period) & ~terminated
        result = self._pack(terminated, truncated)
        result["reward"] = as_column(reward)
        return result

    def _switch_targets(self) -> None:
        episodes, target = self.episodes, self.task.target
        ids = np.flatnonzero(episodes.elapsed >= episodes.switch)
        if len(ids):
            episodes.target[ids, 2] = target.draw_other_angle(self.rng, episodes.target[ids, 2])
            episodes.switch[ids] += target.draw_dwell(self.rng, len(ids))

    def _pack(self, terminated: np.ndarray, truncated: np.ndarray) -> TensorDict:
        """Fresh tensors of what an agent sees now."""
        error = np.linalg.norm((self.episodes.target - self.state.qpos)[:, :2], axis=1)
        return TensorDict(
            {
                "observation": torch.from_numpy(self.episodes.observation.copy()),
                "position_error": as_column(error),
                "episode_return": as_column(self.episodes.total),
                "terminated": torch.from_numpy(terminated[:, None].copy()),
                "truncated": torch.from_numpy(truncated[:, None].copy()),
                "done": torch.from_numpy((terminated | truncated)[:, None]),
            },
            batch_size=self.batch_size,
        )


def as_column(values: np.ndarray) -> torch.Tensor:
    """(N,) numbers as a fresh (N, 1) float32 tensor."""
    return torch.from_numpy(values.astype(np.float32)[:, None])


def make_env(config: TrainConfig) -> VppEnv:
    """The environment of a run.

    Raises:
        InputError: if the twin is unknown or not a drone, or an effect is not in its catalogue.
    """
    spec = load_twin(config.twin)
    if spec.vehicle is None:
        raise InputError(f"twin {config.twin} is not the drone", "a twin that names a vehicle", "train on such a twin")
    check_effects({effect: {} for effect in config.randomize}, spec.catalogue, "randomize")
    twin = Twin(spec, config.num_envs, active=config.randomize, num_threads=config.sim_threads)
    return VppEnv(
        twin, config.task, config.seed, config.noise, config.randomize, config.paper_inputs, config.desynchronize
    )
