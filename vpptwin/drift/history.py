"""`vpptwin history`: named parameters log by log, what changes and from when on, and what left its band."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.drift.course import Band, Course, FittedFlight, ParameterHistory
from vpptwin.drift.free_flight import FlightFit, fit_flights, parse_parameters
from vpptwin.drift.page import render_history
from vpptwin.drift.trend import judge_trend
from vpptwin.effects import find_effect
from vpptwin.logs.flight import Flight
from vpptwin.report.output import Pieces, give_json, stage_results
from vpptwin.report.provenance import Provenance, trace_origin
from vpptwin.report.sources import Log, list_logs, open_flights, open_twin
from vpptwin.system.doubt import is_as_is, take_as_is
from vpptwin.system.errors import InputError, suggest
from vpptwin.system.files import STDOUT, write_json, write_whole
from vpptwin.system.jobs import Jobs, share_out
from vpptwin.system.progress import open_bar
from vpptwin.system.terminal import open_console, print_dropped, print_warnings
from vpptwin.twin.spec import EffectValues, TwinSpec, load_twin, locate_twin

PAGE, DATA = "history.html", "history.json"
LEFT_BAND = 3
"""Exit code where something left its band."""
EARLIEST = 946_684_800 * 10**9
"""Stamps [ns] before the year 2000 are of a clock that knows no date."""


@dataclass(frozen=True, repr=False)
class History(ParameterHistory):
    """Named parameters log by log. Printed it is a sentence for each, in a notebook the page."""

    _origin: Provenance = field(repr=False)

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """The page, in a frame of its own."""
        page = html.escape(self.render([]))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 40em; border: 0"></iframe>'

    def render(self, more: Sequence[str]) -> str:
        """The page; `more` are further options of the command that writes it."""
        return render_history(self, self._origin.add(more))

    def save(self, folder: str | PathLike[str], force: bool = False) -> None:
        """Write history.html and history.json, as `vpptwin history --out` does.

        Args:
            folder: made if need be.
            force: overwrite files of these names that vpptwin did not write, too.

        Raises:
            InputError: if the folder cannot be written to, or holds such a file.
        """
        with stage_results(Path(folder), [PAGE, DATA], [PAGE], force) as drafts:
            self.write(drafts, Path(folder))

    def write(self, folder: Path, out: Path) -> list[str]:
        """Write both files into `folder`, to lie in `out` in the end; returns why the page could not be made, if so."""
        pieces = Pieces()
        write_json(self.as_dict(), folder / DATA)
        if page := pieces.attempt(PAGE, partial(self.render, ["--out", str(out)]), ""):
            write_whole(folder / PAGE, page)
        return pieces.lost


@dataclass(frozen=True)
class FitTask:
    """A log to fit: the twin by its files, so that another process can load it."""

    flight: Flight
    twin: str
    effect_files: tuple[Path, ...]
    effects: EffectValues
    controller: str
    causes: tuple[str, ...]
    as_is: bool


def fit_flight(task: FitTask) -> FlightFit:
    """Fit one log by itself."""
    spec = load_twin(task.twin, task.effect_files).with_effects(task.effects)
    if spec.controller != task.controller:
        spec = spec.with_controller(task.controller)
    with take_as_is(task.as_is):
        return fit_flights(spec, [task.flight], task.causes)


def history(
    logs: Log | Sequence[Log], twin: str | PathLike[str] | TwinSpec, parameters: str | None = None,
    bands: Mapping[str, Band] | None = None, jobs: Jobs = 1, topic_map: str | PathLike[str] | None = None,
    effects: Sequence[str | PathLike[str]] = (), progress: bool = True, as_is: bool = False,
) -> History:  # fmt: skip
    """Fit the named causes to every log by itself, and report what changes, as `vpptwin history` does.

    Args:
        logs: each a recording; their stamps give the date.
        twin: `nominal`, `typical`, a twin YAML, or what `load_twin` read.
        parameters: effect ids, separated by commas; by default those that a diagnosis or identification found, as the
            twin's provenance says, or else all that are switched on in it.
        bands: "EFFECT.PARAMETER" → lowest and highest value that it should have, in its unit.
        jobs: processes that share the logs, or `ray` for the Ray that RAY_ADDRESS names.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own, which are run; not for a twin that was read already.
        progress: whether a bar is shown on standard error.
        as_is: take columns as they are that look as if they were in another unit, sign or order.

    Raises:
        InputError: on bad logs, a bad twin, unknown effects, or a band of what is not fitted.
    """
    spec = open_twin(twin, effects)
    causes = choose_causes(spec, parameters)
    checked = check_bands(spec, causes, bands or {})
    flights = open_flights(logs, topic_map, spec.robot.signals.entries)
    starts = [flight.start_ns for flight in flights]
    dated = min(starts) >= EARLIEST and len(set(starts)) == len(starts)
    if dated:
        flights.sort(key=lambda flight: flight.start_ns)
    options = ["--parameters", parameters] if parameters is not None else []
    options += [part for name, (low, high) in checked.items() for part in ("--band", f"{name}={low:g}:{high:g}")]
    options += ["--topic-map", str(topic_map)] if topic_map is not None else []
    options += ["--as-is"] * (as_is or is_as_is())
    options += [part for file in effects for part in ("--effects", str(file))]
    read = [flight.path for flight in flights]
    origin = trace_origin(["history", *map(str, read), "--twin", spec.name, *options], spec.name, read)
    shared = (locate_twin(spec.name), tuple(file.resolve() for file in spec.effect_files), spec.effects)
    tasks = [FitTask(flight, *shared, spec.controller, tuple(causes), as_is or is_as_is()) for flight in flights]
    fits: dict[int, FlightFit] = {}
    with open_bar(desc="history", disable=not progress, total=len(tasks), unit=" logs", unit_scale=False) as bar:
        for number, fit in share_out(fit_flight, tasks, jobs):
            fits[number] = fit
            bar.update()
    if progress:
        print_dropped({flight.name: flight.dropped for flight in flights})
    found = [FittedFlight(str(flight.path), flight.start_ns, fits[i]) for i, flight in enumerate(flights)]
    told = History(spec.name, dated, found, [], origin)
    for effect in (find_effect(spec.catalogue, cause) for cause in causes):
        for name in (p.name for p in effect.parameters):
            band = checked.get(f"{effect.id}.{name}")
            told.courses.append(follow(told, (effect.id, name), effect.summary, band))
    return told


def follow(record: ParameterHistory, key: Key, meaning: str, band: Band | None) -> Course:
    """One parameter over the logs of a history."""
    values = [flight.fit.values.get(key) for flight in record.flights]
    known = {i: value for i, value in enumerate(values) if value is not None}
    shown, trend = list(known), None
    if len(shown) > 1:
        std = np.array([max(value.std, 1e-12) for value in known.values()])
        trend = judge_trend(record.time[shown], np.array([value.value for value in known.values()]), std)
    return Course(*key, meaning, values, trend, shown, band)


def choose_causes(spec: TwinSpec, parameters: str | None) -> list[str]:
    """Ids of the effects to follow.

    Raises:
        InputError: if there are none, or one is unknown.
    """
    if parameters is not None:
        return parse_parameters(spec, parameters)
    found = {name.rpartition(".")[0] for name in spec.intervals}
    shown = [effect for effect in spec.effects if not find_effect(spec.catalogue, effect).touching]
    causes = [effect for effect in shown if effect in found] or shown
    if not causes:
        expected = "a twin with effects switched on, as `vpptwin diagnose` writes it"
        raise InputError(f"twin {spec.name} has no effects to follow", expected, "name some: --parameters IDS")
    return causes


def check_bands(spec: TwinSpec, causes: Sequence[str], bands: Mapping[str, Band]) -> dict[str, Band]:
    """Bands as numbers.

    Raises:
        InputError: on one of a parameter that is not followed, or one that nothing can be in.
    """
    known = [f"{cause}.{p.name}" for cause in causes for p in find_effect(spec.catalogue, cause).parameters]
    for name, (low, high) in bands.items():
        if name not in known:
            advice = suggest(name, known, "name it in --parameters, or leave it out")
            raise InputError(f"a band of {name}", f"one of {', '.join(known)}", advice)
        if not low <= high:
            raise InputError(f"a band of {name} from {low:g} to {high:g}", "LOW below HIGH", "swap or correct them")
    return {name: (float(low), float(high)) for name, (low, high) in bands.items()}


def parse_bands(given: Sequence[str]) -> dict[str, Band]:
    """Bands from `EFFECT.PARAMETER=LOW:HIGH`, of which LOW or HIGH may be left out."""
    bands = {}
    for text in given:
        name, _, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        try:
            bands[name] = float(low or "-inf"), float(high or "inf")
        except ValueError:
            colon = ""
        if not (name and colon) or any(math.isnan(end) for end in bands[name]):
            expected = "EFFECT.PARAMETER=LOW:HIGH, LOW or HIGH may be left out"
            raise InputError(f"--band {text}", expected, "e.g. --band rail_x.coulomb.force=0:0.4")
    return bands


def follow_logs(
    logs: Sequence[Path], twin: str, out: Path, parameters: str | None = None, bands: Sequence[str] = (),
    jobs: Jobs = 1, topic_map: Path | None = None, json: Path | None = None, effects: Sequence[Path] = (),
    force: bool = False,
) -> int:  # fmt: skip
    """What the command does: fit, write page and data into `out`, print what changes.

    Returns:
        Exit code: `LEFT_BAND` where something left its band, else 0.

    Raises:
        InputError: as `history`, or if `out` cannot be written; old results are left as they were.
    """
    belongs, flown = parse_bands(bands), list_logs(logs)
    with stage_results(out, [PAGE, DATA], [PAGE], force) as folder:
        found = history(flown, twin, parameters, belongs, jobs, topic_map, effects)
        lost = found.write(folder, out)
    print_warnings([*found.warnings, *lost])
    if json is not None:
        give_json(found.as_dict(), json)
    if json != STDOUT:
        console = open_console()
        for told in [*found.sentences, *([] if lost else [str(out / PAGE)]), str(out / DATA)]:
            console.print(told, soft_wrap=True)
    return LEFT_BAND if found.left else 0
