"""Runs that were interrupted go on as if they had not been, and only as the same run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.conftest import EXAMINED, TINY, read_log
from vpptwin.system.errors import InputError
from vpptwin.train.config import to_config
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.progress import EpisodeStatistics
from vpptwin.train.main import run_train

LOGGED = ("return", "difficulty", "loss_objective", "loss_critic", "grad_norm_0", "exam_score_m", "exam_success")


def flatten(node: object, prefix: str = "") -> dict[str, object]:
    """Every leaf of nested dicts and lists by its path."""
    if isinstance(node, dict | list | tuple):
        pairs = node.items() if isinstance(node, dict) else enumerate(node)
        return {key: leaf for name, part in pairs for key, leaf in flatten(part, f"{prefix}/{name}").items()}
    return {prefix: node}


def differences(one: dict, other: dict) -> list[str]:
    """Paths at which two contents differ, bit for bit."""
    here, there = flatten(one), flatten(other)
    different = set(here) ^ set(there)
    for key in set(here) & set(there):
        a, b = here[key], there[key]
        if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
            same = a.dtype == b.dtype and a.shape == b.shape and bytes(a.numpy()) == bytes(b.numpy())
        else:
            same = a == b or (a != a and b != b)
        if not same:
            different.add(key)
    return sorted(different)


def interrupt(run: Path, monkeypatch: pytest.MonkeyPatch, batch: int, *overrides: str) -> None:
    """Start a run in a folder and kill it after it has collected so many batches."""
    batches, collect = 0, EpisodeStatistics.__call__

    def stop(self: EpisodeStatistics, data: object) -> dict[str, float]:
        nonlocal batches
        batches += 1
        if batches == batch:
            raise KeyboardInterrupt
        return collect(self, data)

    with monkeypatch.context() as patch:
        patch.setattr(EpisodeStatistics, "__call__", stop)
        with pytest.raises(KeyboardInterrupt):
            run_train([*EXAMINED, f"out={run}", *overrides])


FLIPS = (
    "task=flip", "task.training_episode=0.5", "task.target.dwell=[0.05,0.3]", "task.target.quiet=0",
    "preset=paper", "critic_hidden=[32,32]", "critic_lstm=16", "torch_threads=1",
)  # fmt: skip
"""With triggers and full turns under way at any time, and a critic that remembers."""


@pytest.mark.parametrize(
    "overrides", [pytest.param((), id="hover", marks=pytest.mark.slow), pytest.param(FLIPS, id="flip")]
)
def test_interrupted_run_continues_the_same_curve(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overrides: tuple[str, ...]
) -> None:
    """A run killed between checkpoints and resumed ends bit-equal to one that was never interrupted.

    All of it: simulations, curriculum, raw and averaged weights, optimizer, random numbers, exams, best policy, logs.
    """
    run, whole = tmp_path / "run", tiny_run
    if overrides:
        whole = run_train([*EXAMINED, f"out={tmp_path / 'whole'}", "checkpoint_every=384", *overrides])
    interrupt(run, monkeypatch, 6, "checkpoint_every=384", *overrides)
    # Batches of 128 steps, checkpoints every 384, exams every 256; batches four and five lost, and an exam with them.
    assert read_checkpoint(run, flying=False)["steps"] == 384
    assert read_log(run, "exam_score_m")[:, 0].tolist() == [256.0, 512.0]
    with (run / "log" / "scalars" / "return.csv").open("a") as log:
        log.write("6")  # a row that the kill cut short
    torch.manual_seed(1234)
    np.random.seed(1234)  # noqa: NPY002
    assert run_train([f"resume={run}", "progress=false"]) == run
    for flying in (True, False):
        here, there = (read_checkpoint(folder, flying) for folder in (run, whole))
        # The configurations differ in how often they save; TorchRL numbers a resumed run's episodes anew.
        ignored = ("/config/", "/training/trainer/save_checkpoint/", "/training/trainer/collector/traj_pool/")
        assert [key for key in differences(here, there) if not key.startswith(ignored)] == []
    assert here["steps"] == 1024
    assert to_config(here["config"]).curriculum.enabled
    for name in LOGGED:
        np.testing.assert_array_equal(read_log(run, name), read_log(whole, name))


def test_resume_refuses_another_run(tiny_run: Path, tmp_path: Path) -> None:
    """Resuming takes no option that would make it another run, no finished run, no folder without one, no policy."""
    for overrides, found in (
        ([f"resume={tiny_run}", "num_envs=8", "minibatch=8"], "num_envs"),
        ([f"resume={tiny_run}", "preset=paper", "total_steps=2048"], "preset"),
        ([f"resume={tiny_run}"], "finished"),
        ([f"resume={tmp_path}"], "no checkpoint"),
        ([f"resume={tiny_run / 'best.pt'}"], "policy only"),
    ):
        with pytest.raises(InputError, match=found):
            run_train(overrides)


def test_finished_run_can_be_extended(tmp_path: Path) -> None:
    """More steps continue a finished run with its own configuration."""
    run = run_train([*TINY, "total_steps=256", f"out={tmp_path / 'run'}", "gamma=0.9"])
    run_train([f"resume={run}", "total_steps=512", "progress=false"])
    content = read_checkpoint(run)
    assert content["steps"] == 512
    assert to_config(content["config"]).gamma == 0.9
    np.testing.assert_array_equal(read_log(run, "reward")[:, 0], [128, 256, 384, 512])


def test_existing_run_is_not_overwritten(tiny_run: Path) -> None:
    """A folder that holds a run is refused, naming how to continue it."""
    with pytest.raises(InputError, match="resume="):
        run_train([*TINY, f"out={tiny_run}"])
