"""One joint, or a hanging chain of two, integrated in steps of 0.1 ms without MuJoCo: what proving/kinds.py moves.

A controller is in the loop: it runs at the rate of the log, and sees what the encoder says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

H, GRAVITY = 1e-4, 9.81  # s, m/s²


@dataclass(frozen=True)
class Log:
    """Samples of a motion, as its sensors saw it: positions and velocities (n, joints), inputs (n, drives)."""

    period: float  # s
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


@dataclass(frozen=True)
class Encoder:
    """What measures a position: its step and the standard deviation of its noise [m or rad]."""

    step: float
    noise: float = 0.0

    def draw(self, rng: np.random.Generator, count: int, joints: int) -> np.ndarray:
        """Noise of a log, (count, joints)."""
        return self.noise * rng.standard_normal((count, joints))


@dataclass(frozen=True)
class Joint:
    """One joint and its drive: inertia a = gear u - weight sin(q) - viscous v - dry friction.

    Attributes:
        slide: a slide, or a hinge in gravity.
        inertia: kg or kg m².
        weight: mass times gravity times distance [N m].
        gear: force per input.
        viscous: N s/m or N m s/rad.
        dry: N or N m.
        ripple: by which share drive and dry friction change along the way.
        wave: length of that [m or rad].
    """

    slide: bool
    inertia: float
    weight: float = 0.0
    gear: float = 1.0
    viscous: float = 0.0
    dry: float = 0.0
    ripple: float = 0.0
    wave: float = 0.03

    @property
    def name(self) -> str:
        """As in the MJCF."""
        return "slide" if self.slide else "hinge"

    def describe(self, driven: bool) -> str:
        """MJCF; a weight hangs at the distance that makes nine tenths of the inertia."""
        length = 0.9 * self.inertia * GRAVITY / self.weight if self.weight else 0.0
        mass = self.weight / (GRAVITY * length) if length else self.inertia if self.slide else 0.1
        spin = 1e-3 * mass if self.slide else self.inertia - mass * length**2
        frame = 'type="slide" axis="1 0 0"' if self.slide else 'type="hinge" axis="0 1 0"'
        drive = f'<motor name="motor" joint="{self.name}" gear="{self.gear!r}"/>' if driven else ""
        return f"""<mujoco model="rig"><option timestep="0.001"/><worldbody><body name="body">
<joint name="{self.name}" {frame} damping="{self.viscous!r}" frictionloss="{self.dry!r}"/>
<inertial pos="0 0 {-length!r}" mass="{mass!r}" diaginertia="{spin!r} {spin!r} {spin!r}"/></body></worldbody>
<actuator>{drive}</actuator></mujoco>
"""


@dataclass(frozen=True)
class Control:
    """u = feed + stiffness (goal - seen) - damping v at every sample; a relay: ± `relay`, past ± `band` of zero."""

    feed: np.ndarray  # (n, joints)
    goal: np.ndarray  # (n, joints)
    stiffness: tuple[float, ...] = (0.0, 0.0)
    damping: tuple[float, ...] = (0.0, 0.0)
    relay: float = 0.0
    band: float = 0.0
    servo: bool = False  # the loop is the joint's own and continuous, its input the goal

    @property
    def laws(self) -> tuple:
        """For compiled code."""
        gains = np.array(self.stiffness), np.array(self.damping)
        return self.feed, self.goal, *gains, self.relay, self.band, self.servo


@njit(cache=True)
def _ride(joint, control, start, every, noise, step):  # noqa: ANN001, ANN202
    """Samples of one joint: seen position, velocity, input, (n, 3)."""
    inertia, weight, gear, viscous, dry, ripple, wave = joint
    feed, goal, stiff, damp, relay, band, _ = control
    rows, q, v, sign = np.zeros((len(feed), 3)), start, 0.0, 1.0
    for k in range(len(feed)):
        seen = np.rint((q + noise[k, 0]) / step) * step
        sign = -1.0 if seen > band else 1.0 if seen < -band else sign
        u = relay * sign + feed[k, 0] + stiff[0] * (goal[k, 0] - seen) - damp[0] * v
        rows[k] = seen, v, u
        for _ in range(every):
            uneven = 1.0 + ripple * np.sin(2.0 * np.pi * q / wave)
            ahead = v + H * (gear * u * uneven - weight * np.sin(q) - viscous * v) / inertia
            stop = H * dry * uneven / inertia
            v = 0.0 if abs(ahead) <= stop else ahead - np.sign(ahead) * stop
            q += H * v
    return rows


def ride(
    rng: np.random.Generator, joint: Joint, control: Control, period: float, encoder: Encoder, start: float = 0.0
) -> Log:
    """The log of one joint, which is let go at `start`; velocities are as noisy as 20 ms of the positions make them."""
    numbers = joint.inertia, joint.weight, joint.gear, joint.viscous, joint.dry, joint.ripple, joint.wave
    noise = encoder.draw(rng, len(control.feed), 1)
    rows = _ride(numbers, control.laws, start, round(period / H), noise, encoder.step)
    slow = (encoder.noise + encoder.step) / 0.02 * rng.standard_normal(len(rows))
    return Log(period, rows[:, :1], rows[:, 1:2] + slow[:, None], rows[:, 2:])


@dataclass(frozen=True)
class Chain:
    """Two links that hang in a vertical plane, angles from straight down.

    Attributes:
        mass: kg.
        centre: of mass, from the joint [m].
        spin: inertia about it [kg m²].
        length: of the first link [m].
        rotor: inertia of the drives at their joints [kg m²].
        viscous: N m s/rad.
        load: point mass on the second link [kg].
        place: of the load, from the second joint [m].
    """

    mass: tuple[float, float]
    centre: tuple[float, float]
    spin: tuple[float, float]
    length: float
    rotor: tuple[float, float] = (0.0, 0.0)
    viscous: tuple[float, float] = (0.0, 0.0)
    load: float = 0.0
    place: float = 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        """Inertias about the joints, coupling, and weights of the links [kg m², N m]."""
        first = self.mass[0] * self.centre[0]
        second = self.mass[1] * self.centre[1] + self.load * self.place
        about = self.spin[1] + self.mass[1] * self.centre[1] ** 2 + self.load * self.place**2
        beyond = (self.mass[1] + self.load) * self.length
        base = self.spin[0] + first * self.centre[0] + beyond * self.length
        return base, about, second * self.length, (first + beyond) * GRAVITY, second * GRAVITY

    def describe(self, servo: tuple[Sequence[float], Sequence[float]] | None, bodies: Sequence[str]) -> str:
        """MJCF without the load; `servo` are stiffness and damping of position servos."""
        joints = [
            f'<joint name="{name}" armature="{self.rotor[j]!r}" damping="{self.viscous[j]!r}"/>'
            f'<inertial pos="0 0 {-self.centre[j]!r}" mass="{self.mass[j]!r}" '
            f'diaginertia="{self.spin[j]!r} {self.spin[j]!r} {0.1 * self.spin[j]!r}"/>'
            for j, name in enumerate(CHAIN)
        ]
        drives = "\n".join(
            f'<position name="m_{name}" joint="{name}" kp="{servo[0][j]!r}" kv="{servo[1][j]!r}"/>'
            if servo else f'<motor name="m_{name}" joint="{name}"/>'
            for j, name in enumerate(CHAIN)
        )  # fmt: skip
        return f"""<mujoco model="arm"><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0"/></default><worldbody><body name="{bodies[0]}">{joints[0]}
