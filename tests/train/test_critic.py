"""What an asymmetric critic is shown, what its LSTM remembers, and what it makes of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.train.conftest import HOVER, plain_schedule, reset_rows, step, tiny_env
from vpptwin.train.config import LSTM_STEPS
from vpptwin.train.env.observe import FORESIGHT, OBSERVATION, PRIVILEGED
from vpptwin.train.env.randomize import Priors
from vpptwin.train.env.reward import ANGLE, POSITION
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.train.learn.networks import Critic

WORLD = "randomize=[airframe.mass,rail_x.coulomb,mocap.delay,gyro.bias]"
"""Effects that make the sensors lie, and two that make the world another."""


def shown(env: VppEnv) -> dict[str, np.ndarray]:
    """What a critic is shown of the last step, by name, each (N,)."""
    return dict(zip(PRIVILEGED, env.episodes.seen[:, -1].T.astype(float)))


@pytest.fixture(scope="module")
def flown() -> VppEnv:
    """Forty flips after a dozen early steps: noise, drawn parameters, triggers, turns, single criteria."""
    overrides = ("task=flip", "task.target.dwell=[0.03,0.2]", "task.target.turns=0.5", "noise=1", WORLD)
    env = tiny_env("num_envs=40", *overrides, schedule=plain_schedule(4000))
    env.flown = 24  # 960 of 4000 steps: difficulty 0.35
    env.reset()
    torch.manual_seed(0)
    for _ in range(12):
        step(env, 0.5 + 0.5 * torch.rand(40, 2))
    return env


def test_a_critic_sees_the_truth(flown: VppEnv) -> None:
    """The errors to the target are the true ones, not the noisy, late and biased ones that the policy sees."""
    seen, state, target = shown(flown), flown.state, flown.episodes.target
    delta = target - state.qpos
    expected = {
        "delta_x": delta[:, 0], "delta_z": delta[:, 1],
        "velocity_x": state.qvel[:, 0], "velocity_z": state.qvel[:, 1], "rate": state.qvel[:, 2],
        "sin_delta_theta": np.sin(delta[:, 2]), "cos_delta_theta": np.cos(delta[:, 2]),
        "sin_target_theta": np.sin(target[:, 2]), "cos_target_theta": np.cos(target[:, 2]),
    }  # fmt: skip
    for name, value in expected.items():
        np.testing.assert_allclose(seen[name], value, rtol=1e-6, atol=1e-6, err_msg=name)  # float32
    told = dict(zip(OBSERVATION, flown.episodes.observation.T.astype(float)))
    for name in ("delta_x", "delta_z", "velocity_x", "velocity_z", "rate"):
        assert (np.abs(told[name] - expected[name]) > 1e-5).mean() > 0.9, name
    for axis in "xz":  # Γ is a number that the policy is fed, so the true one is the policy's
        np.testing.assert_array_equal(seen[f"integral_{axis}"], told[f"integral_{axis}"])


def test_a_critic_sees_actuators_criterion_and_triggers(flown: VppEnv) -> None:
    """Blades, rotors, the last action, what the episode is judged by, what its target has to turn, the next trigger."""
    seen, state, episodes = shown(flown), flown.state, flown.episodes
    expected = {
        "action_thrust": episodes.action[:, 0], "action_rate": episodes.action[:, 1],
        "blade_pitch_1": state.blade_pitch[:, 0] / 0.21, "blade_pitch_2": state.blade_pitch[:, 1] / 0.21,
        "rotor_speed_1": (state.rotor_speed[:, 0] - 471.239) / 50.0,
        "rotor_speed_2": (state.rotor_speed[:, 1] - 471.239) / 50.0,
        "position_only": episodes.criterion == POSITION, "angle_only": episodes.criterion == ANGLE,
        "turn": episodes.turn / (2.0 * np.pi),
        "trigger_soon": np.exp(-(episodes.switch - episodes.elapsed) / FORESIGHT),
    }  # fmt: skip
    assert {*OBSERVATION, *expected} == set(PRIVILEGED)
    for name, value in expected.items():
        np.testing.assert_allclose(seen[name], value, rtol=1e-6, atol=1e-6, err_msg=name)
        assert np.ptp(seen[name]) > 0.0, name
        assert np.abs(seen[name]).max() < 3.0, name


def test_a_critic_sees_what_was_drawn(flown: VppEnv) -> None:
    """Behind the state come the parameters of the row, each from its mean in standard deviations of its prior."""
    keys = [(effect, p) for effect in flown.randomized for p in flown.twin.effects[effect].parameters]
    assert flown.episodes.seen.shape[2] == len(PRIVILEGED) + len(keys)
    kinds = set()
    for k, (effect, parameter) in enumerate(keys):
        prior, value = parameter.prior, flown.twin.parameter(effect, parameter.name)
        # Half-normal: mean σ √(2/π), variance σ² (1 - 2/π); uniform: middle, length / √12.
        mean, spread = {
            "normal": (prior.a, prior.b),
            "halfnormal": (prior.a + prior.b * (2.0 / np.pi) ** 0.5, prior.b * (1.0 - 2.0 / np.pi) ** 0.5),
            "uniform": (0.5 * (prior.a + prior.b), (prior.b - prior.a) / 12.0**0.5),
        }[prior.kind]
        expected = np.clip((value - mean) / spread, -5.0, 5.0)
        np.testing.assert_allclose(flown.episodes.seen[:, -1, len(PRIVILEGED) + k], expected, rtol=1e-5, atol=1e-6)
        assert np.ptp(value) > 0.0
        kinds.add(prior.kind)
    assert len(kinds) >= 2


def test_standardized_draws_are_of_order_one() -> None:
    """Over the whole catalogue, draws have mean 0 and deviation 1 but where a bound cuts a tail off."""
    env = tiny_env("randomize=all")
    priors = Priors.of(env.twin.effects.values())
    values = priors.draw(np.random.default_rng(0), 4000)
    inside = ((values > priors.low) & (values < priors.high)).mean(axis=0) > 0.999
    standard = priors.standardize(values)[:, inside]
    assert inside.sum() > 20
    # 4000 draws: means are known to 0.016, deviations to 1.1 % (1.9 % for half-normals); four and more of these.
    assert np.abs(standard.mean(axis=0)).max() < 0.07
    assert np.abs(standard.std(axis=0) - 1.0).max() < 0.08


def test_a_critic_may_be_shown_the_observation() -> None:
    """With `privileged=false` critic and policy see the same, noise and setup included."""
    env = tiny_env("privileged=false", "noise=1", "setup=PI", WORLD)
    first = env.reset()
    assert torch.equal(first["critic_observation"][:, 0], first["observation"])
    last = step(env)
    assert torch.equal(last["critic_observation"][:, 0], last["observation"])


def test_an_lstm_sees_the_last_five_steps() -> None:
    """Oldest first; at the start of an episode the first step stands for those before it."""
    env = tiny_env("critic=lstm", "noise=1", WORLD)
    seen = [env.reset()["critic_observation"]]
    assert seen[0].shape[:2] == (4, LSTM_STEPS) == (4, 5)
    for k in range(5):
        assert torch.equal(seen[0][:, k], seen[0][:, -1])
    for _ in range(8):
        seen.append(step(env)["critic_observation"])
    steps = [history[:, -1] for history in (*[seen[0]] * 4, *seen)]
    for k, history in enumerate(seen):
        assert torch.equal(history, torch.stack(steps[k : k + 5], 1))
    assert not torch.equal(steps[-1], steps[-2])


def test_an_lstm_does_not_look_across_a_reset() -> None:
    """A row that begins anew shows five times its first step, while the others' histories go on."""
    env = tiny_env("critic=lstm", "noise=1", WORLD)
    env.reset()
    for _ in range(7):
        last = step(env)
    fresh = reset_rows(env, [1, 3], last)["critic_observation"]
    for row in (1, 3):
        assert (fresh[row] == fresh[row, 0]).all()
        assert not torch.equal(fresh[row, -1], last["critic_observation"][row, -1])
    assert torch.equal(fresh[[0, 2]], last["critic_observation"][[0, 2]])
    after = step(env, HOVER)["critic_observation"]
    for row in range(4):
        assert torch.equal(after[row, :-1], fresh[row, 1:])


