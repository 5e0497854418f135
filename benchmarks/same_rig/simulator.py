"""What `benchmarks/peers.py` asks of a simulator of many rigs."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from vpptwin.robots.planar_drone.vehicle import Vehicle


class Simulator(Protocol):
    """Many rigs in one simulator; made from a rig's file, the vehicle, a number of rigs and a seed."""

    title: ClassVar[str]  # how the table names it
    leaves_out: ClassVar[str]  # what it does less, or more, than the environment of vpptwin, for the notes
    controlled: ClassVar[bool]  # whether the flight controller runs; without it there is no flight to compare
    envs: int  # number of rigs
    workers: int  # processes besides this one

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None: ...

    def start(self) -> None:
        """Put every rig at the start state, as at power-on."""

    def step(self, actions: np.ndarray) -> None:
        """Fly one control step of 10 ms under actions in [-1, 1], (envs, 2) float32."""

    def positions(self) -> np.ndarray:
        """Positions x [m], z [m], θ [rad] of every rig, (envs, 3)."""

    def close(self) -> None:
        """End worker processes."""


SIMULATORS = {
    "raw": "raw_batch.RawBatch",
    "raw-clockless": "raw_batch.ClocklessBatch",
    "vpptwin": "vpptwin_env.TwinRigs",
    "gymnasium": "gymnasium_env.AsyncRigs",
    "torchrl-serial": "torchrl_env.SerialRigs",
    "torchrl-parallel": "torchrl_env.ParallelRigs",
    "mjx": "mjx_rigs.MjxRigs",
}
"""Module and class of every simulator, imported only when asked for: some need packages that vpptwin does not."""


def find_simulator(name: str) -> type[Simulator]:
    """The class of a simulator.

    Raises:
        ImportError: if its package is not installed.
    """
    module, cls = SIMULATORS[name].split(".")
    found: type[Simulator] = getattr(import_module(f"same_rig.{module}"), cls)
    return found
