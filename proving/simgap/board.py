"""The board: scores of all entrants on a set, as JSON, Markdown and pictures. Every figure comes from one command."""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from proving.simgap.answers import read_answer
from proving.simgap.entrants import ENTRANTS
from proving.simgap.results import MEASURES, compare, score_answer, summarise
from proving.simgap.run import list_entrants
from proving.simgap.scores import complete_answer
from proving.simgap.session import Session, Truth
from proving.simgap.sets import check_set, hash_set, list_sessions, read_manifest
from proving.simgap.storage import read_session, read_truth

HOME, CLOSE = "vpptwin", 0.10
"""Whose shortcomings go to the top of the page, and the share by which the best in `predict` may be better."""
NAMING = ("log", "brier", "log_group", "brier_group", "first", "confident", "alarm")
SIZING = ("sizes", "held", "energy", "onset", "failed", "seconds", "memory_mb")
BINS = np.array([0.0, 0.05, 0.15, 0.3, 0.5, 0.7, 0.9, 1.0])
"""Of stated probabilities, in the reliability curve."""

Scores = dict[str, dict[str, dict[str, float]]]
"""Entrant → session → measure → value."""


def read_set(folder: Path) -> list[tuple[Session, Truth]]:
    """All sessions of a set with their truths, checked against the hashes."""
    check_set(folder)
    return [(read_session(home), read_truth(folder, home)) for home in list_sessions(folder)]


def read_answers(
    folder: Path, entrant: str, sessions: Sequence[tuple[Session, Truth]]
) -> dict[str, dict[str, Any] | None]:
    """An entrant's answers by session; None where there is no valid one."""
    found: dict[str, dict[str, Any] | None] = {}
    for session, _ in sessions:
        try:
            found[session.name] = read_answer(folder / "answers" / entrant / f"{session.name}.json", session)
        except ValueError:
            found[session.name] = None
    return found


def tune_entrants(folder: Path) -> dict[str, float]:
    """Tune every entrant that gives evidence, write settings.json; the mean log score of each."""
    from proving.simgap.entrants.settle import FILE, tune

    sessions = [(s, t) for s, t in read_set(folder) if "name" in s.tracks]
    settings = json.loads(FILE.read_text()) if FILE.exists() else {}
    found = {}
    for entrant in list_entrants(folder):
        answers = read_answers(folder, entrant, sessions)
        given = [
            (a["evidence"], list(s.causes), t.answer)
            for s, t in sessions
            if (a := answers[s.name]) and "evidence" in a and s.many == 1
        ]
        if given:
            best, found[entrant] = tune(given)
            settings[entrant] = {
                "settings": asdict(best),
                "sessions": len(given),
                "set": hash_set(read_manifest(folder)),
            }
    FILE.write_text(json.dumps(settings, indent=1) + "\n")
    return found


def write_board(folder: Path, out: Path) -> list[Path]:
    """Score all answers of a set and write `board.json`, `board.md`, and two pictures."""
    sessions = read_set(folder)
    answers = {entrant: read_answers(folder, entrant, sessions) for entrant in list_entrants(folder)}
    if not answers:
        raise ValueError(f"{folder} has no answers: run `simgap run {folder}` first")
    scores: Scores = {
        entrant: {s.name: score_answer(given[s.name], s, t) for s, t in sessions} for entrant, given in answers.items()
    }
    manifest = read_manifest(folder)

    def split(key: Callable[[Session, Truth], str]) -> dict[str, dict[str, Any]]:
        """Summaries of parts of the sessions."""
        parts = {
            part: [s.name for s, t in sessions if key(s, t) == part]
            for part in sorted({key(s, t) for s, t in sessions})
        }
        return {
            part: {who: summarise([of[n] for n in names]) for who, of in scores.items()}
            for part, names in parts.items()
        }

    content = {
        "simgap": manifest["simgap"], "set_sha256": hash_set(manifest), "seed": manifest["seed"],
        "seed_sha256": manifest["seed_sha256"], "sessions": len(sessions), **describe(),
        "entrants": {name: describe_entrant(name) for name in scores},
        "all": {name: summarise(list(of.values())) for name, of in scores.items()},
        "worlds": split(lambda s, _: s.world), "difficulty": split(lambda _, t: t.difficulty),
        "reliability": {name: find_reliability(given, sessions) for name, given in answers.items()},
    }  # fmt: skip
    content["against"], content["lead"] = find_faults(scores, sessions), tell_lead(scores)
    out.mkdir(parents=True, exist_ok=True)
    (out / "board.json").write_text(json.dumps(content | {"scores": scores}, indent=1) + "\n")
    (out / "board.md").write_text(format_board(content))
    return [out / "board.json", out / "board.md", *draw_pictures(content, out)]


