"""Pictures of a campaign: confusion by family, detection against strength, what confidences are worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from proving.runner.case import Case
from proving.runner.rates import Rate, confidence_bins, count, leaves_something

FAMILIES = {
    "horizontal rail": ("rail_x", "rail.tilt", "carriage"),
    "vertical guide": ("rail_z",),
    "pivot": ("pitch",),
    "craft and air": ("airframe", "air."),
    "rotors": ("rotor", "battery"),
    "servo and timing": ("servo", "command"),
    "sensors and clocks": ("mocap", "clock", "gyro"),
}
UNEXPLAINED, NOTHING = "unexplained", "nothing"
EDGES = (0.4, 0.55, 0.75, 1.0, 1.5, 2.25, 3.5, 6.0)
"""Of bins of strength."""
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#999999"


def family(effect: str) -> str:
    """The family of an effect."""
    return next(name for name, starts in FAMILIES.items() if effect.startswith(starts))


def confuse(cases: Sequence[Case]) -> tuple[list[str], np.ndarray]:
    """Labels, and how often the first named cause is of which family: truths down, verdicts across.

    Sessions with one effect of the catalogue, one outside it or none.
    """
    labels = [*FAMILIES, UNEXPLAINED, NOTHING]
    table = np.zeros((len(labels), len(labels)), dtype=int)
    for case in cases:
        if case.plan.kind in ("single", "alien", "none") and case.found:
            known = next(iter(case.plan.known), None)
            truth = family(known) if known else {"alien": UNEXPLAINED, "none": NOTHING}[case.plan.kind]
            left = UNEXPLAINED if leaves_something(case) else NOTHING
            said = family(case.first) if case.first else left
            table[labels.index(truth), labels.index(said)] += 1
    return labels, table


def draw_confusion(cases: Sequence[Case], path: Path) -> None:
    """The confusion matrix."""
    labels, table = confuse(cases)
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    figure, axes = plt.subplots(figsize=(7.2, 6.2), layout="constrained")
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    for (row, column), number in np.ndenumerate(table):
        if number:
            colour = "white" if share[row, column] > 0.5 else "black"
            axes.text(column, row, str(number), ha="center", va="center", color=colour)
    axes.set_xticks(range(len(labels)), labels, rotation=40, ha="right")
    axes.set_yticks(range(len(labels)), [*labels[:-2], "outside the catalogue", "nothing"])
    axes.set(xlabel="named first", ylabel="hidden", title=f"{table.sum()} sessions with one effect or none")
    save(figure, path)


def bin_by_strength(cases: Sequence[Case]) -> list[tuple[float, Rate, Rate]]:
    """Middle of each bin of strength that has sessions, with how often the truth is named first, and in a group."""
    single = [c for c in cases if c.plan.kind == "single"]
    bins = []
    for low, high in pairwise(EDGES):
        inside = [c for c in single if low <= c.plan.strength < high]
        if inside:
            rates = count("", (c.all_named for c in inside)), count("", (c.all_suspected for c in inside))
            bins.append((math.sqrt(low * high), *rates))
    return bins


def draw_detection(cases: Sequence[Case], path: Path) -> None:
    """Detection against strength, and hits against confidence."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    bins = bin_by_strength(cases)
    for index, (label, colour) in enumerate((("named first", BLUE), ("named or in the group", ORANGE))):
        draw_rates(left, [(x * (1.0 + 0.03 * index), r[index]) for x, *r in bins], label, colour)
    left.set(xscale="log", xlabel="strength (1: the faintest that the tests hide)", ylabel="share of sessions")
    left.set_xticks([0.5, 1, 2, 4], ["0.5", "1", "2", "4"])
    left.set_xticks([], minor=True)
    draw_rates(right, confidence_bins(cases), "causes", BLUE)
    right.plot([0, 1], [0, 1], color=GREY, linewidth=0.8, label="as it should be")
    right.set(xlabel="confidence", ylabel="share that is true", xlim=(0, 1.03))
    for axes in (left, right):
        axes.set_ylim(0, 1.03)
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right")
    save(figure, path)


def draw_rates(axes: plt.Axes, points: Sequence[tuple[float, Rate]], label: str, colour: str) -> None:
    """Rates with their 95 % intervals."""
    x, y = [p for p, _ in points], [rate.share for _, rate in points]
    down = [max(rate.share - rate.interval[0], 0.0) for _, rate in points]  # rounding may lead below 0
    up = [max(rate.interval[1] - rate.share, 0.0) for _, rate in points]
    axes.errorbar(x, y, yerr=[down, up], marker="o", capsize=2, color=colour, label=label)


def save(figure: plt.Figure, path: Path) -> None:
    """Write a picture, the same bytes for the same data."""
    with plt.rc_context({"svg.hashsalt": "vpptwin"}):
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    plt.close(figure)


def draw_pictures(cases: Sequence[Case], folder: Path) -> list[Path]:
    """Draw all into a folder; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "hidden_confusion.svg", folder / "hidden_detection.svg"]
    draw_confusion(cases, paths[0])
    draw_detection(cases, paths[1])
    return paths
