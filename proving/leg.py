"""A leg on a trunk that is held by hand, its foot on a ball joint, simulated by Pinocchio: no physics of vpptwin.

The trunk moves as a hand moves it, seen by a tracker at 100 Hz; hip and knee are driven by torques at 200 Hz, the foot
hangs free, its attitude from the shank seen at 100 Hz. A leapfrog of 0.5 ms, dry friction of its own, lag and delay.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin

from proving.hidden import Hidden, draw_one, record, save_twin
from proving.logs import Log, Stream

PARTS = {
    "thigh": (0.40, (0.0, 0.0, -0.10), (2.2e-3, 2.2e-3, 3e-4)),
    "shank": (0.25, (0.0, 0.0, -0.09), (1.1e-3, 1.1e-3, 1e-4)),
    "foot": (0.15, (0.02, 0.0, -0.06), (4e-4, 5e-4, 2e-4)),
}
"""Mass [kg], centre of mass in the frame of the joint above [m], moments about it [kg m²]."""
LENGTHS, ROTOR, DRY, VISCOUS, ANKLE = (0.20, 0.18), 0.004, 0.05, 0.02, (0.002, 0.004)
STEP, CONTROL, SEEN, GRAVITY, SLIDING = 5e-4, 5e-3, 1e-2, 9.81, 5e-3  # s, s, s, m/s², rad/s
STIFF, DAMP, MIDDLE, REACH = np.array([12.0, 6.0]), np.array([0.5, 0.25]), np.array([0.2, -0.7]), np.array([0.6, 0.7])


def _inertial(name: str) -> str:
    mass, centre, moments = PARTS[name]
    place, spread = " ".join(map(str, centre)), " ".join(map(str, moments))
    return f'<inertial pos="{place}" mass="{mass}" diaginertia="{spread}"/>'


MJCF = f"""<mujoco model="leg"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="trunk"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="thigh"><joint name="hip" axis="0 1 0" armature="{ROTOR}" frictionloss="{DRY}" damping="{VISCOUS}"/>
{_inertial("thigh")}
<body name="shank" pos="0 0 -{LENGTHS[0]}">
<joint name="knee" axis="0 1 0" armature="{ROTOR}" frictionloss="{DRY}" damping="{VISCOUS}"/>
{_inertial("shank")}
<body name="foot" pos="0 0 -{LENGTHS[1]}"><joint name="ankle" type="ball" frictionloss="{ANKLE[0]}"
damping="{ANKLE[1]}"/>{_inertial("foot")}</body></body></body></body></worldbody>
<actuator><motor name="hip_motor" joint="hip"/><motor name="knee_motor" joint="knee"/></actuator></mujoco>"""
TWIN = """model: leg.xml
signals:
  driven: {trunk: /pose}
  joints: {hip: /joint_states, knee: /joint_states, ankle: /ankle}
  actuators: {hip_motor: /motors, knee_motor: /motors}
