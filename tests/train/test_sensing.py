"""What the environment's sensors show: the truth, or their errors, delays and noise; and what is drawn at resets."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.train.conftest import HOVER, reset_rows, see, step, tiny_config, tiny_env, truth
from vpptwin.train.env.base_env import EnvConfig
from vpptwin.train.env.observe import OBSERVATION, observe
from vpptwin.train.env.reward import compute_reward
from vpptwin.train.env.tasks import HOVER as HOVERING
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.sensors import sensor_noise


def test_perfect_sensors_show_the_truth() -> None:
    """Without noise and effects, or with every effect at its off value, what is observed is the state to the bit."""
    twin = Twin(load_twin(), 4, active=[e.id for e in load_twin().catalogue])
    for env in (tiny_env(), VppEnv(twin, EnvConfig(HOVERING))):
        env.reset()
        for _ in range(7):
            step(env, torch.tensor([0.6, 0.3]))
            state, episodes = env.state, env.episodes
            expected = observe(state.qpos, state.qvel, episodes.target, episodes.integral)
            np.testing.assert_array_equal(episodes.observation, expected)


def test_errors_of_the_sensors_are_observed() -> None:
    """Positions are scaled and late, angles shifted and late, the rate is off but never late."""
    env = tiny_env("randomize=[mocap.delay,mocap.scale,mocap.misalignment,gyro.bias,gyro.scale]")
    env.reset()
    late, scale = np.array([0.0, 0.01, 0.02, 0.04]), np.array([1.0, 1.02, 0.98, 1.01])
    env.twin.set_parameter("mocap.delay", "delay", late)
    env.twin.set_parameter("mocap.scale", "scale", scale)
    env.twin.set_parameter("mocap.misalignment", "angle", 0.05)
    env.twin.set_parameter("gyro.bias", "bias", 0.1)
    env.twin.set_parameter("gyro.scale", "scale", 0.9)
    flown = []
    for _ in range(9):
        step(env, torch.tensor([0.7, 0.2]))
        flown.append(truth(env))
    past = np.array([flown[-1 - round(delay / 0.01)][i] for i, delay in enumerate(late)])
    expected = past * np.column_stack([scale, scale, np.ones(4), scale, scale, np.ones(4)])
    expected[:, 2] += 0.05
    expected[:, 5] = 0.9 * flown[-1][:, 5] + 0.1
    np.testing.assert_allclose(see(env), expected, atol=2e-6)  # the observation is float32


def test_noise_has_the_stds_of_the_sensors() -> None:
    """What noise adds is centred and spread as the vehicle's sensors are, twice that at noise=2."""
    env = tiny_env("noise=2", "num_envs=2000", "minibatch=64")
    env.reset()
    error = see(env) - truth(env)
    expected = 2.0 * np.concatenate(sensor_noise(env.twin.vehicle))
    # 2000 draws: the deviation is known to 1.6 %, the mean to 2.2 % of it; four of these are allowed.
    np.testing.assert_allclose(error.std(axis=0), expected, rtol=0.065)
    assert (np.abs(error.mean(axis=0)) < 0.09 * expected).all()


def test_randomization_starts_from_nominal() -> None:
    """Every draw comes from the prior around the nominal vehicle: a thousand resets do not wander off."""
    env = tiny_env("randomize=[airframe.mass]", "num_envs=64", "minibatch=64")
    parameter = env.twin.effects["airframe.mass"].parameters[0]
    masses = []
    for _ in range(16):
        env.reset()
        masses.append(env.twin.parameter("airframe.mass", "mass"))
    drawn = np.concatenate(masses)
    # 1024 draws: the mean is known to std/32, the deviation to 2 %; four and five of these are allowed.
    assert abs(drawn.mean() - parameter.prior.a) < 4.0 * parameter.prior.b / 32.0
    assert drawn.std() == pytest.approx(parameter.prior.b, rel=0.1)


def test_partial_reset_randomizes_only_its_rows() -> None:
    """Every effect but contacts' is drawn; parameters and constants of the rows that fly on stay as they are."""
    env = tiny_env("randomize=all")
    assert env.randomized == tuple(effect.id for effect in env.twin.spec.catalogue if not effect.touching)
    env.reset()
    keys = [(e.id, p.name) for e in env.twin.effects.values() for p in e.parameters]
    before, constants = {key: env.twin.parameter(*key) for key in keys}, env.twin.constants.copy()
    reset_rows(env, [0], step(env, HOVER))
    for key in keys:
        after = env.twin.parameter(*key)
        assert after[0] != before[key][0], key
        np.testing.assert_array_equal(after[1:], before[key][1:])
    np.testing.assert_array_equal(env.twin.constants[1:], constants[1:])
    assert env.twin.constants[0] != constants[0]


def test_reward_goes_by_the_truth() -> None:
    """Every term, Γ too: a motion capture that is 20 % off in scale, late and noisy changes what is seen, not paid."""
    env = tiny_env("randomize=[mocap.scale,mocap.delay]", "noise=1", "task.weights.integral=1", "task.start.x=[1,1]")
    env.reset()
    env.twin.set_parameter("mocap.scale", "scale", 1.2)
    env.twin.set_parameter("mocap.delay", "delay", 0.02)
    integral = env.episodes.target[:, :2] - truth(env)[:, :2]  # Γ_0 = Δp_0
    for _ in range(5):
        paid = step(env)["reward"].numpy()[:, 0]
        delta = env.episodes.target - truth(env)[:, :3]
        integral = 0.9 * integral + delta[:, :2]
        expected = compute_reward(env.task.weights, delta, truth(env)[:, 3:], integral)
        np.testing.assert_allclose(paid, expected, rtol=1e-6)  # the reward is float32
    assert np.abs(env.episodes.integral - integral)[:, 0].min() > 0.2  # m; that of the policy is what it senses


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
