"""A two-joint arm with position servos that shares no physics with vpptwin: closed form, 0.25 ms, friction of its own.

Targets go to the servos at 50 Hz; encoders count 1.5 mrad. What is hidden is named in the catalogue's terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numba import njit

from proving.hidden import Hidden, draw_one, record, save_twin
from proving.logs import Log, Stream

LENGTH, CENTRE, MASS, INERTIA = (0.15, 0.0), (0.08, 0.07), (0.12, 0.10), (2.5e-4, 2.0e-4)  # m, m, kg, kg m²
ROTOR, STIFF, DAMP, MOST, DRY, VISCOUS, GRAVITY = 0.012, 9.0, 0.6, 1.6, 0.04, 0.02, 9.81
STEP, PERIOD, COUNT, SLIDING = 2.5e-4, 0.02, 0.0015, 1e-3  # s, s, rad, rad/s
JOINTS = ("shoulder", "elbow")
MJCF = f"""<mujoco model="servo_arm"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<default><joint axis="0 1 0" armature="{ROTOR}" frictionloss="{DRY}" damping="{VISCOUS}"/>
<position kp="{STIFF}" kv="{DAMP}" forcerange="-{MOST} {MOST}"/></default>
<worldbody><body name="upper"><joint name="shoulder"/>
<inertial pos="{CENTRE[0]} 0 0" mass="{MASS[0]}" diaginertia="1e-5 {INERTIA[0]} {INERTIA[0]}"/>
<body name="forearm" pos="{LENGTH[0]} 0 0"><joint name="elbow"/>
<inertial pos="{CENTRE[1]} 0 0" mass="{MASS[1]}" diaginertia="1e-5 {INERTIA[1]} {INERTIA[1]}"/></body></body>
</worldbody>
<actuator><position name="shoulder_servo" joint="shoulder"/><position name="elbow_servo" joint="elbow"/></actuator>
</mujoco>"""
TWIN = """model: servo_arm.xml
signals:
  joints: {shoulder: /joint_states, elbow: /joint_states}
  actuators: {shoulder_servo: /targets, elbow_servo: /targets}
