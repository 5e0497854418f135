"""Checkpoints and evaluation: round trip, provenance, and files that are something else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from vpptwin.errors import InputError
from vpptwin.train.checkpoint import read_checkpoint, write_checkpoint
from vpptwin.train.config import to_config
from vpptwin.train.evaluate import evaluate, load_policy, run_evaluate
from vpptwin.train.networks import Exploration, Policy, make_actor


def test_round_trip(tiny_run: Path, tmp_path: Path) -> None:
    """A policy written and read acts bit-equal; a file without training state is small enough to ship."""
    policy, content = load_policy(tiny_run), read_checkpoint(tiny_run)
    path = tmp_path / "policy.pt"
    write_checkpoint(path, to_config(content["config"]), policy, content["steps"])
    observation = torch.randn(7, 11)
    assert torch.equal(load_policy(path)(observation), policy(observation))
    assert path.stat().st_size < 200_000
    assert [p.name for p in tmp_path.iterdir()] == ["policy.pt"]


def test_policy_is_the_mode_of_the_trained_actor() -> None:
    """What is deployed is what the exploring actor does when it does not explore: tanh of the network, in [-1, 1]."""
    torch.manual_seed(0)
    policy = Policy(11)
    actor = make_actor(Exploration(policy, 0.4))
    observation = 5.0 * torch.randn(64, 11)
    distribution = actor.get_dist(actor(as_batch(observation)))
    torch.testing.assert_close(distribution.deterministic_sample, policy(observation))
    assert policy(observation).abs().max() <= 1.0


def as_batch(observation: torch.Tensor) -> TensorDict:
    """Observations as an actor takes them."""
    return TensorDict({"observation": observation}, batch_size=[len(observation)])


def test_paper_network() -> None:
    """The actor is the paper's: 96 ReLU, 64 tanh, two outputs."""
    layers = [str(layer).split("(")[0] for layer in Policy(11).body[1:]]
    assert layers == ["Linear", "ReLU", "Linear", "Tanh", "Linear"]
    assert [tuple(p.shape) for p in Policy(11).parameters() if p.dim() == 2] == [(96, 11), (64, 96), (2, 64)]


def damage(content: dict[str, Any], kind: str) -> dict[str, Any]:
    """A checkpoint's content made unusable in one way."""
    if kind == "format":
        return {**content, "format": 99}
    if kind == "kind":
        return {"weights": content["policy"]}
    if kind == "architecture":
        return {**content, "policy": Policy(11, (32, 32)).state_dict()}
    return {**content, "config": {**content["config"], "unknown_option": 1}}


@pytest.mark.parametrize(
    ("kind", "found"),
    [("format", "format 99"), ("kind", "another kind"), ("architecture", "architecture"), ("config", "unknown_option")],
)
def test_unusable_checkpoints(tiny_run: Path, tmp_path: Path, kind: str, found: str) -> None:
    """Another version, another kind of torch file and another architecture are told apart, in one line each."""
    path = tmp_path / "damaged.pt"
    torch.save(damage(read_checkpoint(tiny_run), kind), path)
    with pytest.raises(InputError, match=found) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"no torch file", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_files_that_are_no_checkpoint(tmp_path: Path, content: bytes) -> None:
    """Empty and foreign files are named as such."""
    path = tmp_path / "file.pt"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a checkpoint"):
        load_policy(path)


def test_truncated_checkpoint(tiny_run: Path, tmp_path: Path) -> None:
    """Half a checkpoint is refused, for evaluation as for resuming."""
    path = tmp_path / "checkpoint.pt"
    whole = (tiny_run / "checkpoint.pt").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(tmp_path)


def test_code_in_a_checkpoint_does_not_run(tmp_path: Path) -> None:
    """A pickle that would execute something is refused, not executed."""

    class Payload:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (tmp_path / "ran",)  # type: ignore[return-value]

    torch.save({"kind": "vpptwin policy", "format": 1, "policy": Payload()}, tmp_path / "evil.pt")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_policy(tmp_path / "evil.pt")
    assert not (tmp_path / "ran").exists()


def test_evaluation_is_data(tiny_run: Path, tmp_path: Path) -> None:
    """The JSON carries the measures, the seed and the commits, and repeats bit-equal for the same seed."""
    path = tmp_path / "out.json"
    result = run_evaluate(tiny_run, "hover", 8, 5, "nominal", path)
    assert json.loads(path.read_text()) == result
    assert (result["tracks"], result["seed"], result["checkpoint"]["steps"]) == (8, 5, 1024)
    again, other = evaluate(tiny_run, "hover", 8, 5), evaluate(tiny_run, "hover", 8, 6)
    measures = ("position_error_m", "fail_rate", "success_share")
    assert [again[key] for key in measures] == [result[key] for key in measures]
    # 1024 steps teach nothing: every craft falls, and then there is no error to report.
    assert result["fail_rate"] == other["fail_rate"] == 1.0
    assert result["success_share"] == 0.0
    assert result["position_error_m"] == {"median": None, "mean": None, "worst": None}


def test_bad_evaluations(tiny_run: Path, tmp_path: Path) -> None:
    """An unknown task, no tracks, an unknown twin and an unwritable file are refused; nothing is written."""
    bad = [
        ("flap", 4, "nominal", tmp_path / "out.json"),
        ("hover", 0, "nominal", tmp_path / "out.json"),
        ("hover", 4, "nowhere.yaml", tmp_path / "out.json"),
        ("hover", 4, "nominal", tmp_path / "missing" / "out.json"),
    ]
    for task, tracks, twin, path in bad:
        with pytest.raises(InputError):
            run_evaluate(tiny_run, task, tracks, 0, twin, path)
    assert not list(tmp_path.iterdir())
