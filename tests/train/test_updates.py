"""What happens to a batch and to weights between two collections: advantages, minibatches, averages."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ValueOperator
from torchrl.objectives.value import GAE

from tests.train.conftest import EXAMINED
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import OBSERVATION, ObservationTerms
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.networks import Critic, Policy
from vpptwin.train.learn.updates import Advantages, Averaging, ExplorationRamp, Minibatches, normalize
from vpptwin.train.main import run_train
from vpptwin.train.stored import FILE_NAME

GAMMA, LMBDA, SCALE = 0.97, 0.9, 0.05


def draw_batch(seed: int, drones: int = 6, steps: int = 20, memory: int = 1, width: int = 14) -> TensorDict:
    """A collected batch (N, T) with ends inside: some episodes terminated, some truncated, one at the very end."""
    torch.manual_seed(seed)
    terminated, truncated = torch.rand(2, drones, steps, 1) < 0.1
    truncated &= ~terminated
    terminated[0, -1], truncated[0, -1], truncated[1, -1], terminated[1, -1] = True, False, True, False
    done = terminated | truncated
    assert terminated[:, :-1].any()
    assert truncated[:, :-1].any()
    assert not done[2:, -1].all()
    seen, following = torch.randn(2, drones, steps, memory, width)
    # Inside an episode what comes next is the root of the next step, as a collector has it.
    inside = ~done[:, :-1, 0]
    following[:, :-1][inside] = seen[:, 1:][inside]
    last = {
        "critic_observation": following, "reward": torch.rand(drones, steps, 1), "done": done,
        "terminated": terminated, "truncated": truncated, "surprised": torch.zeros(drones, steps, 1),
    }  # fmt: skip
    batch = {
        "critic_observation": seen, "observation": torch.randn(drones, steps, 11),
        "action": torch.randn(drones, steps, 2), "action_log_prob": torch.randn(drones, steps), "next": last,
    }  # fmt: skip
    return TensorDict(batch, batch_size=[drones, steps])


@pytest.mark.parametrize("lstm", [0, 8])
def test_advantages_are_torchrls(lstm: int) -> None:
    """Looking values up instead of computing them twice gives what TorchRL's own module gives, ends included."""
    batch = draw_batch(0, memory=5 if lstm else 1)
    critic = ValueOperator(Critic(OBSERVATION, 14, (16,), lstm), in_keys=["critic_observation"])
    ours = Advantages(critic.module, GAMMA, LMBDA, SCALE)(batch)
    theirs = batch.clone()
    theirs["next", "reward"] *= SCALE
    module = GAE(gamma=GAMMA, lmbda=LMBDA, value_network=critic, average_gae=True, deactivate_vmap=True)
    with torch.no_grad():
        module(theirs)
    for key in ("advantage", "value_target"):
        torch.testing.assert_close(ours[key], theirs[key], rtol=1e-4, atol=1e-5)  # float32 sums of 20 steps
    for key in ("observation", "critic_observation", "action", "action_log_prob"):
        assert torch.equal(ours[key], batch[key])


def test_advantages_by_hand() -> None:
    """Two steps to a failure, two to a time limit, a critic that always says 2: δ = r + γ V' - V, summed backwards."""
    batch = draw_batch(0)[:2, :2].clone()
    last = batch["next"]
    last["reward"][:] = torch.tensor([[[1.0], [3.0]], [[1.0], [3.0]]])
    for key, row in (("terminated", 0), ("truncated", 1)):
        last[key][:] = False
        last[key][row, 1] = True
    last["done"][:] = last["terminated"] | last["truncated"]

    class Constant(torch.nn.Module):
        def forward(self, seen: torch.Tensor) -> torch.Tensor:
            return torch.full((*seen.shape[:-2], 1), 2.0)

    result = Advantages(Constant(), 0.5, 0.5, 1.0)(batch)
    # Failure: δ = 1 + 1 - 2 = 0, then 3 - 2 = 1, so A = (0 + 0.25, 1); limit: δ = 0, then 3 + 1 - 2 = 2, A = (0.5, 2).
    advantage = torch.tensor([0.25, 1.0, 0.5, 2.0])
    torch.testing.assert_close(result["value_target"].flatten(), 2.0 + advantage)
    expected = (advantage - advantage.mean()) / advantage.std()
    torch.testing.assert_close(result["advantage"].flatten(), expected)


