"""The actor: its layers, what it does without exploring, and its Lipschitz bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from tests.train.conftest import EXAMINED
from vpptwin.train.config import to_config
from vpptwin.train.env.observe import OBSERVATION, SETUPS, ObservationTerms
from vpptwin.train.evaluate.evaluate import load_policy
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.networks import (
    INPUT_SCALE,
    Exploration,
    Policy,
    bound_layers,
    make_actor,
    spectral_norm,
    surely_within,
)
from vpptwin.train.main import run_train

TIGHT = 0.125
"""A bound that binds from the start: an untrained actor's layers have norms of about 2, 1 and 0.07."""


def wild_policy(seed: int, gain: float = 5.0) -> Policy:
    """A policy whose weights are larger than those that training begins with."""
    torch.manual_seed(seed)
    policy = Policy(ObservationTerms())
    with torch.no_grad():
        for layer in policy.layers():
            layer.weight.mul_(gain)
    return policy


def layer_norms(policy: Policy) -> list[float]:
    """Largest singular value of every layer, by numpy in double precision."""
    return [float(np.linalg.norm(layer.weight.detach().double().numpy(), 2)) for layer in policy.layers()]


@pytest.fixture(scope="module")
def tight_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished tiny run with the bound `TIGHT`, exams and averaging."""
    folder = tmp_path_factory.mktemp("runs") / "tight"
    return run_train([*EXAMINED, f"out={folder}", f"lipschitz={TIGHT}", "total_steps=512"])


def test_policy_is_the_mode_of_the_trained_actor() -> None:
    """What is deployed is what the exploring actor does when it does not explore: tanh of the network, in [-1, 1]."""
    policy = wild_policy(0)
    actor = make_actor(Exploration(policy, 0.4))
    observation = 5.0 * torch.randn(64, 11)
    batch = TensorDict({"observation": observation}, batch_size=[64])
    distribution = actor.get_dist(actor(batch))
    torch.testing.assert_close(distribution.deterministic_sample, policy(observation))
    assert policy(observation).abs().max() <= 1.0


@pytest.mark.parametrize("setup", SETUPS)
def test_paper_network(setup: str) -> None:
    """The actor is the paper's: 96 ReLU, 64 tanh, two outputs, of whatever inputs a setup has."""
    policy, inputs = Policy(ObservationTerms(setup)), len(ObservationTerms(setup).names)
    layers = [str(layer).split("(")[0] for layer in policy.body[1:]]
    assert layers == ["Linear", "ReLU", "Linear", "Tanh", "Linear"]
    assert [tuple(layer.weight.shape) for layer in policy.layers()] == [(96, inputs), (64, 96), (2, 64)]
    assert policy(torch.zeros(3, inputs)).shape == (3, 2)


def test_inputs_are_scaled_by_name() -> None:
    """A policy of fewer inputs divides each by the size that it has among all of them; angles stay as they are."""
    full = dict(zip(OBSERVATION, Policy(ObservationTerms()).body[0].scale.tolist()))
    for setup in SETUPS:
        names = ObservationTerms(setup).names
        scale = dict(zip(names, Policy(ObservationTerms(setup)).body[0].scale.tolist()))
        assert all(scale[name] == full[name] == INPUT_SCALE[name] for name in names if name in INPUT_SCALE)
        assert {scale[name] for name in names if "theta" in name} == {1.0}


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10_000), st.floats(1e-3, 1e3))
@settings(max_examples=50)
def test_spectral_norm_is_the_largest_singular_value(rows: int, columns: int, seed: int, size: float) -> None:
    """As numpy's singular value decomposition has it, for wide, tall, square and single-row matrices."""
    weight = size * torch.randn(rows, columns, generator=torch.Generator().manual_seed(seed))
    expected = np.linalg.svd(weight.double().numpy(), compute_uv=False)[0]
    # float32 keeps 7 digits; squaring for the Gram matrix costs the largest value none of them but a factor.
    assert float(spectral_norm(weight)) == pytest.approx(expected, rel=1e-5)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10_000), st.floats(1e-9, 1e6))
@settings(max_examples=50)
def test_what_is_surely_within_a_bound_is(rows: int, columns: int, seed: int, bound: float) -> None:
    """Never said of a bound below the spectral norm, always of one by a quarter above; sizes do not matter."""
    weight = torch.randn(rows, columns, generator=torch.Generator().manual_seed(seed))
    norm = float(spectral_norm(weight))
    weight *= bound / norm
    assert not surely_within(weight, 0.999 * bound)
    assert surely_within(weight, 1.27 * bound)  # 40 equal singular values: 40 ** (1 / 16) = 1.26
    assert not surely_within(weight * torch.nan, bound)


@given(st.integers(0, 10_000), st.floats(1e-3, 3.0))
@settings(max_examples=50, deadline=None)
def test_actions_change_no_faster_than_the_bound(seed: int, apart: float) -> None:
    """‖Δa‖ ≤ lipschitz() ‖Δs‖ of scaled inputs s, and lipschitz_si() times the distance in SI units, far and near."""
    policy = wild_policy(seed, 2.0)
    scaling = policy.body[0]
    for size in (1.0, 0.01):
        here = size * scaling.scale * torch.randn(256, 11)
        there = here + size * scaling.scale * apart * torch.randn(256, 11)
        change = (policy(here) - policy(there)).norm(dim=1)
        for allowed in (
            policy.lipschitz() * (scaling(here) - scaling(there)).norm(dim=1),
            policy.lipschitz_si() * (here - there).norm(dim=1),
        ):
            assert (change <= 1.0001 * allowed + 1e-5).all()  # actions are float32 numbers of order 1


