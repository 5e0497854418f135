"""Which rotor a hovering quadrotor has trouble with, by its commands: python -m examples.crazypad.by_hand FOLDER."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from vpptwin.mapping.survey import survey

FOLDERS = (
    "normal_flight", "add_weight_W1_near_M3", "add_weight_W3_near_M3", "tape_on_propeller_M3", "cut_propeller_M3_2mm",
)  # fmt: skip
MIX = np.array([[-0.5, 0.5, 1.0], [-0.5, -0.5, -1.0], [0.5, -0.5, 1.0], [0.5, 0.5, -1.0]])
"""What roll, pitch and yaw commands add to each rotor's (Crazyflie's power distribution)."""
HIGH, RUNNING = 0.35, 5000.0
"""In flight: above this height [m], every rotor above this command."""


def read_commands(log: Path) -> np.ndarray:
    """Mean command of each rotor in the middle half of the hover, (4,) of 65535."""
    signals = {signal.label: signal.values for signal in survey(log)[1]}
    if "motor.m1" in signals:
        commands = np.stack([signals[f"motor.m{i}"] for i in range(1, 5)], axis=1)
    else:  # the controller's own four numbers, as some of these logs have
        turns = np.stack([signals[f"controller.cmd_{way}"] for way in ("roll", "pitch", "yaw")], axis=1)
        commands = signals["controller.actuatorThrust"][:, None] + turns @ MIX.T
    flying = np.flatnonzero((signals["stateEstimate.z"] > HIGH) & (commands.min(axis=1) > RUNNING))
    quarter = len(flying) // 4
    return np.asarray(commands[flying[quarter : 3 * quarter]].mean(axis=0))


def compare(folder: Path) -> dict[str, np.ndarray]:
    """Folder → commands of its logs against the mean of the normal flights, each by its own mean, (logs, 4)."""
    shares = {}
    for name in FOLDERS:
        commands = np.array([read_commands(log) for log in sorted((folder / name).glob("E9_log*"))])
        shares[name] = commands / commands.mean(axis=1, keepdims=True)
    usual = shares["normal_flight"].mean(axis=0)
    return {name: share / usual - 1.0 for name, share in shares.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="DATA/crazypad")
    for name, changes in compare(parser.parse_args().folder).items():
        told = ", ".join(f"M{i + 1} {100 * m:+5.1f} ± {100 * s:.1f} %" for i, (m, s) in
                         enumerate(zip(changes.mean(axis=0), changes.std(axis=0))))  # fmt: skip
        print(f"{name:24} {told}")
