"""`vpptwin play`: a log in meshcat, and beside it the twin driven by the log's commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from vpptwin.errors import InputError
from vpptwin.estimation.replay import replay
from vpptwin.logs import Flight, read_flight
from vpptwin.twin.spec import load_twin
from vpptwin.viz.playback import play_live, play_page


def play_log(
    logs: Sequence[Path],
    twin: str | None,
    html: Path | None,
    restart: float | None = 0.5,
    topic_map: Path | None = None,
    effects: Sequence[Path] = (),
) -> None:
    """Play one recording.

    Args:
        logs: its MCAP files.
        twin: `nominal` or a twin YAML; None plays the log alone, on the nominal rig.
        html: the page to write; None serves meshcat until Ctrl-C.
        restart: seconds between the twin's restarts; None lets it run freely.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own.
    """
    if restart is not None and not restart > 0.0:
        raise InputError(f"--restart {restart:g}", "seconds above 0", "use --free for a twin that is never restarted")
    spec = load_twin(twin or "nominal", effects)
    flight = read_flight(list(logs), topic_map)
    if twin is None:
        check_craft(flight)
    prediction = None if twin is None else replay(spec, flight, restart)
    for warning in flight.warnings:
        print(f"{flight.path.name}: {warning}", file=sys.stderr)
    if html is None:
        play_live(flight, prediction, spec=spec)
    else:
        print(play_page(flight, prediction, html, spec=spec))


def check_craft(flight: Flight) -> None:
    """Refuse a log of another rig that comes without the twin that would describe it."""
    if "/mocap/pose" not in flight.streams and flight.joints:
        raise InputError(
            f"{flight.path}: joints on {', '.join(flight.joints)} and no /mocap/pose",
            "a log of our craft, or the twin of another rig",
            "name that rig's twin with --twin",
        )
