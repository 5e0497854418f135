"""Playing a flight log, and beside it the twin driven by the log's commands, in meshcat."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.system.files import write_whole
from vpptwin.system.signals import until_interrupted
from vpptwin.twin.spec import TwinSpec, load_twin
from vpptwin.viz.pages.browse import tell_address
from vpptwin.viz.pages.page import describe_show, record_show, render_page
from vpptwin.viz.pages.serve import LOOPBACK, Server, keep_going
from vpptwin.viz.scene.show import prepare_show

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight


def play_page(
    flight: Flight,
    prediction: Prediction | None = None,
    out: Path = Path("flight.html"),
    *,
    spec: TwinSpec | None = None,
) -> Path:
    """Write one HTML page that plays a flight in a loop, offline, with play, pause, speed and scrubbing.

    Args:
        flight: the log, drawn solid.
        prediction: the twin's answer to the log's commands, drawn translucent; None for the log alone.
        out: the page.
        spec: the twin whose rig is drawn; None for the nominal one.

    Returns:
        The page's path.

    Raises:
        InputError: if the log has nothing to draw or the page cannot be written.
    """
    return write_whole(Path(out), draw_page(flight, prediction, spec or load_twin()))


def draw_page(flight: Flight, prediction: Prediction | None, spec: TwinSpec) -> str:
    """The page of `play_page` as HTML."""
    show = prepare_show(flight, prediction, spec)
    caption = "" if prediction is None else name_twin(spec, prediction)
    return render_page(record_show(show), describe_show(show, flight.name, caption))


def name_twin(spec: TwinSpec, prediction: Prediction) -> str:
    """What the legend calls the twin."""
    name, restarts = Path(spec.name).name, prediction.restarts
    if len(restarts) < 2:
        return f"twin {name}, free-running"
    return f"twin {name}, set back to the log every {np.median(np.diff(restarts)):.3g} s"


def play_live(
    flight: Flight, prediction: Prediction | None = None, *, spec: TwinSpec | None = None, host: str = LOOPBACK,
    port: int = 0,
) -> None:  # fmt: skip
    """Serve the page of `play_page` on an address of this machine, print where, open it, until Ctrl-C.

    The other arguments are those of play_page.

    Raises:
        InputError: if the log has nothing to draw, or there is no such address.
    """
    serve_page(draw_page(flight, prediction, spec or load_twin()), host, port)


def serve_page(text: str, host: str = LOOPBACK, port: int = 0) -> None:
    """Serve a page, print where, open it, until Ctrl-C."""
    page = text.encode()
    server = Server(host, {"": lambda body: ("text/html; charset=utf-8", page)}, port=port)
    with until_interrupted(), closing(server):
        tell_address(server, "shows the flight. Ctrl-C here to end.")
        for _ in keep_going():
            time.sleep(0.5)
