"""Convert a CSV of DFKI's double pendulum: python -m examples.double_pendulum.convert design_A_11.csv out.mcap."""

from __future__ import annotations

import argparse
from pathlib import Path

from examples.csv_log import write_log

JOINTS = {"shoulder": ("pos_meas1", "vel_meas1"), "elbow": ("pos_meas2", "vel_meas2")}


def convert(csv: Path, out: Path, torque: str = "con") -> None:
    """Write the MCAP; torque `con` was commanded, `meas` is the motor's own estimate from its current."""
    write_log(csv, out, JOINTS, {"shoulder_motor": f"tau_{torque}1", "elbow_motor": f"tau_{torque}2"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("csv", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--torque", choices=("con", "meas"), default="con", help="column that drives the twin")
    options = parser.parse_args()
    convert(options.csv, options.out, options.torque)
