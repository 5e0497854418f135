"""`vpptwin demo`: the main job on logs that ship with the package."""

from __future__ import annotations

import time
from pathlib import Path

from vpptwin.report.command import diagnose_logs
from vpptwin.robots.planar_drone.display.markers import describe_flight
from vpptwin.robots.planar_drone.pilot.command import Sortie, fly_log
from vpptwin.system.files import check_own
from vpptwin.system.resources import flights_dir, so101_dir
from vpptwin.train.evaluate.pilot import load_pilot
from vpptwin.twin.spec import load_twin
from vpptwin.viz.command import LogSource, play_log

DIAGNOSED = ("aggressive", "mixed", "steps")
MOTIONS = ("multisine", "prbs_excitation", "random_waypoints")


def show_demo(out: Path, force: bool = False) -> None:
    """Diagnose three shipped flights of a rig with a hidden effect; show a flip beside both twins, and the wall.

    Args:
        out: folder of report and pages.
        force: overwrite files of these names that vpptwin did not write, too.

    Raises:
        InputError: if the folder holds such a file, or cannot be written to.
    """
    if not force:
        check_own([out / name for name in ("flip.html", "wall.html", "wall.mcap")])
    began, flights = time.perf_counter(), shorten(flights_dir())
    print("Three flights of an independent simulation, with one effect that the nominal twin lacks. What is it?\n")
    diagnose_logs([flights / f"{name}.mcap" for name in DIAGNOSED], "nominal", out, force=force)
    print("\nA flip from the same rig, beside it the nominal twin and the extended one, restarted every half second:")
    play_log(LogSource([flights / "flip.mcap"], "nominal"), out / "flip.html", others=[str(out / "twin.yaml")])
    show_wall(out)
    tell_pages(began, out, ("report.html", "flip.html", "wall.html"))


def show_arm(out: Path, force: bool = False) -> None:
    """Diagnose three measured motions of a hobby arm, the SO-101; show one beside both twins.

    Args:
        out: folder of report and page.
        force: overwrite files of these names that vpptwin did not write, too.

    Raises:
        InputError: if the folder holds such a file, or cannot be written to.
    """
    if not force:
        check_own([out / "motion.html"])
    began, home = time.perf_counter(), shorten(so101_dir())
    motions = [home / "motions" / f"{name}.mcap" for name in MOTIONS]
    print("Three motions of a real arm, and a model with its makers' numbers. What is wrong with the turntable's?\n")
    diagnose_logs(motions, str(home / "rotation.yaml"), out, force=force)
    print("\nA motion, beside it the twin as it was and the extended one, restarted every half second:")
    given = LogSource([motions[-1]], str(home / "rotation.yaml"))
    play_log(given, out / "motion.html", others=[str(out / "twin.yaml")])
    tell_pages(began, out, ("report.html", "motion.html"))


def shorten(folder: Path) -> Path:
    """A folder from the current one, if it is in that: commands that the report offers are shorter so."""
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder


def tell_pages(began: float, out: Path, pages: tuple[str, ...]) -> None:
    """Say how long it took, since `began` [s], and what to open."""
    print(f"\nDone in {time.perf_counter() - began:.0f} s. Open in a browser:")
    for name in pages:
        print(f"  {(out / name).resolve()}")


def show_wall(out: Path) -> None:
    """Fly the policy that ships off the wall and back, and write its page into a folder."""
    print("\nThe policy that ships rolls up beside the wall and comes back, with stronger rotors:")
    pilot, spec = load_pilot(Path("wall-backtrack"), None, load_twin("strong"), None, 0)
    fly_log(pilot, Sortie(spec, out / "wall.mcap", 0, False, {"policy": "wall-backtrack"}, describe_flight))
    play_log(LogSource([out / "wall.mcap"], "strong"), out / "wall.html")
