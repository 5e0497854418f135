"""Panels as a file: PNG, SVG or an interactive page."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.files import write_whole
from vpptwin.viz.plots.figure import INK, follow_reader, open_figure, thin, write_svg
from vpptwin.viz.plots.palette import BRIGHT, TWIN, VERMILION
from vpptwin.viz.plots.panels import Line, Panel, Story

WIDTH, HEIGHT = 9.0, 1.7
"""Of a figure and of one panel, inch."""
TALL = 3.0
"""Of panels side by side."""
MAX_SAMPLES = 3000
"""Of a line; a screen has fewer columns."""
FEW = 5
"""Points of a line; fewer are marked."""
LABEL_GAP = 0.24
"""Between an axis and its label, besides the numbers there, which may be a digit longer in the end, inch."""
DPI = 150
FORMATS = (".png", ".svg", ".html")
PLOTLY_DASH = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}


@dataclass(frozen=True)
class Theme:
    """Colours of text and ground."""

    ink: str
    paper: str


THEMES = {"light": Theme("#1A1C1F", "#FFFFFF"), "dark": Theme("#E8EAED", "#15181C")}


def check_format(out: Path) -> None:
    """Refuse what is no picture's name, and a page where plotly is missing."""
    if out.suffix.lower() not in FORMATS:
        raise InputError(f"--out {out}", f"a name that ends in {', '.join(FORMATS)}", "e.g. --out flight.png")
    if out.suffix.lower() == ".html":
        load_extra("plotly", f"--out {out}")


def write_story(story: Story, out: Path, theme: str = "light") -> Path:
    """Write a story in the format that the name asks for.

    Args:
        story: what to show.
        out: .png, .svg or .html; a page is one self-contained file that works offline.
        theme: of PNG and page, `light` or `dark`; an SVG follows its reader's.
    """
    check_format(out)
    kind = out.suffix.lower()
    if theme == "dark" and kind != ".svg":
        story = brighten(story)
    if kind == ".html":
        return write_whole(out, render_page(story, THEMES[theme]))
    ink = THEMES[theme].ink if kind == ".png" else INK
    with open_figure(WIDTH, (HEIGHT if story.columns == 1 else TALL) * story.rows + 0.6, ink) as figure:
        draw_story(figure, story, ink)
        if kind == ".png":
            FigureCanvasAgg(figure)
            content, about, packing = io.BytesIO(), {"Software": "vpptwin"}, {"compress_level": 3}
            paper = THEMES[theme].paper
            figure.savefig(content, format="png", dpi=DPI, facecolor=paper, metadata=about, pil_kwargs=packing)
            return write_whole(out, content.getvalue())
        return write_whole(out, follow_reader(write_svg(figure, story.title)))


def brighten(story: Story) -> Story:
    """The same with the twin in a blue that is seen on dark ground."""
    panels = [
        replace(panel, lines=[replace(o, colour=BRIGHT) if o.colour == TWIN else o for o in panel.lines])
        for panel in story.panels
    ]
    return replace(story, panels=panels)


