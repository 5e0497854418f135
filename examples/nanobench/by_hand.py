"""What a fit by hand says of Nanobench's flights, without MuJoCo: python -m examples.nanobench.by_hand FOLDER.

Of each flight, take-off and landing left out: how much a rotor at full PWM thrusts if it goes with PWM² and the craft
weighs 30 g, from the accelerometer alone, in the first and the last seconds too; the share of what turns the craft
that PWM explains; and the drag across thrust, by which the accelerometer's x and y follow the speed there.
"""

from __future__ import annotations

import argparse
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Array = np.ndarray
MASS, ARM, REACH = 0.030, 0.0325, 0.006  # kg, m, torque of a rotor per thrust m
FLYING, MARGIN, PART = 0.3, 50, 500  # m, samples of 10 ms
ROLL, PITCH, YAW = (-1.0, -1.0, 1.0, 1.0), (-1.0, 1.0, 1.0, -1.0), (-1.0, 1.0, -1.0, 1.0)
"""Sides of rotors 1 to 4 about x, y and z."""


@dataclass(frozen=True)
class Found:
    """Of one flight.

    Attributes:
        thrust: of a rotor at full PWM [N]; `first` and `last`: in five seconds at either end.
        shares: of the variance of the angular acceleration about x, y and z that PWM explains, at its best lag.
        slope: thrust per PWM² about hover, over that of a line through zero.
        drag: along the body's x and y [N s/m].
    """

    thrust: float
    first: float
    last: float
    shares: tuple[float, float, float]
    slope: float
    drag: tuple[float, float]


def read_flight(path: Path) -> dict[str, Array]:
    """Columns by name."""
    with gzip.open(path, "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


def smooth(values: Array) -> Array:
    """Mean over 50 ms, along the first axis."""
    return np.stack([np.convolve(column, np.ones(5) / 5.0, "same") for column in values.T], axis=1)


def look(path: Path) -> Found:
    """The fit of one flight."""
    log = read_flight(path)
    squares = np.stack([(log[f"motor_motor_m{i}"] / 65535.0) ** 2 for i in range(1, 5)], axis=1)
    up = np.flatnonzero(log["pz"] > FLYING)[[0, -1]] + [MARGIN, -MARGIN]
    total, force = squares.sum(axis=1), 9.80665 * MASS * log["imu_acc_z"]

    def fit(rows: slice) -> float:
        return float(force[rows] @ total[rows] / (total[rows] @ total[rows]))

    rows = slice(*up)
    thrust = fit(rows)
    slope = max((np.corrcoef(total[up[0] - k : up[1] - k], force[rows])[0, 1],
                 np.polyfit(total[up[0] - k : up[1] - k], force[rows], 1)[0]) for k in range(12))[1]  # fmt: skip
    rates = np.stack([log[f"imu_gyro_{axis}"] for axis in "xyz"], axis=1)
    turning = np.gradient(smooth(rates), log["t"], axis=0)[rows]
    moments = smooth(squares @ np.array([ROLL, PITCH, YAW]).T)
    shares = [
        max(np.corrcoef(moments[up[0] - k : up[1] - k, axis], turning[:, axis])[0, 1] ** 2 for k in range(10))
        for axis in range(3)
    ]
    ends = fit(slice(up[0], up[0] + PART)), fit(slice(up[1] - PART, up[1]))
    along = turn_to_body(log)[rows]
    drag = [
        -np.polyfit(along[:, i], 9.80665 * MASS * log[f"imu_acc_{axis}"][rows], 1)[0] for i, axis in enumerate("xy")
    ]
    told = (float(shares[0]), float(shares[1]), float(shares[2])), float(slope / thrust)
    return Found(thrust, *ends, *told, (float(drag[0]), float(drag[1])))


def turn_to_body(log: dict[str, Array]) -> Array:
    """Velocities in the body's axes, (n, 3) m/s: v + 2 u × (u × v + w v), its attitude being (w, -u)."""
    u, w = -np.stack([log[f"q{axis}"] for axis in "xyz"], axis=1), log["qw"][:, None]
    velocity = np.stack([log[f"v{axis}"] for axis in "xyz"], axis=1)
    return velocity + 2.0 * np.cross(u, np.cross(u, velocity) + w * velocity)


def main() -> None:
    """Print a line per flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for path in sorted(parser.parse_args().folder.glob("*.csv.gz")):
        one = look(path)
        shares = ", ".join(f"{share:.2f}" for share in one.shares)
        print(f"{path.name:28s} {one.thrust:.4f} N, first {one.first:.4f}, last {one.last:.4f}; slope {one.slope:.2f}; "
              f"turning explained {shares}; drag {one.drag[0]:.4f}, {one.drag[1]:.4f} N s/m")  # fmt: skip


if __name__ == "__main__":
    main()