def test_small_distances_are_magnified() -> None:
    """A centimetre and its integral count as by hand, rising throughout; speeds and angles are only divided."""
    scaling = Policy(ObservationTerms()).body[0]
    one = dict(zip(OBSERVATION, scaling(torch.full((1, 11), 0.01))[0].tolist()))
    assert one["delta_x"] == one["delta_z"] == pytest.approx(0.01 / 0.5 + 0.25 * 0.01 / 0.03)
    assert one["integral_x"] == one["integral_z"] == pytest.approx(0.01 / 2.0 + 0.25 * 0.01 / 0.21)
    assert (one["velocity_x"], one["rate"], one["sin_delta_theta"]) == pytest.approx((0.005, 0.002, 0.01))
    along = scaling(torch.linspace(-3.0, 3.0, 6001)[:, None].expand(-1, 11))
    assert (along.diff(dim=0) > 0.0).all()
    torch.testing.assert_close(along, -along.flip(0))
    step = torch.full((1, 11), 1e-6)
    torch.testing.assert_close((scaling(step) / step)[0], scaling.steepest, rtol=1e-3, atol=0.0)
    assert float(scaling.steepest.max()) == pytest.approx(14.5)


def test_the_bound_is_not_loose() -> None:
    """A chain of layers that pass one direction on, near their steepest points, comes within 1 % of its bound."""
    policy = Policy(ObservationTerms())
    with torch.no_grad():
        for layer, gain in zip(policy.layers(), (2.0, 3.0, 0.5)):
            layer.weight.zero_()
            layer.bias.zero_()
            layer.weight[0, 0] = gain
        next(policy.layers()).bias.fill_(1e-3)  # where the ReLU is open
        assert policy.lipschitz() == pytest.approx(3.0)
        step = torch.zeros(1, 11)
        step[0, 0] = 1e-4
        change = (policy(step) - policy(torch.zeros(1, 11))).norm()
    assert float(change / policy.body[0](step).norm()) == pytest.approx(3.0, rel=0.01)
    assert float(change / step.norm()) == pytest.approx(policy.lipschitz_si(), rel=0.02)


@pytest.mark.parametrize("bound", [0.5, 8.0, 100.0])
def test_projection_scales_down_what_is_too_steep(bound: float) -> None:
    """Layers above the third root of the bound come down to it, in their direction; flatter ones stay to the bit."""
    policy = wild_policy(1)
    before = [layer.weight.detach().clone() for layer in policy.layers()]
    norms, share = layer_norms(policy), bound ** (1.0 / 3.0)
    assert min(norms) < 2.0 < 4.7 < max(norms)
    bound_layers(policy, bound)
    for layer, weight, norm in zip(policy.layers(), before, norms):
        if norm <= share:
            assert torch.equal(layer.weight, weight)
        else:
            torch.testing.assert_close(layer.weight, weight * (share / norm), rtol=1e-5, atol=1e-7)
    assert policy.lipschitz() <= bound * (1.0 + 1e-5)  # three layers rounded to float32
    once = [layer.weight.detach().clone() for layer in policy.layers()]
    bound_layers(policy, bound)
    for layer, weight in zip(policy.layers(), once):
        torch.testing.assert_close(layer.weight, weight, rtol=1e-6, atol=0.0)


def test_training_keeps_the_bound(tight_run: Path) -> None:
    """After a run every layer of what was trained, of its average and of the best policy is within its share.

    The bound binds: some layer stands at its share.
    """
    raw = Policy(ObservationTerms())
    weights = read_checkpoint(tight_run, flying=False)["training"]["trainer"]["loss_module"]
    prefix = next(key for key in weights if key.endswith("body.1.weight") and "actor" in key)[: -len("body.1.weight")]
    raw.load_state_dict({key: weights[prefix + key] for key in raw.state_dict()})
    for policy in (raw, load_policy(tight_run / "checkpoint.pt"), load_policy(tight_run / "best.pt")):
        norms = layer_norms(policy)
        assert max(norms) <= TIGHT ** (1.0 / 3.0) * (1.0 + 1e-6)  # float32
        assert policy.lipschitz() <= TIGHT * (1.0 + 1e-5)
        assert policy.lipschitz() == pytest.approx(np.prod(norms), rel=1e-5)
    assert max(layer_norms(raw)) == pytest.approx(0.5, rel=1e-6)


def test_without_a_bound_weights_are_free(tiny_run: Path, tmp_path: Path) -> None:
    """`lipschitz=null` leaves layers that the bound would have scaled down."""
    free = run_train([*EXAMINED, f"out={tmp_path}", "lipschitz=null", "total_steps=256", "exam_every=0"])
    assert to_config(read_checkpoint(free)["config"]).lipschitz is None
    assert layer_norms(load_policy(free))[0] > 2.0
    assert max(layer_norms(load_policy(tiny_run))) <= 2.0 * (1.0 + 1e-6)  # the third root of 8, in float32
