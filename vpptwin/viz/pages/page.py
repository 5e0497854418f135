"""One self-contained HTML page: meshcat's viewer, the drawing commands, a legend and a playback bar."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field

import jinja2
import numpy as np
import umsgpack

from vpptwin.viz.plots import palette
from vpptwin.viz.scene.camera import CameraView, frame_view
from vpptwin.viz.scene.geoms import GRID_STEP, ROOT, find_corners, name_body
from vpptwin.viz.scene.nodes import VIEWER, Message, Node
from vpptwin.viz.scene.show import TRAIL_DURATION, LegendEntry, Show, view_show
from vpptwin.viz.scene.stage import draw_show
from vpptwin.viz.scene.tracks import Animation

FOREVER = float("inf")  # repetitions of a looping animation
FOLLOWED_HALF_HEIGHT = 0.6  # m seen above and below a followed craft
TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("vpptwin.viz"), autoescape=True, undefined=jinja2.StrictUndefined
)


@dataclass
class Recorder:
    """Keeps what a viewer is told."""

    commands: list[bytes] = field(default_factory=list)

    def send(self, message: Message) -> None:
        """Keep one message, packed."""
        self.commands.append(umsgpack.packb(message))


@dataclass(frozen=True)
class PageText:
    """What the page says and knows around the scene."""

    title: str  # name of the log
    legend: tuple[LegendEntry, ...]  # what the colours mean
    note: str  # what is not drawn to scale
    start: float  # log time of the first frame [s]
    frames: int  # number of frames of the animation
    duration: float  # time of the last frame from the first [s]
    # name -> centre x, z and distance of the camera [m]; "craft" follows the craft
    views: dict[str, tuple[float, float, float]]
    log_node: tuple[str, ...] = ()  # scene path of the body whose pose is read out, empty for none
    twin_node: tuple[str, ...] = ()  # the same body of the twin, empty without a twin


def describe_show(show: Show, title: str, caption: str) -> PageText:
    """Legend, note, views and readouts for what a show holds; caption is what the legend calls the twin."""
    legend = [LegendEntry(palette.LOG, "solid", "the log")]
    rig = frame_view(find_corners(show.model, show.log.qpos[0]), margin=0.3)
    views = {"flight" if show.followed >= 0 else "motion": lower_view(view_show(show)), "rig": lower_view(rig)}
    log_node: tuple[str, ...] = ()
    twin_node: tuple[str, ...] = ()
    if show.twin is not None:
        legend.append(LegendEntry(palette.TWIN, "translucent", caption))
    if show.followed >= 0:
        views["craft"] = lower_view(CameraView(np.zeros(3), FOLLOWED_HALF_HEIGHT))
        root, body = ROOT.removeprefix("/"), name_body(show.model, show.followed)
        log_node = (root, "log", body)
        twin_node = (root, "twin", body) if show.twin is not None else ()
        legend.append(LegendEntry(palette.TRAIL, "line", f"the log's last {TRAIL_DURATION:g} s"))
    note = " ".join([f"Grid: {GRID_STEP:g} m.", *show.overlay.notes])
    start, duration = float(show.frames[0]), float(show.time[-1])
    entries = (*legend, *show.overlay.legend)
    return PageText(title, entries, note, start, len(show.frames), duration, views, log_node, twin_node)


def lower_view(view: CameraView) -> tuple[float, float, float]:
    """Centre x and z and distance of the camera [m]."""
    return float(view.centre[0]), float(view.centre[2]), view.distance


def record_show(show: Show) -> list[bytes]:
    """What a viewer is told, packed, in the order of drawing: the scene, and its motion for ever."""
    recorder = Recorder()
    tracks = draw_show(Node(recorder), show)
    options = {"play": True, "repetitions": FOREVER}
    recorder.send({"type": "set_animation", "animations": Animation(tracks).lower(), "options": options, "path": ""})
    return recorder.commands


def render_page(commands: list[bytes], text: PageText, viewer: str | None = None) -> str:
    """The page as HTML.

    Args:
        commands: packed, of meshcat, in the order of drawing.
        text: what it says around the scene.
        viewer: what stands in the place of meshcat's script; None for that.
    """
    readout: dict[str, object] = {
        "start": text.start, "frame": text.duration / (text.frames - 1), "log": text.log_node, "twin": text.twin_node,
        "views": text.views, "trail": round(TRAIL_DURATION * text.frames / text.duration),
    }  # fmt: skip
    drawing = json.dumps([base64.b64encode(command).decode() for command in commands])
    viewer = viewer or VIEWER.read_text(encoding="utf-8")
    page = TEMPLATES.get_template("play.html")
    return page.render(text=text, viewer=viewer, commands=drawing, readout=readout)
