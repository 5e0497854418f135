"""What closing the loop was worth: a table and a picture."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loop.steps import POLICIES
from vpptwin.system.files import write_whole
from vpptwin.viz.plots.figure import follow_reader, open_figure, write_svg
from vpptwin.viz.plots.palette import BLUE, GREY, ORANGE, PURPLE, VERMILION

LOST = 0.5
"""What a lost flight counts as in the score [m], as in the choice of a run's best policy."""
CLOSE = 0.2
"""A predicted error is right within this share of the flown one."""
COLOURS = {"nominal": VERMILION, "adaptive": PURPLE, "randomized": ORANGE, "extended": BLUE, "oracle": GREY}


def score(flown: dict[str, Any]) -> float:
    """Mean position error [m], a lost flight counted as `LOST` and none as more."""
    errors = np.minimum(flown["position_error"], LOST)
    return float(np.where(np.array(flown["failed"], dtype=bool), LOST, errors).mean())


def error(flown: dict[str, Any]) -> float:
    """Mean position error of the flights that were not lost [m]; NaN if all were."""
    errors = [min(e, LOST) for e, lost in zip(flown["position_error"], flown["failed"], strict=True) if not lost]
    return float(np.mean(errors)) if errors else float("nan")


def closed_share(rigs: Sequence[dict[str, Any]]) -> float:
    """Share of the way from the mean score of nominal policies to the oracles' that the extended ones close, or NaN."""
    nominal, extended, oracle = (mean_score(rigs, name) for name in ("nominal", "extended", "oracle"))
    return (nominal - extended) / (nominal - oracle) if nominal != oracle else float("nan")


def tell_gain(rigs: Sequence[dict[str, Any]]) -> str:
    """What the extended twins' policies gain: a share of what oracles do, or the scores where none was trained."""
    if all("oracle" in rig["policies"] for rig in rigs):
        return f"closes {closed_share(rigs):.0%} of the gap"
    return "brings {:.1f} mm down to {:.1f}".format(*(1e3 * mean_score(rigs, n) for n in ("nominal", "extended")))


def mean_score(rigs: Sequence[dict[str, Any]], name: str) -> float:
    """Mean score of one of the policies over rigs [m]."""
    return statistics.fmean(score(rig["policies"][name]["flown"]) for rig in rigs)


def misjudged(rig: dict[str, Any], name: str = "extended") -> float:
    """By what share the twin at hand predicts a larger error of the flights that are not lost than was flown."""
    pair = rig["policies"][name]
    return error(pair["predicted"]) / error(pair["flown"]) - 1.0


def format_table(rigs: Sequence[dict[str, Any]]) -> str:
    """A row for every policy on every setting, medians over seeds; below it what was closed, named and suggested."""
    head = "| hidden | policy trained on | success | lost | upright [mm] | inverted [mm] | score [mm] |"
    lines = [head, "|" + "---|" * 7]
    for setting in dict.fromkeys(rig["setting"] for rig in rigs):
        group = [rig for rig in rigs if rig["setting"] == setting]
        for name, title in list_flown(group).items():
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
    return "\n".join([*lines, *map(tell, rigs), sum_up(rigs)])


def list_flown(rigs: Sequence[dict[str, Any]]) -> dict[str, str]:
    """What was flown on all these rigs, in words, by name: earlier results have no adaptive controller."""
    return {name: title for name, title in POLICIES.items() if all(name in rig["policies"] for rig in rigs)}


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
    flown, guess = (1e3 * error(extended[part]) for part in ("flown", "predicted"))
    lost, lost_guess = (sum(extended[part]["failed"]) for part in ("flown", "predicted"))
    sizes = {
        cause["effect"]: {name: f"{p['value']:.3g} ± {p['std']:.1g}" for name, p in cause["parameters"].items()}
        for cause in found["causes"]
    }
    truth = {effect: {name: f"{v:.3g}" for name, v in values.items()} for effect, values in rig["hidden"].items()}
    return (
        f"- {rig['title']}, seed {rig['seed']}: {tell_gain([rig])}; its twin predicts "
        f"{guess:.1f} mm where flights are not lost, flown {flown:.1f} mm ({misjudged(rig):+.0%}), "
        f"and {lost_guess} lost, flown {lost}. "
        f"Hidden: {list_effects(truth)}. Named: {list_effects(sizes) or 'nothing'}; "
        f"suggested {found['suggested'] or 'no manoeuvre'}."
    )


def sum_up(rigs: Sequence[dict[str, Any]]) -> str:
    """All rigs in a line: what was closed, and how well the extended twin and the nominal one predict errors."""
    scores = {name: 1e3 * mean_score(rigs, name) for name in list_flown(rigs)}
    off = {name: [abs(misjudged(rig, name)) for rig in rigs] for name in ("nominal", "extended")}
    within = {name: sum(share <= CLOSE for share in shares) for name, shares in off.items()}
    return (
        f"- all {len(rigs)}: mean score {', '.join(f'{name} {value:.1f} mm' for name, value in scores.items())}; "
        f"{tell_gain(rigs)}. The extended twin predicts the error within {CLOSE:.0%} on "
        f"{within['extended']} of {len(rigs)} (median {statistics.median(off['extended']):.0%} off), "
        f"the nominal one on {within['nominal']} ({statistics.median(off['nominal']):.0%})."
    )


def list_effects(effects: dict[str, dict[str, str]]) -> str:
    """Effects with their parameters in words."""
    return ", ".join(
        f"`{effect}` {', '.join(f'{name} {value}' for name, value in values.items())}"
        for effect, values in effects.items()
    )


def draw_picture(rigs: Sequence[dict[str, Any]], path: Path) -> Path:
    """Score of the policies on every setting, a dot for every seed, the twin's prediction as a bar across."""
    settings, flown = list(dict.fromkeys(rig["setting"] for rig in rigs)), list(list_flown(rigs))
    with open_figure(9.0, 3.4) as figure:
        panels = figure.subplots(1, len(settings), sharey=True, squeeze=False)[0]
        for axes, setting in zip(panels, settings):
            group = [rig for rig in rigs if rig["setting"] == setting]
            for x, name in enumerate(flown):
                for i, rig in enumerate(group):
                    place = x + 0.22 * (i - 0.5 * (len(group) - 1))
                    scored, guess = (1e3 * score(rig["policies"][name][key]) for key in ("flown", "predicted"))
                    axes.plot(place, scored, "o", color=COLOURS[name], markersize=6.5)
                    axes.plot(
                        [place - 0.09, place + 0.09], [guess, guess], color=COLOURS[name], linewidth=2.2, alpha=0.75
                    )
            axes.set_xticks(range(len(flown)), flown, rotation=25)
            axes.set_yscale("log")
            axes.set_title(group[0]["title"])
            axes.margins(x=0.12)
        panels[0].set_ylabel("score flown (dot) and\npredicted (bar) [mm]")
        ticks = [5, 10, 20, 50, 100, 200, 500]
        panels[0].set_yticks(ticks, [str(t) for t in ticks])
        panels[0].minorticks_off()
        return write_whole(path, follow_reader(write_svg(figure, "Closing the loop")))
