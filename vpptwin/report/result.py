"""What a diagnosis gives: the verdict in ten lines, the extended twin, pictures, and the folder of files."""

from __future__ import annotations

import fnmatch
import html
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from json import loads
from os import PathLike
from pathlib import Path
from textwrap import shorten

from tqdm import tqdm

from vpptwin.diagnosis.evidence.noise import NoiseFloor, find_noise_floor
from vpptwin.diagnosis.judgement.diagnose import Diagnosis
from vpptwin.diagnosis.judgement.diagnose import diagnose as judge
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.logs.flight import Flight
from vpptwin.report.export import name_files, write_prediction
from vpptwin.report.html.advice import SHORTER, Session, list_steps
from vpptwin.report.html.page import render_report
from vpptwin.report.html.pictures import Pictures, draw_pictures
from vpptwin.report.html.ranking import Suspect, rank_suspects
from vpptwin.report.output import Pieces, stage_results
from vpptwin.report.prediction import FlightPrediction, predict_flight
from vpptwin.report.provenance import Provenance, trace_origin
from vpptwin.report.rerun import write_rrd
from vpptwin.report.sources import Log, open_flights, open_twin
from vpptwin.report.summary import Summary, summarise
from vpptwin.report.twin_file import compose_twin, extend_effects
from vpptwin.report.words import join_words
from vpptwin.system.deadline import Deadline, Stopped, read_limit, tell_time
from vpptwin.system.doubt import is_as_is, take_as_is
from vpptwin.system.errors import InputError, suggest
from vpptwin.system.files import write_json, write_whole
from vpptwin.system.progress import open_bar, tell_stage
from vpptwin.system.terminal import print_dropped
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.warp.replay import choose_maker

VERDICT, REPORT, TWIN, SUGGESTED = "verdict.json", "report.html", "twin.yaml", "twin_suggested.yaml"
LINES, COLUMNS = 10, 160
"""A result prints in no more than so many lines of so many characters."""
LONG = 60.0
"""Time after which a run says how to make it shorter [s]."""
UNDRAWN = "pictures and predictions are missing: the run ended before they were made"


class Picture(str):
    """An SVG element, which a notebook shows."""

    def _repr_svg_(self) -> str:
        return str(self)


@dataclass(frozen=True)
class Drawn:
    """What takes time and can fail beside a verdict: its pictures, and by log what twins predict."""

    pictures: Pictures
    predictions: list[FlightPrediction | None]
    lost: list[str]  # what could not be made, and why