<body name="{bodies[1]}" pos="0 0 {-self.length!r}">{joints[1]}</body></body></worldbody>
<actuator>{drives}</actuator></mujoco>
"""


CHAIN = ("shoulder", "elbow")
DRIVES = ("m_shoulder", "m_elbow")


@njit(cache=True)
def _swing(chain, rotor, viscous, control, start, every, noise, step):  # noqa: ANN001, ANN202
    """Samples of two joints: seen positions, velocities, inputs, (n, 6)."""
    base, about, couple, weight, tip = chain
    feed, goal, stiff, damp, _, _, servo = control
    rows, q, v, torque = np.zeros((len(feed), 6)), start.copy(), np.zeros(2), np.zeros(2)
    for k in range(len(feed)):
        for j in range(2):
            rows[k, j] = np.rint((q[j] + noise[k, j]) / step) * step
            torque[j] = feed[k, j] + stiff[j] * (goal[k, j] - rows[k, j]) - damp[j] * v[j]
            rows[k, 2 + j], rows[k, 4 + j] = v[j], goal[k, j] if servo else torque[j]
        for _ in range(every):
            if servo:
                torque = stiff * (goal[k] - q) - damp * v
            cos, bend, low = np.cos(q[1]), couple * np.sin(q[1]), tip * np.sin(q[0] + q[1])
            one = torque[0] - viscous[0] * v[0] + bend * (2.0 * v[0] * v[1] + v[1] ** 2) - weight * np.sin(q[0]) - low
            two = torque[1] - viscous[1] * v[1] - bend * v[0] ** 2 - low
            a = base + about + 2.0 * couple * cos + rotor[0]
            b, d = about + couple * cos, about + rotor[1]
            det = a * d - b * b
            v = v + H * np.array([d * one - b * two, a * two - b * one]) / det
            q = q + H * v
    return rows


def swing(
    rng: np.random.Generator, chain: Chain, control: Control, period: float, encoder: Encoder, start: np.ndarray
) -> Log:
    """The log of a chain that starts at rest at `start`, (2,) rad."""
    laws, noise = (np.array(chain.rotor), np.array(chain.viscous)), encoder.draw(rng, len(control.feed), 2)
    rows = _swing(chain.numbers, *laws, control.laws, start, round(period / H), noise, encoder.step)
    slow = (encoder.noise + encoder.step) / 0.02 * rng.standard_normal((len(rows), 2))
    return Log(period, rows[:, :2], rows[:, 2:4] + slow, rows[:, 4:])