def test_surprises_are_no_loss() -> None:
    """At a trigger that values should not know of, what comes after counts as what came before: V' = V, and no trace.

    With values 2, 3, 4, 5 and one more 5, rewards of 1, γ = λ = 0.5 and the trigger in the second step:
    δ = 1 + 1.5 - 2, 1 + 1.5 - 3, 1 + 2.5 - 4, 1 + 2.5 - 5; A4 = -1.5, A3 = -0.5 - 0.375, A2 = -0.5, A1 = 0.5 - 0.125.
    """
    batch = draw_batch(0)[:1, :4].clone()
    last = batch["next"]
    last["reward"][:] = 1.0
    for key in ("done", "terminated", "truncated"):
        last[key][:] = False
    last["surprised"][0, 1] = 1.0
    batch["critic_observation"][0, :, 0, 0] = torch.tensor([2.0, 3.0, 4.0, 5.0])
    last["critic_observation"][0, :, 0, 0] = torch.tensor([3.0, 4.0, 5.0, 5.0])

    class First(torch.nn.Module):
        def forward(self, seen: torch.Tensor) -> torch.Tensor:
            return seen[..., -1, :1]

    result = Advantages(First(), 0.5, 0.5, 1.0)(batch)
    advantage = torch.tensor([0.375, -0.5, -0.875, -1.5])
    torch.testing.assert_close(result["value_target"].flatten(), torch.tensor([2.0, 3.0, 4.0, 5.0]) + advantage)
    torch.testing.assert_close(result["advantage"].flatten(), (advantage - advantage.mean()) / advantage.std())


