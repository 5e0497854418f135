"""One self-contained HTML page: meshcat's viewer, the drawing commands, a legend and a playback bar."""

from __future__ import annotations

import base64
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import jinja2
import meshcat
import umsgpack

from vpptwin.errors import InputError
from vpptwin.viz import palette
from vpptwin.viz.rotors import PITCH_EXAGGERATION, TURN_SLOWDOWN
from vpptwin.viz.scene import ROOT, find_craft, name_body
from vpptwin.viz.show import Show

if TYPE_CHECKING:
    from vpptwin.logs.flight import Flight

TRAIL_DURATION = 1.5  # s of the past that the trail shows
VIEWER = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("vpptwin.viz"), autoescape=True, undefined=jinja2.StrictUndefined
)


class Command(Protocol):
    """A meshcat command: what a viewer is told."""

    def lower(self) -> Mapping[str, object]:
        """The command as the viewer's message."""


@dataclass
class Recorder:
    """Takes the place of meshcat's window: keeps the commands instead of sending them to a server."""

    commands: list[bytes] = field(default_factory=list)

    def send(self, command: Command) -> None:
        """Keep one command, packed."""
        self.commands.append(umsgpack.packb(command.lower()))


@dataclass(frozen=True)
class LegendEntry:
    """A colour, how it is drawn (solid, translucent, line) and what it stands for."""

    colour: str
    style: str
    text: str


@dataclass(frozen=True)
class PageText:
    """What the page says: title, legend, a note on drawing, and the nodes whose poses it reads out.

    Attributes:
        start: log time of the first frame [s].
        frames: number of frames of the animation.
        log_node, twin_node: scene paths of the bodies to read out, empty for none.
    """

    title: str
    legend: tuple[LegendEntry, ...]
    note: str
    start: float
    duration: float
    frames: int
    log_node: tuple[str, ...] = ()
    twin_node: tuple[str, ...] = ()


def describe_show(show: Show, flight: Flight, twin_name: str) -> PageText:
    """Legend, note and readouts for what a show holds."""
    legend = [LegendEntry("#2A2C31", "solid", "the log")]
    notes = ["Grid: 0.5 m."]
    log_node: tuple[str, ...] = ()
    twin_node: tuple[str, ...] = ()
    if show.twin is not None:
        legend.append(LegendEntry(palette.TWIN, "translucent", f"{twin_name}, given the log's commands"))
    if show.vehicle is not None:
        craft = name_body(show.model, find_craft(show.model))
        log_node = (*split_path(ROOT), "log", craft)
        twin_node = (*split_path(ROOT), "twin", craft) if show.twin is not None else ()
        legend.append(LegendEntry(palette.TRAIL, "line", "the log's path"))
    if show.target is not None:
        legend.append(LegendEntry(palette.TARGET, "translucent", "target"))
    if show.log.rotors is not None:
        legend.append(LegendEntry(palette.POSITIVE_THRUST, "solid", "thrust"))
        legend.append(LegendEntry(palette.NEGATIVE_THRUST, "solid", "negative thrust"))
        notes.append(f"Rotors turn {TURN_SLOWDOWN:g} × slower and pitch {PITCH_EXAGGERATION:g} × further than real.")
        notes.append("Thrust: k_T × speed × commanded pitch.")
    return PageText(
        Path(flight.path).name,
        tuple(legend),
        " ".join(notes),
        float(show.frames[0]),
        float(show.time[-1]),
        len(show.frames),
        log_node,
        twin_node,
    )


def split_path(path: str) -> list[str]:
    """The names along a scene path."""
    return [name for name in path.split("/") if name]


def write_page(commands: list[bytes], text: PageText, out: Path) -> Path:
    """Write the page beside its place and move it there whole.

    Args:
        commands: packed meshcat commands in the order of drawing.
        text: what the page says around the scene.
        out: the page.
    """
    html = TEMPLATES.get_template("play.html").render(
        text=text,
        viewer=VIEWER.read_text(encoding="utf-8"),
        commands=json.dumps([base64.b64encode(command).decode() for command in commands]),
        readout=json.dumps(
            {
                "start": text.start,
                "frame": text.duration / (text.frames - 1),
                "log": text.log_node,
                "twin": text.twin_node,
                "trail": round(TRAIL_DURATION * text.frames / text.duration),
            }
        ),
    )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=out.parent, suffix=".html", encoding="utf-8", delete=False) as file:
            file.write(html)
        os.chmod(file.name, 0o644)
        os.replace(file.name, out)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}", "a writable path", "choose another") from error
    return out