"""
SPANS = {
    **{f"{joint}.coulomb": ("torque", 0.04, 0.25) for joint in ("hip", "knee")},
    **{f"{joint}.viscous": ("damping", 0.03, 0.2) for joint in ("hip", "knee")},
    **{f"{joint}.load": ("mu", 0.06, 0.3) for joint in ("hip", "knee")},
    **{f"{joint}.offset angle": ("angle", 0.02, 0.1) for joint in ("hip", "knee")},
    **{f"{joint}.inertia": ("inertia", 0.002, 0.01) for joint in ("hip", "knee")},
    **{f"{joint}_motor.gain": ("gain", 0.95, 0.75) for joint in ("hip", "knee")},
    **{f"{joint}_motor.delay": ("delay", 0.006, 0.03) for joint in ("hip", "knee")},
    "shank.mass": ("mass", 0.03, 0.15), "foot.payload": ("mass", 0.01, 0.08),
    "ankle.coulomb": ("torque", 0.002, 0.015), "ankle.viscous": ("damping", 0.002, 0.012),
    **{f"foot.com {axis}": (axis, 0.003, 0.02) for axis in "xy"},
}  # fmt: skip


def write_twin(folder: Path) -> Path:
    """The nominal twin and its MJCF."""
    return save_twin(folder, "leg", MJCF, TWIN)


def draw_hidden(seed: int) -> Hidden:
    """See `draw_one`."""
    return draw_one([seed, 9], SPANS)


def _build(hidden: Hidden) -> pin.Model:
    """Trunk, thigh, shank and foot with what is hidden in them."""
    model, joint = pin.Model(), 0
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    down = [np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -LENGTHS[0]]), np.array([0.0, 0.0, -LENGTHS[1]])]
    kinds = pin.JointModelFreeFlyer(), pin.JointModelRY(), pin.JointModelRY(), pin.JointModelSpherical()
    for name, kind, place in zip(("trunk", *PARTS), kinds, down):
        joint = model.addJoint(joint, kind, pin.SE3(np.eye(3), place), name)
        mass, centre, moments = PARTS.get(name, (1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01)))
        more = hidden.get(f"{name}.mass", {}).get("mass", 0.0)
        centre = np.array(centre) + [hidden.get(f"{name}.com", {}).get(axis, 0.0) for axis in "xyz"]
        body = pin.Inertia(mass + more, centre, np.diag(moments) * (1.0 + more / mass))
        if load := hidden.get(f"{name}.payload", {}).get("mass", 0.0):
            body += pin.Inertia(load, np.array([0.04, 0.0, -0.12]), np.zeros((3, 3)))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return model


def _attitude(matrix: np.ndarray) -> np.ndarray:
    return np.array(pin.Quaternion(matrix).coeffs())  # which lie in the quaternion


def _hold(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How a hand moves the trunk: pose (n, 7), velocity and acceleration in its own axes (n, 6), every `STEP`."""
    time = STEP * np.arange(-1, count + 1)
    rates, phases = rng.uniform(0.8, 9.0, (6, 8)), rng.uniform(0.0, 2.0 * np.pi, (6, 8))
    sizes = rng.standard_normal((6, 8)) * np.repeat([0.25, 1.2], 3)[:, None] / (4.0 + rates**1.5)
    way = (sizes[..., None] * np.sin(rates[..., None] * time + phases[..., None])).sum(axis=1).T
    turns = np.array([pin.exp3(turn) for turn in way[:, 3:]])
    spin = np.array([pin.log3(a.T @ b) for a, b in pairwise(turns)]) / STEP  # between samples
    spin = 0.5 * (np.vstack([spin, spin[-1:]]) + np.vstack([spin[:1], spin]))
    climb = np.einsum("nji,nj->ni", turns, np.gradient(way[:, :3], STEP, axis=0))
    velocity = np.hstack([climb, spin])
    attitude = np.array([_attitude(turn) for turn in turns])
    return np.hstack([way[:, :3], attitude])[1:], velocity[1:], np.gradient(velocity, STEP, axis=0)[1:]


def plan(rng: np.random.Generator, duration: float) -> np.ndarray:
    """Targets of hip and knee, ramps and rests, (n, 2) rad every `CONTROL`."""
    time, targets = np.arange(round(duration / CONTROL)) * CONTROL, []
    for j in range(2):
        at, places = np.cumsum(rng.uniform(0.15, 0.7, 2 * round(duration / 0.3))), [MIDDLE[j]]
        for _ in at[1:]:
            places.append(places[-1] if rng.random() < 0.3 else MIDDLE[j] + REACH[j] * rng.uniform(-1.0, 1.0))
        targets.append(np.interp(time, at, places))
    return np.stack(targets, axis=1)


