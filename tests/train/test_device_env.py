"""The environment that Warp steps, on its processor device: as numba's, in float32; it trains, and is resumed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from tests.train.conftest import plain_schedule, reset_rows, tiny_config
from vpptwin import make_env as make_task_env
from vpptwin.system.errors import InputError
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.train.evaluate.evaluate import Conditions, evaluate
from vpptwin.train.learn.checkpoint import SaveCheckpoint, build_policy, read_checkpoint
from vpptwin.train.main import run_train

pytest.importorskip("mujoco_warp")
from vpptwin.train.env.device_env import DeviceEnv, check_warp, make_device_env

FLOWN = ("num_envs=16", "minibatch=32", "randomize=paper", "engine=warp", "desynchronize=false", "sim_threads=1")
HERE = torch.device("cpu")
FLOAT32 = 2e-4
"""What 40 control steps may make of float32's rounding, 400 inner ones, in m, m/s, rad/s and shares of a reward."""


def device_env(*overrides: str, **options: Any) -> DeviceEnv:  # noqa: ANN401
    """A small environment on Warp's processor device."""
    return make_device_env(tiny_config(*FLOWN, *overrides), HERE, **options)


def copy_over(plain: VppEnv, env: DeviceEnv) -> None:
    """Put the rigs and episodes of an environment of numba's into one of Warp's."""
    env.table.copy_(torch.tensor(env.stepper.pack_state(plain.state)))
    twin, env.stepper.twin = env.stepper.twin, plain.twin
    env.numbers.copy_(torch.tensor(env.stepper.pack_numbers()))
    env.stepper.twin = twin
    for mine, theirs in ((env.episodes, plain.episodes), (env.sensors, plain.sensors)):
        for name, values in vars(theirs).items():
            getattr(mine, name).copy_(torch.tensor(values))


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("task=flip", "critic=lstm", "task.target.turns=0"),
        pytest.param(("task=wall-backtrack",), marks=pytest.mark.slow),
    ],
    ids=["hover", "flip", "wall"],
)
def test_flies_as_numba_does(overrides: tuple[str, ...]) -> None:
    """Observation, reward, what a critic sees and how episodes end, with what the paper randomizes."""
    overrides = "noise=0", *overrides
    plain, env = make_env(tiny_config(*FLOWN, *overrides)), device_env(*overrides)
    plain.reset()
    env.reset()
    copy_over(plain, env)
    plain.episodes.switch[:] = plain.episodes.due[:] = env.episodes.switch[:] = env.episodes.due[:] = np.inf
    generator, alive = torch.Generator().manual_seed(0), torch.ones(16, dtype=torch.bool)
    compared = 0
    for _ in range(40):
        action = torch.tensor([0.5, 0.0]) + torch.tensor([0.3, 0.3]) * torch.randn(16, 2, generator=generator)
        one, other = (each.step(TensorDict({"action": action}, [16]))["next"] for each in (plain, env))
        alive &= env._touched == 0  # near the floor numba's goes on, in MuJoCo's steps
        for key in ("observation", "critic_observation", "reward", "position_error", "success", "episode_return"):
            torch.testing.assert_close(other[key][alive], one[key][alive], rtol=FLOAT32, atol=FLOAT32, msg=key)
        assert torch.equal(other["done"][alive], one["done"][alive])
        compared += int(alive.sum())
        alive &= ~one["done"][:, 0]
    assert compared > 400


def test_specs() -> None:
    """TorchRL's own check of shapes, types and reset behaviour passes, and users get it by name."""
    env = make_task_env("flip", num_envs=4, engine="warp", randomize=["paper"])
    assert isinstance(env, DeviceEnv)
    check_env_specs(env, seed=0)
    assert env.render().shape == (400, 640, 3)


def test_new_episodes_begin_where_they_are_over() -> None:
    """By mask: other rows stay as they are; a fresh one has another start, and parameters of the bank."""
    env = device_env("task=flip", "noise=1")
    before = env.reset().clone()
    table, numbers = env.table.clone(), env.numbers.clone()
    after = reset_rows(env, [2, 5], before)
    fresh = torch.zeros(16, dtype=torch.bool)
    fresh[[2, 5]] = True
    same, places = ~fresh, env.stepper.state["qpos"]
    assert torch.equal(env.table[:, same], table[:, same])
    assert torch.equal(env.numbers[:, same], numbers[:, same])
    assert torch.equal(after["observation"][same], before["observation"][same])
    assert (env.table[places][:, fresh] != table[places][:, fresh]).all()
    assert (env.numbers[:, 2, None] == env.bank.numbers).all(0).any()
    assert (env.state.time == 0.0).all()


