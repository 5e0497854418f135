"""One page for several twins beside the same log: a scene each, in step, and how far each is off in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.twin.robot.manifold import difference_poses
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.pages.page import TEMPLATES, VIEWER, describe_show, record_show, render_page
from vpptwin.viz.scene.show import Show, prepare_show

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight

MOST = 8
"""Degrees of freedom that are listed: those by which the first twin is off most."""
LATE = 0.05
"""By how much one scene may be behind another [s]."""
PLACE = "/* the viewer, once for all scenes */"


def draw_beside(flight: Flight, shown: Sequence[tuple[str, Prediction, TwinSpec]]) -> str:
    """The page as HTML, offline; `shown` are names of twins, what they did, and the twins."""
    shows = [prepare_show(flight, prediction, spec) for _, prediction, spec in shown]
    texts = [describe_show(show, flight.name, "the twin") for show in shows]
    pages = [
        render_page(record_show(show), replace(text, title="legend"), PLACE)
        for show, text in zip(shows, texts, strict=True)
    ]
    every = [np.diff(prediction.restarts) for _, prediction, _ in shown if len(prediction.restarts) > 1]
    reset = f"is reset to the log every {np.median(every[0]):.3g} s" if every else "runs freely"
    return TEMPLATES.get_template("beside.html").render(
        title=flight.name, names=[name for name, *_ in shown], rows=list_rows(shown[0][2], shows), pages=pages,
        note=f"The log is solid. The twin under the log's commands is translucent, and {reset}. "
        "The distances are of the whole log.",
        duration=texts[0].duration, start=texts[0].start, views=list(texts[0].views), place=PLACE, late=LATE,
        viewer=VIEWER.read_text(encoding="utf-8"),
    )  # fmt: skip


def list_rows(spec: TwinSpec, shows: Sequence[Show]) -> list[dict[str, object]]:
    """How far each twin is off in each degree of freedom that is simulated: mm, or degrees."""
    off = np.array([measure_off(show) for show in shows])
    simulated = [i for i in range(spec.model.nv) if i not in set(spec.robot.driven.tolist())]
    worst = sorted(simulated, key=lambda i: -off[0, i])[:MOST]
    rotary = spec.robot.rotary
    return [
        {
            "name": spec.robot.name_dof(i),
            "values": [f"{np.rad2deg(x):.3g}°" if rotary[i] else f"{1e3 * x:.3g} mm" for x in off[:, i]],
        }
        for i in sorted(worst)
    ]


def measure_off(show: Show) -> np.ndarray:
    """Rms of the twin's distance from the log over the frames in which it is shown, (nv,) m or rad."""
    assert show.twin is not None
    at = show.twin.shown & show.log.shown
    off = difference_poses(show.model, show.log.qpos[at], show.twin.qpos[at])
    return np.sqrt(np.mean(off**2, axis=0)) if at.any() else np.full(show.model.nv, np.nan)
