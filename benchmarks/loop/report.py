"""What closing the loop was worth: a table and a picture."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loop.steps import POLICIES
from vpptwin.files import write_whole
from vpptwin.viz.figure import follow_reader, open_figure, write_svg
from vpptwin.viz.palette import BLUE, GREY, ORANGE, VERMILION

LOST = 0.5
"""What a lost flight counts as in the score [m], as in the choice of a run's best policy."""
COLOURS = {"nominal": VERMILION, "randomized": ORANGE, "extended": BLUE, "oracle": GREY}


def score(flown: dict[str, Any]) -> float:
    """Mean position error [m], a lost flight counted as `LOST` and none as more."""
    errors = np.minimum(flown["position_error"], LOST)
    return float(np.where(np.array(flown["failed"], dtype=bool), LOST, errors).mean())


def closed_share(rig: dict[str, Any]) -> float:
    """Share of the distance between the nominal policy's score and the oracle's that the extended twin's closes."""
    nominal, extended, oracle = (score(rig["policies"][name]["flown"]) for name in ("nominal", "extended", "oracle"))
    return (nominal - extended) / (nominal - oracle)


def format_table(rigs: Sequence[dict[str, Any]]) -> str:
    """A row for every policy on every setting, medians over seeds; below it what was closed, named and suggested."""
    head = "| hidden | policy trained on | success | lost | upright [mm] | inverted [mm] | score [mm] |"
    lines = [head, "|" + "---|" * 7]
    for setting in dict.fromkeys(rig["setting"] for rig in rigs):
        group = [rig for rig in rigs if rig["setting"] == setting]
        for name, title in POLICIES.items():
            pairs = [rig["policies"][name] for rig in group]
            cells = [
                group[0]["title"] if name == "nominal" else "", title,
                f"{statistics.median(pair['flown']['success_share'] for pair in pairs):.1%}",
                both(pairs, lambda flown: 100.0 * float(np.mean(flown["failed"])), " %"),
                both(pairs, lambda flown: in_mm(flown["upright_error_m"]["mean"])),
                both(pairs, lambda flown: in_mm(flown["inverted_error_m"]["mean"])),
                both(pairs, lambda flown: 1e3 * score(flown)),
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    note = "Score: mean position error, a lost flight counted as 0.5 m. In brackets: what the twin at hand predicts."
    lines += ["", note, ""]
    return "\n".join([*lines, *map(tell, rigs)])


def in_mm(metres: float | None) -> float | None:
    """Millimetres of what is there."""
    return None if metres is None else 1e3 * metres


def both(pairs: Sequence[dict[str, Any]], read: Callable[[dict[str, Any]], float | None], unit: str = "") -> str:
    """Median over seeds of what was flown, and in brackets of what was predicted."""
    shown = []
    for part in ("flown", "predicted"):
        known = [value for value in (read(pair[part]) for pair in pairs) if value is not None]
        shown.append(f"{statistics.median(known):.1f}{unit}" if known else "none left")
    return f"{shown[0]} ({shown[1]})"


def tell(rig: dict[str, Any]) -> str:
    """What became of one rig, in a line."""
    extended, found = rig["policies"]["extended"], rig["diagnosis"]
    flown, guess = score(extended["flown"]), score(extended["predicted"])
    sizes = {
        cause["effect"]: {name: f"{p['value']:.3g} ± {p['std']:.1g}" for name, p in cause["parameters"].items()}
        for cause in found["causes"]
    }
    truth = {effect: {name: f"{v:.3g}" for name, v in values.items()} for effect, values in rig["hidden"].items()}
    return (
        f"- {rig['title']}, seed {rig['seed']}: closes {closed_share(rig):.0%} of the gap; its twin predicts "
        f"{1e3 * guess:.1f} mm, flown {1e3 * flown:.1f} mm ({guess / flown - 1.0:+.0%}). "
        f"Hidden: {list_effects(truth)}. Named: {list_effects(sizes) or 'nothing'}; "
        f"suggested {found['suggested'] or 'no manoeuvre'}."
    )


def list_effects(effects: dict[str, dict[str, str]]) -> str:
    """Effects with their parameters in words."""
    return ", ".join(
        f"`{effect}` {', '.join(f'{name} {value}' for name, value in values.items())}"
        for effect, values in effects.items()
    )


def draw_picture(rigs: Sequence[dict[str, Any]], path: Path) -> Path:
    """Score of the four policies on every setting, a dot for every seed, the twin's prediction as a bar across."""
    settings = list(dict.fromkeys(rig["setting"] for rig in rigs))
    with open_figure(9.0, 3.4) as figure:
        panels = figure.subplots(1, len(settings), sharey=True, squeeze=False)[0]
        for axes, setting in zip(panels, settings):
            group = [rig for rig in rigs if rig["setting"] == setting]
            for x, (name, colour) in enumerate(COLOURS.items()):
                for i, rig in enumerate(group):
                    place = x + 0.22 * (i - 0.5 * (len(group) - 1))
                    flown, guess = (1e3 * score(rig["policies"][name][key]) for key in ("flown", "predicted"))
                    axes.plot(place, flown, "o", color=colour, markersize=6.5)
                    axes.plot([place - 0.09, place + 0.09], [guess, guess], color=colour, linewidth=2.2, alpha=0.75)
            axes.set_xticks(range(len(COLOURS)), ["nominal", "randomized", "extended", "oracle"], rotation=25)
            axes.set_yscale("log")
            axes.set_title(group[0]["title"])
            axes.margins(x=0.12)
        panels[0].set_ylabel("score flown (dot) and\npredicted (bar) [mm]")
        ticks = [5, 10, 20, 50, 100, 200, 500]
        panels[0].set_yticks(ticks, [str(t) for t in ticks])
        panels[0].minorticks_off()
        return write_whole(path, follow_reader(write_svg(figure, "Closing the loop")))
