"""The page of a history: every parameter over date or flight number. One file, offline."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import MaxNLocator

from vpptwin.drift.course import Course, ParameterHistory
from vpptwin.drift.trend import CLEAR, LEAST
from vpptwin.effects import SIGMAS_90
from vpptwin.report.html.page import open_templates, tie_units
from vpptwin.report.provenance import Provenance
from vpptwin.report.words import format_digits, format_value
from vpptwin.viz.plots.figure import AFTER, BEFORE, INK, name_axes, open_figure, write_svg
from vpptwin.viz.plots.palette import GREEN

CHANGES = {"any": "any change", "line": "steady", "step": "at once", "bend": "from a log on"}
"""Kinds of change → headings of their columns, which are left out where no parameter has an evidence."""


def render_history(record: ParameterHistory, origin: Provenance) -> str:
    """The page as HTML."""
    rows = [
        {
            "label": record.label(i), "fit": flight.fit, "name": flight.log,
            "values": [
                "not shown" if (value := course.values[i]) is None
                else format_value(value) + ", hardly seen" * ((course.effect, course.parameter) in flight.fit.vague)
                for course in record.courses
            ],
        }
        for i, flight in enumerate(record.flights)
    ]  # fmt: skip
    trends = [(course, course.trend) for course in record.courses if course.trend is not None]
    found = [{"any": trend.evidence, **trend.evidences} for _, trend in trends]
    kinds = [kind for kind in CHANGES if any(np.isfinite(each.get(kind, np.nan)) for each in found)]
    weighed = [
        {
            "name": course.name, "scatter": f"{trend.scatter:.2g}{course.unit}",
            "evidence": [f"{each[kind]:.1f}" if np.isfinite(each.get(kind, np.nan)) else "" for kind in kinds],
        }
        for (course, trend), each in zip(trends, found, strict=True)
    ]  # fmt: skip
    environment = open_templates("vpptwin.drift")
    environment.filters["tie"] = tie_units
    return environment.get_template("history.html.j2").render(
        record=record, sentences=record.sentences, rows=rows, weighed=weighed,
        changes=[CHANGES[kind] for kind in kinds], clear=CLEAR, least=LEAST, origin=origin,
        banded=any(course.band is not None for course in record.courses),
        figures=[draw_course(record, course) for course in record.courses if course.shown],
        warnings=record.warnings, format_digits=format_digits,
    )  # fmt: skip


def draw_course(record: ParameterHistory, course: Course) -> str:
    """A parameter over date or flight number: values with intervals, what is likeliest, the band, the twin's own."""
    place: list[Any] = [f.date if record.dated else i + 1 for i, f in enumerate(record.flights)]
    with open_figure(4.6, 3.2) as figure:
        axes = figure.subplots()
        known = [(i, value) for i, value in enumerate(course.values) if value is not None]
        for i, value in known:
            left = i in course.outside
            colour = BEFORE if left else INK
            axes.errorbar(
                [place[i]], [value.value], SIGMAS_90 * value.std, fmt="o", color=colour, markersize=5.0, capsize=3.0,
                markerfacecolor=colour if left else "none", elinewidth=1.2,
            )  # fmt: skip
        axes.axhline(known[0][1].nominal, color=INK, linewidth=1.0, linestyle=":")
        bottom, top = axes.get_ylim()
        if course.band is not None:
            low, high = np.clip(course.band, bottom, top)
            axes.axhspan(low, high, color=GREEN, alpha=0.15, linewidth=0.0)
            axes.set_ylim(bottom, top)
        if course.trend is not None:
            style = "steps-post" if course.trend.kind == "step" else "default"
            shown = [place[i] for i in course.shown]
            axes.plot(shown, course.trend.fitted, color=AFTER, drawstyle=style)
        if record.dated:
            locator = AutoDateLocator(maxticks=6)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
            if len(place) == 1:
                axes.set_xlim(place[0] - timedelta(days=1), place[0] + timedelta(days=1))
        else:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        unit = course.unit.strip()
        name_axes(axes, "date" if record.dated else "log", f"{course.parameter} [{unit or '1'}]", course.name)
        return write_svg(figure, f"{course.name} over logs")
