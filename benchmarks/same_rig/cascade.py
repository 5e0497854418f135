"""The flight controller and actuators of one craft in plain Python floats: what stands between action and thrust.

Written for one craft a process, as gymnasium and TorchRL's MuJoCo base have it. Two floats are no work for numpy: with
arrays of length two the same lines take several times as long. Independent of `vpptwin.actuators`, so that agreement
with the twin means something.
"""

from __future__ import annotations

import math

from vpptwin.robots.planar_drone.vehicle import Vehicle

GOVERNOR_KP, GOVERNOR_KI = 0.08, 0.5
"""Speed feedback of the governor [V s/rad] and [V/rad], the choice in docs/architecture.md."""


def clip(value: float, limit: float) -> float:
    """`value` within ±limit."""
    return limit if value > limit else -limit if value < -limit else value


class Rotor:
    """A variable-pitch rotor: servo lag, governor, motor.

    Attributes:
        pitch: blade pitch [rad].
        speed: rad/s.
        integral: of the speed error [rad].
    """

    def __init__(self, vehicle: Vehicle, dt: float) -> None:
        self._rotor, self._motor, self._dt = vehicle.rotor, vehicle.motor, dt
        rotor, motor = vehicle.rotor, vehicle.motor
        self._per_thrust = 1.0 / (rotor.k_t * rotor.speed)
        self._ratio = vehicle.servo.time_constant / dt
        self._left = math.exp(-1.0 / self._ratio)
        self._idle_voltage = rotor.speed / motor.k_v + motor.resistance * motor.no_load_current
        self.reset()

    def reset(self) -> None:
        """Blades flat, speed governed."""
        self.pitch, self.speed, self.integral = 0.0, self._rotor.speed, 0.0

    def _drag(self, speed: float, pitch: float) -> float:
        """Drag torque [N m]."""
        rotor = self._rotor
        return speed * (rotor.k_d1 * speed + rotor.k_d2 * speed * pitch * pitch + rotor.k_d3 * abs(pitch))

    def step(self, thrust: float) -> float:
        """Thrust [N], mean over one inner step, when `thrust` is asked for."""
        rotor, motor, dt = self._rotor, self._motor, self._dt
        command = clip(thrust * self._per_thrust, rotor.pitch_max)
        error = rotor.speed - self.speed
        grown = self.integral + dt * error
        voltage = self._idle_voltage + motor.resistance * motor.k_q * self._drag(rotor.speed, command)
        throttle = (voltage + GOVERNOR_KP * error + GOVERNOR_KI * grown) / motor.battery
        if 0.0 <= throttle <= 1.0:
            self.integral = grown
        else:
            throttle = 0.0 if throttle < 0.0 else 1.0
        gap = command - self.pitch
        mean = command - self._ratio * (1.0 - self._left) * gap
        self.pitch = command - self._left * gap
        current = (throttle * motor.battery - self.speed / motor.k_v) / motor.resistance
        torque = (current - motor.no_load_current) / motor.k_q - self._drag(self.speed, self.pitch)
        self.speed = max(self.speed + dt * torque / rotor.inertia, 0.0)
        return rotor.k_t * self.speed * mean


class Cascade:
    """Rate loop, allocation and two rotors, one call an inner step."""

    def __init__(self, vehicle: Vehicle) -> None:
        control = vehicle.control
        self._dt = 1.0 / control.inner_rate
        self._kp, self._kd, self._filter = control.rate_kp, control.rate_kd / self._dt, control.gyro_filter
        self._scale = (control.thrust_max, control.rate_max)
        self._lever = 0.5 / vehicle.airframe.half_length
        self._limit = vehicle.rotor.k_t * vehicle.rotor.speed * vehicle.rotor.pitch_max
        self._rotors = Rotor(vehicle, self._dt), Rotor(vehicle, self._dt)
        self._gyro, self._thrust, self._rate = 0.0, 0.0, 0.0

    def reset(self) -> None:
        """As at power-on."""
        self._gyro = 0.0
        for rotor in self._rotors:
            rotor.reset()

    def command(self, thrust: float, rate: float) -> None:
        """Take an action in [-1, 1]², held until the next one."""
        self._thrust, self._rate = 0.5 * self._scale[0] * thrust, self._scale[1] * rate

    def step(self, rate: float) -> tuple[float, float]:
        """Thrusts of the rotors [N] during the coming inner step, from the gyro's rate [rad/s]."""
        filtered = self._gyro + self._filter * (rate - self._gyro)
        torque = self._kp * (self._rate - filtered) - self._kd * (filtered - self._gyro)
        self._gyro = filtered
        difference = clip(torque * self._lever, self._limit)
        common = clip(self._thrust, self._limit - abs(difference))
        return self._rotors[0].step(common - difference), self._rotors[1].step(common + difference)
