"""The batched environment: specs, partial resets, ends of episodes, determinism, independence of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from tests.train.conftest import tiny_config, tiny_env
from vpptwin.train.env import VppEnv, make_env
from vpptwin.train.observe import observe
from vpptwin.train.snapshot import restore_snapshot, take_snapshot
from vpptwin.train.tasks import HOVER as HOVERING
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.health import MOST, find_diverged, replay_fault
from vpptwin.twin.sensors import sensor_noise

HOVER = torch.tensor([0.4905, 0.0])
"""Action that carries craft and slider: (0.450 + 0.050) kg * 9.81 m/s^2 of 10 N."""


def step(env: VppEnv, action: torch.Tensor) -> TensorDict:
    """One step of all simulations, without a reset; what `next` holds."""
    return env.step(TensorDict({"action": action.expand(env.batch_size[0], 2)}, batch_size=env.batch_size))["next"]


def reset_rows(env: VppEnv, rows: list[int], last: TensorDict) -> TensorDict:
    """Reset only `rows`, as TorchRL does after the step that returned `last`."""
    mask = torch.zeros(env.batch_size[0], 1, dtype=torch.bool)
    mask[rows] = True
    return env.reset(last.exclude("reward").set("_reset", mask))


@pytest.mark.parametrize("overrides", [(), ("paper_inputs=true",), ("noise=1", "randomize=all")])
def test_specs(overrides: tuple[str, ...]) -> None:
    """TorchRL's own check of shapes, types and reset behaviour passes."""
    check_env_specs(tiny_env(*overrides), seed=0)


def test_hovering_thrust_carries_the_craft() -> None:
    """Actions are scaled with the vehicle's limits: thrust equal to the weight keeps the vertical velocity."""
    env = tiny_env("task.start.theta=[0,0]", "task.start.rate=[0,0]")
    env.reset()
    rotor = env.twin.vehicle.rotor
    for name in ("horn", "blade", "output", "mean"):  # blades already at hovering pitch
        env.state.actuators[name] = 0.5 * 4.905 / (rotor.k_t * rotor.speed)
    before = env.state.qvel.copy()
    for _ in range(20):
        step(env, HOVER)
    # The governed rotors sag by a few rad/s under the load: 0.2 s at 1 % of gravity is 0.02 m/s.
    np.testing.assert_allclose(env.state.qvel[:, 1], before[:, 1], atol=0.02)


def test_partial_reset_touches_only_its_rows() -> None:
    """Rows outside the mask keep state, integral, clock and observation; masked rows start afresh."""
    env = tiny_env("noise=1", "randomize=all")
    env.reset()
    for _ in range(5):
        last = step(env, HOVER)
    old_state, old_episodes = env.state.copy(), {k: v.copy() for k, v in vars(env.episodes).items()}
    old_sensors = env.sensors.take(np.array([0, 2]))
    fresh = reset_rows(env, [1, 3], last)
    for name, old in old_episodes.items():
        np.testing.assert_array_equal(getattr(env.episodes, name)[[0, 2]], old[[0, 2]], err_msg=name)
    np.testing.assert_array_equal(env.state.qpos[[0, 2]], old_state.qpos[[0, 2]])
    np.testing.assert_array_equal(env.state.rotor_speed[[0, 2]], old_state.rotor_speed[[0, 2]])
    for name, old in old_sensors.arrays().items():
        np.testing.assert_array_equal(env.sensors.arrays()[name][[0, 2]], old, err_msg=name)
    torch.testing.assert_close(fresh["observation"][[0, 2]], last["observation"][[0, 2]], rtol=0, atol=0)
    np.testing.assert_array_equal(env.episodes.elapsed[[1, 3]], 0.0)
    np.testing.assert_array_equal(env.state.time[[1, 3]], 0.0)
    assert (env.state.qpos[[1, 3]] != old_state.qpos[[1, 3]]).all()
    # A fresh integral is the first error alone.
    torch.testing.assert_close(fresh["observation"][[1, 3], 7:9], fresh["observation"][[1, 3], 0:2])


def test_integral_follows_the_recursion_in_flight() -> None:
    """The observed Γ obeys Γ_t = 0.9 Γ_{t-1} + Δp_t at every step."""
    env = tiny_env()
    previous = env.reset()["observation"][:, 7:9]
    for _ in range(10):
        now = step(env, HOVER)["observation"]
        torch.testing.assert_close(now[:, 7:9], 0.9 * previous + now[:, 0:2], rtol=1e-5, atol=1e-6)  # float32
        previous = now[:, 7:9]