@dataclass(frozen=True, repr=False)
class Result:
    """What a diagnosis found. Printed it is a summary, in a notebook the report.

    Attributes:
        verdict: causes, errors before and after, what is left, as in verdict.json.
        twin: the diagnosed twin with the fitted causes switched on, but for those that are hardly probable.
        suggested: the same with these too; None where there are none.
        summary: the verdict in sentences.
        lost: pictures and files that could not be made, and why; also among the verdict's warnings.
    """

    verdict: Verdict
    twin: TwinSpec
    suggested: TwinSpec | None
    summary: Summary
    lost: list[str]
    _spec: TwinSpec = field(repr=False)
    _logs: list[Path]
    _ranking: list[Suspect]
    _preflight: list[str]
    _origin: Provenance
    _options: list[str]
    _drawn: Drawn
    _draw: Callable[[], Drawn] | None = None

    def __str__(self) -> str:
        """The verdict in at most ten lines."""
        lines = [*self.summary.lines, *self.verdict.warnings]
        shown = [*lines[:1], *(shorten(line, COLUMNS, placeholder=" …") for line in lines[1:])]
        return "\n".join(shown if len(shown) <= LINES else [*shown[: LINES - 1], f"and {len(shown) - LINES + 1} more"])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """The report, in a frame of its own, so that its style stays there."""
        page = self._render(self._origin, None, [])
        return f'<iframe srcdoc="{html.escape(page)}" style="width: 100%; height: 40em; border: 0"></iframe>'

    @property
    def figures(self) -> dict[str, list[Picture]]:
        """The report's pictures as SVG by what they show, the missing force by the cause that explains it."""
        drawn = self._drawn.pictures
        named = {f"force {effect}": drawings for effect, drawings in drawn.forces.items()}
        for name, found in (("errors", drawn.errors), ("flight", drawn.flight)):
            named[name] = [drawing for drawings in found.values() for drawing in drawings]
        named |= {"sketch": [drawn.sketch] if drawn.sketch else [], "left over": drawn.leftover}
        return {name: [Picture(drawing) for drawing in drawings] for name, drawings in named.items() if drawings}

    @property
    def files(self) -> list[str]:
        """Names of what `save` writes."""
        return [VERDICT, REPORT, *self._twins, *name_files(self._logs)]

    @property
    def _twins(self) -> dict[str, TwinSpec]:
        """Twins that are written, by their file names."""
        return {TWIN: self.twin} | ({SUGGESTED: self.suggested} if self.suggested is not None else {})

    def draw(self) -> Result:
        """The same with pictures and predictions, as far as they can be made."""
        return self if self._draw is None else replace(self, _drawn=self._draw(), _draw=None)

    def save(self, folder: str | PathLike[str], force: bool = False, rrd: bool = False) -> None:
        """Write verdict.json, report.html, twin.yaml and the twins' predictions, as `vpptwin diagnose --out` does.

        Args:
            folder: made if need be.
            force: overwrite files of these names that vpptwin did not write, too.
            rrd: write the predictions for Rerun as well.

        Raises:
            InputError: if the folder cannot be written to, or holds such a file; or if Rerun is not installed.
        """
        out = Path(folder)
        files = [*self.files, *(name_files(self._logs, ".rrd") if rrd else ())]
        with stage_results(out, files, [*list_stale(out), *files], force) as drafts:
            self.write(drafts, out, rrd)

    def write(self, folder: Path, out: Path, rrd: bool = False) -> Result:
        """Write all files into `folder`, to lie in `out` in the end; one that cannot be made costs only itself.

        Returns:
            The same, whose verdict says what could not be made and why, as verdict.json does.
        """
        origin = self._origin.add(["--out", str(out)])
        traced = {"command": origin.command, "date": origin.date, "twin": origin.twin}
        pieces, made = Pieces(list(self._drawn.lost)), [VERDICT]
        twins = {
            name: pieces.attempt(name, partial(compose_twin, self._spec, twin.effects, self.verdict, origin, out), "")
            for name, twin in self._twins.items()
        }
        made += [name for name, content in twins.items() if content]
        for suffix in (".mcap", ".rrd") if rrd else (".mcap",):
            for prediction, name in zip(self._drawn.predictions, name_files(self._logs, suffix), strict=True):
                if prediction is not None:  # or else it is told already
                    export = partial(self._export, folder / name, prediction, traced)
                    made += pieces.attempt(name, export, [])
        page = pieces.attempt(REPORT, lambda: self.tell(pieces.lost)._render(origin, out, made), "")
        told = self.tell(pieces.lost)
        write_json(told.verdict.as_dict(), folder / VERDICT)
        for name, content in (*twins.items(), (REPORT, page)):
            if content:
                write_whole(folder / name, content)
        return told

    def _export(self, path: Path, prediction: FlightPrediction, traced: Mapping[str, str]) -> list[str]:
        """Write a prediction in the form that its name asks for; the names of what was written."""
        try:
            if path.suffix == ".rrd":
                write_rrd(path, prediction)
            else:
                write_prediction(path, self._spec, prediction, {"log": str(prediction.flight.path), **traced})
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return [path.name]

    def tell(self, lost: Sequence[str]) -> Result:
        """The same with a verdict that says what else is missing."""
        verdict = replace(self.verdict, warnings=[*self.verdict.warnings, *lost])
        return replace(self, verdict=verdict, lost=[*self.lost, *lost])

    def _render(self, origin: Provenance, out: Path | None, files: Sequence[str]) -> str:
        """The report, as it lies in the folder `out` beside `files`, or in none."""
        session = Session(self._spec, [str(log) for log in self._logs], self._options, out)
        meanings = name_meanings(self._spec)
        steps = list_steps(self.verdict, session, self.summary.experiment, meanings)
        drawn = self._drawn.pictures
        given = (self.verdict, self.summary, steps, files, self._ranking, drawn, self._preflight, origin, meanings)
        return render_report(*given)


