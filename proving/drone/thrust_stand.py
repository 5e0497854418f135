"""A thrust stand: the true rotors of a batch of runs, driven blade pitch and throttle at a time, with their sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .effects import Effects
from .rig import Rig
from .rotor import Motor, Propeller, Servo
from .sensors import CURRENT_LSB, SPEED_LSB, quantise


@dataclass(frozen=True)
class Reading:
    """What a stand shows at one time. Each (2, runs)."""

    speed: np.ndarray  # Measured, rad/s
    current: np.ndarray  # Measured, A
    thrust: np.ndarray  # True, N
    true_speed: np.ndarray  # rad/s
    pitch: np.ndarray  # True blade pitch, rad


class ThrustStand:
    """Two rotors a run, at rest in the air, stepped a millisecond at a time."""

    def __init__(
        self,
        effects: Sequence[Effects],
        seed: int,
        steps: int,
        *,
        jitter: bool = True,
        curve: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        """Set up stands.

        Args:
            effects: Hidden in each, {id: {parameter: value in SI}}.
            seed: Of tolerances and sensor noise; run i is the same whatever runs come after it.
            steps: How often it will be read, at most.
            jitter: Whether stands differ from nominal within tolerance.
            curve: From blade pitch rad to the pitch that a line of slope k_T would need for that thrust, rad.
        """
        sessions = [seed + i if jitter else None for i in range(len(effects))]
        self.rig = Rig(list(effects), sessions)
        noise = self.rig.nominal["sensors"]["rotor"]
        self.noise = noise["speed_std"], noise["current_std"]
        drawn = [np.random.default_rng([seed + i, 5]).standard_normal((steps, 2, 2)) for i in range(len(effects))]
        self.drawn = np.stack(drawn, axis=-1)  # speed and current, (steps, 2, 2, runs)
        rest = np.zeros((2, len(effects)))
        self.servo, self.motor, self.propeller = Servo(self.rig, rest), Motor(self.rig), Propeller(self.rig)
        self.pitch = rest + self.servo.trim
        self.propeller.pitch = self.pitch.copy()
        self.tick = 0
        self.curve = curve

    def read(self) -> Reading:
        """Sample the sensors."""
        drawn = self.drawn[self.tick]
        speed = quantise(self.motor.speed + self.noise[0] * drawn[0], SPEED_LSB)
        current = quantise(self.motor.compute_current() + self.noise[1] * drawn[1], CURRENT_LSB)
        pitch = self.pitch if self.curve is None else self.curve(self.pitch)
        thrust = self.propeller.compute_thrust(pitch[None], self.motor.speed[None])[0]
        return Reading(speed, current, thrust, self.motor.speed.copy(), self.pitch.copy())

    def advance(self, pitch: np.ndarray, throttle: np.ndarray) -> None:
        """Advance a millisecond under commanded blade pitch rad and throttle 0..1, both (2, runs)."""
        path = self.servo.advance(pitch)
        self.motor.advance(throttle, path, self.tick * 0.001)
        self.pitch = path[-1]
        self.tick += 1