def test_a_seed_gives_one_flight() -> None:
    """Draws on the device and in the bank come from it."""
    flights = []
    for seed in (0, 0, 1):
        env = device_env(f"seed={seed}", "noise=1", "task=flip")
        env.reset()
        flights.append(fly(env))
    assert torch.equal(flights[0], flights[1])
    assert not torch.equal(flights[0], flights[2])


def fly(env: DeviceEnv, steps: int = 30) -> torch.Tensor:
    """Observations of some steps at full thrust, new episodes and all."""
    seen, shown = [], env.reset()
    for _ in range(steps):
        shown["action"] = torch.full((env.count, 2), 0.6)
        done, shown = env.step_and_maybe_reset(shown)
        seen.append(done["next", "observation"].clone())
    return torch.stack(seen)


def test_triggers_come() -> None:
    """Targets change when it is time, by a turn or to the other angle, and the flight is told."""
    env = device_env("task=flip", "task.target.turns=0.5", "task.training_episode=null")
    env.reset()
    env.episodes.switch[:8] = 0.005
    angle = env.episodes.target[:, 2].clone()
    shown = env.step(TensorDict({"action": torch.zeros(16, 2)}, [16]))["next"]
    assert shown["surprised"][:, 0].tolist() == [1.0] * 8 + [0.0] * 8
    moved, turning = (env.episodes.target[:, 2] - angle).cos() < 0.0, env.episodes.turn != 0.0
    assert (moved ^ turning)[:8].all()
    assert not (moved | turning)[8:].any()
    assert (env.episodes.switch[:8] > 0.5).all()


def test_lesson() -> None:
    """Below its level episodes are judged by one criterion; failed starts are flown again; the bank follows."""
    env = device_env("task=flip", schedule=plain_schedule(100_000))
    env.reset()
    assert set(env.episodes.criterion.tolist()) == {1, 2}
    env.failed_starts.add(torch.tensor([True] + [False] * 15), env.episodes.started)
    pose = torch.zeros(4, 3)
    again = env.failed_starts.replace(1.0, env.draws, pose, pose, pose)
    assert torch.equal(torch.cat(again, 1), env.episodes.started[:1].expand(4, 9))
    assert torch.equal(env.failed_starts.replace(0.0, env.draws, pose, pose, pose)[0], pose)


def test_what_diverges_begins_anew() -> None:
    """It is counted, ends its episode without a reward, and leaves numbers behind that can be flown."""
    env = device_env()
    env.reset()
    env.table[env.stepper.state["qvel"], 3] = torch.nan
    shown = env.step(TensorDict({"action": torch.zeros(16, 2)}, [16]))["next"]
    assert env.faults == 1
    assert shown["terminated"][:, 0].tolist() == [k == 3 for k in range(16)]
    assert shown["reward"][3] == 0.0
    assert torch.isfinite(shown["observation"]).all()


@pytest.mark.parametrize("task", ["flip", pytest.param("wall-backtrack", marks=pytest.mark.slow)])
def test_snapshot_goes_on_bit_equal(task: str) -> None:
    """What evolves is saved and put back whole; one of numba's is refused."""
    env, other = device_env(f"task={task}", "noise=1"), device_env(f"task={task}", "noise=1", "seed=7")
    fly(env)
    other.restore_snapshot(env.take_snapshot())
    env.restored = True  # its next full reset too hands out the present
    assert torch.equal(fly(env), fly(other))
    plain = make_env(tiny_config(*FLOWN))
    with pytest.raises(InputError, match="engine=numba"):
        env.restore_snapshot(plain.take_snapshot())
    with pytest.raises(InputError, match="init_from"):
        plain.restore_snapshot(env.take_snapshot())


def test_training_on_warp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few thousand steps; continued from the middle they end bit-equal; the policy flies in numba's twin."""
    save, middle = SaveCheckpoint.__call__, tmp_path / "middle"

    def keep(hook: SaveCheckpoint, batch: object = None) -> None:
        save(hook, batch)
        if hook.saved == 2048 and not middle.exists():
            middle.mkdir()
            copy(hook.path, middle)

    monkeypatch.setattr(SaveCheckpoint, "__call__", keep)
    brief = ("task=hover", "engine=warp", "num_envs=64", "rollout=16", "minibatch=256", "exam_every=0", "loggers=csv",
             "progress=false", "sim_threads=1", "task.episode=0.5", "task.success.window=0.2", "total_steps=4096",
             "checkpoint_every=2048")  # fmt: skip
    whole = run_train([*brief, f"out={tmp_path / 'whole'}"])
    policies = [read_checkpoint(run, flying=False)["policy"] for run in (whole, run_train([f"resume={middle}"]))]
    assert all(torch.equal(policies[0][name], policies[1][name]) for name in policies[0])
    assert evaluate(whole, Conditions(tracks=4))["fail_rate"] <= 1.0


