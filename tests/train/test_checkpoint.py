"""Checkpoints: round trip, which file a name stands for, and files that are something else."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from vpptwin.errors import InputError
from vpptwin.train.checkpoint import FORMAT, find_checkpoint, read_checkpoint, shipped_policies, write_checkpoint
from vpptwin.train.config import to_config
from vpptwin.train.evaluate import load_policy
from vpptwin.train.networks import Policy
from vpptwin.train.observe import Sight


def test_round_trip(tiny_run: Path, tmp_path: Path) -> None:
    """A policy written and read acts bit-equal; a file without training state is small enough to ship."""
    policy, content = load_policy(tiny_run), read_checkpoint(tiny_run)
    path = tmp_path / "policy.pt"
    write_checkpoint(path, to_config(content["config"]), policy, content["steps"])
    observation = torch.randn(7, 11)
    assert torch.equal(load_policy(path)(observation), policy(observation))
    assert path.stat().st_size < 200_000
    assert [p.name for p in tmp_path.iterdir()] == ["policy.pt"]


def test_a_folder_flies_its_best_and_resumes_its_last(tiny_run: Path, tmp_path: Path) -> None:
    """best.pt if there is one, else checkpoint.pt; a file stands for itself."""
    assert find_checkpoint(tiny_run) == tiny_run / "best.pt"
    assert find_checkpoint(tiny_run, flying=False) == tiny_run / "checkpoint.pt"
    assert find_checkpoint(tiny_run / "checkpoint.pt") == tiny_run / "checkpoint.pt"
    shutil.copy(tiny_run / "checkpoint.pt", tmp_path)
    assert find_checkpoint(str(tmp_path)) == tmp_path / "checkpoint.pt"


def test_policies_ship_by_name(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bare name stands for models/policies/NAME.pt, unless there is such a file here; others are refused."""
    monkeypatch.setattr("vpptwin.train.checkpoint.models_dir", lambda: tmp_path)
    (tmp_path / "policies").mkdir()
    shutil.copy(tiny_run / "best.pt", tmp_path / "policies" / "spin.pt")
    observation = torch.randn(3, 11)
    assert torch.equal(load_policy("spin")(observation), load_policy(tiny_run)(observation))
    for name in ("loop", "policies/spin", "spin.pt"):
        with pytest.raises(InputError, match="no checkpoint"):
            load_policy(name)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    shutil.copytree(tiny_run, tmp_path / "here" / "spin")
    (tmp_path / "here" / "spin" / "best.pt").unlink()
    assert find_checkpoint("spin") == Path("spin/checkpoint.pt")


def test_every_policy_that_ships_can_be_flown() -> None:
    """Whatever lies in models/policies loads, within the bound that it was trained with."""
    for name in shipped_policies():
        policy = load_policy(name)
        bound = to_config(read_checkpoint(name)["config"]).lipschitz
        assert bound is None or policy.lipschitz() <= bound * (1.0 + 1e-5)  # float32


def damage(content: dict[str, Any], kind: str) -> dict[str, Any]:
    """A checkpoint's content made unusable in one way."""
    if kind == "format":
        return {**content, "format": 99}
    if kind == "kind":
        return {"weights": content["policy"]}
    if kind == "architecture":
        return {**content, "policy": Policy(Sight(), (32, 32)).state_dict()}
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

    torch.save({"kind": "vpptwin policy", "format": FORMAT, "policy": Payload()}, tmp_path / "evil.pt")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_policy(tmp_path / "evil.pt")
    assert not (tmp_path / "ran").exists()
