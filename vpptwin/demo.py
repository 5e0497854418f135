"""`make demo`: the main job on the flights that ship with the project."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from vpptwin.cli import guard
from vpptwin.diagnosis.report.command import diagnose_logs
from vpptwin.errors import InputError
from vpptwin.viz.command import play_log

FLIGHTS = Path(__file__).resolve().parent.parent / "demo" / "flights"
OUT = Path("out") / "demo"
DIAGNOSED = ("aggressive", "mixed", "steps")


def run_demo() -> None:
    """Diagnose three shipped flights of a rig with a hidden effect, then show a flip beside the nominal twin."""
    if not FLIGHTS.is_dir():
        raise InputError(f"no folder {FLIGHTS}", "the flights of a checkout", "run it from a clone of the repository")
    began = time.perf_counter()
    print("Three flights of an independent simulation, with one effect that the nominal twin lacks. What is it?\n")
    diagnose_logs([FLIGHTS / f"{name}.mcap" for name in DIAGNOSED], "nominal", OUT)
    print("\nA flip from the same rig, the nominal twin beside it, restarted every half second:")
    play_log([FLIGHTS / "flip.mcap"], "nominal", OUT / "flip.html")
    print(f"\nDone in {time.perf_counter() - began:.0f} s. Open in a browser:")
    for name in ("report.html", "flip.html"):
        print(f"  {(OUT / name).resolve()}")


if __name__ == "__main__":
    sys.exit(guard(run_demo))
