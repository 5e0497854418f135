"""Training runs as curves: the paper's figure, return over policy steps, with the fixed set's errors beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from yaml import YAMLError

from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml
from vpptwin.viz.plots.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from vpptwin.viz.plots.panels import Line, Panel, Story

Curve = tuple[Sequence[float], Sequence[float]]
"""Policy steps, values."""
SETUPS = {"VA": (VERMILION, ":"), "TA": (ORANGE, "--"), "PI": (GREEN, "-."), "All": (BLUE, "-")}
"""Colour and dash of the paper's setups; others take what is left."""
OTHERS = [
    (BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (ORANGE, ":"), (PURPLE, "--"), (SKY, "-."), (VERMILION, "-"),
    (GREEN, ":"), (ORANGE, "-"), (PURPLE, ":"),
]  # fmt: skip
PANELS = {
    "return": ("return of finished episodes", False),
    "exam_error_m": ("position error, fixed flights [m]", True),
    "exam_failures": ("share of them that failed", False),
}
"""Scalars that are drawn: label, whether on a logarithmic axis."""
MAX_POINTS = 60
"""Of a curve; what lies between is averaged."""
IGNORED_OPTIONS = ("seed", "out", "resume", "progress", "workers", "sim_threads", "torch_threads", "loggers")
"""Options in which runs may differ without being called different."""


def is_run(path: Path) -> bool:
    """Whether this is the folder of a training run."""
    return (path / "log" / "scalars").is_dir()


def read_curve(run: Path, name: str) -> Curve | None:
    """A logged scalar, averaged to at most `MAX_POINTS` points; None where no number was.

    Raises:
        InputError: if its file is not what training writes.
    """
    file = run / "log" / "scalars" / f"{name}.csv"
    if not file.is_file() or not file.stat().st_size:
        return None
    try:
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
        parts = [part for part in np.array_split(rows, min(MAX_POINTS, len(rows))) if np.isfinite(part[:, 1]).any()]
        steps = [round(float(p[:, 0].mean())) for p in parts]
        return (steps, [float(np.nanmean(p[:, 1])) for p in parts]) if parts else None
    except (ValueError, IndexError) as error:
        raise InputError(f"{file}: {error}", "lines of step, value", "name the folder of a training run") from error


def tell_runs(runs: Sequence[Path]) -> Story:
    """Curves of runs; those that differ in nothing but their seed are one line with a band."""
    curves: dict[str, list[dict[str, Curve]]] = {}
    for label, run in zip(name_runs(runs), runs):
        logged = {name: curve for name in PANELS if (curve := read_curve(run, name))}
        if not logged:
            found = f"{run}: no {', '.join(PANELS)} in log/scalars"
            raise InputError(found, "a run that has finished an update", "train on, with loggers=[csv]")
        curves.setdefault(label, []).append(logged)
    return draw_curves(curves, ", ".join(run.name for run in runs) if len(runs) < 4 else f"{len(runs)} runs")


def name_runs(runs: Sequence[Path]) -> list[str]:
    """What to call each run: the options in which it differs from others, else the task."""
    told = [read_options(run) for run in runs]
    # What an older version did not know of is no difference.
    shared = [key for key in told[0] if all(key in options for options in told)]
    differing = [key for key in shared if len({str(options[key]) for options in told}) > 1]
    if differing:
        return [", ".join(f"{key}={options[key]}" for key in differing) for options in told]
    return [str(options.get("task.name", run.name)) for options, run in zip(told, runs)]


def read_options(run: Path) -> dict[str, object]:
    """The options of a run by dotted name, without those that do not count."""
    file = run / "config.yaml"
    try:
        nested = read_yaml(file)
    except (OSError, ValueError, YAMLError) as error:
        found = f"{file} cannot be read ({type(error).__name__})"
        raise InputError(found, "the configuration that training saves", "name the folder of a training run") from error
    flat: dict[str, object] = {}

    def flatten(values: object, prefix: str) -> None:
        if isinstance(values, dict):
            for key, value in values.items():
                flatten(value, f"{prefix}.{key}" if prefix else str(key))
        else:
            flat[prefix] = values

    flatten(nested, "")
    return {key: value for key, value in flat.items() if key not in IGNORED_OPTIONS}


def draw_curves(curves: Mapping[str, Sequence[Mapping[str, Curve]]], title: str) -> Story:
    """One line a label, the median over its runs, and the band from the worst to the best of them."""
    setups = {label: SETUPS[label.removeprefix("setup=")] for label in curves if label.removeprefix("setup=") in SETUPS}
    spare = iter(look for look in OTHERS * 3 if look not in setups.values())
    looks = {label: setups.get(label) or next(spare) for label in curves}
    panels = []
    for name, (axis, log) in PANELS.items():
        lines = []
        for label, runs in curves.items():
            known = [run[name] for run in runs if name in run]
            if not known:
                continue
            length = min(len(curve[0]) for curve in known)
            steps = np.array(known[0][0][:length]) / 1e6
            values = np.array([curve[1][:length] for curve in known])
            band = np.array([values.min(axis=0), values.max(axis=0)]) if len(known) > 1 else None
            lines.append(Line(label, steps, np.median(values, axis=0), *looks[label], band=band))
        if lines:
            panels.append(Panel(axis, lines, log))
    return Story(title, panels, across="policy steps [10⁶]", columns=len(panels))
