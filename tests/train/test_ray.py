"""Training with Ray: two workers on this machine, interrupted and resumed; what is refused without starting any."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import pytest
import ray
import torch
from tensordict import TensorDictBase

from tests.train.conftest import TINY
from vpptwin.cli.main import main
from vpptwin.system.errors import InputError
from vpptwin.system.jobs import connect, explain_failures
from vpptwin.train import run as running
from vpptwin.train.learn import collect
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.train.learn.collect import WorkerEnv
from vpptwin.train.learn.ppo import Training
from vpptwin.train.learn.progress import EpisodeStatistics
from vpptwin.train.main import compose_config, run_train

WORKED = (
    *TINY, "exam_every=0", "loggers=csv", "collector=ray", "workers=2", "total_steps=512", "task.episode=0.5",
    "task.success.window=0.2",
)  # fmt: skip
"""Four batches of 16 drones x 8 steps, flown by two workers with eight drones each."""


def find_processes() -> list[str]:
    """Processes of Ray that this one has started and that still run after ten seconds."""
    _, alive = psutil.wait_procs(psutil.Process().children(recursive=True), 0.1)
    _, alive = psutil.wait_procs([child for child in alive if "ray" in " ".join(child.cmdline())], 10.0)
    return [" ".join(child.cmdline()) for child in alive]


@dataclass
class Flown:
    """What a run with Ray went through.

    Attributes:
        run: its folder.
        batches: collected by the run that was interrupted, 3, and by the resumed one, 2.
        expected: locations of the actions that the trainer's own weights give for these batches.
        left: steps in the checkpoint that the interruption left.
        alive: processes of Ray after the interruption and after the end.
    """

    run: Path
    batches: list[TensorDictBase] = field(default_factory=list)
    expected: list[torch.Tensor] = field(default_factory=list)
    left: int = 0
    alive: list[list[str]] = field(default_factory=list)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flown]:
    """A run that Ctrl-C stops in its third batch, and that is resumed."""
    flown = Flown(tmp_path_factory.mktemp("ray") / "run")
    build, collect = running.build_training, EpisodeStatistics.__call__
    trainings: list[Training] = []

    def watch(*given: object) -> Training:
        trainings.append(build(*given))  # type: ignore[arg-type]
        return trainings[-1]

    def note(self: EpisodeStatistics, batch: TensorDictBase) -> dict[str, float]:
        flown.batches.append(batch.clone())
        with torch.no_grad():
            flown.expected.append(trainings[-1].policy.body(batch["observation"]))
        if len(flown.batches) == 3:
            raise KeyboardInterrupt
        return collect(self, batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "build_training", watch)
        patch.setattr(EpisodeStatistics, "__call__", note)
        patch.delenv("RAY_ADDRESS", raising=False)
        try:
            with pytest.raises(KeyboardInterrupt):
                run_train([*WORKED, "checkpoint_every=256", f"out={flown.run}"])
            flown.alive.append(find_processes())
            flown.left = read_checkpoint(flown.run, flying=False)["steps"]
            run_train([f"resume={flown.run}", "progress=false"])
            flown.alive.append(find_processes())
            yield flown
        finally:
            ray.shutdown()


@pytest.mark.slow  # tests/test_jobs.py works with Ray in CI
def test_batches_hold_every_simulation_step_by_step(flown: Flown) -> None:
    """A batch is (16, 8), rows are simulations that go on from batch to batch, and no two are alike."""
    assert [tuple(batch.shape) for batch in flown.batches] == [(16, 8)] * 5
    for first, second in ((0, 1), (1, 2), (3, 4)):
        batch = torch.cat([flown.batches[first], flown.batches[second]], 1)
        goes_on = ~batch["next", "done"][:, :-1, 0]
        assert goes_on.any(1).all()
        for key in ("observation", "critic_observation"):
            following, now = batch["next", key][:, :-1], batch[key][:, 1:]
            torch.testing.assert_close(following[goes_on], now[goes_on], rtol=0.0, atol=0.0)
    starts = flown.batches[0]["observation"][:, 0]
    assert len(torch.unique(starts, dim=0)) == 16


@pytest.mark.slow  # tests/test_jobs.py works with Ray in CI
def test_workers_fly_with_the_weights_and_the_exploration_of_the_moment(flown: Flown) -> None:
    """Every batch is flown with what the trainer holds as it comes in, however often that has changed."""
    exploration = compose_config(WORKED).exploration
    for batch, expected, steps in zip(flown.batches, flown.expected, (0, 128, 256, 256, 384)):
        torch.testing.assert_close(batch["loc"], expected)
        assert batch["scale"].unique().tolist() == pytest.approx([exploration.at(steps / 512)])
    assert not torch.equal(flown.expected[0], flown.expected[1])


@pytest.mark.slow  # tests/test_jobs.py works with Ray in CI
def test_interrupted_run_goes_on_with_new_episodes(flown: Flown) -> None:
    """Ctrl-C keeps the checkpoint; resuming goes on with its steps, logs and curriculum, and flies other episodes."""
    content = read_checkpoint(flown.run, flying=False)
    assert (flown.left, content["steps"]) == (256, 512)
    assert content["training"]["env"] is None
    for name in ("reward", "difficulty", "faults", "loss_objective"):
        assert np.loadtxt(flown.run / f"log/scalars/{name}.csv", delimiter=",")[:, 0].tolist() == [128, 256, 384, 512]
    schedule = compose_config(WORKED).schedule()
    logged = np.loadtxt(flown.run / "log/scalars/difficulty.csv", delimiter=",")
    assert logged[:, 1] == pytest.approx([schedule.difficulty_at(steps) for steps in (128, 256, 384, 512)])
    assert not torch.equal(flown.batches[0]["observation"][:, 0], flown.batches[3]["observation"][:, 0])


@pytest.mark.slow  # tests/test_jobs.py works with Ray in CI
def test_nothing_of_ray_is_left(flown: Flown) -> None:
    """Ray and its workers end with the run, interrupted or not."""
    assert flown.alive == [[], []]
    assert not ray.is_initialized()


def test_workers_share_the_simulations_and_the_curriculum(tmp_path: Path) -> None:
    """Each has its own seed, another one after a resume, its half of the simulations, and the run's difficulty."""
    config = compose_config(WORKED)
    makers = [WorkerEnv(config, worker, begun, tmp_path, frozenset()) for worker in (0, 1) for begun in (0, 128)]
    assert len({maker.seed for maker in makers}) == 4
    with torch.random.fork_rng():
        env = makers[3]()
    assert env.batch_size == torch.Size([8])
    assert env.difficulty == pytest.approx(config.schedule().difficulty_at(128))
    assert env.config.fault_folder == tmp_path / "worker-1"