@pytest.mark.parametrize("groups", [1, 3, 10])
def test_advantages_are_normalized_among_steps_of_like_value(groups: int) -> None:
    """Sorted by value, each part has mean 0 and deviation 1, and inside it the order and the ratios stay."""
    torch.manual_seed(0)
    value = torch.randn(20, 15, 1)
    advantage = torch.randn(20, 15, 1) * (2.0 + value).abs() + value
    result = normalize(advantage, value, groups)
    assert result.shape == advantage.shape
    order = value.flatten().argsort()
    for ids in order.reshape(groups, -1):
        before, after = advantage.flatten()[ids], result.flatten()[ids]
        assert float(after.mean()) == pytest.approx(0.0, abs=1e-5)
        assert float(after.std()) == pytest.approx(1.0, rel=1e-4)
        torch.testing.assert_close(after, (before - before.mean()) / before.std(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("count", [1, 7])
def test_few_or_equal_advantages_stay_finite(count: int) -> None:
    """More groups than steps, or steps that are all alike: no advantage, not a division by zero."""
    assert torch.equal(normalize(torch.full((count,), 3.0), torch.arange(count) * 1.0, 10), torch.zeros(count))


def test_advantages_are_computed_once_per_batch() -> None:
    """Asked again for the same batch, as before every epoch, the first answer comes back; another batch has its own."""
    critic = Critic(OBSERVATION, 14, (16,))
    advantages = Advantages(critic, GAMMA, LMBDA, SCALE)
    one, other = draw_batch(0), draw_batch(1)
    first = advantages(one)
    with torch.no_grad():
        critic.body[0].weight.add_(1.0)
    assert advantages(one) is first
    assert not torch.equal(advantages(other)["advantage"], first["advantage"])
    assert not torch.equal(advantages(one)["value_target"], first["value_target"])


def test_minibatches_use_every_sample_once() -> None:
    """An epoch hands out all samples in a new order, but for a remainder smaller than half a minibatch."""
    minibatches = Minibatches(32)
    batch = TensorDict({"k": torch.arange(80).reshape(8, 10)}, batch_size=[8, 10])
    orders = []
    for _ in range(2):
        flat = minibatches.shuffle(batch)
        taken = [minibatches.take(flat)["k"] for _ in range(3)]
        with pytest.raises(StopIteration):
            minibatches.take(flat)
        assert sorted(map(len, taken)) == [16, 32, 32]
        orders.append(torch.cat(taken).tolist())
        assert sorted(orders[-1]) == list(range(80))
    assert orders[0] != orders[1]
    flat = minibatches.shuffle(batch[:, :9])  # 72 samples: 8 are left over
    assert [len(minibatches.take(flat)) for _ in range(2)] == [32, 32]
    with pytest.raises(StopIteration):
        minibatches.take(flat)


def test_average_by_hand() -> None:
    """The first update is taken as it is; then 80 % of the average stay and 20 % come from the weights of now."""
    torch.manual_seed(0)
    policy = Policy(ObservationTerms(), (4, 4))
    averaging = Averaging(policy, 0.8)
    history = []
    for _ in range(4):
        with torch.no_grad():
            for weights in policy.parameters():
                weights.copy_(torch.randn_like(weights))
        history.append(copy.deepcopy(policy.state_dict()))
        averaging()
    # 0.8 (0.8 (0.8 w0 + 0.2 w1) + 0.2 w2) + 0.2 w3
    for key, value in averaging.averaged.state_dict().items():
        w0, w1, w2, w3 = (weights[key] for weights in history)
        torch.testing.assert_close(value, 0.512 * w0 + 0.128 * w1 + 0.16 * w2 + 0.2 * w3)
        assert torch.equal(policy.state_dict()[key], w3)


def test_no_average_is_the_policy_itself() -> None:
    """With a share of 0 what flies is what is trained, to the bit."""
    policy = Policy(ObservationTerms(), (4, 4))
    averaging = Averaging(policy, 0.0)
    for _ in range(3):
        with torch.no_grad():
            for weights in policy.parameters():
                weights.copy_(torch.randn_like(weights))
        averaging()
        for mine, averaged in zip(policy.parameters(), averaging.averaged.parameters()):
            assert torch.equal(mine, averaged)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_end_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: float) -> None:
    """One line says so, and the checkpoint written before is as it was."""
    ramp, calls, kept = ExplorationRamp.__call__, 0, b""

    def spoil(self: ExplorationRamp) -> None:
        nonlocal calls, kept
        calls += 1
        ramp(self)
        if calls == 3:
            kept = (tmp_path / FILE_NAME).read_bytes()
            with torch.no_grad():
                self.exploration.policy.body[3].weight[1, 1] = value

    monkeypatch.setattr(ExplorationRamp, "__call__", spoil)
    with pytest.raises(InputError, match="not finite") as caught:
        run_train([*EXAMINED, f"out={tmp_path}"])
    assert "\n" not in str(caught.value)
    assert (tmp_path / FILE_NAME).read_bytes() == kept
    assert read_checkpoint(tmp_path, flying=False)["steps"] == 256


@pytest.mark.parametrize("lipschitz", ["8", "null"])
def test_a_learning_rate_that_explodes_ends_a_run(
    tmp_path: Path, lipschitz: str, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Whether or not layers are bound, weights that overflow while a batch is learned from are told in one line."""
    monkeypatch.setattr("vpptwin.train.config.MAX_NUMBER", 1e31)  # what overflows at once is refused else
    with pytest.raises(InputError, match="not finite") as caught:
        run_train([*EXAMINED, f"out={tmp_path}", "learning_rate.start=1e30", f"lipschitz={lipschitz}"])
    assert "\n" not in str(caught.value)
    assert not (tmp_path / FILE_NAME).exists()


@pytest.mark.slow
def test_exploration_may_be_learned(tmp_path: Path) -> None:
    """With the paper's preset its width is a weight for each output, from where the schedule starts."""
    out = run_train([*EXAMINED, "preset=paper", f"out={tmp_path}", "total_steps=512", "exam_every=0", "lipschitz=null"])
    weights = read_checkpoint(out, flying=False)["training"]["trainer"]["loss_module"]
    (learned,) = [value for key, value in weights.items() if key.endswith("log_std")]
    assert learned.shape == (2,)
    assert 1e-4 < float((learned.exp() - 0.55).abs().max()) < 0.2
