"""The environment on a device: rigs, episodes and draws in tensors there, stepped by one Warp kernel."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from vpptwin.engine.arrays import Array, MaskedRows, beside
from vpptwin.system.errors import InputError
from vpptwin.system.progress import tell_wait
from vpptwin.train.config import Schedule, TrainConfig
from vpptwin.train.env.base_env import BaseEnv, EnvConfig
from vpptwin.train.env.episodes import MAX_STARTS, Episodes
from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.train.env.vpp_env import configure_env
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.health import FASTEST
from vpptwin.twin.sensors import PERFECT, read_sensors
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.stepping.kernel import COMPILING
from vpptwin.twin.stepping.past import record_poses, start_sensors
from vpptwin.twin.warp.device import check_driver, load_warp
from vpptwin.twin.warp.mujoco import WarpMujoco
from vpptwin.twin.warp.step import WarpStep

BANK_SIZE = 1024
"""Sets of parameters that episodes take theirs from at any time."""
REFRESH_STEPS = 32
"""Policy steps in which all of them are drawn afresh."""


class DeviceDraws:
    """Random numbers on a device, with numpy's names; what draws from `numpy.random.Generator` draws from this too."""

    def __init__(self, device: torch.device, seed: int) -> None:
        self.device = device
        self.generator = torch.Generator(device).manual_seed(seed)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> torch.Tensor:  # noqa: ANN401
        """Uniform numbers, by default of the shape of `low`."""
        shape = low.shape if size is None else shape_of(size)
        unit = torch.rand(shape, generator=self.generator, device=self.device)
        low, high = (end if isinstance(end, (float, int, torch.Tensor)) else beside(unit, end) for end in (low, high))
        return low + (high - low) * unit

    def standard_normal(self, size: Any) -> torch.Tensor:  # noqa: ANN401
        """Normal numbers."""
        return torch.randn(shape_of(size), generator=self.generator, device=self.device)

    def integers(self, low: int, high: int, size: Any) -> torch.Tensor:  # noqa: ANN401
        """Whole numbers from low to below high."""
        return torch.randint(low, high, shape_of(size), generator=self.generator, device=self.device)

    def choice(self, values: Sequence[float], size: Any) -> torch.Tensor:  # noqa: ANN401
        """Any of some values, each as likely as the other."""
        table = beside(torch.empty(0, device=self.device), values)
        return table[self.integers(0, len(values), size)]


def shape_of(size: Any) -> tuple[int, ...]:  # noqa: ANN401
    """A shape from what numpy calls size."""
    return (size,) if isinstance(size, int) else tuple(size)


class ParameterBank:
    """Sets of parameters with all that effects make of them, drawn on the processor and kept on a device.

    Effects that act on constants run in numpy, as everywhere; a new episode takes a set of the bank.

    Attributes:
        numbers: of the stepper, (rows, sets).
        drawn: what was drawn, standardized for a critic, (sets, K).
    """

    def __init__(self, stepper: WarpStep, priors: Priors, rng: np.random.Generator, device: torch.device) -> None:
        self._stepper, self._priors, self._rng = stepper, priors, rng
        self._device = device
        self.sets = stepper.twin.num_sims
        self.numbers = torch.tensor(stepper.pack_numbers(), dtype=torch.float32, device=device)
        self.drawn = torch.zeros(self.sets, len(priors.keys), device=device)

    def refresh(self, draw_levels: Callable[[int], np.ndarray], first: int = 0, last: int | None = None) -> None:
        """Draw sets afresh, all or those from first to before last, at levels of the moment, (sets,)."""
        ids = np.arange(self.sets)[first:last]
        if not self._priors.keys or not len(ids):
            return
        drawn = randomize(self._stepper.twin, self._priors, ids, self._rng, draw_levels(len(ids)))
        known = np.clip(self._priors.standardize(drawn), -5.0, 5.0)
        self.numbers[:, first:last] = self._send(self._stepper.pack_numbers(slice(first, last)))
        self.drawn[first:last] = self._send(known)

    def _send(self, numbers: np.ndarray) -> torch.Tensor:
        """Numbers on the device, for which nothing waits."""
        tensor = torch.as_tensor(numbers, dtype=torch.float32)
        return tensor.pin_memory().to(self._device, non_blocking=True) if self._device.type == "cuda" else tensor

    def follow(self, step: int, draw_levels: Callable[[int], np.ndarray]) -> None:
        """Draw a share of the sets afresh, that of a policy step."""
        size, turn = -(-self.sets // REFRESH_STEPS), step % REFRESH_STEPS
        self.refresh(draw_levels, turn * size, (turn + 1) * size)


class StartRing:
    """The latest starts that led to a failure, on a device, as `vpptwin.train.env.episodes.FailedStarts` keeps them.

    Attributes:
        starts: target, pose and velocity, (MAX_STARTS + 1, 9); the last row takes what is not to be kept.
        seen: how many there have been so far, () int.
    """

    def __init__(self, device: torch.device) -> None:
        self.starts = torch.zeros(MAX_STARTS + 1, 9, device=device)
        self.seen = torch.zeros((), dtype=torch.int64, device=device)

    def add(self, here: torch.Tensor, started: torch.Tensor) -> None:
        """Keep the starts (N, 9) of the rows where `here`, (N,) bool, says so."""
        slots = (self.seen + here.cumsum(0) - 1) % MAX_STARTS
        self.starts[torch.where(here, slots, MAX_STARTS)] = started
        self.seen += here.sum()

    def replace(
        self, share: float, draws: DeviceDraws, target: torch.Tensor, pose: torch.Tensor, velocity: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """Starts (N, 3) each, one of these in place of a share of them."""
        if not share:
            return target, pose, velocity
        kept = self.seen.clamp(max=MAX_STARTS)
        ids = (draws.uniform(size=len(target)) * kept).long().clamp(max=MAX_STARTS - 1)
        again = (draws.uniform(size=len(target)) < share) & (kept > 0)
        return torch.where(again[:, None], self.starts[ids], torch.cat([target, pose, velocity], 1)).split(3, 1)


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


def make_device_env(
    config: TrainConfig, device: torch.device, schedule: Schedule | None = None, spec: TwinSpec | None = None
) -> DeviceEnv:
    """The environment of a run on a device.

    Raises:
        InputError: as `vpptwin.train.env.vpp_env.make_env` and `DeviceEnv`.
    """
    check_warp(device)
    spec, flown = configure_env(config, schedule, spec=spec)
    twin = Twin(spec, BANK_SIZE if flown.randomized else 1, active=flown.randomized, num_threads=config.sim_threads)
    return DeviceEnv(twin, flown, config.num_envs, device)


def check_warp(device: torch.device) -> None:
    """Refuse a device that Warp does not step on.

    Raises:
        InputError: if Warp is not installed, or the card's driver is older than what it was built for.
    """
    load_warp()
    if device.type == "cuda":
        check_driver(f"device={device}", "say engine=numba, which simulates on the processor")
