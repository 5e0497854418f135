"""Playing a flight log, and beside it the twin driven by the log's commands, in meshcat."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from meshcat import Visualizer
from meshcat.commands import SetAnimation

from vpptwin.vehicle import Vehicle
from vpptwin.viz.page import Recorder, describe_show, write_page
from vpptwin.viz.show import prepare_show
from vpptwin.viz.stage import draw_show
from vpptwin.viz.tracks import Animation

if TYPE_CHECKING:
    from vpptwin.logs.flight import Flight
    from vpptwin.twin.replay import Prediction

FOREVER = float("inf")  # repetitions of a looping animation


def play_page(
    flight: Flight,
    prediction: Prediction | None = None,
    out: Path = Path("flight.html"),
    *,
    model: Path | None = None,
    vehicle: Vehicle | None = None,
    joint_topics: Mapping[str, str] | None = None,
    twin_name: str = "twin",
) -> Path:
    """Write one HTML page that plays a flight in a loop, offline, with play, pause, speed and scrubbing.

    Args:
        flight: the log, drawn solid.
        prediction: the twin's answer to the log's commands, drawn translucent; None for the log alone.
        out: the page.
        model: MJCF of the rig; None for ours.
        vehicle: numbers of our craft; None for the nominal ones.
        joint_topics: other rigs: joint name -> JointState topic; None finds joints by name.
        twin_name: what the legend calls the twin.

    Returns:
        The page's path.

    Raises:
        InputError: if the log has nothing to draw, the MJCF does not compile or the page cannot be written.
    """
    show = prepare_show(flight, prediction, model, vehicle, joint_topics)
    recorder = Recorder()
    tracks = draw_show(Visualizer(window=recorder), show)
    recorder.send(SetAnimation(Animation(tracks), play=True, repetitions=FOREVER))
    return write_page(recorder.commands, describe_show(show, flight, twin_name), Path(out))


def play_live(
    flight: Flight,
    prediction: Prediction | None = None,
    *,
    model: Path | None = None,
    vehicle: Vehicle | None = None,
    joint_topics: Mapping[str, str] | None = None,
) -> None:
    """Serve a flight with meshcat, which prints its address, and play it in a loop until Ctrl-C.

    The arguments are those of play_page.
    """
    show = prepare_show(flight, prediction, model, vehicle, joint_topics)
    vis = Visualizer()
    try:
        tracks = draw_show(vis, show)
        print("Open Controls > Animations there to pause, scrub and change the speed. Ctrl-C here to end.", flush=True)
        vis.window.send(SetAnimation(Animation(tracks), play=True, repetitions=FOREVER))
        while True:
            time.sleep(0.5)
    except KeyboardInterrupt:
        pass
    finally:
        vis.window.server_proc.terminate()
