"""`vpptwin compare`: how well twins predict logs, with nothing fitted."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.evidence.flights import HORIZONS_S, SHOWN, choose_window, list_starts
from vpptwin.diagnosis.evidence.logged_inputs import describe_turned, read_session
from vpptwin.diagnosis.evidence.noise import NoiseFloor, find_noise_floor
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.diagnosis.judgement.material import open_held_out
from vpptwin.estimation.measurements import list_warnings
from vpptwin.logs.flight import Flight
from vpptwin.report.error_table import ErrorTable, tabulate_errors
from vpptwin.report.output import give_json
from vpptwin.report.sources import Log, list_logs, open_flights, open_twin
from vpptwin.report.terminal import print_beside, print_errors
from vpptwin.report.words import format_digits
from vpptwin.system.doubt import take_as_is
from vpptwin.system.errors import InputError
from vpptwin.system.files import STDOUT
from vpptwin.system.progress import open_bar
from vpptwin.system.terminal import open_console, print_dropped, print_warnings
from vpptwin.twin.spec import TwinSpec

CHI2 = "whole-log chi² {} ({})"
FLOOR = "1 = noise floor; that of `diagnose` is of held-out windows only"
GUESSED = "the noise is assumed: compare twins with each other, not with 1 or with `diagnose`, which estimates it"


def tell_floor(noise: NoiseFloor) -> str:
    """What a chi² may be compared with."""
    return FLOOR if noise.label == "sensor noise" else GUESSED


@dataclass(frozen=True)
class Scored:
    """A twin's errors on whole logs.

    Attributes:
        twin: its name.
        windows: stretches of log that were predicted.
        score: errors over the horizon.
        noise: what sensor noise alone makes.
        warnings: of what looks odd about the logs, or follows them instead of being predicted.
    """

    twin: str
    windows: int
    score: Score
    noise: NoiseFloor
    warnings: list[str]

    def tabulate(self) -> list[ErrorTable]:
        """Errors over the horizon as text."""
        return tabulate_errors(self.score, None, self.noise)

    def __str__(self) -> str:
        """Chi² and the errors half a second ahead."""
        told = [f"{t.quantity} {t.rows[SHOWN].before} {t.unit}" for t in self.tabulate()[:2]]
        ahead = f"{HORIZONS_S[SHOWN]:g} s ahead"
        return f"{self.twin}: chi² {format_digits(self.score.chi2)}, errors {ahead}: {', '.join(told)}"


@dataclass(frozen=True, repr=False)
class Comparison:
    """How well twins predict the same logs.

    Attributes:
        logs: their paths.
        twins: in the order in which they were given.
    """

    logs: list[str]
    twins: list[Scored]

    def __str__(self) -> str:
        """A line for each twin."""
        return "\n".join(map(str, self.twins))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Errors over the horizon, a table for each quantity and a column for each twin."""
        parts = []
        for entries in zip(*(one.tabulate() for one in self.twins)):
            heads = "".join(f"<th>{html.escape(one.twin)}</th>" for one in self.twins)
            rows = [(rows[0].horizon, [row.before for row in rows]) for rows in zip(*(entry.rows for entry in entries))]
            rows += [(entries[0].noise_label, [entry.noise for entry in entries])] if entries[0].noise else []
            lines = "".join(
                f"<tr><td>{html.escape(label)}</td>{''.join(f'<td>{html.escape(cell)}</td>' for cell in cells)}</tr>"
                for label, cells in rows
            )
            title = html.escape(f"{entries[0].quantity} error [{entries[0].unit}]")
            parts.append(f"<table><caption>{title}</caption><tr><th>horizon</th>{heads}</tr>{lines}</table>")
        told = "; ".join(f"{html.escape(one.twin)}: chi² {one.score.chi2:.3g}" for one in self.twins)
        notes = "".join(f"<p>warning: {html.escape(warning)}</p>" for warning in self.warnings)
        return f"{''.join(parts)}<p>{told} ({tell_floor(self.twins[0].noise)})</p>{notes}"

    @property
    def warnings(self) -> list[str]:
        """What looks odd about the logs, or follows them instead of being predicted."""
        return list(dict.fromkeys(warning for one in self.twins for warning in one.warnings))

    def as_dict(self) -> dict[str, object]:
        """Plain data: of one twin its own, of several a list `twins`."""
        told: list[dict[str, object]] = [
            {"twin": one.twin, "samples": {"windows": one.windows}, "error": one.score.as_dict()} for one in self.twins
        ]
        shared: dict[str, object] = {"logs": self.logs, "horizons_s": list(HORIZONS_S), "warnings": self.warnings}
        return shared | (told[0] if len(told) == 1 else {"twins": told})


