"""Fly the logs that ship in demo/flights: `python -m proving.drone.demo`."""

from __future__ import annotations

import argparse
from pathlib import Path

from .flight import FlightPlan, fly_many
from .recording import write_mcap

FOLDER = Path(__file__).resolve().parents[2] / "demo" / "flights"
HIDDEN = {"rail_x.coulomb": {"force": 0.30}}  # what the nominal twin lacks; N
SESSION = 2  # one rig in all of them
FLIGHTS = (
    ("steps.mcap", "x_steps", 16.0, 101),
    ("aggressive.mcap", "aggressive", 18.0, 102),
    ("mixed.mcap", "mixed", 20.0, 103),
    ("flip.mcap", "flip", 9.0, 104),
)


def main() -> None:
    """Fly and write every demo log."""
    parser = argparse.ArgumentParser(prog="python -m proving.drone.demo", description=__doc__)
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name, manoeuvre, duration, seed in FLIGHTS:
        flight: FlightPlan = {
            "effects": HIDDEN,
            "manoeuvre": manoeuvre,
            "duration": duration,
            "seed": seed,
            "session": SESSION,
        }
        path = write_mcap(fly_many([flight])[0], out / name)
        print(f"{path}  {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