@pytest.mark.parametrize("lstm", [0, 16])
def test_values_of_any_batch(lstm: int) -> None:
    """A batch (N, T) and its steps one by one have the same values; an LSTM uses all five steps, an MLP the last."""
    torch.manual_seed(0)
    critic = Critic(OBSERVATION, 13, (32, 16), lstm)
    seen = torch.randn(3, 4, 5, 13)
    value = critic(seen)
    assert value.shape == (3, 4, 1)
    alone = torch.stack([critic(seen[i, j][None])[0] for i in range(3) for j in range(4)]).reshape(3, 4, 1)
    torch.testing.assert_close(value, alone, rtol=1e-4, atol=1e-6)
    for k in range(5):
        other = seen.clone()
        other[:, :, k] += 1.0
        assert bool((critic(other) != value).all()) == (lstm > 0 or k == 4)


def test_an_lstm_reads_from_old_to_new() -> None:
    """The value is that of torch's cell, fed with the scaled steps one after the other from a blank memory."""
    torch.manual_seed(0)
    critic = Critic(OBSERVATION, 13, (8,), 6)
    assert critic.lstm is not None
    cell = torch.nn.LSTMCell(13, 6)
    cell.load_state_dict({name.removesuffix("_l0"): value for name, value in critic.lstm.state_dict().items()})
    seen = torch.randn(7, 5, 13)
    memory = (torch.zeros(7, 6), torch.zeros(7, 6))
    for k in range(5):
        memory = cell(critic.scale(seen[:, k]), memory)
    torch.testing.assert_close(critic(seen), critic.body(memory[0]), rtol=1e-4, atol=1e-6)
