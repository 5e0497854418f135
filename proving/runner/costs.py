"""Where the time of a diagnosis goes, from the profile of one."""

from __future__ import annotations

import cProfile
import pstats
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import vpptwin
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.logs.flight import Flight
from vpptwin.twin import TwinSpec

PACKAGE = Path(vpptwin.__file__).parent
ENGINE, SENSORS = "engine: the twin through the windows", "what the sensors would have seen"
FITS, JUDGING = "linear algebra of the fits", "judging: held-out flights, leftover, power"
STAGES = {
    "logs": "reading logs",
    "estimation": "measurements, starting states, windows",
    **dict.fromkeys(("twin", "engine", "effects", "actuators"), ENGINE),
    "robots/planar_drone/effects": ENGINE,
    "robots": "measurements, starting states, windows",
    "diagnosis/evidence": SENSORS,
    "diagnosis/search": FITS,
    "diagnosis/judgement": JUDGING,
}
REST = "everything else"
Function = tuple[str, int, str]


def stage_of(file: str) -> str:
    """The stage that a file of ours belongs to, "" for other people's."""
    path = Path(file)
    if not path.is_relative_to(PACKAGE):
        return ""
    name = path.relative_to(PACKAGE).as_posix()
    return next((stage for folder, stage in STAGES.items() if name.startswith(f"{folder}/")), REST)


def share_out(stats: dict[Function, tuple[int, int, float, float, dict]]) -> dict[str, float]:
    """Seconds of each stage: functions of ours count where they are, those they call where they were called from.

    Args:
        stats: `pstats.Stats.stats`: function → calls, primitive calls, own time, time with calls, callers.
    """
    known: dict[Function, dict[str, float]] = {}

    def weights(function: Function, depth: int = 0) -> dict[str, float]:
        """Shares of a function's own time by stage."""
        if stage := stage_of(function[0]):
            return {stage: 1.0}
        if function in known:
            return known[function]
        callers = stats[function][4] if function in stats else {}
        total = sum(own for _, _, own, _ in callers.values())
        if depth > 30 or total <= 0.0:
            return {REST: 1.0}
        known[function] = {REST: 1.0}  # for functions that call one another
        mixed: dict[str, float] = defaultdict(float)
        for caller, (_, _, own, _) in callers.items():
            for stage, weight in weights(caller, depth + 1).items():
                mixed[stage] += weight * own / total
        known[function] = dict(mixed)
        return known[function]

    seconds: dict[str, float] = defaultdict(float)
    for function, (_, _, own, _, _) in stats.items():
        for stage, weight in weights(function).items():
            seconds[stage] += weight * own
    return dict(seconds)


def profile_diagnosis(spec: TwinSpec, flights: Sequence[Flight]) -> dict[str, float]:
    """Seconds by stage of one diagnosis, compiled code warm; profiling itself makes Python's part dearer."""
    profile = cProfile.Profile()
    profile.enable()
    diagnose(spec, flights)
    profile.disable()
    stats: Any = pstats.Stats(profile)
    return share_out(stats.stats)


def format_costs(seconds: dict[str, float]) -> str:
    """Stages by cost as a Markdown table."""
    total = sum(seconds.values())
    lines = ["| stage | s | share |", "|---|---:|---:|"]
    ranked = sorted(seconds.items(), key=lambda item: -item[1])
    lines += [f"| {stage} | {own:.1f} | {100 * own / total:.0f} % |" for stage, own in ranked]
    return "\n".join([*lines, f"| all | {total:.1f} | 100 % |"])
