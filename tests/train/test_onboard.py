"""Policies that are shown what the Kalman filter on board estimates."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict

from tests.train.conftest import tiny_config
from vpptwin.train.env.observe import OBSERVATION
from vpptwin.train.env.vpp_env import VppEnv, make_env

SPEED = [OBSERVATION.index(name) for name in ("velocity_x", "velocity_z")]
PLACE = [OBSERVATION.index(name) for name in ("delta_x", "delta_z")]


def fly(env: VppEnv, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the observed position and velocity under random commands, (steps, N, 2) each."""
    env.set_seed(0)
    torch.manual_seed(0)
    env.reset()
    places, speeds = [], []
    for _ in range(steps):
        action = torch.tensor([0.5, 0.0]) + 0.1 * torch.randn(env.twin.num_sims, 2)
        seen = env.step(TensorDict({"action": action.clamp(-1.0, 1.0)}, env.batch_size))["next", "observation"].numpy()
        places.append(seen[:, PLACE] - (env.episodes.target - env.state.qpos)[:, :2])
        speeds.append(seen[:, SPEED] - env.state.qvel[:, :2])
    return np.array(places), np.array(speeds)


def test_the_estimate_is_closer_than_the_sensors() -> None:
    """Half of the sensors' error in position, a tenth in velocity, with the noise of both."""
    errors = {
        name: fly(make_env(tiny_config(f"estimator={name}", "noise=1", "num_envs=32", "randomize=[]")), 40)
        for name in ("sensors", "kalman")
    }
    for part, share in ((0, 0.6), (1, 0.1)):
        sensed, estimated = (np.sqrt((errors[name][part][5:] ** 2).mean()) for name in ("sensors", "kalman"))
        assert 0.0 < estimated < share * sensed


def test_new_episodes_begin_with_what_is_known() -> None:
    """A reset row forgets its last flight: its first observation is where it starts, the others' filters go on."""
    env = make_env(tiny_config("estimator=kalman", "noise=1", "num_envs=8"))
    fly(env, 10)
    assert env.onboard is not None
    before = env.onboard.filter.pose
    mask = torch.zeros(8, 1, dtype=torch.bool)
    mask[3] = True
    env.reset(TensorDict({"_reset": mask}, [8]))
    now = env.onboard.filter.pose
    np.testing.assert_array_equal(now[[0, 1, 2, 4, 5, 6, 7]], before[[0, 1, 2, 4, 5, 6, 7]])
    np.testing.assert_allclose(now[3], env.state.qpos[3])
    np.testing.assert_allclose(env.onboard.filter.velocity[3], env.state.qvel[3])


def test_a_snapshot_holds_the_filter() -> None:
    """An environment put back goes on bit-equal."""
    config = tiny_config("estimator=kalman", "noise=1", "num_envs=8", "randomize=[gyro.bias]")
    env, other = make_env(config), make_env(config)
    fly(env, 10)
    other.restore_snapshot(env.take_snapshot())
    action = TensorDict({"action": torch.full((8, 2), 0.3)}, [8])
    here, there = (e.step(action.clone())["next", "observation"] for e in (env, other))
    assert torch.equal(here, there)
