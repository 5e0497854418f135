"""Runs that do not fit into memory are refused in one line, before anything is made."""

from __future__ import annotations

from pathlib import Path

import pytest
from torchrl.collectors import Collector

from tests.train.conftest import TINY
from vpptwin.cli.main import main
from vpptwin.system.errors import InputError
from vpptwin.train import run
from vpptwin.train.config import TrainConfig
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.learn import memory
from vpptwin.train.learn.checkpoint import make_policy
from vpptwin.train.learn.collect import OPTIONS
from vpptwin.train.learn.networks import Exploration, make_actor
from vpptwin.train.main import compose_config


def tiny_config(*overrides: str) -> TrainConfig:
    """Configuration of a tiny run."""
    return compose_config([*TINY, *overrides])


@pytest.mark.parametrize(
    "overrides",
    [
        ("num_envs=100000000",),
        ("num_envs=2000000", "preset=paper"),
        ("rollout=10000000",),
        ("exam_every=1000", "exam_tracks=100000000"),
        ("collector=ray", "num_envs=100000000"),
    ],
)
def test_too_large_a_run_is_refused(
    overrides: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line says what is needed, what is free and what to lower; exit code 2, and no folder is left."""
    monkeypatch.setattr(memory, "find_free", lambda: 16 * memory.GIB)
    monkeypatch.setattr(run, "build_training", lambda *_: pytest.fail("not refused"))
    given = [text for text in TINY if text.split("=")[0] not in [override.split("=")[0] for override in overrides]]
    assert main(["train", *given, *overrides, f"out={tmp_path / 'run'}"]) == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    for text in ("needs about", "GiB of memory", "at most the 16.0 GiB that are free", "lower num_envs or rollout"):
        assert text in said
    assert not list(tmp_path.iterdir())


def estimate_run(*overrides: str) -> float:
    """What a run is refused for when nothing is free, GiB."""
    config, needed = compose_config([*overrides, "exam_every=0"]), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(memory, "compare", lambda _, size: needed.append(size))
        memory.check_run(config)
    return needed[0] / memory.GIB


def test_usual_runs_fit() -> None:
    """The defaults need less than 0.1 GiB and the paper's networks less than 0.3 GiB besides the program itself."""
    assert estimate_run("preset=fast") < 0.1
    assert estimate_run("preset=paper") < 0.3


@pytest.mark.parametrize("overrides", [(), ("randomize=all",), ("critic=lstm",), ("privileged=false",)])
def test_record_is_what_a_collector_returns(overrides: tuple[str, ...]) -> None:
    """The bytes of a collected batch are those of the estimate, to the byte."""
    config = tiny_config(*overrides)
    env = make_env(config)
    actor = make_actor(Exploration(make_policy(config), 0.5))
    (batch,) = list(Collector(env, actor, frames_per_batch=128, total_frames=128, **OPTIONS))
    size = sum(values.numel() * values.element_size() for values in batch.values(True, True))
    assert size == 128 * memory.size_record(config)


@pytest.mark.parametrize("overrides", [(), ("randomize=all",), ("critic=lstm",)])
def test_simulation_is_more_than_its_state(overrides: tuple[str, ...]) -> None:
    """The estimate of a simulation exceeds the arrays that are visibly there: states, sensors, episodes, parameters."""
    config = tiny_config(*overrides)
    env = make_env(config)
    arrays = [*env.state.arrays().values(), *env._before.arrays().values(), *env.sensors.arrays().values()]
    arrays += [*vars(env.episodes).values(), env.twin.constants]
    size = sum(values.nbytes for values in arrays) / config.num_envs
    assert size < memory.size_simulation(config) < 4.0 * size


def test_worker_checks_its_own_share(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker of four looks at a quarter of the simulations, on the machine that it is on."""
    config = tiny_config("collector=ray", "workers=4")
    # 4 simulations, and 4 x 8 steps twice: in the collector's buffer and on the way to the head.
    needed = 4 * memory.size_simulation(config) + 64 * memory.size_record(config)
    monkeypatch.setattr(memory, "find_free", lambda: needed)
    memory.check_share(config)
    monkeypatch.setattr(memory, "find_free", lambda: needed - 1)
    with pytest.raises(InputError, match="needs about"):
        memory.check_share(config)


def test_container_limits_what_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container's limit counts, with file caches that would be given up as free; none, or no container, does not."""
    monkeypatch.setattr(memory, "CONTAINER", tmp_path)
    assert memory.find_free() > 10_000_000
    (tmp_path / "memory.max").write_text("9000000\n")
    (tmp_path / "memory.current").write_text("5000000\n")
    (tmp_path / "memory.stat").write_text("anon 3500000\ninactive_file 1500000\n")
    assert memory.find_free() == 5_500_000
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.find_free() > 10_000_000


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("std::bad_alloc"),
        MemoryError("Unable to allocate 7.45 GiB for an array"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 4096 bytes"),
    ],
)
def test_memory_that_runs_out_all_the_same_is_one_line(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """What the estimate did not foresee ends with exit code 2 and advice too, not with a traceback."""

    def run_out(*_: object) -> None:
        raise error

    monkeypatch.setattr(run, "build_training", run_out)
    assert main(["train", *TINY, f"out={tmp_path / 'run'}"]) == 2
    said = capfd.readouterr().err
    assert "memory ran out with num_envs=16 and rollout=8" in said
    assert said.count("\n") == 1


def test_other_errors_stay_what_they_are() -> None:
    """A RuntimeError that is none of memory is not disguised as one."""
    with pytest.raises(RuntimeError, match="shapes"), memory.explain_exhaustion(tiny_config()):
        raise RuntimeError("shapes do not match")