def simulate(hidden: Hidden, duration: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Swing the leg with something hidden in it.

    Returns:
        Pose (n, 13), as Pinocchio has it, and joint velocities (n, 5), every `STEP`; torques (m, 2) every `CONTROL`.
    """

    def get(kind: str, name: str, off: float = 0.0) -> np.ndarray:
        return np.array([hidden.get(f"{joint}{kind}", {}).get(name, off) for joint in ("hip", "knee")])

    rng, model, count, held = np.random.default_rng(seed), _build(hidden), round(duration / STEP), round(CONTROL / STEP)
    base, speed, push = _hold(rng, count)
    targets, data = plan(rng, duration + 1.0), model.createData()
    extra, damping = get(".inertia", "inertia") + ROTOR, get(".viscous", "damping") + VISCOUS
    dry, mu, gain = get(".coulomb", "torque") + DRY, get(".load", "mu"), get("_motor.gain", "gain", 1.0)
    late, zero = np.rint(get("_motor.delay", "delay") / STEP).astype(int), get(".offset", "angle")
    ankle_dry = ANKLE[0] + hidden.get("ankle.coulomb", {}).get("torque", 0.0)
    damping = np.append(damping, np.full(3, ANKLE[1] + hidden.get("ankle.viscous", {}).get("damping", 0.0)))
    q, v = np.concatenate([base[0], MIDDLE, [0.0, 0.0, 0.0, 1.0]]), np.zeros(11)
    torques, sent = np.zeros((count // held + 1, 2)), np.zeros((count + 1, 2))
    poses, rates, level = np.empty((count + 1, 13)), np.empty((count + 1, 5)), np.empty(5)
    for k in range(count + 1):
        q[:7], v[:6] = base[k], speed[k]
        before = v[6:].copy()
        if k % held == 0:
            lack = targets[k // held] - q[7:9] - zero
            torques[k // held] = np.rint((STIFF * lack - DAMP * v[6:8]) / 2e-3) * 2e-3
        sent[k] = torques[k // held]
        torque = gain * sent[np.maximum(k - late, 0), [0, 1]]
        mass = np.triu(pin.crba(model, data, q))
        mass = mass + np.triu(mass, 1).T
        rest = -pin.nonLinearEffects(model, data, q, v)[6:] - mass[6:, :6] @ push[k]
        rest[:2] += torque
        level[:2], level[2:] = dry + mu * np.abs(torque), ankle_dry
        slide = np.tanh(before / SLIDING)
        steep = level * (1.0 - slide * slide) / SLIDING
        inner = mass[6:, 6:].copy()
        inner[0, 0] += extra[0]
        inner[1, 1] += extra[1]
        right = inner @ before + STEP * (rest - level * slide + steep * before)
        v[6:] = np.linalg.solve(inner + STEP * np.diag(steep + damping), right)
        poses[k], rates[k] = q, 0.5 * (before + v[6:])
        q = pin.integrate(model, q, STEP * v)
    return poses, rates, torques


def move(hidden: Hidden, duration: float, seed: int, noise: float = 1.0) -> Log:
    """The log of such a motion, whose sensors have `noise` times their noise."""
    poses, rates, torques = simulate(hidden, duration, seed)
    rng, held, seen = np.random.default_rng([seed, 1]), round(CONTROL / STEP), round(SEEN / STEP)
    time, slow = CONTROL * np.arange(len(torques)), SEEN * np.arange(len(poses[::seen]))
    angles = poses[::held, 7:9] + [hidden.get(f"{joint}.offset", {}).get("angle", 0.0) for joint in ("hip", "knee")]
    angles = angles + noise * 2e-4 * rng.standard_normal(angles.shape)
    speeds = rates[::held, :2] + noise * 0.01 * rng.standard_normal(angles.shape)

    def look(attitude: np.ndarray) -> np.ndarray:
        turns = [pin.exp3(noise * 1e-3 * turn) for turn in rng.standard_normal((len(attitude), 3))]
        blurred = [_attitude(pin.Quaternion(q).matrix() @ turn) for q, turn in zip(attitude, turns)]
        return np.roll(np.array(blurred), 1, axis=1)

    trunk = poses[::seen, :3] + noise * 3e-4 * rng.standard_normal((len(slow), 3))
    names = ("hip", "knee")
    joints = {
        "/joint_states": {
            n: Stream(time, {"position": angles[:, j], "velocity": speeds[:, j]}) for j, n in enumerate(names)
        },
        "/motors": {f"{n}_motor": Stream(time, {"effort": torques[:, j]}) for j, n in enumerate(names)},
    }
    spatial = {
        "/pose": Stream(slow, {"position": trunk, "attitude": look(poses[::seen, 3:7])}),
        "/ankle": Stream(slow, {"attitude": look(poses[::seen, 9:13])}),
    }
    return Log(Path(f"motion_{seed}.mcap"), 0, {}, joints, spatial=spatial)


if __name__ == "__main__":
    record(MJCF, move, 16.0)