def compare(
    logs: Log | Sequence[Log],
    twin: str | PathLike[str] | TwinSpec | Sequence[str | PathLike[str] | TwinSpec] = "nominal",
    topic_map: str | PathLike[str] | None = None, effects: Sequence[str | PathLike[str]] = (), progress: bool = True,
    as_is: bool = False,
) -> Comparison:  # fmt: skip
    """Score twins on whole logs: what `vpptwin compare` prints.

    Args:
        logs: each a recording.
        twin: one or several, each `nominal`, `typical`, a twin YAML, or what `load_twin` read.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own, which are run; not for twins that were read already.
        progress: whether a bar is shown on standard error.
        as_is: take columns as they are that look as if they were in another unit, sign or order.

    Raises:
        InputError: on bad logs or a bad twin.
    """
    given = [twin] if isinstance(twin, (str, PathLike, TwinSpec)) else list(twin)
    if not given:
        raise InputError("no twins", "at least one", "name one")
    specs, listed = [open_twin(each, effects) for each in given], list_logs(logs)
    scored = []
    for i, spec in enumerate(specs):
        flights = open_flights(listed, topic_map, spec.robot.signals.entries)
        with take_as_is(as_is):
            scored.append(score_twin(spec, flights, progress))
        if progress and not i:
            print_dropped({flight.name: flight.dropped for flight in flights})
    return Comparison([str(flight.path) for flight in flights], scored)


def score_twin(spec: TwinSpec, flights: Sequence[Flight], progress: bool) -> Scored:
    """One twin's errors."""
    spec, measurements = read_session(spec, flights)
    chosen, measurements = choose_window(spec, measurements)
    starts = list_starts(measurements, chosen.robot.window)
    with threadpool_limits(limits=1, user_api="blas"), open_bar(desc="compare", disable=not progress) as bar:
        held_out = open_held_out(chosen, measurements, starts, bar.update)
        score = held_out.score({})
    noise = find_noise_floor(measurements)
    warnings = [*describe_turned(spec), *list_warnings(flights, measurements)]
    return Scored(spec.name, len(held_out.short.windows), score, noise, warnings)


def compare_logs(
    logs: Sequence[Path], twins: Sequence[str], json: Path | None, topic_map: Path | None = None,
    effects: Sequence[Path] = (),
) -> Comparison:  # fmt: skip
    """Compare, and print (and write) the errors over the horizon.

    Raises:
        InputError: on bad logs, a bad twin, or a file that cannot be written.
    """
    comparison = compare(logs, twins, topic_map, effects)
    print_warnings(comparison.warnings)
    if json != STDOUT:
        console, (first, *others) = open_console(), comparison.twins
        if others:
            print_beside(console, {one.twin: one.tabulate() for one in comparison.twins})
            chi2 = ", ".join(f"{format_digits(one.score.chi2)} of {one.twin}" for one in comparison.twins)
        else:
            print_errors(console, f"prediction error of twin {first.twin}", first.tabulate())
            chi2 = format_digits(first.score.chi2)
        console.print(CHI2.format(chi2, tell_floor(first.noise)))
    if json is not None:
        give_json(comparison.as_dict(), json)
    return comparison