def draw_story(figure: Figure, story: Story, ink: str = INK) -> None:
    """All panels, over a common axis."""
    grid = figure.subplots(story.rows, story.columns, sharex=True, squeeze=False)
    for axes, panel in zip(grid.flat, story.panels):
        draw_panel(axes, panel, story.triggers, ink)
    for axes in grid[-1]:
        axes.set_xlabel(story.across)
    if story.columns == 1:
        named: set[str] = set()
        for axes in grid.flat:  # each name once, where it first appears
            fresh = {label: handle for handle, label in zip(*axes.get_legend_handles_labels()) if label not in named}
            named |= fresh.keys()
            if fresh:
                axes.legend(fresh.values(), fresh.keys(), loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9.0)
    else:
        handles, labels = grid.flat[0].get_legend_handles_labels()
        fitting = max(110 // (max(map(len, labels)) + 8), 1)
        figure.legend(handles, labels, loc="outside lower center", ncols=min(fitting, len(labels)))
    figure.suptitle(story.title, x=0.01, horizontalalignment="left", fontsize=11.0)
    for column in grid.T if story.rows > 1 else ():
        # Labels in one line, left of the widest number, which `align_ylabels` measures anew for each.
        widest = max(number.get_window_extent().width for axes in column for number in axes.get_yticklabels())
        away = ScaledTranslation(-widest / figure.dpi - LABEL_GAP, 0.0, figure.dpi_scale_trans)
        for axes in column:
            axes.yaxis.set_label_coords(0.0, 0.5, transform=axes.transAxes + away)


def draw_panel(axes: Axes, panel: Panel, triggers: np.ndarray, ink: str) -> None:
    """The lines of one panel, and the triggers across it."""
    for i, time in enumerate(triggers):
        axes.axvline(time, color=VERMILION, linestyle="--", linewidth=1.0, label="trigger" if i == 0 else None)
    for line in panel.lines:
        name = f" {line.name}" if line.name.startswith("_") else line.name  # which matplotlib would hide
        time, values = thin_line(line)
        log = line.colour == INK
        style, sparse = "steps-post" if line.steps else "default", is_sparse(line)
        axes.plot(
            time, values, line.dash, color=ink if log else line.colour, drawstyle=style, label=name,
            linewidth=2.6 if log else 1.6, alpha=0.55 if log else 1.0, ms=4.0,
            marker="o" if sparse else "", clip_on=not sparse,
        )  # fmt: skip
        if line.band is not None:
            axes.fill_between(line.time, *line.band, color=line.colour, alpha=0.12, linewidth=0.0)
    axes.set_ylabel(panel.label)
    axes.margins(x=0.0)
    if panel.log:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")


def is_sparse(line: Line) -> bool:
    """Whether a line has so few points that they have to be marked to be seen."""
    return int(np.count_nonzero(np.isfinite(line.values))) < FEW


def thin_line(line: Line) -> tuple[np.ndarray, np.ndarray]:
    """Time and values of a line, at most so many samples of it; where it is broken it stays broken."""
    kept = np.union1d(thin(len(line.time), MAX_SAMPLES), np.flatnonzero(~np.isfinite(line.values)))
    return line.time[kept], line.values[kept]


def render_page(story: Story, theme: Theme) -> str:
    """A page with plotly inside, to zoom into and to read values from."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    rows = story.rows
    figure = make_subplots(rows=rows, cols=story.columns, shared_xaxes=True, vertical_spacing=0.03 / rows)
    named: set[str] = set()
    shapes: list[dict[str, object]] = []
    for i, panel in enumerate(story.panels):
        place = {"row": i // story.columns + 1, "col": i % story.columns + 1}
        for line in panel.lines:
            time, values = thin_line(line)
            look = {
                "color": theme.ink if line.colour == INK else line.colour, "dash": PLOTLY_DASH[line.dash],
                "shape": "hv" if line.steps else "linear",
            }  # fmt: skip
            first, mode = line.name not in named, "lines+markers" if is_sparse(line) else "lines"
            named.add(line.name)
            about = {"name": escape(line.name), "legendgroup": line.name, "showlegend": first, "mode": mode}
            figure.add_trace(Scatter(x=time, y=values, line=look, **about), **place)
        figure.update_yaxes(title_text=escape(panel.label), type="log" if panel.log else "linear", **place)
        number = "" if i == 0 else str(i + 1)
        shapes += [
            {
                "type": "line", "xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1,
                "x0": time, "x1": time, "line": {"color": VERMILION, "dash": "dash", "width": 1},
            }
            for time in story.triggers.tolist()
        ]  # fmt: skip
    for column in range(story.columns):
        figure.update_xaxes(title_text=story.across, row=rows, col=column + 1)
    faint = "rgba(127,127,127,0.25)"
    figure.update_xaxes(gridcolor=faint, zeroline=False).update_yaxes(gridcolor=faint, zeroline=False)
    style: dict[str, object] = {
        "margin": {"l": 70, "r": 20, "t": 60}, "template": "none", "font": {"color": theme.ink},
        "paper_bgcolor": theme.paper, "plot_bgcolor": theme.paper,
    }  # fmt: skip
    height = (190 if story.columns == 1 else 420) * rows + 120
    title = {"text": escape(story.title), "side": "top", "font": {"size": 16}}
    above = {"title": title, "orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom"}  # a phone has no room beside
    figure.update_layout(legend=above, showlegend=True, shapes=shapes, height=height, hovermode="x unified", **style)
    text: str = figure.to_html(include_plotlyjs=True, full_html=True, config={"displaylogo": False})
    head = '<meta name="generator" content="vpptwin"><meta name="viewport" content="width=device-width">'
    text = text.replace("<head>", f"<head>{head}<title>{escape(story.title)}</title>", 1)
    return text.replace("<body>", f'<body style="margin: 0; background: {theme.paper}">', 1)