def diagnose(
    logs: Log | Sequence[Log], twin: str | PathLike[str] | TwinSpec = "nominal",
    topic_map: str | PathLike[str] | None = None, effects: Sequence[str | PathLike[str]] = (), progress: bool = True,
    device: str | None = None, only: Sequence[str] = (), limit: str | float | None = None, as_is: bool = False,
    without: Sequence[str] = (), fix: Mapping[str, float] | None = None,
) -> Result:  # fmt: skip
    """Find what a twin gets wrong: what the command `vpptwin diagnose` does, its files aside.

    Args:
        logs: each a recording.
        twin: `nominal`, `typical`, a twin YAML, or what `load_twin` read.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own, which are run; not for a twin that was read already.
        progress: whether a bar is shown on standard error.
        device: where simulations run: `cuda`, a card, or `cpu`, both through Warp; None for the processor's cores.
        only: effects that are candidates, by ids or patterns such as `elbow.*`; none named for all.
        limit: time [s], or text such as `10m`, after which the search stops; what it has by then is the verdict.
        as_is: take columns as they are that look as if they were in another unit, sign or order.
        without: effects that are no candidates, likewise by ids or patterns.
        fix: values of effects that are known, `{"slide.coulomb": 0.3}` or `{"motor.lag.time_constant": 0.02}`.

    Raises:
        InputError: on bad logs or a bad twin, a device that is not there, or a rig that none steps; or if the limit
            comes before all candidates have been tried once.
    """
    deadline = Deadline(None if limit is None else read_limit(limit, "limit"))
    with take_as_is(as_is):
        spec = settle_effects(open_twin(twin, effects), without, fix or {})
        return judge_logs(logs, spec, topic_map, effects, progress, device, only, deadline).draw()


def judge_logs(
    logs: Log | Sequence[Log], twin: str | PathLike[str] | TwinSpec, topic_map: str | PathLike[str] | None,
    effects: Sequence[str | PathLike[str]], progress: bool, device: str | None, only: Sequence[str],
    deadline: Deadline, causes: Sequence[str] | None = None,
) -> Result:  # fmt: skip
    """A diagnosis as `diagnose` has it, but for what is yet to be drawn; of `causes` that are taken for granted."""
    spec = open_twin(twin, effects)
    make_twin, candidates = choose_maker(spec, device), choose_candidates(spec, only)
    flights = open_flights(logs, topic_map, spec.robot.signals.entries, apart=True)
    options = ["--topic-map", str(topic_map)] if topic_map is not None else []
    options += ["--as-is"] * is_as_is()
    options += [part for file in effects for part in ("--effects", str(file))]
    paths = [flight.path for flight in flights]
    apart = [*(["--device", device] if device else []), *(["--only", ",".join(only)] if only else [])]
    apart += list_settled(spec)
    apart += ["--limit", f"{deadline.limit:g}s"] if deadline.limit is not None else []
    origin = trace_origin(["diagnose", *map(str, paths), "--twin", spec.name, *options, *apart], spec.name, paths)
    with open_bar(desc="diagnose", disable=not progress) as bar:
        told = partial(tell_stage, bar), advise_meanwhile(bar, deadline)
        try:
            diagnosis = judge(
                spec, flights, *told, causes=causes, make_twin=make_twin, only=candidates, deadline=deadline,
                announce=partial(tell_before, bar),
            )  # fmt: skip
        except Stopped as stop:
            found = f"{stop} was over before every candidate had been tried once"
            raise InputError(found, "more time, or less to do", SHORTER) from stop
    if progress:
        print_dropped({flight.name: flight.dropped for flight in flights})
    spec = spec.with_robot(signals=diagnosis.held_out.short.spec.robot.signals)  # of what follows its log, too
    return collect_result(spec, flights, diagnosis, origin, options)


