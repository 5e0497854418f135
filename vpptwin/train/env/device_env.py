"""The environment on a device: rigs, episodes and draws in tensors there, stepped by one Warp kernel."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from vpptwin.engine.arrays import Array, MaskedRows
from vpptwin.system.errors import InputError
from vpptwin.system.progress import tell_wait
from vpptwin.train.config import Lesson, TrainConfig
from vpptwin.train.env.base_env import BaseEnv, EnvConfig
from vpptwin.train.env.device_draws import BANK, DeviceDraws, ParameterBank, StartRing
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.vpp_env import configure_env
from vpptwin.train.learn.devices import check_warp
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.health import FASTEST
from vpptwin.twin.sensors import PERFECT, read_sensors
from vpptwin.twin.stepping.kernel import COMPILING
from vpptwin.twin.stepping.past import record_poses, start_sensors
from vpptwin.twin.warp.device import load_warp
from vpptwin.twin.warp.mujoco import WarpMujoco
from vpptwin.twin.warp.step import WarpStep


class DeviceEnv(BaseEnv):
    """`BaseEnv` in float32 on a device; no step waits for the device.

    What touches something, or comes as near as the ball around it, ends its episode as a failure; a task that goes on
    there, and a rig that only MuJoCo steps, are stepped by `mujoco_warp`, contact and all.
    Parameters are drawn, and effects that act on constants applied, on the processor: for a bank of rigs, from which
    new episodes take theirs, and which is drawn afresh as training goes.

    Args:
        twin: of the bank: as many simulations as it has sets of parameters, with the randomized effects switched on.
        config: what to fly; its estimator is `sensors`.
        count: simulations N.
        device: `cpu`, by Warp's processor device, or `cuda`.

    Raises:
        InputError: if Warp, mujoco_warp or a card is missing, or the rig or an effect cannot be flown by them.
    """

    def __init__(self, twin: Twin, config: EnvConfig, count: int, device: torch.device) -> None:
        check_warp(device)
        super().__init__(twin, config, count, device)
        alone = twin.layout is not None and self.task.limits.ends
        self.stepper = (WarpStep if alone else WarpMujoco)(twin, round(self._period / twin.dt), single=True)
        self.draws = DeviceDraws(device, config.seed)
        self.bank = ParameterBank(self.stepper, self._priors, self.rng, device)
        start = self.stepper.pack_state(twin.initial_state(ids=np.zeros(1, int)))
        self._start = torch.tensor(start, dtype=torch.float32, device=device)
        self.table = self._start.repeat(1, count)
        self.numbers = self.bank.numbers[:, :1].repeat(1, count)
        self._command = torch.zeros(2, count, device=device)
        self._touched = torch.zeros(count, dtype=torch.int32, device=device)
        self._scale, self._noise_std = self._to(self._scale), self._to(self._noise_std)
        self.show_rows()
        self._shown: Any = self._name_constants()
        self.episodes = Episodes(**{name: self._to(array) for name, array in vars(self.episodes).items()})
        self.sensors = start_sensors(self.state.qpos, self.state.qvel, self._depth, self._period)
        self.failed_starts = StartRing(device)
        self._faults = torch.zeros((), dtype=torch.int64, device=device)
        self._wp = load_warp()
        with tell_wait(COMPILING):
            self._launch = self.stepper.record(
                *(self._wp.from_torch(t) for t in (self.table, self.numbers, self._command, self._touched))
            )
        self._everyone = MaskedRows(torch.ones(count, dtype=torch.bool, device=device))

    def show_rows(self) -> None:
        """Let `state` be what `TwinState` shows of the table, (N, ...)."""
        rows, table = self.stepper.state, self.table
        self.state = SimpleNamespace(
            qpos=table[rows["qpos"]].T, qvel=table[rows["qvel"]].T, time=table[rows["time"]][0],
            blade_pitch=table[rows["actuators.output"]].T, rotor_speed=table[rows["actuators.rotor_speed"]].T,
        )  # fmt: skip

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

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Start new episodes where they are over, without asking whether any is."""
        return tensordict.update(self._reset(TensorDict({"_reset": tensordict["done"]}, tensordict.batch_size)))

    def _read(self, tensor: torch.Tensor) -> torch.Tensor:
        return tensor

    def _draw_parameters(self, rows: MaskedRows) -> None:
        """The bank has drawn them; it does so anew where all begin."""
        if rows is self._everyone:
            self.bank.refresh(self._draw_levels)

    def _start_rigs(self, rows: MaskedRows, pose: torch.Tensor, velocity: torch.Tensor) -> None:
        ids = self.draws.integers(0, self.bank.sets, self.count)
        self.numbers.copy_(torch.where(rows.mask, self.bank.numbers[:, ids], self.numbers))
        rows.put(self.episodes.drawn, self.bank.drawn[ids])
        places, table = self.stepper.state, self._start.repeat(1, self.count)
        table[places["qpos"]], table[places["qvel"]] = pose.T, velocity.T
        if "actuator.trim" in self.stepper.numbers.shapes:
            trim = self.numbers[self.stepper.numbers["actuator.trim"]]
            table[places["actuators.output"]] = table[places["actuators.mean"]] = trim
        for k, start in enumerate(self.twin.pipeline.starts):
            if isinstance(start, tuple):
                table[places["effects"].start + k] = (pose if start[0] == "position" else velocity)[:, start[1]]
        self.table.copy_(torch.where(rows.mask, table, self.table))
        fresh = start_sensors(pose, velocity, self._depth, self._period)
        for name, ring in self.sensors.arrays().items():
            rows.put(ring, getattr(fresh, name))

    def _fly(self, command: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What diverged rests at a start until its new episode begins."""
        self._command.copy_(command.T)
        self._launch.launch(self._find_stream())
        diverged = ~torch.isfinite(self.table.sum(0)) | (self.state.qvel.abs() > FASTEST).any(1)
        self._faults += diverged.sum()
        self.table.copy_(torch.where(diverged, self._start, self.table))
        record_poses(self.sensors, self.state.qpos, self.state.qvel)
        return diverged, diverged | (self._touched > 0)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        after = super()._step(tensordict)
        self.bank.follow(self.flown, self._draw_levels)
        return after

    def _sense(self, rows: MaskedRows) -> tuple[Array, Array]:
        state = self.state
        return read_sensors(self._shown, self.sensors, state.qpos, state.qvel, state.time, self._period)

    def _show_first(self) -> TwinState:
        return self.stepper.unpack_state(self.table[:, :1].cpu().numpy())

    def list_tensors(self) -> dict[str, torch.Tensor]:
        """Every tensor that evolves, by name."""
        rings = {f"sensors.{name}": ring for name, ring in self.sensors.arrays().items()}
        starts = {f"starts.{name}": ring for name, ring in vars(self.failed_starts).items()}
        bank = {"bank.numbers": self.bank.numbers, "bank.drawn": self.bank.drawn}
        return {"table": self.table, "numbers": self.numbers, **vars(self.episodes), **rings, **starts, **bank}

    def take_snapshot(self) -> dict[str, Any]:
        """Everything that evolves, as tensors and plain data, so that a resumed run goes on as if never interrupted."""
        tensors = {name: tensor.cpu().clone() for name, tensor in self.list_tensors().items()}
        draws = self.draws.generator.get_state(), json.dumps(self.rng.bit_generator.state)
        return {"tensors": tensors, "random": draws, "faults": self.faults, "flown": self.flown}

    def restore_snapshot(self, snapshot: Mapping[str, Any]) -> None:
        """Go on where a snapshot was taken; the next full reset hands out the observation of that moment.

        Raises:
            InputError: if it was taken of simulations on the processor.
        """
        tensors = snapshot.get("tensors", {})
        if tensors.keys() != self.list_tensors().keys():
            found = "a checkpoint of simulations that numba stepped"
            raise InputError(found, "one of engine=warp", "add engine=numba, or train on with init_from=RUN")
        for name, tensor in self.list_tensors().items():
            tensor.copy_(tensors[name])
        state, numbers = snapshot["random"]
        if self.device.type == "cpu":  # generators of a card and of a processor have nothing in common
            self.draws.generator.set_state(state)
        self.rng.bit_generator.state = json.loads(numbers)
        self._faults.fill_(snapshot["faults"])
        self.flown, self.restored = snapshot["flown"], True


def make_device_env(config: TrainConfig, device: torch.device, lesson: Lesson | None = None) -> DeviceEnv:
    """The environment of a run on a device.

    Raises:
        InputError: as `vpptwin.train.env.vpp_env.make_env` and `DeviceEnv`.
    """
    check_warp(device)
    spec, flown = configure_env(config, lesson)
    twin = Twin(spec, BANK if flown.randomized else 1, active=flown.randomized, num_threads=config.sim_threads)
    return DeviceEnv(twin, flown, config.num_envs, device)