def describe() -> dict[str, str]:
    """Commit and machine."""
    told = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "commit": told.stdout.strip() or "unknown",
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
    }


def describe_entrant(name: str) -> dict[str, str]:
    """Title, limits and version of an entrant."""
    if name not in ENTRANTS:
        return {"title": name, "limits": "", "version": ""}
    entrant = ENTRANTS[name]
    try:
        told = f"{entrant.needs} {version(entrant.needs)}" if entrant.needs else ""
    except PackageNotFoundError:
        told = entrant.needs
    return {"title": entrant.title, "limits": entrant.limits, "version": told}


def find_reliability(
    answers: Mapping[str, Mapping[str, Any] | None], sessions: Sequence[tuple[Session, Truth]]
) -> list[tuple[float, float, int]]:
    """Of all probabilities said, by bins: mean, share that was true, and how many."""
    said: list[tuple[float, bool]] = []
    for session, truth in sessions:
        given = answers[session.name]
        if given and given.get("probabilities"):
            told = complete_answer(given["probabilities"], list(session.causes))
            said += [(min(1.0, session.many * p), name in truth.present) for name, p in told.items()]
    if not said:
        return []
    values, right = (np.array(column, float) for column in zip(*said))
    rows = np.clip(np.digitize(values, BINS) - 1, 0, len(BINS) - 2)
    bins = [rows == b for b in range(len(BINS) - 1) if (rows == b).any()]
    return [(round(float(values[b].mean()), 4), round(float(right[b].mean()), 4), int(b.sum())) for b in bins]


def tell_lead(scores: Scores) -> str:
    """The log score of `HOME` beside that of the best rival, over all sessions with that track."""
    each = {who: [one["log"] for one in of.values() if "log" in one] for who, of in scores.items()}
    ours = each.pop(HOME, [])
    if not ours or not each:
        return ""
    best = min(each, key=lambda who: np.mean(each[who]))
    gap, low, high = compare(ours, each[best])
    return (
        f"Over {len(ours)} sessions {HOME} has a log score of {np.mean(ours):.3g}, the best rival, {best}, "
        f"{np.mean(each[best]):.3g} (difference {gap:+.3g}, {low:+.3g} to {high:+.3g})."
    )


def find_faults(scores: Scores, sessions: Sequence[tuple[Session, Truth]]) -> list[str]:
    """Where `HOME` is not first in `name` and `watch` by more than the bootstrap error, or off by `CLOSE` in `predict`.

    Each is a comparison with the best rival of that world.
    """
    found = []
    for world in sorted({s.world for s, _ in sessions}) if HOME in scores else []:
        names = [s.name for s, _ in sessions if s.world == world]
        for measure, track in (("log", "name"), ("energy", "predict"), ("onset", "watch")):
            each = {who: [of[n][measure] for n in names if measure in of[n]] for who, of in scores.items()}
            ours = each.pop(HOME)
            if not ours or not each:
                continue
            best = min(each, key=lambda who: np.mean(each[who]))
            gap, low, high = compare(ours, each[best])
            theirs = float(np.mean(each[best]))
            if np.mean(ours) > (1.0 + CLOSE) * theirs if track == "predict" else high >= 0.0:
                found.append(
                    f"{world}, {track}: {MEASURES[measure].title} {np.mean(ours):.3g}, {best} {theirs:.3g} "
                    f"(difference {gap:+.2g}, {low:+.2g} to {high:+.2g})"
                )
    return found


def format_cell(values: Mapping[str, Sequence[float]], name: str) -> str:
    """A value with its interval."""
    if name not in values:
        return "–"
    value, low, high = values[name]
    if name in ("seconds", "memory_mb"):
        return f"{value:.3g}"
    return f"{value:.3g} ({low:.2g}–{high:.2g})"


