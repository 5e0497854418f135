"""The craft's own 1 kHz loops as its firmware runs them: angular rate, allocation, blade pitch, rotor speed."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .rotor import STEP
from .sensors import quantise

PITCH_LSB = 2.0**-14  # rad, resolution of the servo command
THROTTLE_LSB = 2.0**-12
_SPEED_KP, _SPEED_KI = 0.02, 0.15  # V s/rad, V/rad


class Controller(Protocol):
    """Whose loops run in a batch of flights."""

    def command(
        self, thrust: np.ndarray, rate: np.ndarray, gyro: np.ndarray, speed: np.ndarray, current: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run the loops once.

        Args:
            thrust: Commanded by the policy, N. (flights,).
            rate: Commanded by the policy, rad/s. (flights,).
            gyro: Measured q, rad/s. (flights,).
            speed: Measured rotor speeds, rad/s. (2, flights).
            current: Measured motor currents, A. (2, flights).

        Returns:
            Blade pitch rad and throttle, both (2, flights).
        """


class Firmware:
    """Nominal numbers only: the firmware knows nothing of hidden effects."""

    def __init__(self, nominal: dict, count: int) -> None:
        control, rotor, motor = nominal["control"], nominal["rotor"], nominal["motor"]
        self.kp, self.kd, self.filter_gain = control["rate_kp"], control["rate_kd"], control["gyro_filter"]
        self.arm = 2 * nominal["airframe"]["half_length"]
        self.speed, self.pitch_max = rotor["speed"], rotor["pitch_max"]
        self.per_newton = 1.0 / (rotor["k_t"] * rotor["speed"])  # rad/N
        self.thrust_max = self.pitch_max / self.per_newton  # N, of one rotor
        self.k_d = (rotor["k_d1"], rotor["k_d2"], rotor["k_d3"])
        self.motor = motor
        self.rate = np.zeros(count)  # filtered gyro
        self.integral = np.zeros((2, count))  # V

    def command(
        self, thrust: np.ndarray, rate: np.ndarray, gyro: np.ndarray, speed: np.ndarray, current: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run the loops once, as `Controller` says; currents do not matter to it."""
        before = self.rate
        self.rate = before + self.filter_gain * (gyro - before)
        moment = self.kp * (rate - self.rate) - self.kd * (self.rate - before) / STEP
        split = moment / self.arm  # N, half the difference of the thrusts
        limit = self.thrust_max
        split = np.minimum(np.maximum(split, -limit), limit)
        room = limit - np.abs(split)  # what rate control leaves for thrust
        mean = np.minimum(np.maximum(0.5 * thrust, -room), room)
        pitch = quantise(np.stack([mean - split, mean + split]) * self.per_newton, PITCH_LSB)
        pitch = np.minimum(np.maximum(pitch, -self.pitch_max), self.pitch_max)
        return pitch, self._govern(pitch, speed)

    def _govern(self, pitch: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Throttle that holds the rotor speed: feed-forward from the drag map, PI on the measured speed."""
        k1, k2, k3 = self.k_d
        twist = self.speed * np.abs(pitch)
        drag = k1 * self.speed**2 + (k2 * twist + k3) * twist
        motor = self.motor
        current = motor["no_load_current"] + motor["k_q"] * drag
        error = self.speed - speed
        self.integral = np.minimum(np.maximum(self.integral + _SPEED_KI * STEP * error, -2.0), 2.0)
        voltage = self.speed / motor["k_v"] + motor["resistance"] * current + _SPEED_KP * error + self.integral
        throttle = np.rint(voltage / (motor["battery"] * THROTTLE_LSB)) * THROTTLE_LSB
        return np.minimum(np.maximum(throttle, 0.0), 1.0)
