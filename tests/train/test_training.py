"""Training: it learns, a seed gives one run, an interrupted run continues as if it had not been."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from tensordict import TensorDict

from tests.train.conftest import TINY
from vpptwin.errors import InputError
from vpptwin.train.checkpoint import read_checkpoint
from vpptwin.train.config import to_config
from vpptwin.train.env import VppEnv
from vpptwin.train.evaluate import evaluate
from vpptwin.train.main import run_train
from vpptwin.train.progress import EpisodeStatistics
from vpptwin.twin.health import replay_fault

NOISY = (*TINY, "total_steps=1024", "noise=1", "randomize=all")
"""As the run of the fixture `tiny_run`."""


def read_log(run: Path, name: str) -> np.ndarray:
    """Rows (steps, value) of a logged scalar."""
    return np.loadtxt(run / "log" / "scalars" / f"{name}.csv", delimiter=",", ndmin=2)


def same_weights(one: Path, other: Path) -> bool:
    """Whether two runs ended with bit-equal policies."""
    policies = [read_checkpoint(run)["policy"] for run in (one, other)]
    return all(torch.equal(policies[0][key], policies[1][key]) for key in policies[0])


def test_brief_training_learns_to_hover(tmp_path: Path) -> None:
    """150 000 steps turn a craft that always falls into one that hovers near its target.

    Seeds 0 to 2 ended at 5.2, 0.8 and 0.8 cm with 0, 0 and 3 % failures, and rewards rose from 0.4 to about 2 per step.
    """
    overrides = ["num_envs=128", "rollout=16", "minibatch=256", "total_steps=150000", "sim_threads=1", "progress=false"]
    run = run_train([f"out={tmp_path / 'run'}", *overrides])
    reward = read_log(run, "reward")[:, 1]
    assert reward[-5:].mean() > 3.0 * reward[:5].mean()
    result = evaluate(run, tracks=100)
    assert result["fail_rate"] <= 0.10
    assert result["position_error_m"]["median"] < 0.10


def test_run_leaves_what_the_docs_promise(tiny_run: Path) -> None:
    """A run's folder holds a checkpoint, its configuration as YAML, and logged scalars of every batch."""
    content = read_checkpoint(tiny_run)
    assert content["steps"] == 1024
    assert content["versions"]["torchrl"] != "unknown"
    assert yaml.safe_load((tiny_run / "config.yaml").read_text()) == content["config"]
    for name in ("reward", "return", "failures", "faults", "loss_critic"):
        np.testing.assert_array_equal(read_log(tiny_run, name)[:, 0], np.arange(128, 1025, 128))
    assert not list(tiny_run.glob(".checkpoint*"))


def test_same_seed_same_run(tiny_run: Path, tmp_path: Path) -> None:
    """The same seed gives bit-equal weights, another seed does not."""
    again = run_train([*NOISY, f"out={tmp_path / 'again'}"])
    other = run_train([*NOISY, f"out={tmp_path / 'other'}", "seed=1"])
    assert same_weights(tiny_run, again)
    assert not same_weights(tiny_run, other)


def test_interrupted_run_continues_the_same_curve(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run killed between checkpoints and resumed ends bit-equal to one that was never interrupted, logs included."""
    run, batches = tmp_path / "run", 0
    collect = EpisodeStatistics.__call__

    def interrupt(self: EpisodeStatistics, batch: object) -> dict[str, float]:
        nonlocal batches
        batches += 1
        if batches == 6:
            raise KeyboardInterrupt
        return collect(self, batch)

    with monkeypatch.context() as patch:
        patch.setattr(EpisodeStatistics, "__call__", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_train([*NOISY, f"out={run}", "checkpoint_every=256"])
    # Batches of 128 steps, checkpoints every 256, the sixth batch lost.
    assert read_checkpoint(run)["steps"] == 512
    with (run / "log" / "scalars" / "return.csv").open("a") as log:
        log.write("6")  # a row that the kill cut short
    torch.manual_seed(1234)
    assert run_train([f"resume={run}", "progress=false"]) == run
    assert read_checkpoint(run)["steps"] == 1024
    assert same_weights(tiny_run, run)
    for name in ("return", "loss_objective", "grad_norm_0"):
        np.testing.assert_array_equal(read_log(run, name), read_log(tiny_run, name))


def test_training_survives_a_simulation_that_diverges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """It is counted in the log, kept for replay and told at the end; weights stay finite, and resuming counts on."""
    fly, calls = VppEnv._step, 0

    def break_some(self: VppEnv, tensordict: TensorDict) -> TensorDict:
        nonlocal calls
        calls += 1
        if calls % 20 == 0:
            self.state.qvel[3] = 1e200
        return fly(self, tensordict)

    monkeypatch.setattr(VppEnv, "_step", break_some)
    run = run_train([*NOISY, f"out={tmp_path / 'run'}"])  # 64 steps of 16 drones
    assert read_log(run, "faults")[-1].tolist() == [1024.0, 3.0]
    assert "3 simulations diverged" in capfd.readouterr().err
    assert all(torch.isfinite(weights).all() for weights in read_checkpoint(run)["policy"].values())
    run_train([f"resume={run}", "total_steps=1408", "progress=false"])
    assert read_log(run, "faults")[-1].tolist() == [1408.0, 4.0]
    saved = sorted((run / "faults").iterdir())
    assert [path.name for path in saved] == [f"fault-{k:04d}.npz" for k in (1, 2, 3, 4)]
    assert all(replay_fault(path).equal for path in saved)


def test_resume_refuses_another_run(tiny_run: Path, tmp_path: Path) -> None:
    """Resuming takes no option that would make it another run, no finished run and no folder without one."""
    for overrides, found in (
        ([f"resume={tiny_run}", "num_envs=8", "minibatch=8"], "num_envs"),
        ([f"resume={tiny_run}"], "finished"),
        ([f"resume={tmp_path}"], "no checkpoint"),
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


@pytest.mark.parametrize(
    ("override", "found"),
    [
        ("twin=nowhere.yaml", "nowhere.yaml"),
        ("randomize=[rail_x.colomb]", "rail_x.colomb"),
        ("out=/proc/vpptwin", "cannot write"),
    ],
)
def test_bad_input(override: str, found: str, tmp_path: Path) -> None:
    """An unknown twin or effect and an unwritable folder are one line each, and leave no checkpoint."""
    with pytest.raises(InputError, match=found) as caught:
        run_train([*TINY, f"out={tmp_path / 'run'}", override])
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run" / "checkpoint.pt").exists()


def test_progress_bar_tells_how_it_goes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The bar shows return, position error, failures, speed and time left on stderr, and hydra makes no folder."""
    run_train([*TINY, "progress=true", "total_steps=512", f"out={tmp_path / 'run'}"])
    shown = capfd.readouterr().err
    for text in ("100%", "512/512", "steps/s", "left", "return", "error", "failures"):
        assert text in shown
    assert not Path("outputs").exists()