def tell_before(bar: tqdm, line: str) -> None:
    """A line above the bar, where there is one."""
    if not bar.disable:
        bar.write(f"vpptwin: {line}", sys.stderr)


def advise_meanwhile(bar: tqdm, deadline: Deadline) -> Callable[[int], None]:
    """What tells a bar of progress, and says once, after `LONG`, how to make such a run shorter."""
    told = bar.disable

    def report(steps: int) -> None:
        nonlocal told
        bar.update(steps)
        if not told and deadline.passed > LONG:
            told = True
            shorter = f"to shorten it, {SHORTER}; --limit 10m keeps what is found by then"
            bar.write(f"vpptwin: {tell_time(LONG)} so far; {shorter}", sys.stderr)

    return report


def match_effects(spec: TwinSpec, names: Sequence[str], option: str) -> set[str]:
    """Ids of the effects that ids and patterns name.

    Raises:
        InputError: if one names none.
    """
    known, chosen = [effect.id for effect in spec.catalogue], set[str]()
    for name in names:
        if not (found := fnmatch.filter(known, name)):
            expected = f"ids of effects of {spec.name}, or patterns such as NAME.*"
            listed = f"`vpptwin effects --twin {spec.name}` lists them"
            raise InputError(f"{option} {name}", expected, suggest(name, known, listed))
        chosen.update(found)
    return chosen


def choose_candidates(spec: TwinSpec, only: Sequence[str]) -> frozenset[str]:
    """Ids of the effects that ids and patterns name, of those that are not settled.

    Raises:
        InputError: if one names none, or all together name only effects that need impacts.
    """
    chosen = match_effects(spec, only, "--only") - spec.settled
    shown = [e.id for e in spec.catalogue if not spec.robot.hides(e) and e.id not in spec.settled]
    if (only and not chosen & set(shown)) or not shown:
        found = f"--only {join_words(sorted(only))}" if only else "no candidate is left"
        raise InputError(found, "an effect that shows without impacts, too, and is not settled", "name one more")
    return frozenset(chosen)


def settle_effects(spec: TwinSpec, without: Sequence[str], fix: Mapping[str, float]) -> TwinSpec:
    """The twin with some effects left out of question: as they are in it, or at a value.

    Args:
        spec: the twin.
        without: ids or patterns of effects.
        fix: EFFECT.PARAMETER, or EFFECT where it has but one, → value.

    Raises:
        InputError: on an unknown effect or parameter, or a value out of bounds.
    """
    effects, known = {id: dict(values) for id, values in spec.effects.items()}, {e.id: e for e in spec.catalogue}
    fixed = set[str]()
    for name, value in fix.items():
        effect, parameter = (name, "") if name in known else name.rpartition(".")[::2]
        match_effects(spec, [effect if effect in known else name], "--fix")
        names = [p.name for p in known[effect].parameters]
        if parameter not in names and (parameter or len(names) > 1):
            example = f"--fix {effect}.{names[0]}={value:g}"
            raise InputError(
                f"--fix {name}={value:g}", f"a parameter of {effect}: {join_words(names)}", f"e.g. {example}"
            )
        effects.setdefault(effect, {})[parameter or names[0]] = value
        fixed.add(effect)
    return spec.with_effects(effects).settle(match_effects(spec, without, "--without") | fixed)


