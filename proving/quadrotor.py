"""A quadrotor that shares no physics with vpptwin: a rigid body by the midpoint rule, rotors with lag, drag, gusts.

Motors 1 to 4 at (+,-), (-,-), (-,+), (+,+) of the arm along x and y; 1 and 3 turn against 2 and 4. Commands are
thrusts [N] at 500 Hz, poses come from a tracker at 100 Hz, rates from a gyro at 500 Hz, both noisy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from proving.hidden import Hidden, draw_one, record, save_twin
from proving.logs import Log, Stream

MASS, ARM, TORQUE = 0.030, 0.0325, 0.006  # kg, m, m (torque over thrust)
INERTIA = np.array([1.5e-5, 1.5e-5, 2.6e-5])  # kg m²
LAG, GRAVITY, STEP = 0.03, 9.81, 0.002  # s, m/s², s
SUBSTEPS = 4
SIDES = np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
SPINS = np.array([-1.0, 1.0, -1.0, 1.0])
ROTORS = "".join(f'<site name="r{i + 1}" pos="{ARM * x} {ARM * y} 0"/>' for i, (x, y) in enumerate(SIDES))
MOTORS = "".join(
    f'<general name="m{i + 1}" site="r{i + 1}" gear="0 0 1 0 0 {TORQUE * s}"/>' for i, s in enumerate(SPINS)
)
MJCF = f"""<mujoco model="quadrotor"><option timestep="0.002" integrator="Euler"/>
<worldbody><body name="quad"><freejoint/>
<inertial pos="0 0 0" mass="{MASS}" diaginertia="{" ".join(map(str, INERTIA))}"/>
<geom name="hull" type="box" size="0.03 0.03 0.01" contype="0" conaffinity="0" mass="0"/><site name="imu"/>
{ROTORS}
</body></worldbody>
<actuator>{MOTORS}
</actuator></mujoco>"""
TWIN = """model: quadrotor.xml
signals:
  bodies: {quad: /pose}
  sites: {imu: /imu}
  actuators: {m1: /motors, m2: /motors, m3: /motors, m4: /motors}
effects:
  m1+m2+m3+m4.lag: {time_constant: 0.03}
