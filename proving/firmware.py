"""The product's own firmware in crafts of the independent simulation: what learns there is what would fly."""

from __future__ import annotations

import numpy as np
from numba import njit

from proving.drone.control import PITCH_LSB, THROTTLE_LSB
from proving.drone.sensors import quantise
from vpptwin.actuators.adaptive import start_memory
from vpptwin.actuators.controller import run_cascade
from vpptwin.actuators.layer import layer_dtype
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle

STEP = 0.001  # s
NOMINAL = load_vehicle()


def start_memories(shape: tuple[int, ...], rotors: int, adaptive: bool) -> np.recarray:
    """Memories of controllers of `rotors` each, of that shape, before anything is learned."""
    memories = np.zeros(shape, layer_dtype(rotors, 0, adaptive)).view(np.recarray)
    if adaptive:
        memories.adaptive[:] = start_memory(NOMINAL.rotor.speed)
    memories.throttle[:] = NOMINAL.rotor.speed / NOMINAL.motor.k_v / NOMINAL.motor.battery
    return memories


@njit(error_model="numpy")
def _run(vehicle, memories, thrust, rate, gyro, speed, current, pitch):  # noqa: ANN001, ANN202
    for i in range(len(memories)):
        pitch[0, i], pitch[1, i] = run_cascade(
            vehicle, memories[i], thrust[i], rate[i], gyro[i],
            (speed[0, i], speed[1, i]), (current[0, i], current[1, i]), STEP,
        )  # fmt: skip


class VpptwinFirmware:
    """`proving.drone.control.Controller` of a batch of crafts: vpptwin's loops, which believe in a vehicle."""

    def __init__(self, count: int, adaptive: bool, vehicle: Vehicle = NOMINAL) -> None:
        self.vehicle = record_vehicle(vehicle)[0]
        self.memories = start_memories((count,), 2, adaptive)

    def command(
        self, thrust: np.ndarray, rate: np.ndarray, gyro: np.ndarray, speed: np.ndarray, current: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run the loops once: blade pitch rad and throttle, both (2, flights)."""
        pitch = np.empty(speed.shape)
        _run(self.vehicle, self.memories, thrust, rate, gyro, speed, current, pitch)
        throttle = quantise(self.memories.throttle.T, THROTTLE_LSB)
        return quantise(pitch, PITCH_LSB), np.clip(throttle, 0.0, 1.0)
