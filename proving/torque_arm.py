"""A two-joint arm driven by torques that shares no physics with vpptwin: closed form, steps of 0.5 ms.

Its motors may sit anywhere: a matrix says what torque each of them makes about either joint. The twin has one on each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proving.logs import Log, Stream
from vpptwin.twin import TwinSpec, load_twin

LENGTH, CENTRE, MASS, INERTIA = 0.3, (0.16, 0.13), (1.4, 0.8), (0.012, 0.006)  # m, m, kg, kg m²
ROTOR, VISCOUS, GRAVITY = 0.02, 0.05, 9.81  # kg m², N m s/rad, m/s²
STEP, EVERY = 5e-4, 10  # s, steps between samples and changes of the torque
NOISE = 1e-4, 2e-3  # rad, rad/s
JOINTS = ("shoulder", "elbow")
MJCF = f"""<mujoco model="torque_arm"><compiler angle="radian"/><option timestep="0.002" gravity="0 0 -{{gravity}}"/>
<default><joint axis="0 1 0" armature="{ROTOR}" damping="{VISCOUS}"/></default>
<worldbody><body name="upper"><joint name="shoulder"/>
<inertial pos="{CENTRE[0]} 0 0" mass="{MASS[0]}" diaginertia="1e-4 {INERTIA[0]} {INERTIA[0]}"/>
<body name="forearm" pos="{LENGTH} 0 0"><joint name="elbow"/>
<inertial pos="{CENTRE[1]} 0 0" mass="{MASS[1]}" diaginertia="1e-4 {INERTIA[1]} {INERTIA[1]}"/></body></body>
</worldbody>
<actuator><motor name="m_shoulder" joint="shoulder"/><motor name="m_elbow" joint="elbow"/></actuator></mujoco>"""
TWIN = """model: torque_arm.xml
signals:
  joints: {shoulder: /joint_states, elbow: /joint_states}
  actuators: {m_shoulder: /efforts, m_elbow: /efforts}
"""


@dataclass(frozen=True)
class Truth:
    """What the arm is that its twin is not."""

    gain: tuple[float, float] = (1.0, 1.0)  # torque of each motor over the logged effort
    drive: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))  # joint: torque of either motor
    coulomb: tuple[float, float] = (0.0, 0.0)  # N m
    viscous: tuple[float, float] = (0.0, 0.0)  # N m s/rad
    load: float = 0.0  # kg at 0.22 m along the forearm
    heavier: tuple[float, float] = (1.0, 1.0)  # mass and inertia of either link, times
    rotor: float = 0.0  # kg m² more at either joint
    gravity: float = GRAVITY  # m/s²; 0 for an arm that lies on its side
    slow: float = 1.0  # by which all motion is slower


def write_arm(folder: Path, gravity: float = GRAVITY) -> TwinSpec:
    """The nominal twin."""
    (folder / "torque_arm.xml").write_text(MJCF.format(gravity=gravity))
    (folder / "twin.yaml").write_text(TWIN)
    return load_twin(folder / "twin.yaml")


def swing_arm(truth: Truth, duration: float, seed: int) -> Log:
    """The log of a motion of this arm under a controller that follows sines of several frequencies."""
    rng = np.random.default_rng(seed)
    count = round(duration / STEP / EVERY)
    time = np.arange(count) * STEP * EVERY
    waves = [[(rng.uniform(0.1, 0.45), rng.uniform(0.6, 5.0) / truth.slow, rng.uniform(0.0, 6.0)) for _ in range(4)]
             for _ in JOINTS]  # fmt: skip
    rows, logged = np.zeros((count, 4)), np.zeros((count, 2))
    back = np.linalg.inv(np.array(truth.drive))
    m1, m2 = (mass * times for mass, times in zip(MASS, truth.heavier))
    i1, i2 = (inertia * times for inertia, times in zip(INERTIA, truth.heavier))
    c2 = (m2 * CENTRE[1] + truth.load * 0.22) / (m2 + truth.load)
    i2 += m2 * CENTRE[1] ** 2 + truth.load * 0.22**2
    m2 += truth.load
    i1 += m1 * CENTRE[0] ** 2 + m2 * LENGTH**2
    couple, rotor = m2 * LENGTH * c2, ROTOR + truth.rotor
    q = [sum(a * math.sin(p) for a, _, p in part) + (-0.4, 0.5)[j] for j, part in enumerate(waves)]
    v = [sum(a * w * math.cos(p) for a, w, p in part) for part in waves]
    for k in range(count):
        rows[k] = *q, *v
        weight = truth.gravity * m2 * c2 * math.cos(q[0] + q[1])
        fall = (truth.gravity * (m1 * CENTRE[0] + m2 * LENGTH) * math.cos(q[0]) + weight, weight)
        asked = np.zeros(2)
        for j, part in enumerate(waves):
            goal = sum(a * math.sin(w * time[k] + p) for a, w, p in part) + (-0.4, 0.5)[j]
            rate = sum(a * w * math.cos(w * time[k] + p) for a, w, p in part)
            heavy = (i1 + i2 + rotor, i2 + rotor)[j]
            asked[j] = heavy * (80.0 * (goal - q[j]) + 14.0 * (rate - v[j])) - fall[j]
        motors = back @ asked
        logged[k] = motors / truth.gain
        push = np.array(truth.drive) @ motors
        for _ in range(EVERY):
            cos, sin = math.cos(q[1]), math.sin(q[1])
            weight = truth.gravity * m2 * c2 * math.cos(q[0] + q[1])
            one = push[0] + couple * sin * (2.0 * v[0] * v[1] + v[1] ** 2) + weight
            one += truth.gravity * (m1 * CENTRE[0] + m2 * LENGTH) * math.cos(q[0])
            two = push[1] - couple * sin * v[0] ** 2 + weight
            one, two = (
                torque - (VISCOUS + truth.viscous[j]) * v[j] - truth.coulomb[j] * math.tanh(v[j] / 2e-3)
                for j, torque in enumerate((one, two))
            )
            a, b, d = i1 + i2 + 2.0 * couple * cos + rotor, i2 + couple * cos, i2 + rotor
            det = a * d - b * b
            v = [v[0] + STEP * (d * one - b * two) / det, v[1] + STEP * (a * two - b * one) / det]
            q = [q[0] + STEP * v[0], q[1] + STEP * v[1]]
    rows += np.repeat(NOISE, 2) * rng.standard_normal(rows.shape)
    joints = {n: Stream(time, {"position": rows[:, j], "velocity": rows[:, 2 + j]}) for j, n in enumerate(JOINTS)}
    efforts = {f"m_{n}": Stream(time, {"effort": logged[:, j]}) for j, n in enumerate(JOINTS)}
    return Log(Path(f"arm_{seed}.mcap"), 0, {}, {"/joint_states": joints, "/efforts": efforts})