def test_without_ray(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """If Ray is not installed, one line says how to install it."""
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["train", *WORKED, f"out={tmp_path / 'run'}"]) == 2
    said = capfd.readouterr().err
    assert "ray is not installed" in said
    assert "pip install 'vpptwin[ray]'" in said
    assert said.count("\n") == 1


def test_simulations_that_cannot_be_shared(tmp_path: Path) -> None:
    """A remainder is refused, for a new run and for one that is resumed with other workers."""
    with pytest.raises(InputError, match="num_envs=16 for workers=3"):
        run_train([*WORKED, "workers=3", f"out={tmp_path / 'run'}"])


@pytest.mark.slow  # tests/test_jobs.py works with Ray in CI
def test_resume_with_other_workers_is_checked(flown: Flown) -> None:
    """Workers are the machine's matter and may change with a resume, if they can share the simulations."""
    with pytest.raises(InputError, match="num_envs=16 for workers=3"):
        run_train([f"resume={flown.run}", "workers=3", "total_steps=640"])


@pytest.mark.parametrize(
    ("address", "found"), [("127.0.0.1:1", "no Ray at"), ("ray://127.0.0.1:1", "ray://"), ("nonsense", "nonsense")]
)
def test_no_cluster_at_the_address(address: str, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An address at which no Ray answers is told at once."""
    monkeypatch.setenv("RAY_ADDRESS", address)
    with pytest.raises(InputError, match=re.escape(found)) as caught:
        connect(2)
    assert "\n" not in str(caught.value)


def test_too_few_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that Ray could never place are refused; cores that others use are waited for, in one line."""
    monkeypatch.setattr(ray, "cluster_resources", lambda: {"CPU": 3.0})
    monkeypatch.setattr(ray, "available_resources", lambda: {"CPU": 3.0})
    with pytest.raises(InputError, match="Ray has 3 cores; expected 4 for workers=2 with sim_threads=2"):
        collect.check_cores(compose_config([*WORKED, "sim_threads=2"]))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("The actor died.\nTraceback (most recent call last):\n  x\nvpptwin.errors.InputError: no twin", "no twin"),
        ("The actor died.\nTraceback (most recent call last):\n  x\nMemoryError: full", "MemoryError: full"),
        ("The node ran out of memory.\nSee the logs.", "The node ran out of memory."),
    ],
)
def test_what_ended_a_worker_is_told_in_a_line(text: str, told: str) -> None:
    """The last line of an exception, the first of a description, never a traceback."""
    with pytest.raises(InputError) as caught, explain_failures("see why"):
        raise ray.exceptions.RayError(text)
    assert str(caught.value).startswith(f"a Ray worker ended: {told};")