def format_table(
    rows: Mapping[str, Mapping[str, Sequence[float]]], names: Sequence[str], titles: Mapping[str, str]
) -> list[str]:
    """Entrants × measures, the best in bold."""
    names = [name for name in names if any(name in row for row in rows.values())]
    best = {}
    for name in names:
        sign = 1.0 if MEASURES[name].less else -1.0
        best[name] = min(sign * row[name][0] for row in rows.values() if name in row) * sign
    lines = ["| entrant | " + " | ".join(MEASURES[n].title for n in names) + " |", "|---|" + "---|" * len(names)]
    for entrant, row in rows.items():
        cells = [format_cell(row, n) for n in names]
        cells = [f"**{c}**" if n in row and row[n][0] == best[n] else c for n, c in zip(names, cells)]
        lines.append(f"| {titles[entrant]} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def format_board(content: Mapping[str, Any]) -> str:
    """The page."""
    titles = {name: told["title"] for name, told in content["entrants"].items()}
    secret = "a secret seed" if content["seed_sha256"] else "measured data"
    seed = f"seed {content['seed']} (public)" if content["seed"] is not None else secret
    lines = [
        "# SimGap board", "",
        f"{content['sessions']} sessions of {seed}, set {content['set_sha256'][:12]}, commit {content['commit']}, "
        f"{content['machine']}. Written by `simgap board`. Brackets: 95 % bootstrap intervals over sessions.", "",
    ]  # fmt: skip
    if content["lead"]:
        lines += [content["lead"], ""]
    if content["against"]:
        lines += [
            "## Where vpptwin is not first", "",
            "In `name` and `watch` it is not ahead of the best rival by more than the bootstrap error; in `predict` the"
            " best rival is more than 10 % better.", "", *(f"- {fault}" for fault in content["against"]), "",
        ]  # fmt: skip
    lines += ["## Causes", "", *format_table(content["all"], NAMING, titles)]
    lines += ["## Sizes, forecasts, onset, cost", "", *format_table(content["all"], SIZING, titles)]
    for part, title in (("worlds", "By world"), ("difficulty", "By difficulty")):
        lines += [f"## {title}", ""]
        for name, rows in content[part].items():
            shown = ("log", "log_group", "first", "confident", "energy", "onset")
            lines += [f"**{name}**", "", *format_table(rows, shown, titles)]
    lines += ["![Share that was true against stated probability](reliability.png)", "",
              "![Log score against time](cost.png)", "", "## Entrants", "",
              "| entrant | version | limits |", "|---|---|---|",
              *(f"| {t['title']} | {t['version']} | {t['limits']} |" for t in content["entrants"].values()),
              ""]  # fmt: skip
    return "\n".join(lines)


def draw_pictures(content: Mapping[str, Any], out: Path) -> list[Path]:
    """Reliability curves, and time against log score."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullLocator

    marks, titles = "osv^D<>PX*", {name: told["title"] for name, told in content["entrants"].items()}
    figure, axes = pyplot.subplots(figsize=(6.0, 6.2))
    axes.plot([0, 1], [0, 1], color="0.7", zorder=0)
    for (name, curve), mark in zip(content["reliability"].items(), marks):
        if curve and name not in ("nothing", "everything"):
            said, right, _ = zip(*curve)
            axes.plot(said, right, marker=mark, label=titles[name], linewidth=2.5 if name == HOME else 1.0)
    axes.set(xlabel="stated probability", ylabel="share that was true", xlim=(0, 1), ylim=(0, 1))
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncol": 2, "fontsize": 7, "frameon": False}
    axes.legend(**below)
    figure.tight_layout()
    figure.savefig(out / "reliability.png", dpi=120)
    figure, axes = pyplot.subplots(figsize=(6.0, 5.2))
    for (name, row), mark in zip(content["all"].items(), marks):
        if "seconds" in row and "log" in row:
            value, low, high = row["log"]
            axes.errorbar(
                row["seconds"][0],
                value,
                [[value - low], [high - value]],
                marker=mark,
                label=titles[name],
            )
    axes.set(xscale="log", xlabel="time of a session [s]", ylabel="log score [nats], less is better")
    axes.set_xticks(ticks := [1, 2, 5, 10, 20, 50, 100, 200, 500], [str(t) for t in ticks], minor=False)
    axes.xaxis.set_minor_locator(NullLocator())
    times = [row["seconds"][0] for row in content["all"].values() if "seconds" in row]
    axes.set_xlim(0.7 * min(times, default=1.0), 1.4 * max(times, default=10.0))
    axes.legend(**below)
    figure.tight_layout()
    figure.savefig(out / "cost.png", dpi=120)
    pyplot.close("all")
    return [out / "reliability.png", out / "cost.png"]
