"""Figures as SVG text that a report can hold: vector, self-contained, in the text colour of the page around them."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from vpptwin.viz.plots.palette import BLUE, VERMILION

BEFORE = VERMILION  # the twin as it was
AFTER = BLUE  # the twin with the named causes
INK = "#fe01fe"  # stands for the page's text colour until the SVG is written
STYLE: dict[Any, object] = {  # keys: rcParams, which matplotlib types as one long literal
    "svg.fonttype": "none",  # text stays text: selectable, searchable, in the page's colour
    "svg.hashsalt": "vpptwin", "font.family": "sans-serif", "font.size": 10.0, "text.color": INK,
    "axes.facecolor": "none", "axes.edgecolor": INK, "axes.labelcolor": INK, "axes.titlesize": 10.0,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": INK, "grid.alpha": 0.15, "grid.linewidth": 0.8, "xtick.color": INK, "ytick.color": INK,
    "text.parse_math": False,  # a $ in a name is one
    "legend.frameon": False, "lines.linewidth": 1.6,
}  # fmt: skip


@contextmanager
def open_figure(width: float, height: float, ink: str = INK) -> Iterator[Figure]:
    """A figure of width x height [inch] in our style, text in `ink`; draw and write it inside the with block."""
    with mpl.rc_context({key: ink if value == INK else value for key, value in STYLE.items()}):
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="none")
        FigureCanvasSVG(figure)
        yield figure


def write_svg(figure: Figure, title: str) -> str:
    """The figure as an <svg> element; a page may set the CSS variables --before and --after, say for dark readers.

    Args:
        figure: drawn within open_figure.
        title: what a screen reader says; it also keeps the element ids of several figures on a page apart.
    """
    text = io.StringIO()
    empty = {"Creator": None, "Date": None, "Format": None, "Type": None}
    figure.savefig(text, format="svg", transparent=True, metadata=empty)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor")
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        svg = svg.replace(colour.lower(), f"var(--{name}, {colour})")
    prefix = re.sub(r"\W+", "-", title.lower()).strip("-")
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    svg = svg.replace("url(#", f"url(#{prefix}-").replace('href="#', f'href="#{prefix}-')
    label = html.escape(title, quote=True)
    opening = f'<svg role="img" aria-label="{label}" style="max-width: 100%; height: auto"'
    return svg.replace("<svg", opening, 1).strip()


def follow_reader(svg: str) -> str:
    """An SVG that stands alone: its text is dark, or light where the reader's screen is dark."""
    style = "<style>svg { color: #1a1c1f } @media (prefers-color-scheme: dark) { svg { color: #e8eaed } }</style>"
    opening, rest = svg.split(">", 1)
    return f"{opening}><!-- vpptwin -->{style}{rest}\n"


def name_axes(axes: Axes, x_label: str, y_label: str, title: str = "") -> None:
    """Label both axes; labels carry their unit in brackets."""
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    if title:
        axes.set_title(title)


def find_loudest(departures: Iterable[np.ndarray]) -> tuple[int, float]:
    """Which of some departures, each in noises of its channel, stands out most, and by how many noises (RMS)."""
    loudness = [float(np.sqrt(np.mean(departure**2))) for departure in departures]
    best = int(np.argmax(loudness))
    return best, loudness[best]


def thin(count: int, most: int) -> np.ndarray:
    """Indices of at most `most` evenly spread items of count."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