def list_settled(spec: TwinSpec) -> list[str]:
    """The options of a command that settle the same effects."""
    told = []
    for effect in sorted(spec.settled):
        fixed = [("--fix", f"{effect}.{name}={value:g}") for name, value in spec.effects.get(effect, {}).items()]
        told += [part for pair in fixed or [("--without", effect)] for part in pair]
    return told


def parse_fixed(given: Sequence[str]) -> dict[str, float]:
    """Values from `EFFECT=VALUE`.

    Raises:
        InputError: if one is no such pair.
    """
    fixed = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            fixed[name] = float(value)
        except ValueError:
            raise InputError(f"--fix {text}", "EFFECT=VALUE, e.g. slide.coulomb=0.3", "correct it") from None
    return fixed


def read_causes(folder: Path) -> tuple[list[Path], str, list[str]]:
    """Logs, twin and causes of the verdict in a folder.

    Raises:
        InputError: if there is none.
    """
    try:
        told = loads((folder / VERDICT).read_text(encoding="utf-8"))
        return (
            [Path(log) for log in told["logs"]],
            str(told["twin"]),
            [cause["effect"] for cause in told["causes"] if not cause.get("weak")],
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        found = f"--from {folder}: no readable {VERDICT}"
        raise InputError(found, "a folder that `vpptwin diagnose` wrote", "name another") from error


def collect_result(
    spec: TwinSpec, flights: Sequence[Flight], diagnosis: Diagnosis, origin: Provenance, options: Sequence[str]
) -> Result:
    """A diagnosis in sentences, and what its pictures take.

    Args:
        spec: the twin that was diagnosed.
        flights: logs that were diagnosed.
        diagnosis: what came out.
        origin: where it comes from.
        options: of the command that does the same, which other commands have too.
    """
    verdict, meanings = diagnosis.verdict, name_meanings(spec)
    extended = spec.with_effects(extend_effects(spec, diagnosis.values))
    suggested = spec.with_effects(extend_effects(spec, diagnosis.suggested)) if diagnosis.suggested else None
    twins = [spec, extended] if verdict.named else [spec]
    noise = find_noise_floor(diagnosis.measurements, "estimated noise")
    return Result(
        verdict, extended, suggested, summarise(verdict, noise, meanings), [], spec,
        [flight.path for flight in flights],
        rank_suspects(diagnosis.ranking, verdict, meanings), [flight.describe() for flight in diagnosis.preflight],
        origin, list(options), Drawn(Pictures(), [None] * len(flights), [UNDRAWN]),
        partial(draw_result, twins, flights, diagnosis, noise),
    )  # fmt: skip


def draw_result(twins: Sequence[TwinSpec], flights: Sequence[Flight], diagnosis: Diagnosis, noise: NoiseFloor) -> Drawn:
    """Pictures of a diagnosis, and what twins predict for its logs."""
    pieces, predictions = Pieces(), list[FlightPrediction | None]()
    for flight, measured in zip(flights, diagnosis.measurements, strict=True):
        what = f"the prediction of {flight.name}"
        predictions.append(pieces.attempt(what, partial(predict_flight, twins, flight, measured), None))
    draw = partial(draw_pictures, diagnosis, predictions, noise, pieces)
    return Drawn(pieces.attempt("the pictures", draw, Pictures()), predictions, pieces.lost)


def name_meanings(spec: TwinSpec) -> dict[str, str]:
    """Effect id → what it is."""
    return {effect.id: effect.summary for effect in spec.catalogue}


def list_stale(out: Path) -> list[str]:
    """Predictions that an earlier diagnosis in the same folder wrote, by the logs that its verdict names."""
    try:
        verdict = loads((out / VERDICT).read_text(encoding="utf-8"))
        logs = [Path(log) for log in verdict["logs"]]
        return [SUGGESTED, *name_files(logs), *name_files(logs, ".rrd")]
    except (OSError, ValueError, KeyError, TypeError):
        return []