@pytest.mark.slow
def test_a_policy_flies_alike() -> None:
    """The flip that ships, 200 flights by either engine: 2 failed of each, 6.9 and 6.6 mm off, medians."""
    policy, _ = build_policy(read_checkpoint("flip"), "flip")
    medians = []
    for engine in ("warp", "numba"):
        env = make_task_env("flip", num_envs=200, noise=1.0, randomize=["paper"], engine=engine, seed=3)
        shown, failed, errors = env.reset(), torch.zeros(200, dtype=torch.bool), []
        for _ in range(env.max_steps):
            with torch.no_grad():
                shown["action"] = policy(shown["observation"])
            shown = env.step(shown)["next"]
            failed |= shown["terminated"][:, 0]
            errors.append(shown["position_error"][:, 0].clone())
        assert failed.sum() <= 6
        medians.append(float(torch.stack(errors[-100:]).mean(0)[~failed].median()))
    assert medians[0] == pytest.approx(medians[1], abs=2e-3)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [(("estimator=kalman",), "estimator=sensors"), (("collector=ray",), "collector=local"), (("engine=jax",), "warp")],
)
def test_what_warp_does_not_do_is_refused(overrides: tuple[str, ...], said: str) -> None:
    """With the processor's engine as the way out."""
    with pytest.raises(InputError, match=said):
        tiny_config(*FLOWN, *overrides)


@pytest.mark.slow
def test_training_at_the_wall(tmp_path: Path) -> None:
    """A few hundred steps by mujoco_warp; the policy flies in numba's twin."""
    brief = ("task=wall-backtrack", "engine=warp", "num_envs=16", "rollout=8", "minibatch=64", "exam_every=0",
             "loggers=csv", "progress=false", "sim_threads=1", "task.episode=0.5", "task.success.window=0.2",
             "total_steps=384", f"out={tmp_path / 'wall'}")  # fmt: skip
    assert evaluate(run_train([*brief]), Conditions(tracks=4))["fail_rate"] <= 1.0


def test_missing_parts_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """No card, no Warp, a driver that is too old: one line each."""
    import warp as wp

    with pytest.raises(InputError, match="finds 0 CUDA devices"):
        make_task_env("hover", device="cuda")
    monkeypatch.setattr(wp, "is_cuda_available", lambda: False)
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (11, 2))
    with pytest.raises(InputError, match=r"driver for CUDA 11\.2.*engine=numba"):
        check_warp(torch.device("cuda", 0))
    monkeypatch.setitem(__import__("sys").modules, "warp", None)
    with pytest.raises(InputError, match=r"needs warp.*pip install 'vpptwin\[gpu\]'"):
        make_task_env("hover", engine="warp")


def test_no_step_asks_the_device() -> None:
    """On a device that only knows shapes: nothing reads a number back, or mixes in what is elsewhere."""
    env = device_env("task=flip", "noise=1", "critic=lstm", schedule=plain_schedule(100_000))
    env.reset()
    for part in (env, env.episodes, env.sensors, env.failed_starts, env.bank):
        tensors = {name: value.to("meta") for name, value in vars(part).items() if isinstance(value, torch.Tensor)}
        for name, tensor in tensors.items():
            object.__setattr__(part, name, tensor)
    env._shown = {name: tensor.to("meta") for name, tensor in env._shown.items()}
    env._device = env.bank._device = env.draws.device = torch.device("meta")
    env._launch, env._find_stream = SimpleNamespace(launch=lambda stream: None), lambda: None
    env.draws.generator = None
    env.show_rows()
    shown = env._step(TensorDict({"action": torch.zeros(16, 2, device="meta")}, [16], device="meta"))
    after = env.maybe_reset(TensorDict({"done": shown["done"]}, [16], device="meta"))
    assert after["observation"].device.type == after["critic_observation"].device.type == "meta"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a card")
@pytest.mark.parametrize("task", ["hover", "flip", "wall-backtrack"])
def test_no_step_waits_for_the_card(task: str) -> None:
    """Neither a step nor a new episode synchronises, and a card flies as Warp's processor device does."""
    card = make_device_env(
        replace(tiny_config(*FLOWN, "noise=0", f"task={task}"), device="cuda"), torch.device("cuda", 0)
    )
    env = device_env("noise=0", f"task={task}")
    card.reset()
    env.reset()
    for mine, theirs in zip(card.list_tensors().values(), env.list_tensors().values(), strict=True):
        mine.copy_(theirs)
    action = TensorDict({"action": torch.full((16, 2), 0.5)}, [16])
    on_card = action.to("cuda")
    torch.cuda.set_sync_debug_mode("error")
    try:
        _, after = card.step_and_maybe_reset(on_card)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    shown = env.step_and_maybe_reset(action)[0]
    torch.testing.assert_close(on_card["next", "observation"].cpu(), shown["next", "observation"], rtol=1e-4, atol=1e-4)
    assert after.device.type == "cuda"
