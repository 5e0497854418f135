"""The environment on a device: rigs, episodes and draws in tensors there, stepped by one Warp kernel."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from vpptwin.system.errors import InputError
from vpptwin.system.progress import tell_wait
from vpptwin.train.config import Lesson, TrainConfig
from vpptwin.train.env.device_draws import BANK, DeviceDraws, ParameterBank, StartRing
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.observe import Sight, accumulate_error, observe, wrap_angle
from vpptwin.train.env.privileged import see_everything
from vpptwin.train.env.randomize import IDENTIFIED
from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, compute_reward
from vpptwin.train.env.snapshot import restore_snapshot, take_snapshot
from vpptwin.train.env.starts import SOON
from vpptwin.train.env.tasks import Task
from vpptwin.train.env.vpp_env import NEAR, VppEnv, load_randomized
from vpptwin.train.learn.devices import check_warp
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.health import FASTEST
from vpptwin.twin.sensors import PERFECT, read_sensors
from vpptwin.twin.stepping.kernel import COMPILING
from vpptwin.twin.stepping.past import record_poses, start_sensors
from vpptwin.twin.warp.device import load_warp
from vpptwin.twin.warp.mujoco import WarpMujoco
from vpptwin.twin.warp.step import WarpStep


class DeviceEnv(VppEnv):
    """N drones as `VppEnv` flies them, in float32 on a device; no step waits for the device.

    What touches something, or comes as near as the ball around it, ends its episode as a failure; a task that goes on
    there, and a rig that only MuJoCo steps, are stepped by `mujoco_warp`, contact and all.
    Parameters are drawn, and effects that act on constants applied, on the processor: for a bank of rigs, from which
    new episodes take theirs, and which is drawn afresh as training goes.

    Args:
        twin: of the bank: as many simulations as it has sets of parameters, with `randomized` effects switched on.
        task: what to fly.
        count: simulations N.
        device: `cpu`, by Warp's processor device, or `cuda`.
        seed, noise, randomized, sight, desynchronize, lesson, memory, privileged, narrowed: as `VppEnv`.

    Raises:
        InputError: if Warp, mujoco_warp or a card is missing, or the rig or an effect cannot be flown by them.
    """

    def __init__(
        self, twin: Twin, task: Task, count: int, device: torch.device, seed: int = 0, noise: float = 0.0,
        randomized: Sequence[str] = (), sight: Sight | None = None, desynchronize: bool = False,
        lesson: Lesson | None = None, memory: int = 0, privileged: bool = True, narrowed: bool = False,
    ) -> None:  # fmt: skip
        check_warp(device)
        super().__init__(
            twin, task, seed, noise, randomized, sight, desynchronize, lesson, memory, privileged, narrowed=narrowed,
            count=count, device=device,
        )  # fmt: skip
        alone = twin.layout is not None and task.limits.ends
        self.stepper = (WarpStep if alone else WarpMujoco)(twin, round(self._period / twin.dt), single=True)
        self.draws: Any = DeviceDraws(device, seed)  # which numpy's generator is declared for
        self.bank = ParameterBank(self.stepper, self._priors, self.rng, device)
        start = self.stepper.pack_state(twin.initial_state(ids=np.zeros(1, int)))
        self._start = torch.tensor(start, dtype=torch.float32, device=device)
        self.table = self._start.repeat(1, count)
        self.numbers = self.bank.numbers[:, :1].repeat(1, count)
        self._command = torch.zeros(2, count, device=device)
        self._touched = torch.zeros(count, dtype=torch.int32, device=device)
        self._limit, self._noise = (self._to(array) for array in (self._scale, self._noise_std))
        self.show_rows()
        self._shown: Any = self._name_constants()
        tensors: dict[str, Any] = {name: self._to(array) for name, array in vars(self.episodes).items()}
        self.episodes: Any = Episodes(**tensors)
        self.sensors: Any = start_sensors(self.state.qpos, self.state.qvel, self._depth, self._period)
        self.failed_starts: Any = StartRing(device)
        self._broken = torch.zeros((), dtype=torch.int64, device=device)
        self._wp = load_warp()
        with tell_wait(COMPILING):
            self._launch = self.stepper.record(
                *(self._wp.from_torch(t) for t in (self.table, self.numbers, self._command, self._touched))
            )
        self._everyone = torch.ones(count, dtype=torch.bool, device=device)

    def show_rows(self) -> None:
        """Let `state` be what `TwinState` shows of the table, (N, ...)."""
        rows, table = self.stepper.state, self.table
        self.state: Any = SimpleNamespace(
            qpos=table[rows["qpos"]].T, qvel=table[rows["qvel"]].T, time=table[rows["time"]][0],
            blade_pitch=table[rows["actuators.output"]].T, rotor_speed=table[rows["actuators.rotor_speed"]].T,
        )  # fmt: skip

    @property
    def faults(self) -> int:
        """Number of simulations so far that diverged and were started afresh."""
        return int(self._broken) if hasattr(self, "_broken") else 0

    @faults.setter
    def faults(self, number: int) -> None:
        if hasattr(self, "_broken"):
            self._broken.fill_(number)

    def _to(self, array: np.ndarray) -> torch.Tensor:
        """An array on the device, numbers in float32."""
        tensor = torch.as_tensor(array)
        return tensor.to(self.device, torch.float32 if tensor.is_floating_point() else tensor.dtype).contiguous()

    def _name_constants(self) -> dict[str, torch.Tensor]:
        """Constants of the sensors by name, (N, nv) each: views of `numbers`, or the same for all."""
        rows, known = self.stepper.numbers, self.twin.constants[0]
        return {
            name: self.numbers[rows[name]].T if name in rows.shapes else self._to(known[name]).expand(self.count, -1)
            for name in PERFECT
        }

    def _find_stream(self) -> Any:  # noqa: ANN401
        """Torch's stream of now, as Warp has it; None on a processor."""
        if self.device.type == "cpu":
            return None
        return self._wp.stream_from_torch(torch.cuda.current_stream(self.device))

    def _set_seed(self, seed: int | None) -> None:
        super()._set_seed(seed)
        self.draws = DeviceDraws(self.device, seed or 0)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        never = torch.zeros_like(self._everyone)
        if self.restored and mask is None:
            self.restored = False
            return self._pack(never, never)
        if mask is None:
            self.bank.refresh(self._draw_levels)
            self._begin_anew(self._everyone)
            if self.desynchronize:
                self.episodes.elapsed[:] = self.draws.uniform(0.0, self.duration, self.count)
                self._schedule(self._everyone)
        else:
            self._begin_anew(mask.reshape(-1))
        return self._pack(never, never)

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Start new episodes where they are over, without asking whether any is."""
        return tensordict.update(self._reset(TensorDict({"_reset": tensordict["done"]}, tensordict.batch_size)))

    def _begin_anew(self, here: torch.Tensor) -> None:
        """Start new episodes where `here`, (N,) bool, says so: what all would start with is drawn, and put there."""
        draws, episodes, task, count = self.draws, self.episodes, self.task, self.count
        target = task.target.draw(draws, count)
        pose, velocity = task.start.draw(draws, target)
        criterion = torch.full((count,), BOTH, device=self.device)
        if self.lesson is not None:
            if self.lesson.single(self.flown * count):
                criterion = draws.choice([POSITION, ANGLE], count).long()
            share = self.lesson.again(self.flown * count)
            target, pose, velocity = self.failed_starts.replace(share, draws, target, pose, velocity)
        started = torch.cat([target, pose, velocity], 1)
        near = target[:, 2] + draws.uniform(-NEAR, NEAR, count)
        pose[:, 2] = torch.where(criterion == POSITION, near, pose[:, 2])
        ids = self.bank.pick(draws, count)
        self.numbers.copy_(torch.where(here, self.bank.numbers[:, ids], self.numbers))
        self.table.copy_(torch.where(here, self._start_rigs(pose, velocity), self.table))
        fresh = start_sensors(pose, velocity, self._depth, self._period)
        for name, ring in self.sensors.arrays().items():
            put(ring, here, getattr(fresh, name))
        put(episodes.started, here, started)
        put(episodes.target, here, target)
        put(episodes.criterion, here, criterion)
        put(episodes.true_integral, here, (target - pose)[:, :2])
        for name in ("turn", "elapsed", "age", "total", "stage", "integral", "action"):
            put(getattr(episodes, name), here, 0)
        put(episodes.closest, here, torch.inf)
        episodes.missed &= ~here
        self._schedule(here)
        if episodes.seen.numel():
            put(episodes.drawn, here, self.bank.drawn[ids])
        self._measure_where(here)
        put(episodes.seen, here, episodes.seen[:, -1:])

    def _start_rigs(self, pose: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
        """What evolves, (rows, N), of rigs at rest but for their pose and velocity, (N, 3) each."""
        rows, table = self.stepper.state, self._start.repeat(1, self.count)
        table[rows["qpos"]], table[rows["qvel"]] = pose.T, velocity.T
        if "actuator.trim" in self.stepper.numbers.shapes:
            trim = self.numbers[self.stepper.numbers["actuator.trim"]]
            table[rows["actuators.output"]] = table[rows["actuators.mean"]] = trim
        for k, start in enumerate(self.twin.pipeline.starts):
            if isinstance(start, tuple):
                table[rows["effects"].start + k] = (pose if start[0] == "position" else velocity)[:, start[1]]
        return table

    def _schedule(self, here: Any) -> None:  # noqa: ANN401
        """Draw when the next triggers come, as `VppEnv`, where `here` says so."""
        episodes, target = self.episodes, self.task.target
        now, stage = episodes.elapsed, episodes.stage
        time, soonest = now + target.draw_dwell(self.draws, stage), now + target.span_dwell(stage)[0]
        last = np.inf if self.lesson is not None else self.duration - target.quiet
        never = (time > last) | (episodes.criterion == POSITION)
        put(episodes.switch, here, torch.where(never, torch.inf, time))
        put(episodes.due, here, torch.where(never, torch.inf, soonest))

    def _measure_where(self, here: torch.Tensor) -> None:
        """Advance the integral and take a fresh observation, as `VppEnv`, where `here` says so."""
        episodes, state = self.episodes, self.state
        pose, velocity = read_sensors(self._shown, self.sensors, state.qpos, state.qvel, state.time, self._period)
        if self.noise:
            level = self.difficulty
            pose = pose + level * self._noise[0] * self.draws.standard_normal(pose.shape)
            velocity = velocity + level * self._noise[1] * self.draws.standard_normal(velocity.shape)
        integral = accumulate_error(episodes.integral, (episodes.target - pose)[:, :2])
        put(episodes.integral, here, integral)
        put(episodes.observation, here, observe(pose, velocity, episodes.target, episodes.integral, self.sight))
        if episodes.seen.numel():
            now = episodes.observation
            if self.privileged:
                now = see_everything(state, episodes, self.twin.vehicle, slice(None), self._unmet())
            put(episodes.seen, here, torch.cat([episodes.seen[:, 1:], now[:, None]], 1))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict.get("action").detach().clamp(-1.0, 1.0)
        self._command.copy_((action * self._limit).T)
        self._launch.launch(self._find_stream())
        broken = ~torch.isfinite(self.table.sum(0)) | (self.state.qvel.abs() > FASTEST).any(1)
        self._broken += broken.sum()
        self.table.copy_(torch.where(broken, self._start, self.table))  # until its new episode begins
        episodes, task = self.episodes, self.task
        pose, velocity = self.state.qpos, self.state.qvel
        record_poses(self.sensors, pose, velocity)
        episodes.action[:] = action
        episodes.elapsed += self._period
        episodes.age += self._period
        self.flown += 1
        self.bank.follow(self.flown, self._draw_levels)
        delta = episodes.target - pose
        episodes.true_integral[:] = accumulate_error(episodes.true_integral, delta[:, :2])
        torch.minimum(episodes.closest, wrap_angle(delta[:, 2]).abs(), out=episodes.closest)
        self._move_targets()
        reward = compute_reward(task.weights, delta, velocity, episodes.true_integral, episodes.criterion)
        reward = torch.where(broken, 0.0, reward)
        episodes.total += reward
        self._measure_where(~broken)
        terminated = task.limits.exceeded(self.twin.vehicle, pose, velocity) | (self._touched > 0) | broken
        if self.lesson is not None:
            self.failed_starts.add(terminated & (episodes.age <= SOON), episodes.started)
            terminated = terminated | episodes.missed | ((episodes.elapsed >= episodes.due) & self._unmet())
        truncated = (episodes.elapsed > self.duration - 0.5 * self._period) & ~terminated
        return self._pack(terminated, truncated, reward)

    def _move_targets(self) -> None:
        """Turn the targets that are turning, and let triggers come, as `VppEnv`."""
        episodes, target = self.episodes, self.task.target
        episodes.surprised[:] = False
        if target.dwell is None:
            return
        if target.turns:
            reach = target.turn_rate * self._period
            step = episodes.turn.clamp(-reach, reach)
            episodes.target[:, 2] += step
            episodes.turn -= step
        here = episodes.elapsed >= episodes.switch
        episodes.missed |= here & self._unmet()
        put(episodes.closest, here, torch.inf)
        episodes.stage += here
        if not target.expected:
            episodes.surprised |= here
        now = wrap_angle(episodes.target[:, 2])
        turn = target.draw_turn(self.draws, self.count)
        other = target.draw_other_angle(self.draws, now, episodes.stage)
        put(episodes.turn, here, turn)
        put(episodes.target[:, 2], here, torch.where(turn == 0.0, other, now))
        self._schedule(here)

    def _pack(self, terminated: Any, truncated: Any, reward: Any = None) -> TensorDict:  # noqa: ANN401
        """Fresh tensors of what an agent sees now, with the reward after a step, as `VppEnv`."""
        episodes, wanted = self.episodes, self.task.success
        delta = episodes.target - self.state.qpos
        distance = torch.hypot(delta[:, 0], delta[:, 1])
        there = (distance <= wanted.position) & (wrap_angle(delta[:, 2]).abs() <= wanted.angle) & ~episodes.missed
        told = {"position_error": distance, "success": there & truncated, "surprised": episodes.surprised,
                "episode_return": episodes.total}  # fmt: skip
        if reward is not None:
            told["reward"] = reward
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        shown = {"observation": episodes.observation.clone()}
        if episodes.seen.numel():
            shown["critic_observation"] = episodes.seen.clone()
        columns = {name: value.float()[:, None].clone() for name, value in told.items()}
        flagged = {name: value[:, None].clone() for name, value in flags.items()}
        return TensorDict({**shown, **columns, **flagged}, batch_size=self.batch_size, device=self.device)

    def _show_first(self) -> TwinState:
        return self.stepper.unpack_state(self.table[:, :1].cpu().numpy())

    def list_tensors(self) -> dict[str, torch.Tensor]:
        """Every tensor that evolves, by name."""
        rings = {f"sensors.{name}": ring for name, ring in self.sensors.arrays().items()}
        starts = {f"starts.{name}": ring for name, ring in vars(self.failed_starts).items()}
        bank = {"bank.numbers": self.bank.numbers, "bank.drawn": self.bank.drawn}
        return {"table": self.table, "numbers": self.numbers, **vars(self.episodes), **rings, **starts, **bank}


@take_snapshot.register
def take_device_snapshot(env: DeviceEnv) -> dict[str, Any]:
    """Everything that evolves in an environment on a device, as tensors and plain data."""
    tensors = {name: tensor.cpu().clone() for name, tensor in env.list_tensors().items()}
    draws = env.draws.generator.get_state(), json.dumps(env.rng.bit_generator.state)
    return {"tensors": tensors, "random": draws, "faults": env.faults, "flown": env.flown}


@restore_snapshot.register
def restore_device_snapshot(env: DeviceEnv, snapshot: Mapping[str, Any]) -> None:
    """Put an environment on a device where a snapshot was taken.

    Raises:
        InputError: if it was taken of simulations on the processor.
    """
    tensors = snapshot.get("tensors", {})
    if tensors.keys() != env.list_tensors().keys():
        found = "a checkpoint of simulations that numba stepped"
        raise InputError(found, "one of engine=warp", "add engine=numba, or train on with init_from=RUN")
    for name, tensor in env.list_tensors().items():
        tensor.copy_(tensors[name])
    state, numbers = snapshot["random"]
    if env.device.type == "cpu":  # generators of a card and of a processor have nothing in common
        env.draws.generator.set_state(state)
    env.rng.bit_generator.state = json.loads(numbers)
    env.faults, env.flown, env.restored = snapshot["faults"], snapshot["flown"], True


def make_device_env(config: TrainConfig, device: torch.device, lesson: Lesson | None = None) -> DeviceEnv:
    """The environment of a run on a device.

    Args:
        config: of the run.
        device: where it is.
        lesson: of training; None for flying at full difficulty.

    Raises:
        InputError: as `vpptwin.train.env.vpp_env.make_env` and `DeviceEnv`.
    """
    check_warp(device)
    spec, randomized = load_randomized(config)
    twin = Twin(spec, BANK if randomized else 1, active=randomized, num_threads=config.sim_threads)
    return DeviceEnv(
        twin, config.task, config.num_envs, device, config.seed, config.noise, randomized, config.sight,
        config.desynchronize, lesson, config.critic_memory, config.privileged, IDENTIFIED in config.randomize,
    )  # fmt: skip


def put(target: torch.Tensor, here: torch.Tensor, value: Any) -> None:  # noqa: ANN401
    """Write values, or one for all, into the rows of a tensor where `here`, (N,) bool, says so."""
    mask = here.reshape(-1, *(1,) * (target.dim() - 1))
    target.copy_(torch.where(mask, value, target))
