"""Training curves: the paper's figure, return over policy steps, with position errors of the fixed set beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vpptwin.viz.figure import name_axes, open_figure, write_svg
from vpptwin.viz.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

LOOKS = {"VA": (VERMILION, ":"), "TA": (ORANGE, "--"), "PI": (GREEN, "-."), "All": (BLUE, "-")}
"""Colour and dash of the paper's setups; others take what is left."""
OTHERS = [(PURPLE, "--"), (SKY, "-."), (VERMILION, "-"), (GREEN, ":"), (ORANGE, ":"), (PURPLE, ":")]
PANELS = {
    "return": ("Return of finished episodes", "return"),
    "exam_error_m": ("Position error, fixed flights", "error [m]"),
}


def draw_curves(results: list[dict], path: Path) -> None:
    """One line a variant, the median over seeds, and the band from the worst to the best seed."""
    variants = list(dict.fromkeys(result["variant"] for result in results))
    spare = iter(OTHERS)
    with open_figure(9.0, 3.6) as figure:
        panels = figure.subplots(1, 2)
        for variant in variants:
            colour, dash = LOOKS[variant] if variant in LOOKS else next(spare)
            for axes, name in zip(panels, PANELS):
                curves = [r["curve"][name] for r in results if r["variant"] == variant]
                length = min(len(curve[0]) for curve in curves)
                steps = np.array(curves[0][0][:length]) / 1e6
                values = np.array([curve[1][:length] for curve in curves])
                axes.plot(steps, np.median(values, axis=0), dash, color=colour, label=variant)
                axes.fill_between(steps, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.12, linewidth=0)
        for axes, (title, label) in zip(panels, PANELS.values()):
            name_axes(axes, "policy steps [10⁶]", label, title)
        panels[1].set_yscale("log")
        panels[0].legend(loc="lower right")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(write_svg(figure, "Training curves") + "\n")
