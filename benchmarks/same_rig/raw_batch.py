"""MuJoCo's own batch alone, the yardstick: no controller, no observation, no reward."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch
from numba import cfunc, types

from same_rig.rig import START_POSE, START_VELOCITY, SUBSTEPS
from vpptwin.robots.planar_drone.vehicle import Vehicle


class RawBatch:
    """`Batch.step(nstep=10)`: thrusts held for 10 ms, friction in MuJoCo's solver, back to the start every second."""

    title = "raw mujoco.batch.Batch"
    leaves_out = "no flight controller, servo, motor, observation or reward: thrusts held for 10 ms"
    controlled = False
    workers = 0

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None:
        self.envs, self._steps = envs, 0
        self._scale = np.array([0.5 * vehicle.control.thrust_max, 0.05])
        self._batch = Batch(mujoco.MjModel.from_xml_path(str(rig)), envs, 0)
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.start()

    def start(self) -> None:
        """Put every rig at the start state."""
        self._qpos[:], self._qvel[:], self._steps = START_POSE, START_VELOCITY, 0

    def step(self, actions: np.ndarray) -> None:
        """Ten steps of physics under thrusts like those of a flight."""
        if self._steps == 100:
            self.start()
        common, difference = (self._scale * actions).T
        self._ctrl[:, 0], self._ctrl[:, 1] = common - difference, common + difference
        self._batch.step(nstep=SUBSTEPS)
        self._steps += 1

    def positions(self) -> np.ndarray:
        """x, z, θ, (envs, 3)."""
        return self._qpos.copy()

    def close(self) -> None:
        """Nothing to end."""


@cfunc(types.float64())
def stop_clock() -> float:
    """Time that does not pass [ms]."""
    return 0.0


class ClocklessBatch(RawBatch):
    """As `RawBatch`, while the profiling clock that MuJoCo's Python bindings install stands still, as in our twin.

    MuJoCo reads that clock some thirty times a step, which a model as small as this one notices.
    """

    title = "the same, its profiling clock stopped"

    def step(self, actions: np.ndarray) -> None:
        """Ten steps of physics under thrusts like those of a flight."""
        clock = mujoco.get_mjcb_time()
        mujoco.set_mjcb_time(stop_clock.ctypes)
        try:
            super().step(actions)
        finally:
            mujoco.set_mjcb_time(clock)
