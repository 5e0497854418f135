"""Flights: the true plant, the craft's firmware and a pilot in closed loop, many flights at once.

At t_k = k ms the sensors are sampled from the state at t_k, then (each 10 ms) the pilot and then the firmware compute
their commands, stamped t_k, which act until the next one. Currents are those under the voltage that acted up to t_k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypedDict

import numpy as np

from .control import Controller, Firmware
from .effects import Effects
from .gusts import Field, Wind
from .manoeuvres import write_script
from .pilot import Commander, Estimator, Pilot
from .plant import Plant
from .recording import Recording
from .rig import PITCH, Rig, X, Z
from .rotor import STEP, SUBSTEPS, Motor, Propeller, Servo
from .sensors import (
    ACCEL_LSB,
    ANGLE_LSB,
    CURRENT_LSB,
    GYRO_LSB,
    MOCAP_PERIOD,
    POSITION_LSB,
    SPEED_LSB,
    draw_chances,
    look_back,
    quantise,
)

SETTLING = 1.5  # s flown before the log starts, so that it starts in flight
_LATENCY = 8  # ms from a mocap frame to the pilot
PERIOD_MARGIN = 0.02  # s of script beyond the end: the last step is at `duration` itself
_GUST_WEIGHTS = ((np.arange(SUBSTEPS) + 0.5) / SUBSTEPS)[:, None, None]


class FlightPlan(TypedDict, total=False):
    """One flight of a batch: the arguments of `fly`, and how strong its rotors are, 1 for those of vehicle.yaml."""

    effects: Effects
    manoeuvre: str
    duration: float
    seed: int
    session: int | None
    gusts: bool
    wind: Wind
    jitter: bool
    dropouts: bool
    distractors: bool
    outliers: bool
    initial: Sequence[float] | None
    strength: float


_DEFAULTS: FlightPlan = {
    "effects": {},
    "gusts": True,
    "wind": Wind(),
    "jitter": True,
    "dropouts": True,
    "distractors": False,
    "outliers": False,
    "initial": None,
    "session": None,
    "strength": 1.0,
}


def fly(
    effects: Effects,
    manoeuvre: str,
    duration: float,
    seed: int,
    *,
    session: int | None = None,
    gusts: bool = True,
    wind: Wind = Wind(),  # noqa: B008 (frozen)
    jitter: bool = True,
    dropouts: bool = True,
    distractors: bool = False,
    outliers: bool = False,
    initial: Sequence[float] | None = None,
) -> Recording:
    """Fly one flight.

    Args:
        effects: {id: {parameter: value in SI}}.
        manoeuvre: One of MANOEUVRES.
        duration: s.
        seed: Of everything random about the flight.
        session: Seed of the rig's tolerances; flights of one rig share it. By default `seed`.
        gusts: Whether gusts blow.
        wind: What they are like.
        jitter: Whether the rig differs from nominal within tolerance, and mocap stamps jitter.
        dropouts: Whether mocap frames go missing.
        distractors: Whether thrust ripples and the gyro wanders, both too little to be noticed.
        outliers: Whether a few recorded mocap frames are far off (the pilot's own filter has refused them).
        initial: x m, z m, theta rad and their rates at the start; by default the craft settles in hover first.
    """
    plan: FlightPlan = {
        "effects": effects,
        "manoeuvre": manoeuvre,
        "duration": duration,
        "seed": seed,
        "session": session,
        "gusts": gusts,
        "wind": wind,
        "jitter": jitter,
        "dropouts": dropouts,
        "distractors": distractors,
        "outliers": outliers,
        "initial": initial,
    }
    return fly_many([plan])[0]


def fly_many(
    plans: Sequence[FlightPlan], pilot: Commander | None = None, firmware: Callable[[int], Controller] | None = None
) -> list[Recording]:
    """Fly a batch of flights of equal duration at once: 64 take little longer than one.

    Args:
        plans: One dictionary per flight, the arguments of `fly`.
        pilot: Who flies all of them; by default the script of each flight's manoeuvre, which else only names it.
        firmware: Makes the loops below the pilot for so many flights; by default `Firmware`.

    Returns:
        A recording per flight. A flight does not depend on the others of its batch.
    """
    batch = [_DEFAULTS | plan for plan in plans]
    if len({(plan["duration"], plan["strength"], plan["initial"] is None) for plan in batch}) != 1:
        raise ValueError("flights of one batch need the same duration and rotors, and all or none an initial state")
    return Batch(batch, pilot, firmware).run()


def _read_scripts(flights: Sequence[FlightPlan], nominal: dict) -> Pilot:
    """The scripted pilot with the manoeuvre of each flight."""
    return Pilot([write_script(f["manoeuvre"], f["duration"] + PERIOD_MARGIN, f["seed"]) for f in flights], nominal)


class Batch:
    """Flights that are stepped together. Time is the first axis of every series, the flight the last."""

    def __init__(
        self, flights: list[FlightPlan], pilot: Commander | None = None,
        firmware: Callable[[int], Controller] | None = None,
    ) -> None:  # fmt: skip
        self.flights = flights
        self.count = len(flights)
        self.all = np.arange(self.count)
        settle = flights[0]["initial"] is None
        self.lead = round(SETTLING / STEP) if settle else 0
        self.steps = self.lead + round(flights[0]["duration"] / STEP)
        sessions = [f["seed"] if f["session"] is None else f["session"] for f in flights]
        effects, strength = [f["effects"] for f in flights], flights[0]["strength"]
        self.rig = Rig(effects, [s if f["jitter"] else None for f, s in zip(flights, sessions)], strength=strength)
        nominal = self.rig.nominal
        self.chances = draw_chances(flights, self.steps + 1, nominal)
        self.field = Field(flights, nominal)
        self.rippling = any(f["distractors"] for f in flights)
        self.pilot = pilot or _read_scripts(flights, nominal)
        state = np.zeros((6, self.count))
        if settle:
            state[:3] = self.pilot.setpoint[0]
        else:
            state[:] = np.array([f["initial"] for f in flights], dtype=float).T
        self.plant = Plant(self.rig, state[:3], state[3:])
        hover = nominal["gravity"] * (nominal["airframe"]["mass"] + nominal["rig"]["slider_mass"]) / 2
        believed = Firmware(nominal, self.count)
        self.firmware: Controller = firmware(self.count) if firmware else believed
        trim = np.full((2, self.count), hover * believed.per_newton)
        trim = np.copysign(trim, np.cos(state[PITCH]))  # carries the craft either way up
        self.servo, self.motor, self.propeller = Servo(self.rig, trim), Motor(self.rig), Propeller(self.rig)
        self.propeller.pitch = trim.copy()
        self._allocate()
        age = (-self.chances.phase - _LATENCY) % MOCAP_PERIOD + _LATENCY
        self.estimator = Estimator(state[:3], state[3:], age.astype(float), self.rig.gravity)

    def _allocate(self) -> None:
        shape, steps, frames = (self.steps + 1, 3, self.count), self.steps, self.steps // MOCAP_PERIOD + 1
        self.position, self.velocity, self.accel = (np.zeros(shape) for _ in range(3))
        self.blade, self.speed, self.current = (np.empty((steps + 1, 2, self.count)) for _ in range(3))
        self.thrust = np.empty((steps + 1, 2, self.count))
        self.pitch_command, self.throttle = (np.empty((steps + 1, 2, self.count)) for _ in range(2))
        self.gyro = np.empty((steps + 1, self.count))
        self.specific = np.zeros((steps + 1, 2, self.count))
        self.speed_read = np.empty((steps + 1, 2, self.count))
        self.frames = np.zeros((frames, 3, self.count))
        self.policy = np.zeros((frames, 2, self.count))
        hidden = self.rig.hidden
        self.mocap_delay = hidden.get("mocap.delay", "delay")
        self.drift, self.drifting = hidden.get("clock.drift", "drift"), hidden.any("clock.drift")
        self.newest = np.full(self.count, -1)  # frame that the pilot has had
        self.misalignment = hidden.get("mocap.misalignment", "angle")
        self.mocap_scale = hidden.get("mocap.scale", "scale")
        self.g_gain, self.g_sensitive = hidden.get("alien.g_sensitivity", "gain"), hidden.any("alien.g_sensitivity")
        self.gyro_bias, self.gyro_scale = hidden.get("gyro.bias", "bias"), hidden.get("gyro.scale", "scale")

    def run(self) -> list[Recording]:
        """Fly the batch."""
        plant, chances = self.plant, self.chances
        blade, speed = self.servo.horn + self.servo.trim, self.motor.speed
        thrust = self.propeller.compute_thrust(blade[None], speed[None])[0]
        command = (np.zeros(self.count), np.zeros(self.count))
        for k in range(self.steps + 1):
            plant.drop_ballast((k - self.lead) * STEP)
            self.propeller.break_blade((k - self.lead) * STEP)
            self._feel_field(k)
            self._sample(k, blade, speed, thrust)
            if k % MOCAP_PERIOD == 0:
                command = self._pilot(k)
            current = quantise(self.current[k] + chances.current[k], CURRENT_LSB)
            pitch, throttle = self.firmware.command(*command, self.gyro[k], self.speed_read[k], current)
            self.pitch_command[k], self.throttle[k] = pitch, throttle
            if k == self.steps:
                break
            path = self.servo.advance(pitch)
            speeds = self.motor.advance(throttle, path, (k - self.lead) * STEP)
            thrusts = self.propeller.compute_thrust(path, speeds)
            if self.rippling:
                thrusts = thrusts * chances.ripple[k]
            gust = chances.gust[k] + _GUST_WEIGHTS * (chances.gust[k + 1] - chances.gust[k])
            plant.advance(thrusts, speeds, gust)
            blade, speed, thrust = path[-1], speeds[-1], thrusts[-1]
        return [Recording.from_batch(self, index) for index in range(self.count)]

    def _feel_field(self, k: int) -> None:
        """Gusts that depend on place: here and now, and where the craft will be a millisecond on."""
        if len(rows := self.field.rows):
            position, velocity, gust = self.plant.position, self.plant.velocity, self.chances.gust
            gust[k][:, rows] = self.field.feel(k * STEP, position)
            gust[k + 1][:, rows] = self.field.feel((k + 1) * STEP, position + STEP * velocity)

    def _sample(self, k: int, blade: np.ndarray, speed: np.ndarray, thrust: np.ndarray) -> None:
        """Read the sensors at step k."""
        plant, chances = self.plant, self.chances
        self.position[k], self.velocity[k] = plant.position, plant.velocity
        self.accel[k] = plant.compute_acceleration(thrust, speed, chances.gust[k])
        self.blade[k], self.speed[k], self.thrust[k] = blade, speed, thrust
        rate = self.gyro_scale * plant.velocity[PITCH] + self.gyro_bias
        if self.g_sensitive:
            angle, gravity = plant.position[PITCH], self.rig.gravity
            lift = (self.accel[k, Z] + gravity) * np.cos(angle) - self.accel[k, X] * np.sin(angle)
            rate = rate + self.g_gain * (lift - gravity)
        self.gyro[k] = quantise(rate + chances.gyro[k], GYRO_LSB)
        self.speed_read[k] = quantise(speed + chances.speed[k], SPEED_LSB)
        self.current[k] = self.motor.compute_current()

    def _read_accelerometer(self, span: slice) -> None:
        angle, accel = self.position[span, PITCH], self.accel[span]
        sine, cosine = np.sin(angle), np.cos(angle)
        lift = accel[:, Z] + self.rig.gravity
        force = np.stack([accel[:, X] * cosine + lift * sine, lift * cosine - accel[:, X] * sine], axis=1)
        self.specific[span] = quantise(force + self.chances.accel[span], ACCEL_LSB)

    def _pilot(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Estimate and command at policy tick k / 10."""
        tick = k // MOCAP_PERIOD
        self._read_accelerometer(slice(max(k - MOCAP_PERIOD + 1, 0), k + 1))
        frame = self._find_frame(k)
        arrived = frame > self.newest
        self.newest = frame
        if self.drifting:  # a fast clock brings two frames in one period now and then
            self._take_frame(np.maximum(frame - 1, 0), k, arrived & (frame > 0))
            self.estimator.blend = (k - self.stamp_frame(np.maximum(frame, 0))[1] - MOCAP_PERIOD) / MOCAP_PERIOD
        frame = np.maximum(frame, 0)
        pose = self._take_frame(frame, k, arrived)
        if k:
            span = slice(k - MOCAP_PERIOD + 1, k + 1)
            seen = arrived & self.chances.seen[frame, self.all]
            self.estimator.update(self.gyro[span].mean(0), self.specific[span].mean(0), pose, seen)
        lead = self.lead // MOCAP_PERIOD
        estimate = self.estimator
        thrust, rate = self.pilot.command(tick - lead, estimate.pose, estimate.speed, estimate.rate)
        self.policy[tick] = thrust, rate
        return thrust, rate

    def stamp_frame(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """When frames are taken by the mocap's clock, which stamps them, and by the onboard clock, ms. (flights,) each.

        The clocks agree at the start of the log.
        """
        stamp = frame * MOCAP_PERIOD + self.chances.phase
        return stamp, stamp - self.drift * (stamp - self.lead)

    def _find_frame(self, k: int) -> np.ndarray:
        """Newest frame that has reached the pilot at step k, -1 before the first. (flights,)."""
        stamp = (k - _LATENCY - self.drift * self.lead) / (1 - self.drift)
        frame = np.floor((stamp - self.chances.phase) / MOCAP_PERIOD).astype(int)
        return np.clip(frame, -1, len(self.frames) - 1)

    def _take_frame(self, frame: np.ndarray, k: int, arrived: np.ndarray) -> np.ndarray:
        """Measure the pose of a frame not after step k and keep it where it has arrived. (3, flights)."""
        taken = np.minimum(self.stamp_frame(frame)[1], k)
        pose = look_back(self.position, self.velocity, taken, self.mocap_delay, self.all)
        pose[:PITCH] *= self.mocap_scale
        pose[PITCH] += self.misalignment
        pose += self.chances.mocap[frame, :, self.all].T
        pose[:PITCH] = quantise(pose[:PITCH], POSITION_LSB)
        pose[PITCH] = quantise(pose[PITCH], ANGLE_LSB)
        self.frames[frame[arrived], :, self.all[arrived]] = pose.T[arrived]
        return pose

    def read_currents(self) -> np.ndarray:
        """Measured motor currents, A. (steps + 1, 2, flights)."""
        return quantise(self.current + self.chances.current, CURRENT_LSB)
