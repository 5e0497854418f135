"""Rigs that are not ours, simulated without MuJoCo and at a finer step: carts with friction or cogging, pendula."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from vpptwin.logs.write import START_NS, FlightWriter

STEP = 1e-4
"""Step of the independent simulation [s]: a twentieth of the twin's."""
LOG_EVERY = 50
"""Steps between samples and between changes of the command: 200 Hz."""
DURATION = 24.0
MASS, FRICTION = 2.0, 1.1  # kg, N
PITCH = 0.4
"""Distance at which the cart's cogging repeats [m]."""
BOB, LENGTH, DAMPING = 0.3, 0.4, 0.03  # kg, m, N m s/rad

CART = """<mujoco>
  <default><joint solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="0.004 1"/></default>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" gear="20"/></actuator>
</mujoco>"""
PENDULUM = """<mujoco>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="swing" type="hinge" axis="0 -1 0"/>
      <inertial pos="0 0 -0.4" mass="0.3" diaginertia="1e-6 1e-6 1e-6"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="swing" gear="1"/></actuator>
</mujoco>"""
SERVO = re.sub(r"<motor .*/>", '<position name="motor" joint="swing" kp="6" kv="0.4"/>', PENDULUM).replace(
    "0.002", "0.001"
)
"""At 2 ms MuJoCo's integrator would be off by twice the sensors' noise."""
UNDRIVEN = re.sub(r"  <actuator>.*\n", "", PENDULUM)
TWIN = """model: rig.xml
signals:
  joints: {%s: /joint_states}
"""

Track = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position, velocity and control input at every sample, (n,) each; the input (n, 0) where there is no actuator."""


@cache
def drive_cart(friction: float, seed: int, cogging: float = 0.0) -> Track:
    """A cart of 2 kg after steps of its reference, under a motor of 20 N and Karnopp's dry friction [N].

    At rest it stays exactly at rest below breakaway; where the velocity would cross zero it stops first. `cogging` is
    the amplitude [N] of a force that goes as the sine of the position, which no effect of the catalogue is.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION / STEP / LOG_EVERY)
    goals = np.repeat(rng.uniform(-0.5, 0.5, count // 240 + 1), 240)[:count]  # a new one every 1.2 s
    log = np.empty((count, 3))
    x, v = 0.0, 0.0
    for i in range(count):
        control = float(np.clip((25.0 * (goals[i] - x) - 9.0 * v) / 20.0, -0.5, 0.5))
        log[i] = x, v, control
        motor = 20.0 * control
        for _ in range(LOG_EVERY):
            push = motor + cogging * math.sin(2.0 * math.pi / PITCH * x) if cogging else motor
            direction = push if v == 0.0 else v
            drag = min(friction, abs(push)) if v == 0.0 else friction
            ahead = v + STEP * (push - math.copysign(drag, direction)) / MASS
            if v * ahead < 0.0:
                x, v = x + 0.5 * STEP * v * v / (v - ahead), 0.0
            else:
                x, v = x + 0.5 * STEP * (v + ahead), ahead
    return log[:, 0], log[:, 1], log[:, 2]


@cache
def swing_pendulum(damping: float, seed: int) -> Track:
    """A bob of 0.3 kg on 0.4 m with viscous damping [N m s/rad], under torques held for 0.7 s."""
    rng = np.random.default_rng(seed)
    count = round(DURATION / STEP / LOG_EVERY)
    return swing(damping, np.repeat(rng.uniform(-0.6, 0.6, count // 140 + 1), 140)[:count], 0.0)


@cache
def let_swing(damping: float, seed: int, duration: float = 12.0) -> Track:
    """The same bob let go at rest from about 1 rad, without any motor: no control input, (n, 0)."""
    angle, rate, torque = swing(damping, np.zeros(round(duration / STEP / LOG_EVERY)), 1.0 + 0.02 * seed)
    return angle, rate, torque[:, None][:, :0]


@cache
def serve(share: float, seed: int) -> Track:
    """The same bob held by a position servo of so much of the stiffness in `SERVO`, after targets held for 0.7 s."""
    rng = np.random.default_rng(seed)
    count = round(DURATION / STEP / LOG_EVERY)
    targets = np.repeat(rng.uniform(-1.0, 1.0, count // 140 + 1), 140)[:count]
    return swing(0.0, targets, 0.0, (6.0 * share, 0.4))


def swing(damping: float, torques: np.ndarray, angle: float, servo: tuple[float, float] | None = None) -> Track:
    """The bob from rest at an angle [rad], under torques [N m] held between samples, by Runge and Kutta.

    With a servo of some stiffness [N m/rad] and damping [N m s/rad] they are its targets [rad].
    """
    inertia, weight = BOB * LENGTH**2, BOB * 9.81 * LENGTH

    def slope(state: np.ndarray, torque: float) -> np.ndarray:
        if servo is not None:
            torque = servo[0] * (torque - state[0]) - servo[1] * state[1]
        return np.array([state[1], (torque - damping * state[1] - weight * np.sin(state[0])) / inertia])

    step = LOG_EVERY * STEP / 10.0
    log = np.empty((len(torques), 3))
    state = np.array([angle, 0.0])
    for i, torque in enumerate(torques):
        log[i] = *state, torque
        for _ in range(10):
            a = slope(state, torque)
            b = slope(state + 0.5 * step * a, torque)
            c = slope(state + 0.5 * step * b, torque)
            d = slope(state + step * c, torque)
            state = state + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return log[:, 0], log[:, 1], log[:, 2]


@dataclass(frozen=True)
class Case:
    """One rig: its model, its joint, how it moves, its sensors' noise [m, m/s or rad, rad/s]."""

    model: str
    joint: str
    move: Callable[[float, int], Track]
    noise: tuple[float, float]


CARTS = Case(CART, "slide", drive_cart, (3e-4, 3e-3))
PENDULA = Case(PENDULUM, "swing", swing_pendulum, (1e-3, 2e-2))
SERVOS = Case(SERVO, "swing", serve, (1e-3, 2e-2))
DECAYS = Case(UNDRIVEN, "swing", let_swing, (1e-3, 2e-2))


def record(
    case: Case, size: float, folder: Path, seed: int, name: str = "log", start_ns: int = START_NS, part: float = 1.0
) -> tuple[Path, Path]:
    """Move a rig with that much friction, log it through noisy sensors; the log and the twin, which has no friction.

    Of its motion a `part` is logged, from its beginning on.
    """
    position, velocity, control = case.move(size, seed)
    rng = np.random.default_rng(seed + 1000)
    position = position + case.noise[0] * rng.standard_normal(len(position))
    velocity = velocity + case.noise[1] * rng.standard_normal(len(velocity))
    with FlightWriter(folder / f"{name}.mcap", start_ns) as writer:
        for i, (q, v, u) in enumerate(zip(position[: round(part * len(position))], velocity, control)):
            time = i * LOG_EVERY * STEP
            writer.write_joints("/joint_states", time, {case.joint: {"position": q, "velocity": v}})
            if np.size(u):
                writer.write_joints("/actuator_command", time, {"motor": {"effort": u}})
    return folder / f"{name}.mcap", write_rig(case, folder)


def write_rig(case: Case, folder: Path) -> Path:
    """The twin of a rig on disk, its model beside it."""
    (folder / "rig.xml").write_text(case.model)
    driven = "  actuators: {motor: /actuator_command}\n" if "<actuator>" in case.model else ""
    (folder / "rig.yaml").write_text(TWIN % case.joint + driven)
    return folder / "rig.yaml"
