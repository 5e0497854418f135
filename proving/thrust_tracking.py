"""Thrust commands on the stand of the independent simulation, by the map alone and by the adaptive controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from proving.drone.effects import Effects
from proving.drone.thrust_stand import ThrustStand
from proving.firmware import NOMINAL, STEP, start_memories
from vpptwin.actuators.adaptive import DRAG, FAULT, HALF_GAP, TRIM
from vpptwin.actuators.controller import drive_rotor
from vpptwin.actuators.numbers import record_vehicle

LEVELS = (0.0, 2.0, -2.0, 4.0, -4.0, 1.0, -1.0, 3.0, 0.5, -3.0, 2.5, -0.5)
"""Thrusts of the step sequence, N."""
DWELL = 0.5
"""Time at each of them, s."""
Spoil = Callable[[float, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A sensor fault: from time [s], measured speed and current, (2, stands), to what arrives."""

COMMANDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "steps": lambda time: np.take(LEVELS, (time / DWELL + 1e-9).astype(int) % len(LEVELS)),
    "sine, 1 Hz": lambda time: 3.0 * np.sin(2.0 * np.pi * time),
    "sine, 3 Hz": lambda time: 2.0 + 1.5 * np.sin(6.0 * np.pi * time),
    "full steps": lambda time: np.where((time / DWELL + 1e-9).astype(int) % 2 == 0, 5.0, -5.0),
    "held": lambda time: np.where(time < 4.0, np.take(LEVELS, (time / DWELL + 1e-9).astype(int) % len(LEVELS)), 2.25),
}
"""Commanded thrust of each rotor [N] over time [s]."""


@dataclass(frozen=True)
class Track:
    """What came of a command. Time first, then rotors and stands.

    Attributes:
        time: s, (steps,).
        command: N, (steps,).
        reachable: the command behind the nominal servo's lag, what an actuator without errors does, N, (steps,).
        thrust: true, N, (steps, 2, stands).
        speed: true, rad/s, (steps, 2, stands).
        believed: trim [rad], half gap [rad] and drag over the map's, (steps, 3, 2, stands); zero without learning.
        fault: what the controller says is wrong, (steps, 2, stands).
    """

    time: np.ndarray
    command: np.ndarray
    reachable: np.ndarray
    thrust: np.ndarray
    speed: np.ndarray
    believed: np.ndarray
    fault: np.ndarray

    def error(self, begin: float = 0.0) -> np.ndarray:
        """RMS of thrust less what is reachable, from a time [s] on, N, (2, stands)."""
        late = self.time >= begin
        wrong = self.thrust[late] - self.reachable[late, None, None]
        rms: np.ndarray = np.sqrt((wrong**2).mean(axis=0))
        return rms

    def settling(self, begin: float, share: float = 0.05) -> np.ndarray:
        """Time after every step of the command until thrust stays within a share of the step, s, (steps, 2, stands)."""
        edges = np.flatnonzero(np.diff(self.command)) + 1
        ends = np.append(edges[1:], len(self.command))
        times = []
        for start, end in zip(edges, ends):
            if self.time[start] < begin:
                continue
            step = abs(self.command[start] - self.command[start - 1])
            outside = np.abs(self.thrust[start:end] - self.command[start]) > share * step
            last = np.where(outside.any(axis=0), end - start - np.argmax(outside[::-1], axis=0), 0)
            times.append(last * STEP)
        return np.array(times)


@njit(error_model="numpy")
def _drive(vehicle, memories, thrust, speed, current, pitch, throttle):  # noqa: ANN001, ANN202
    for stand in range(memories.shape[1]):
        for rotor in range(2):
            memory = memories[rotor, stand]
            pitch[rotor, stand] = drive_rotor(
                vehicle, memory, 0, thrust, speed[rotor, stand], current[rotor, stand], STEP
            )
            throttle[rotor, stand] = memory.throttle[0]


def track_thrust(
    effects: Sequence[Effects], command: str, duration: float, *, adaptive: bool, seed: int, spoil: Spoil | None = None
) -> Track:
    """Send a command to both rotors of every stand.

    Args:
        effects: hidden in each stand.
        command: one of `COMMANDS`.
        duration: s.
        adaptive: whether the controller learns, else it is the map alone.
        seed: of the stands' tolerances and sensor noise.
        spoil: a sensor fault.
    """
    steps, count = round(duration / STEP), len(effects)
    stand = ThrustStand(effects, seed, steps)
    vehicle = record_vehicle(NOMINAL)[0]
    memories = start_memories((2, count), 1, adaptive)
    time = np.arange(steps) * STEP
    wanted = COMMANDS[command](time)
    pitch, throttle = np.zeros((2, count)), np.zeros((2, count))
    thrust, speed, fault = (np.zeros((steps, 2, count)) for _ in range(3))
    believed = np.zeros((steps, 3, 2, count))
    for k in range(steps):
        now = stand.read()
        shown = now.speed, now.current
        if spoil is not None:
            shown = spoil(time[k], *shown)
        _drive(vehicle, memories, wanted[k], *shown, pitch, throttle)
        thrust[k], speed[k] = now.thrust, now.true_speed
        if adaptive:
            learned = memories.adaptive[:, :, 0]
            believed[k] = learned[..., [TRIM, HALF_GAP, DRAG]].transpose(2, 0, 1)
            fault[k] = learned[..., FAULT]
        stand.advance(pitch, throttle)
    keep = np.exp(-STEP / NOMINAL.servo.time_constant)
    reachable = np.zeros(steps)
    for k in range(1, steps):
        reachable[k] = keep * reachable[k - 1] + (1.0 - keep) * wanted[k - 1]
    return Track(time, wanted, reachable, thrust, speed, believed, fault)


def draw_worn(drag: float, random: np.random.Generator) -> Effects:
    """Actuators with 0.02 rad of play, trim errors of up to 0.02 rad, and `drag` times the drag of the map."""
    trim = random.uniform(-0.02, 0.02, 2)
    return {
        "servo.backlash": {"gap": 0.02},
        "servo.trim": {"offset_1": float(trim[0]), "offset_2": float(trim[1])},
        "rotor.drag": {"gain": drag},
    }


def draw_stands(count: int, seed: int) -> list[Effects]:
    """Stands with worn actuators and a drag map that is 20 % off, either way."""
    random = np.random.default_rng(seed)
    return [draw_worn(1.2 if i % 2 == 0 else 0.8, random) for i in range(count)]