def test_time_limit_truncates() -> None:
    """An episode that runs out of time is truncated, not terminated, at its length and not before."""
    env = tiny_env("task.episode=1", "task.success.window=0.5", "task.start.theta=[0,0]")
    env.reset()
    for k in range(100):
        last = step(env, HOVER)
        assert last["truncated"].all() == (k == 99)
    assert not last["terminated"].any()
    assert torch.equal(last["done"], last["truncated"])


@pytest.mark.parametrize(
    ("pose", "velocity"),
    [
        ((1.6, 1.2, 0.0), (0.0, 0.0, 0.0)),  # past the right end of the rail
        ((0.0, 0.23, 1.5), (0.0, 0.0, 0.0)),  # arm on end, 0.2 m long: its tip is 3 cm above the floor
        ((0.0, 1.2, 0.0), (9.0, 0.0, 0.0)),  # faster than 8 m/s
        ((0.0, 1.2, 0.0), (0.0, 0.0, 60.0)),  # spinning faster than 40 rad/s
    ],
)
def test_failures_terminate(pose: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    """Leaving the travel, touching the floor and flying too fast end an episode as terminated, not truncated."""
    env = tiny_env()
    env.reset()
    qpos, qvel = env.state.qpos.copy(), env.state.qvel.copy()
    qpos[2], qvel[2] = pose, velocity
    env.state = replace(env.state, qpos=qpos, qvel=qvel)
    last = step(env, HOVER)
    assert last["terminated"][:, 0].tolist() == [False, False, True, False]
    assert not last["truncated"].any()


def test_outputs_are_not_shared() -> None:
    """What a step returned stays as it was when the environment goes on."""
    env = tiny_env("noise=1")
    first = env.reset()
    kept = first.clone()
    second = step(env, HOVER)
    kept_second = second.clone()
    reset_rows(env, [0], step(env, HOVER))
    for now, before in ((first, kept), (second, kept_second)):
        for key in before.keys():  # noqa: SIM118 - a TensorDict iterates over rows
            assert torch.equal(now[key], before[key]), key


@pytest.mark.parametrize("overrides", [(), ("noise=1", "randomize=all", "desynchronize=true")])
def test_same_seed_same_flight(overrides: tuple[str, ...]) -> None:
    """A seed fixes starts, targets, noise and parameters; another seed changes them."""
    runs = []
    for seed in (3, 3, 4):
        env = tiny_env(*overrides, f"seed={seed}")
        torch.manual_seed(0)
        runs.append(env.rollout(30, break_when_any_done=False)["next", "observation"])
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_row_equals_single() -> None:
    """A drone of a batch flies bit-equal to the same drone alone."""
    many, one = tiny_env(), tiny_env("num_envs=1", "minibatch=8")
    many.reset()
    one.reset()
    one.state = many.state.take(np.array([2]))
    for name, value in vars(many.episodes).items():
        setattr(one.episodes, name, value[[2]].copy())
    torch.manual_seed(0)
    for _ in range(25):
        action = 2.0 * torch.rand(4, 2) - 1.0
        row = many.step(TensorDict({"action": action}, batch_size=[4]))["next"][2:3]
        single = one.step(TensorDict({"action": action[2:3]}, batch_size=[1]))["next"]
        for key in ("observation", "reward", "terminated", "truncated"):
            assert torch.equal(row[key], single[key]), key


def test_clocks_are_desynchronized() -> None:
    """With the option on, first episodes end at different times; without it all together."""
    together, spread = tiny_env(), tiny_env("desynchronize=true")
    together.reset()
    spread.reset()
    assert np.ptp(together.episodes.elapsed) == 0.0
    assert len(set(spread.episodes.elapsed)) == 4
    assert (spread.episodes.elapsed < spread.task.episode).all()


@pytest.mark.parametrize("way", ["action", "velocity", "state"])
def test_broken_simulation_is_replaced(tmp_path: Path, way: str) -> None:
    """A simulation that diverges is terminated, counted, written down and started afresh; the others do not notice."""
    config = tiny_config("num_envs=4", "minibatch=32", "desynchronize=false", "randomize=all")
    env, healthy = make_env(config, tmp_path / "faults"), make_env(config)
    env.reset()
    healthy.reset()
    action = HOVER.repeat(4, 1)
    broken = action.clone()
    if way == "action":
        broken[1, 0] = torch.nan
    else:
        env.state.qvel[1] = 1e200 if way == "velocity" else np.nan
    last, expected = step(env, broken), step(healthy, action)
    assert env.faults == 1
    assert last["terminated"][:, 0].tolist() == [False, True, False, False]
    assert last["reward"][1] == 0.0
    replay = replay_fault(tmp_path / "faults" / "fault-0001.npz")
    assert replay.equal
    assert find_diverged(replay.after).all()
    for _ in range(10):
        assert torch.isfinite(last["observation"]).all()
        for key in ("observation", "reward", "terminated"):
            assert torch.equal(last[key][[0, 2, 3]], expected[key][[0, 2, 3]])
        last, expected = step(env, action), step(healthy, action)
    assert env.faults == 1


def test_faults_are_bounded_on_disk(tmp_path: Path) -> None:
    """Every fault is counted, the first ones are kept, and a run without any leaves no folder."""
    env = make_env(tiny_config("num_envs=16", "task.start.theta=[0,0]"), tmp_path / "faults")
    env.reset()
    step(env, HOVER)
    assert not (tmp_path / "faults").exists()
    for _ in range(3):
        assert torch.isfinite(step(env, torch.tensor([torch.nan, 0.0]))["observation"]).all()
    assert env.faults == 48
    assert len(list((tmp_path / "faults").iterdir())) == MOST


def see(env: VppEnv) -> np.ndarray:
    """Measured x, z, θ, v_x, v_z, q, read out of the last observation, (N, 6)."""
    seen, target = env.episodes.observation.astype(float), env.episodes.target
    angle = target[:, 2] - np.arctan2(seen[:, 4], seen[:, 5])
    return np.column_stack([target[:, :2] - seen[:, :2], angle, seen[:, 2:4], seen[:, 6]])


def truth(env: VppEnv) -> np.ndarray:
    """The true x, z, θ, v_x, v_z, q, (N, 6)."""
    return np.column_stack([env.state.qpos, env.state.qvel])


def test_perfect_sensors_show_the_truth() -> None:
    """Without noise and effects, or with every effect at its off value, what is observed is the state to the bit."""
    for env in (tiny_env(), VppEnv(Twin(load_twin(), 4, active=[e.id for e in load_twin().catalogue]), HOVERING)):
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
    """Every effect can be drawn; parameters and constants of the rows that fly on stay as they are."""
    env = tiny_env("randomize=all")
    assert env.randomized == tuple(effect.id for effect in env.twin.spec.catalogue)
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


def test_targets_switch() -> None:
    """With a dwell time the target's angle changes among the choices while the position stays."""
    env = tiny_env("task.target.angles=[0,3.14159]", "task.target.dwell=[0.05,0.1]", "task.start.theta=[0,0]")
    env.reset()
    position = env.episodes.target[:, :2].copy()
    angles = []
    for _ in range(40):
        step(env, HOVER)
        angles.append(env.episodes.target[:, 2].copy())
    assert set(np.unique(angles)) == {0.0, 3.14159}
    changes = np.count_nonzero(np.diff(angles, axis=0), axis=0)
    # 0.39 s with a change every 0.05 to 0.1 s.
    assert ((changes >= 3) & (changes <= 8)).all()
    np.testing.assert_array_equal(env.episodes.target[:, :2], position)


def test_snapshot_continues_bit_equal() -> None:
    """An environment put back from a snapshot flies, measures and draws as the original does."""
    overrides = ("noise=1", "randomize=all")
    original, copy = tiny_env(*overrides), tiny_env(*overrides, "seed=9")
    original.reset()
    for _ in range(5):
        step(original, HOVER)
    restore_snapshot(copy, take_snapshot(original))
    assert torch.equal(copy.reset()["observation"], torch.from_numpy(original.episodes.observation))
    for _ in range(5):
        here, there = step(copy, HOVER), step(original, HOVER)
        assert torch.equal(here["observation"], there["observation"])
    here, there = reset_rows(copy, [1], here), reset_rows(original, [1], there)
    assert torch.equal(here["observation"], there["observation"])
    assert torch.equal(step(copy, HOVER)["observation"], step(original, HOVER)["observation"])
