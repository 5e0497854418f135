"""The same rig on a device: the twin's Warp kernel, the environment around it and mujoco_warp, for `throughput.py`."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from throughput_rigs import FRICTION, SUBSTEPS, TASK, Rigs, Spent

from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS
from vpptwin.system.resources import find_model_file
from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.robot.losses import take_out_losses
from vpptwin.twin.warp.mujoco import WarpMujoco
from vpptwin.twin.warp.step import WarpStep, load_warp

FLIGHT = 50
"""Control steps after which all rigs start where they started."""
BANK = 1024
"""Twins that rigs take their parameters from."""


class DeviceRigs(Rigs):
    """N rigs on a device, near hovering under commands that change at random; no step waits for the one before.

    Args:
        device: Warp's name of it.
    """

    def __init__(self, count: int, threads: int, seed: int, device: str) -> None:
        super().__init__(count, threads, seed)
        self.wp, self.device = load_warp(), device

    def fly(self, steps: int) -> Spent:
        """Fly so many control steps of all rigs; the time is that until the device is done."""
        spent = Spent(steps=steps * self.count)
        self.wp.synchronize_device(self.device)
        with spent.counted():
            for k in range(steps):
                self.advance(k)
            self.wp.synchronize_device(self.device)
        return spent

    @abstractmethod
    def advance(self, k: int) -> None:
        """Fly control step k."""

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Not looked at while it flies."""
        raise NotImplementedError

    def step(self, command: np.ndarray, spent: Spent) -> None:
        """Not flown by a pilot on the processor."""
        raise NotImplementedError


class KernelRigs(DeviceRigs):
    """The twin's step alone, float32, every effect drawn from its prior: what `Twin.advance_policy` is here."""

    stepper: type[WarpStep] = WarpStep

    def __init__(self, count: int, threads: int, seed: int, device: str) -> None:
        super().__init__(count, threads, seed, device)
        spec = load_twin()
        twin = Twin(spec, BANK, [e.id for e in spec.catalogue], threads)
        randomize(twin, Priors.of(spec.catalogue), np.arange(BANK), self.rng)
        pose, velocity = self.begin(np.arange(count))
        step, ids = self.stepper(twin, SUBSTEPS, single=True), np.arange(count) % BANK
        table = step.pack_state(twin.initial_state(pose, velocity, ids=ids))
        self.start, self.table, numbers = (self.send(t) for t in (table, table, step.pack_numbers()[:, ids]))
        hover = (twin.vehicle.airframe.mass + twin.vehicle.rig.slider_mass) * twin.vehicle.gravity
        self.commands = [self.send(np.stack([self.rng.normal(hover, 0.3, count), self.rng.normal(0.0, 1.0, count)]))
                         for _ in range(10)]  # fmt: skip
        self.command = self.wp.clone(self.commands[0])
        touched = self.wp.zeros(count, dtype=self.wp.int32, device=device)
        self.recorded = step.record(self.table, numbers, self.command, touched)

    def send(self, table: np.ndarray) -> Any:  # noqa: ANN401
        """A table on the device."""
        return self.wp.array(np.ascontiguousarray(table), dtype=self.wp.float32, device=self.device)

    def advance(self, k: int) -> None:
        """Fly control step k."""
        if k % FLIGHT == 0:
            self.wp.copy(self.table, self.start)
        self.wp.copy(self.command, self.commands[k % len(self.commands)])
        self.recorded.launch()


class ContactRigs(KernelRigs):
    """The twin's step by mujoco_warp, which rigs that touch something need."""

    stepper = WarpMujoco


class DeviceEnvRigs(DeviceRigs):
    """The environment on the device, every effect drawn: sensors with noise, reward, resets, as TorchRL steps it."""

    def __init__(self, count: int, threads: int, seed: int, device: str) -> None:
        super().__init__(count, threads, seed, device)
        import torch

        from vpptwin.train.env.base_env import EnvConfig
        from vpptwin.train.env.device_env import DeviceEnv

        spec, place = load_twin(), torch.device(device)
        every = [e.id for e in spec.catalogue]
        config = EnvConfig(TASK, seed, 1.0, every, desynchronize=True)
        self.env = DeviceEnv(Twin(spec, BANK, every, threads), config, count, place)
        self.now = self.env.reset()
        spread, middle = torch.tensor([0.03, 0.05], device=place), torch.tensor([0.49, 0.0], device=place)
        self.actions = [middle + spread * torch.randn(count, 2, device=place) for _ in range(10)]

    def advance(self, k: int) -> None:
        """Fly control step k."""
        self.now["action"] = self.actions[k % len(self.actions)]
        _, self.now = self.env.step_and_maybe_reset(self.now)


class MujocoWarpRigs(DeviceRigs):
    """`mujoco_warp.step`, ten to a control step, in a graph on a card: the rig's MJCF with friction, thrusts held."""

    def __init__(self, count: int, threads: int, seed: int, device: str) -> None:
        super().__init__(count, threads, seed, device)
        import mujoco_warp

        spec = mujoco.MjSpec.from_file(str(find_model_file("rail_rig.xml")))
        take_out_losses(spec, CRAFT_JOINTS)
        for name in ("rail_x", "rail_z"):
            spec.joint(name).frictionloss = FRICTION
        model = spec.compile()
        data = mujoco.MjData(model)
        pose, velocity = self.begin(np.arange(count))
        with self.wp.ScopedDevice(device):
            self.model, self.data = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=count)
            for name, values in (("qpos", pose), ("qvel", velocity), ("ctrl", np.full((count, 2), 2.45))):
                self.wp.copy(getattr(self.data, name), self.wp.array(values, dtype=self.wp.float32))
            self.run = lambda: [mujoco_warp.step(self.model, self.data) for _ in range(SUBSTEPS)]
            self.run()
            if self.wp.get_device(device).is_cuda:
                with self.wp.ScopedCapture() as capture:
                    self.run()
                self.run = lambda: self.wp.capture_launch(capture.graph)
            self.start = [self.wp.clone(getattr(self.data, name)) for name in ("qpos", "qvel")]

    def advance(self, k: int) -> None:
        """Fly control step k."""
        with self.wp.ScopedDevice(self.device):
            if k % FLIGHT == 0:
                for name, start in zip(("qpos", "qvel"), self.start, strict=True):
                    self.wp.copy(getattr(self.data, name), start)
            self.run()


def list_contenders(device: str) -> dict[str, tuple[str, Callable[[int, int, int], Rigs]]]:
    """What is measured on a device: title and how to make N rigs of it; mujoco_warp where it is installed."""
    place = "cuda:0" if device == "cuda" else device
    kinds: dict[str, tuple[str, type[DeviceRigs]]] = {
        f"twin on {device}": ("the twin's step as a Warp kernel, every effect, float32", KernelRigs),
        f"environment on {device}": ("DeviceEnv: all effects, sensors, reward, resets", DeviceEnvRigs),
    }
    try:
        import mujoco_warp  # noqa: F401

        kinds[f"twin with contact on {device}"] = ("the twin's step by mujoco_warp, every effect, float32", ContactRigs)
        kinds[f"mujoco_warp on {device}"] = ("mujoco_warp.step ten times, friction in its solver", MujocoWarpRigs)
    except ImportError:
        pass
    return {name: (title, lambda n, threads, seed, kind=kind: kind(n, threads, seed, place))  # type: ignore[misc]
            for name, (title, kind) in kinds.items()}  # fmt: skip
