"""What a fit by hand says of the SO-101's servos, without MuJoCo: python -m examples.so101.by_hand FOLDER.

Each joint alone, the others where they were measured: J q'' = τ - b q' - F sgn q' + G(q), the servo τ = kp (u - z - q)
within ±most, `late` behind its target u. J is that of the CAD with 0.028 kg m² of rotor, G its weight.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from examples.by_hand import Array, Estimate, Fit, draw_errors, low_pass
from examples.so101.convert import JOINTS, read_motion

WEIGHT = {"Pitch": (0.103, 0.008, 0.090), "Elbow": (0.104, 0.098, 0.003), "Wrist_Pitch": (0.079, 0.039, 0.0)}
"""Link that each joint of the plane carries: mass [kg], centre ahead of the joint and above it [m], at zero."""
NEXT = {"Pitch": (0.028, 0.113), "Elbow": (0.135, 0.005), "Wrist_Pitch": (0.061 + 0.029, 0.002)}
"""Where the next joint is, the same way; behind the wrist the centre of the gripper."""
GRIPPER = 0.099  # kg
INERTIA = {"Rotation": 0.042, "Pitch": 0.040, "Elbow": 0.037, "Wrist_Pitch": 0.029, "Wrist_Roll": 0.0281}  # kg m²
LIMITS = {
    "kp": (0.5, 2.0, 60.0), "b": (0.02, 0.0, 3.0), "F": (0.01, 0.0, 0.8), "most": (0.05, 0.2, 6.0),
    "late": (0.002, 0.0, 0.1), "z": (0.001, -0.05, 0.051),
}  # fmt: skip
"""Parameter → step of its secant, lowest, highest: N m/rad, N m s/rad, N m, N m, s, rad."""
MAKERS = {"kp": 17.8, "b": 0.6, "F": 0.052, "most": 3.35, "late": 0.0, "z": 0.0}
"""What so101.xml has of its makers."""
NEAR = 0.03
"""What a stiffness e times the makers' counts as, as an error of one sample [rad]."""
DT, WINDOW, SUBSTEPS, SLIDING = 0.02, 25, 4, 0.03  # s, samples, of a sample, rad/s over which friction turns round


def weigh(joint: str, position: Array) -> Array:
    """Weight that the servo of a joint holds, (n,) N m, positive where it pulls the joint forward."""
    chain = list(WEIGHT)
    if joint not in chain:
        return np.zeros(len(position))
    torque, ahead, angle = np.zeros(len(position)), np.zeros(len(position)), np.zeros(len(position))
    for name in chain:
        angle = angle + position[:, JOINTS.index(name)]
        cos, sin = np.cos(angle), np.sin(angle)
        if chain.index(name) >= chain.index(joint):
            mass, x, z = WEIGHT[name]
            torque += 9.81 * mass * (ahead + x * cos + z * sin)
            x, z = NEXT[name]
            ahead = ahead + x * cos + z * sin
    return torque + 9.81 * GRIPPER * ahead


def fit_joint(folders: list[Path], joint: str) -> Fit:
    """Fit windows of half a second, simulated from the measured state.

    Stiffness, damping and friction may all be larger together at hardly any cost: the stiffness stays near its makers'.
    """
    logs = [prepare(folder, joint) for folder in folders]

    step, low, high = (np.array([LIMITS[name][i] for name in LIMITS]) for i in range(3))

    def miss(value: Array) -> Array:
        off = [simulate(value[:, None], INERTIA[joint], *log).ravel() for log in logs]
        return np.concatenate([*off, [NEAR * np.log(value[0] / MAKERS["kp"])]])

    start = 0.5 * (low + high)
    found = least_squares(miss, start, bounds=(low, high), x_scale=step, diff_step=step / np.abs(start), loss="soft_l1",
                          f_scale=0.01)  # fmt: skip
    columns = np.repeat(found.x[:, None], 1 + len(step), axis=1)
    columns[np.arange(len(step)), 1 + np.arange(len(step))] += step
    each = [simulate(columns, INERTIA[joint], *log) for log in logs]
    left, slopes = [one[..., 0] for one in each], [one[..., 1:] - one[..., :1] for one in each]
    errors = draw_errors(left, slopes, 4)
    errors -= errors.mean(axis=0)  # squares that grow without end, and no bounds, would ask for another optimum
    ends = np.clip(np.percentile(found.x + step * errors, [5.0, 95.0], axis=0), low, high)
    estimates = {name: Estimate(*numbers) for name, *numbers in zip(LIMITS, found.x, *ends, strict=True)}
    return Fit(estimates, float("nan"), [np.sqrt(np.mean(one**2, axis=(0, 2))) for one in left])


def prepare(folder: Path, joint: str) -> tuple[Array, Array, Array, Array]:
    """Target, position, velocity and weight of a joint on an even grid, (n,) each."""
    time, target, position = read_motion(folder)
    grid = np.arange(time[0], time[-1], DT)
    index = JOINTS.index(joint)
    held = target[np.searchsorted(time, grid, side="right") - 1, index]
    seen = np.stack([np.interp(grid, time, column) for column in position.T], axis=1)
    rate = np.gradient(low_pass(seen[:, index], DT, 8.0), DT)
    return held, seen[:, index], rate, weigh(joint, seen)


def simulate(columns: Array, inertia: float, target: Array, seen: Array, rate: Array, weight: Array) -> Array:
    """Simulated minus measured, (times, 1, windows, m); semi-implicit Euler, friction turned round smoothly."""
    kp, b, dry, most, late, zero = columns[:, None, :]
    starts = np.arange(10, len(seen) - WINDOW - 1, WINDOW)
    q, v = (np.repeat(value[starts][:, None], columns.shape[1], axis=1) for value in (seen, rate))
    h, left, index = DT / SUBSTEPS, [], np.arange(len(target))
    for k in range(WINDOW):
        pull = weight[starts + k][:, None]
        for s in range(SUBSTEPS):
            at = starts[:, None] + k + s / SUBSTEPS - late / DT
            torque = np.clip(kp * (np.interp(at, index + 0.5, target) - zero - q), -most, most)
            sliding = np.tanh(v / SLIDING)
            free, stiff = torque + pull - dry * sliding, dry * (1.0 - sliding**2) / SLIDING
            v = v + h * (free - b * v) / (inertia + h * (b + stiff))
            q = q + h * v
        left.append((q - seen[starts + k + 1][:, None])[None])
    return np.stack(left)


def miss(folder: Path, joint: str, values: dict[str, float]) -> float:
    """How far windows of half a second of a motion are off, rms [mrad]."""
    columns = np.array([[values[name]] for name in LIMITS])
    return float(1e3 * np.sqrt(np.mean(simulate(columns, INERTIA[joint], *prepare(folder, joint)) ** 2)))


def main() -> None:
    """Print a line per joint: what the fit finds, and how far it is off on motions that it saw and did not see."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--motions", nargs="+", default=["prbs_excitation"])
    parser.add_argument("--unseen", nargs="+", default=["random_waypoints", "multisine", "chirp_sweep"])
    options = parser.parse_args()
    for joint in JOINTS:
        fit = fit_joint([options.folder / motion for motion in options.motions], joint)
        values = {name: fit[name] for name in LIMITS}
        off = [
            f"{motion} {miss(options.folder / motion, joint, MAKERS):.1f} -> "
            f"{miss(options.folder / motion, joint, values):.1f}"
            for motion in (*options.motions, *options.unseen)
        ]
        print(f"{joint:12s} {fit}\n{'':12s} off [mrad]: {', '.join(off)}")


if __name__ == "__main__":
    main()