"""


def write_twin(folder: Path) -> Path:
    """The nominal twin and its MJCF."""
    return save_twin(folder, "quadrotor", MJCF, TWIN)


@njit(cache=True)
def _matrix(q):  # noqa: ANN001, ANN202
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@njit(cache=True)
def _turn(q, r):  # noqa: ANN001, ANN202
    angle = np.sqrt((r * r).sum())
    s = np.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    w, (x, y, z) = np.cos(0.5 * angle), s * r
    a, b, c, d = q
    found = np.array([
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    ])  # fmt: skip
    return found / np.sqrt((found * found).sum())


@njit(cache=True)
def _skew(c):  # noqa: ANN001, ANN202
    return np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])


@njit(cache=True)
def _accelerate(v, q, w, thrust, gust, body):  # noqa: ANN001, ANN202
    """Of the body's origin in the world's axes, and about its own; the centre of mass is `com` off the origin."""
    mass, com, inertia, drag, wind, twist, up, sides, spins = body
    turn = _matrix(q)
    back = turn.T.copy()
    push = np.array([0.0, 0.0, thrust.sum()]) - drag * (back @ v)
    weight = mass * (back @ up)
    force = push + back @ (wind + gust[:3]) - weight - mass * np.cross(w, np.cross(w, com))
    lift = np.array(
        [(ARM * sides[:, 1] * thrust).sum(), -(ARM * sides[:, 0] * thrust).sum(), (TORQUE * spins * thrust).sum()]
    )
    skew = _skew(com)
    about = inertia - mass * (skew @ skew)
    moment = lift + twist + gust[3:] - np.cross(w, about @ w) - np.cross(com, weight)
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[3:, 3:] = mass * np.eye(3), about
    matrix[:3, 3:], matrix[3:, :3] = -mass * skew, mass * skew
    found = np.linalg.solve(matrix, np.concatenate((force, moment)))
    return turn @ found[:3].copy(), found[3:].copy()


@njit(cache=True)
def _fly(count, goals, yaws, noise, strength, craft):  # noqa: ANN001, ANN202
    mass, com, inertia, gain, lag, drag, wind, twist, sides, spins, moments = craft
    p, v, w = np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)
    q, up = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, GRAVITY])
    thrust, integral, gust = np.full(4, MASS * GRAVITY / 4.0), np.zeros(3), strength * noise[0]
    memory, h = np.exp(-STEP / 0.25), STEP / SUBSTEPS
    mix = np.empty((4, 4))
    mix[0], mix[1], mix[2], mix[3] = 1.0, ARM * sides[:, 1], -ARM * sides[:, 0], TORQUE * spins
    log = np.empty((count + 1, 17))
    for k in range(count + 1):
        i = int(k * STEP / 1.2)
        error = p - goals[i]
        integral = np.minimum(np.maximum(integral + error * STEP, -0.5), 0.5)
        wanted = -6.0 * error - 3.6 * v - 2.0 * integral + up
        turn = _matrix(q)
        collective = MASS * (wanted * turn[:, 2]).sum()
        z = wanted / np.sqrt((wanted * wanted).sum())
        y = np.cross(z, np.array([np.cos(yaws[i]), np.sin(yaws[i]), 0.0]))
        y /= np.sqrt((y * y).sum())
        target = np.stack((np.cross(y, z), y, z), axis=1)
        off = turn.T.copy() @ target
        lean = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
        torque = moments * (np.array([160.0, 160.0, 40.0]) * lean - np.array([22.0, 22.0, 10.0]) * w)
        command = np.linalg.solve(mix, np.array([collective, torque[0], torque[1], torque[2]]))
        command = np.rint(np.minimum(np.maximum(command, 0.005), 0.2) / 2e-6) * 2e-6
        log[k, :3], log[k, 3:7], log[k, 7:10], log[k, 10:13], log[k, 13:] = p, q, v, w, command
        gust = memory * gust + strength * np.sqrt(1.0 - memory**2) * noise[k]
        for _ in range(SUBSTEPS):
            ahead = gain * (command + (thrust - command) * np.exp(-0.5 * h / lag))
            body = mass, com, inertia, drag, wind, twist, up, sides, spins
            a, b = _accelerate(v, q, w, ahead, gust, body)
            half = _turn(q, 0.5 * h * w + 0.125 * h * h * b)
            a, b = _accelerate(v + 0.5 * h * a, half, w + 0.5 * h * b, ahead, gust, body)
            p = p + h * v + 0.5 * h * h * a
            q = _turn(q, h * w + 0.5 * h * h * b)
            v, w = v + h * a, w + h * b
            thrust = command + (thrust - command) * np.exp(-h / lag)
    return log


SPANS = {
    **{f"m{i}.gain": ("gain", 0.97, 0.85) for i in range(1, 5)}, "m1+m2+m3+m4.gain": ("gain", 0.97, 0.85),
    "m1+m2+m3+m4.lag": ("time_constant", 0.035, 0.05), "quad.mass": ("mass", 0.001, 0.006),
    **{f"quad.com {axis}": (axis, 3e-4, 3e-3) for axis in "xy"}, "quad.drag": ("across", 0.005, 0.03),
    **{f"quad.wind {axis}": (axis, 0.005, 0.05) for axis in "xy"},
    **{f"quad.twist {axis}": (axis, 5e-5, 5e-4) for axis in "xy"},
}  # fmt: skip


def draw_hidden(seed: int) -> Hidden:
    """See `draw_one`."""
    return draw_one([seed, 8], SPANS)


def simulate(hidden: Hidden, duration: float, seed: int, gusts: float) -> np.ndarray:
    """Fly between waypoints with something hidden in the craft; gusts as a share of its weight.

    Returns:
        Every `STEP` position, attitude, velocity, rate and commands, (n, 3 + 4 + 3 + 3 + 4).
    """

    def get(effect: str, name: str, off: float = 0.0) -> float:
        return hidden.get(effect, {}).get(name, off)

    rng, count = np.random.default_rng(seed), round(duration / STEP)
    goals = np.cumsum(np.vstack([[[0.0, 0.0, 1.0]], rng.uniform(-0.7, 0.7, (round(duration) + 2, 3))]), axis=0)
    goals = np.clip(goals, [-1.5, -1.5, 0.6], [1.5, 1.5, 2.0])
    yaws = np.cumsum(rng.uniform(-1.0, 1.0, len(goals)))
    strength = gusts * MASS * GRAVITY * np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.02])
    craft = (
        MASS + get("quad.mass", "mass"), np.array([get("quad.com", axis) for axis in "xyz"]),
        np.diag(INERTIA * [get("quad.inertia", axis, 1.0) for axis in "xyz"]),
        np.array([get(f"m{i}.gain", "gain", 1.0) for i in range(1, 5)]) * get("m1+m2+m3+m4.gain", "gain", 1.0),
        np.array([get("m1+m2+m3+m4.lag", "time_constant", LAG) for _ in range(4)]),
        np.array([get("quad.drag", way) for way in ("across", "across", "along")]),
        *(np.array([get(f"quad.{kind}", axis) for axis in "xyz"]) for kind in ("wind", "twist")), SIDES, SPINS, INERTIA,
    )  # fmt: skip
    return np.asarray(_fly(count, goals, yaws, rng.standard_normal((count + 1, 6)), strength, craft))


def fly(hidden: Hidden, duration: float, seed: int, gusts: float = 0.002, noise: float = 1.0) -> Log:
    """The log of such a flight, whose sensors have `noise` times their noise."""
    log, rng = simulate(hidden, duration, seed, gusts), np.random.default_rng([seed, 1])
    time, seen = STEP * np.arange(len(log)), misread_poses(log, hidden)
    attitude = np.array(
        [_turn(q, 1.5e-3 * noise) for q, noise in zip(seen[:, 3:], rng.standard_normal((len(seen), 3)))]
    )
    position = seen[:, :3] + noise * 3e-4 * rng.standard_normal((len(seen), 3))
    mounted = Rotation.from_rotvec([hidden.get("imu.misalignment", {}).get(axis, 0.0) for axis in "xyz"])
    rate = hidden.get("imu.scale", {}).get("scale", 1.0) * mounted.inv().apply(log[:, 10:13])
    rate = rate + [hidden.get("imu.bias", {}).get(axis, 0.0) for axis in "xyz"]
    rate = rate + noise * 0.01 * rng.standard_normal((len(log), 3))
    motors = {f"m{i + 1}": Stream(time, {"effort": log[:, 13 + i]}) for i in range(4)}
    spatial = {
        "/pose": Stream(time[::5], {"position": position, "attitude": attitude}),
        "/imu": Stream(time, {"rate": rate}),
    }
    return Log(Path(f"flight_{seed}.mcap"), 0, {}, {"/motors": motors}, spatial=spatial)


def misread_poses(log: np.ndarray, hidden: Hidden) -> np.ndarray:
    """Poses of every fifth step as the tracker has them: late, off by a factor, of a marker body that is turned."""
    stamp = STEP * np.arange(0, len(log), 5)
    age = hidden.get("quad.delay", {}).get("delay", 0.0) + hidden.get("quad.drift", {}).get("drift", 0.0) * stamp
    steps, row = np.modf(np.clip((stamp - age) / STEP, 0.0, len(log) - 1.0))
    seen = log[row.astype(int), :7].copy()
    seen[:, :3] += (STEP * steps)[:, None] * log[row.astype(int), 7:10]
    seen[:, :3] *= hidden.get("quad.scale", {}).get("scale", 1.0)
    markers = np.array([hidden.get("quad.misalignment", {}).get(axis, 0.0) for axis in "xyz"])
    for pose, rate, ahead in zip(seen, log[row.astype(int), 10:13], STEP * steps):
        pose[3:] = _turn(_turn(pose[3:], ahead * rate), markers)
    return seen


if __name__ == "__main__":
    record(MJCF, fly, 12.0)
