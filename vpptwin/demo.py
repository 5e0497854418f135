"""`vpptwin demo`: the main job on the flights that ship with the package."""

from __future__ import annotations

import time
from pathlib import Path

from vpptwin.diagnosis.report.command import diagnose_logs
from vpptwin.files import check_own
from vpptwin.resources import flights_dir
from vpptwin.viz.command import play_log

DIAGNOSED = ("aggressive", "mixed", "steps")


def show_demo(out: Path, force: bool = False) -> None:
    """Diagnose three shipped flights of a rig with a hidden effect, then show a flip beside the nominal twin.

    Args:
        out: folder of report and flip.
        force: overwrite files of these names that vpptwin did not write, too.

    Raises:
        InputError: if the folder holds such a file, or cannot be written to.
    """
    if not force:
        check_own([out / "flip.html"])
    began, flights, here = time.perf_counter(), flights_dir(), Path.cwd()
    if flights.is_relative_to(here):  # commands that the report offers are shorter so
        flights = flights.relative_to(here)
    print("Three flights of an independent simulation, with one effect that the nominal twin lacks. What is it?\n")
    diagnose_logs([flights / f"{name}.mcap" for name in DIAGNOSED], "nominal", out, force=force)
    print("\nA flip from the same rig, the nominal twin beside it, restarted every half second:")
    play_log([flights / "flip.mcap"], "nominal", out / "flip.html")
    print(f"\nDone in {time.perf_counter() - began:.0f} s. Open in a browser:")
    for name in ("report.html", "flip.html"):
        print(f"  {(out / name).resolve()}")