"""
SPANS = {
    "shoulder.coulomb": ("torque", 0.03, 0.2), "elbow.coulomb": ("torque", 0.03, 0.15),
    "shoulder.viscous": ("damping", 0.1, 0.6), "elbow.viscous": ("damping", 0.1, 0.4),
    "shoulder.load": ("mu", 0.1, 0.4), "elbow.load": ("mu", 0.1, 0.4),
    "shoulder.offset angle": ("angle", 0.02, 0.1), "elbow.offset angle": ("angle", 0.02, 0.1),
    "shoulder.inertia": ("inertia", 0.004, 0.02), "elbow.inertia": ("inertia", 0.004, 0.02),
    "shoulder_servo.stiffness": ("stiffness", 0.5, 0.85), "elbow_servo.stiffness": ("stiffness", 0.5, 0.85),
    "shoulder_servo.dead_band": ("band", 0.01, 0.04), "elbow_servo.dead_band": ("band", 0.01, 0.04),
    "shoulder_servo.delay": ("delay", 0.01, 0.05), "elbow_servo.delay": ("delay", 0.01, 0.05),
    "shoulder_servo.force_limit": ("limit", 0.35, 0.6), "elbow_servo.force_limit": ("limit", 0.15, 0.35),
    "forearm.payload": ("mass", 0.03, 0.15),
}  # fmt: skip


def write_twin(folder: Path) -> Path:
    """The nominal twin and its MJCF."""
    return save_twin(folder, "servo_arm", MJCF, TWIN)


def draw_hidden(seed: int) -> Hidden:
    """See `draw_one`."""
    return draw_one([seed, 7], SPANS)


@njit(cache=True)
def _move(targets, laws, servos, payload):  # noqa: ANN001, ANN202
    samples = len(targets)
    steps, h = round(PERIOD / STEP), STEP
    log = np.zeros((samples, 2))
    q, v = targets[0].copy(), np.zeros(2)
    tip, load = 0.14, payload
    m2, c2 = MASS[1] + load, (MASS[1] * CENTRE[1] + load * tip) / (MASS[1] + load)
    i2 = INERTIA[1] + MASS[1] * CENTRE[1] ** 2 + load * tip**2
    i1 = INERTIA[0] + MASS[0] * CENTRE[0] ** 2 + m2 * LENGTH[0] ** 2
    couple = m2 * LENGTH[0] * c2
    M, right, torque = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    for k in range(samples):
        log[k] = q
        for s in range(steps):
            cos, sin = np.cos(q[1]), np.sin(q[1])
            M[0, 0] = i1 + i2 + 2.0 * couple * cos + ROTOR + laws[0, 2]
            M[0, 1] = M[1, 0] = i2 + couple * cos
            M[1, 1] = i2 + ROTOR + laws[1, 2]
            weight = GRAVITY * m2 * c2 * np.cos(q[0] + q[1])
            push = np.array([
                couple * sin * (2.0 * v[0] * v[1] + v[1] ** 2)
                + GRAVITY * (MASS[0] * CENTRE[0] + m2 * LENGTH[0]) * np.cos(q[0]) + weight,
                -couple * sin * v[0] ** 2 + weight,
            ])  # fmt: skip
            for j in range(2):
                at = max((k * steps + s - round(servos[j, 2] / STEP)) // steps, 0)
                # what does nothing is where the servo is, damping and all
                lack = STIFF * servos[j, 0] * (targets[at, j] - q[j] - laws[j, 4]) - DAMP * v[j]
                band = STIFF * servos[j, 0] * servos[j, 1]
                lack -= min(max(lack, -band), band)
                torque[j] = min(max(lack, -MOST * servos[j, 3]), MOST * servos[j, 3])
                dry = DRY + laws[j, 0] + laws[j, 3] * abs(torque[j])
                slide = np.tanh(v[j] / SLIDING)
                steep = dry * (1.0 - slide * slide) / SLIDING
                right[j] = h * (push[j] + torque[j] - dry * slide + steep * v[j])
                right[j] += M[j, 0] * v[0] + M[j, 1] * v[1]
                torque[j] = steep + VISCOUS + laws[j, 1]
            a, d, b = M[0, 0] + h * torque[0], M[1, 1] + h * torque[1], M[0, 1]
            det = a * d - b * b
            v[0], v[1] = (d * right[0] - b * right[1]) / det, (a * right[1] - b * right[0]) / det
            q = q + h * v
    return log


def plan_targets(
    rng: np.random.Generator, duration: float, places: Sequence[tuple[float, float]] = ((-0.6, 0.6), (0.5, 0.8))
) -> np.ndarray:
    """Waypoints reached at different speeds, steps and a slow wander, (n, J) rad at 50 Hz, about middles by reaches."""
    time = np.arange(round(duration / PERIOD)) * PERIOD
    targets = np.zeros((len(time), len(places)))
    for j, (middle, reach) in enumerate(places):
        at, value, here = 0.0, [middle], [0.0]
        while at < duration:
            at += rng.uniform(0.15, 1.0)
            here += [at]
            value += [middle + reach * rng.uniform(-1.0, 1.0)]
            if rng.random() < 0.5:
                at += rng.uniform(0.2, 0.8)
                here, value = [*here, at], [*value, value[-1]]
        targets[:, j] = np.interp(time, here, value)
        steps = np.repeat(rng.uniform(-0.25, 0.25, len(time) // 40 + 1), 40)[: len(time)]
        targets[:, j] += np.where(rng.random(len(time) // 100 + 1).repeat(100)[: len(time)] < 0.5, steps, 0.0)
    return targets


def move(hidden: Hidden, duration: float, seed: int) -> Log:
    """The log of a motion of this arm."""

    def get(kind: str, name: str, off: float = 0.0) -> list[float]:
        return [hidden.get(f"{joint}{kind}", {}).get(name, off) for joint in JOINTS]

    rng = np.random.default_rng(seed)
    targets = plan_targets(rng, duration)
    laws = np.array([get(".coulomb", "torque"), get(".viscous", "damping"), get(".inertia", "inertia"),
                     get(".load", "mu"), get(".offset", "angle")]).T.copy()  # fmt: skip
    servos = np.array([get("_servo.stiffness", "stiffness", 1.0), get("_servo.dead_band", "band"),
                       get("_servo.delay", "delay"), get("_servo.force_limit", "limit", 1.0)]).T.copy()  # fmt: skip
    truth = _move(targets, laws, servos, hidden.get("forearm.payload", {}).get("mass", 0.0))
    seen = np.rint((truth + laws[:, 4]) / COUNT) * COUNT
    time = PERIOD * np.arange(len(targets))
    joints = {name: Stream(time, {"position": seen[:, j]}) for j, name in enumerate(JOINTS)}
    inputs = {f"{name}_servo": Stream(time, {"effort": targets[:, j]}) for j, name in enumerate(JOINTS)}
    return Log(Path(f"motion_{seed}.mcap"), 0, {}, {"/joint_states": joints, "/targets": inputs})


if __name__ == "__main__":
    record(MJCF, move, 16.0)
