"""A quadruped's leg in the air, trunk on a stand, with position servos, simulated by Pinocchio: no physics of vpptwin.

Targets go to roll, hip and knee at 50 Hz; encoders count 0.4 mrad at 100 Hz. Steps of 0.25 ms, friction of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from proving.hidden import Hidden, record
from proving.logs import Log, Stream
from proving.servo_arm import plan_targets

JOINTS = ("roll", "hip", "knee")
LINKS = {
    "pelvis": ("1 0 0", (0.0, 0.0, 0.0), 0.70, (0.0, 0.01, 0.0), (4.7e-4, 8e-4, 5.5e-4)),
    "thigh": ("0 1 0", (0.0, 0.08, 0.0), 1.00, (-0.003, -0.01, -0.03), (5.5e-3, 5.1e-3, 1.4e-3)),
    "shank": ("0 1 0", (0.0, 0.0, -0.20), 0.17, (0.006, 0.0, -0.11), (3.0e-3, 3.0e-3, 4e-5)),
}
"""Axis and place [m] of the joint above; mass [kg], centre of mass [m], moments about it [kg m²]."""
TIP = np.array([0.0, 0.0, -0.20])  # m
ROTOR, STIFF, DAMP, MOST, DRY, VISCOUS, GRAVITY = 0.012, 25.0, 0.6, 8.0, 0.12, 0.03, 9.81
STEP, PERIOD, COUNT, SLIDING = 2.5e-4, 0.01, 4e-4, 1e-3  # s, s, rad, rad/s
PLACES = ((0.0, 0.35), (0.6, 0.7), (-1.3, 0.7))
"""Middle and reach of every joint's targets [rad]."""


def _write(name: str, joint: str) -> str:
    axis, place, mass, centre, moments = LINKS[name]
    told = [" ".join(map(str, vector)) for vector in (place, centre, moments)]
    return (
        f'<body name="{name}" pos="{told[0]}"><joint name="{joint}" axis="{axis}"/>\n'
        f'<inertial pos="{told[1]}" mass="{mass}" diaginertia="{told[2]}"/>\n'
    )


MJCF = f"""<mujoco model="servo_leg"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint armature="{ROTOR}" frictionloss="{DRY}" damping="{VISCOUS}"/>
<position kp="{STIFF}" kv="{DAMP}" forcerange="-{MOST} {MOST}"/></default>
<worldbody>{"".join(map(_write, LINKS, JOINTS))}</body></body></body></worldbody>
<actuator>{"".join(f'<position name="{j}_servo" joint="{j}"/>' for j in JOINTS)}</actuator></mujoco>"""
SPANS = {
    **{f"{joint}.coulomb": ("torque", 0.08, 0.6) for joint in JOINTS},
    **{f"{joint}.viscous": ("damping", 0.05, 0.5) for joint in JOINTS},
    **{f"{joint}.load": ("mu", 0.06, 0.3) for joint in JOINTS},
    **{f"{joint}.offset angle": ("angle", 0.01, 0.08) for joint in JOINTS},
    **{f"{joint}.inertia": ("inertia", 0.003, 0.02) for joint in JOINTS},
    **{f"{joint}_servo.stiffness": ("stiffness", 0.6, 0.9) for joint in JOINTS},
    **{f"{joint}_servo.dead_band": ("band", 0.01, 0.04) for joint in JOINTS},
    **{f"{joint}_servo.delay": ("delay", 0.005, 0.03) for joint in JOINTS},
    **{f"{joint}_servo.force_limit": ("limit", 0.2, 0.5) for joint in ("hip", "knee")},
    "shank.payload": ("mass", 0.04, 0.3),
}  # fmt: skip


def _build(payload: float) -> pin.Model:
    """The leg with a mass at its tip."""
    model, joint = pin.Model(), 0
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    for name, (axis, place, mass, centre, moments) in LINKS.items():
        kind = pin.JointModelRX() if axis == "1 0 0" else pin.JointModelRY()
        joint = model.addJoint(joint, kind, pin.SE3(np.eye(3), np.array(place)), name)
        body = pin.Inertia(mass, np.array(centre), np.diag(moments))
        if name == "shank":
            body += pin.Inertia(payload, TIP, np.zeros((3, 3)))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return model


def simulate(hidden: Hidden, targets: np.ndarray) -> np.ndarray:
    """Angles (n, 3) at every target (n, 3), every `PERIOD`."""

    def get(kind: str, name: str, off: float = 0.0) -> np.ndarray:
        return np.array([hidden.get(f"{joint}{kind}", {}).get(name, off) for joint in JOINTS])

    model, held = _build(hidden.get("shank.payload", {}).get("mass", 0.0)), round(PERIOD / STEP)
    data, zero, band = model.createData(), get(".offset", "angle"), get("_servo.dead_band", "band")
    stiff, most = STIFF * get("_servo.stiffness", "stiffness", 1.0), MOST * get("_servo.force_limit", "limit", 1.0)
    late = np.rint(get("_servo.delay", "delay") / STEP).astype(int)
    dry, mu, damping = DRY + get(".coulomb", "torque"), get(".load", "mu"), VISCOUS + get(".viscous", "damping")
    extra = np.diag(ROTOR + get(".inertia", "inertia"))
    q, v, found = targets[0] - zero, np.zeros(3), np.empty_like(targets)
    for k in range(len(targets) * held):
        if k % held == 0:
            found[k // held] = q
        lack = stiff * (targets[np.maximum(k - late, 0) // held, range(3)] - q - zero) - DAMP * v
        lack -= np.clip(lack, -stiff * band, stiff * band)  # what does nothing is where the servo is, damping and all
        torque = np.clip(lack, -most, most)
        mass = np.triu(pin.crba(model, data, q))
        mass = mass + np.triu(mass, 1).T + extra
        level, slide = dry + mu * np.abs(torque), np.tanh(v / SLIDING)
        steep = level * (1.0 - slide * slide) / SLIDING
        push = torque - pin.nonLinearEffects(model, data, q, v) - level * slide + steep * v
        v = np.linalg.solve(mass + STEP * np.diag(steep + damping), mass @ v + STEP * push)
        q = q + STEP * v
    return found


def move(hidden: Hidden, duration: float, seed: int) -> Log:
    """The log of a motion of this leg."""
    wanted = plan_targets(np.random.default_rng(seed), duration, PLACES)
    targets = np.repeat(wanted, 2, axis=0)
    zero = np.array([hidden.get(f"{joint}.offset", {}).get("angle", 0.0) for joint in JOINTS])
    seen = np.rint((simulate(hidden, targets) + zero) / COUNT) * COUNT
    time = PERIOD * np.arange(len(targets))
    joints = {name: Stream(time, {"position": seen[:, j]}) for j, name in enumerate(JOINTS)}
    inputs = {f"{name}_servo": Stream(time[::2], {"effort": wanted[:, j]}) for j, name in enumerate(JOINTS)}
    return Log(Path(f"motion_{seed}.mcap"), 0, {}, {"/joint_states": joints, "/targets": inputs})


if __name__ == "__main__":
    record(MJCF, move, 16.0)
