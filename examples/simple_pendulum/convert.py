"""Convert a CSV of DFKI's simple pendulum: python -m examples.simple_pendulum.convert ilqr.csv out.mcap."""

from __future__ import annotations

import argparse
from pathlib import Path

from examples.csv_log import write_log


def convert(csv: Path, out: Path) -> None:
    """Write the MCAP; the only torque column is the motor's own estimate from its current."""
    write_log(csv, out, {"pendulum": ("position", "velocity")}, {"motor": "torque"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("csv", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    convert(options.csv, options.out)
