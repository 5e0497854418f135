"""A verdict in sentences, the same for the terminal and the report."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vpptwin.diagnosis.evidence.flights import HORIZONS_S, SHOWN
from vpptwin.diagnosis.evidence.noise import NoiseFloor
from vpptwin.diagnosis.judgement.verdict import (
    Cause,
    Experiment,
    Misfit,
    Rival,
    Unexplained,
    Verdict,
)
from vpptwin.effects import UNLIMITED
from vpptwin.report.error_table import CHANGED, ErrorTable, format_error, tabulate_errors
from vpptwin.report.words import (
    format_digits,
    format_plain,
    format_value,
    is_plural,
    join_words,
    name_effect,
)
from vpptwin.system.deadline import tell_time

AHEAD = ("0.05 s", "0.1 s", "a quarter of a second", "half a second", "one second")
"""`HORIZONS_S` in words."""
REACHABLE = 0.1 * UNLIMITED
"""Limits below this are some; a twin with more has none."""
SURE = 0.89
"""Confidence beyond which a headline names a cause without how probable it is; `Criteria.suggested` caps there."""
FLOOR = 1.5
"""Held-out chi² up to which an error may be called noise; a right explanation leaves 1.05 to 1.15 on the drone."""
WHOLE = 0.95
"""Shares of what drives a joint from which a force is as strong as that."""
MOST_WITHIN = 4
"""Effects within their tolerance that are told of at most."""
MOST_NAMED = 3
"""Causes that the headline names at most."""
MOST_SHAPED = 2
"""Parameters up to which the headline tells all of a cause."""
FAINT = 0.05
"""Probability below which a rival is not told."""
NOTHING = 0.005
"""Probabilities below this are written as less than one percent."""
LESS, HALF = 2.0, 0.5
"""An error of which one second ahead so many times as large a share stays, and more than that, is told there too."""
SHARE = (
    "Shares are of the held-out excess chi²: the squared error on held-out data beyond sensor noise. "
    "Short horizons dominate them; the error 1 s ahead may change less."
)
"""What the percentages beside causes are shares of; those of what is left are shares of the missing force."""
HORIZON = (
    "The twin predicts open loop, without corrections. Errors of the starting state and disturbances grow over the "
    "horizon, so the last error may stay large although the twin is right."
)
"""Why errors at long horizons stay."""
SIZE_FITS = re.compile(
    r"^(?!.*\b(?:wrong|of|that|whose)\b.* (?:on|in|from|between|along) )(.+?)( (?:on|in|from|between) .*)$"
)
"""Summaries such as `dry friction on the horizontal rail`, in which `of 0.31 N` fits before the place."""
SURER = 0.05
"""By how much surer a kind must be than a cause of it to be told."""


@dataclass(frozen=True)
class Row:
    """Causes of one kind at one place and their rivals of that kind, then other rivals, a line for each kind."""

    effects: str
    text: str
    instead: list[str]


@dataclass(frozen=True)
class Summary:
    """What a verdict says, in sentences."""

    headline: str  # the sentence to read if one reads no other
    more: list[str]  # what belongs to it: an error that falls less, a twin that is suggested
    partial: str  # what was not looked at; "" where everything was
    rows: list[Row]  # causes and rivals with sizes and probabilities
    remains: str  # what is left
    remedy: str  # what would help against an error far above the sensors' noise; "" where there is none
    weak: list[str]  # causes that the extended twin lacks
    tables: list[ErrorTable]  # errors by horizon
    experiment: str | None  # what to fly next; None if nothing is to be decided

    @property
    def lines(self) -> list[str]:
        """All of it, line by line."""
        rows = [line for row in self.rows for line in (f"{row.effects}: {row.text}", *row.instead)]
        told = [self.headline, *self.more, self.partial, *rows, self.remains, self.remedy]
        return [line for line in [*told, f"fly next: {self.experiment}" if self.experiment else ""] if line]


def summarise(verdict: Verdict, noise: NoiseFloor, meanings: Mapping[str, str]) -> Summary:
    """Put a verdict into sentences; meanings: effect id → summary of the catalogue."""
    tables = tabulate_errors(verdict.before, verdict.after if verdict.named else None, noise, verdict.improvement)
    first, *more = say_first(verdict, tables, noise, meanings)
    first = f"Of some candidates only: {first}" if verdict.only else first
    if verdict.stopped is not None:
        first = f"Partial, stopped by {verdict.stopped.why}: {first}"
    return Summary(
        headline=first, more=more, partial=describe_partial(verdict), rows=list_rows(verdict, meanings),
        remains=describe_remainder(verdict, tables), remedy=describe_remedy(verdict),
        weak=[describe_sure(cause, meanings) for cause in verdict.weak], tables=tables,
        experiment=describe_experiment(verdict.experiment, meanings) if verdict.experiment is not None else None,
    )  # fmt: skip


def describe_partial(verdict: Verdict) -> str:
    """What was not looked at; "" where everything was."""
    told = []
    if (cut := verdict.stopped) is not None:
        told.append(f"This verdict is partial: {cut.why} stopped the run after {tell_time(cut.after_s)}.")
        told.append(f"What was not done: {join_words(cut.not_done)}.")
    if verdict.only:
        told.append(f"Only {join_words(verdict.only)} were tried; other effects may explain as much.")
    if verdict.settled:
        told.append(f"Not tried, as asked: {join_words(verdict.settled)}.")
    return " ".join(told)


def say_first(
    verdict: Verdict, tables: Sequence[ErrorTable], noise: NoiseFloor, meanings: Mapping[str, str]
) -> list[str]:
    """What helps, by how much; or that nothing is wrong, or that nothing was found."""
    where = say_where(verdict)
    told = describe_gain(verdict.named, tables, where, meanings) if verdict.named else []
    if verdict.suggested is not None and verdict.suggests:
        tables = tabulate_errors(verdict.after, verdict.suggested, noise)
        more = describe_gain(verdict.weak, tables, where, meanings)[0]
        told.append(f"Not in twin.yaml, but in twin_suggested.yaml: {more[0].lower()}{more[1:]}")
    return told or [say_nothing(verdict, tables, where)]


def say_nothing(verdict: Verdict, tables: Sequence[ErrorTable], where: str) -> str:
    """The headline without a cause."""
    error = f"the error {AHEAD[SHOWN]} ahead, {format_ahead(tables, SHOWN, False)},"
    nothing = "No cause was found among what was tried" if verdict.partial else "No cause was found"
    if verdict.unexplained.significant:
        if not verdict.partial:
            nothing = "Something is wrong that no known effect explains"
        return f"{nothing}: {error} has structure {where}."
    if verdict.misfit is not None or not is_floor(verdict):
        return f"{nothing}: {error} is more than sensor noise makes {where}."
    if not verdict.partial:
        nothing = "Nothing is wrong that these data show"
    return f"{nothing}: {error} is consistent with sensor noise and disturbances {where}."


def say_where(verdict: Verdict) -> str:
    """On which data errors are measured."""
    if len(verdict.logs) == 1:
        return f"(held-out stretches of {Path(verdict.logs[0]).stem})"
    return f"(held-out data of {len(verdict.logs)} logs)"


def describe_gain(
    causes: Sequence[Cause], tables: Sequence[ErrorTable], where: str, meanings: Mapping[str, str]
) -> list[str]:
    """What causes together do to the error; then what they do to it one second ahead, if that is much less."""
    places = [*(find_place(cause) for cause in causes[:MOST_NAMED]), ""]
    few = [
        describe_sure(cause, meanings, own if own == following else "")  # one place is told once
        for cause, own, following in zip(causes, places, places[1:])
    ]
    rest = [f"{len(causes) - MOST_NAMED} more" if len(causes) > MOST_NAMED else ""]
    what, many = join_words([*few, *filter(None, rest)]), len(causes) > 1
    what, verb = f"{what[0].upper()}{what[1:]}{' together' * many}", "take" if many else "takes"
    if not many and is_plural(causes[0].summary):
        verb = "take"
    if causes[0].summary.startswith("a wrong "):
        what, verb = f"Correcting {what[0].lower()}{what[1:]}", "takes"
    found = find_changes(tables)
    if found is None:
        hardly = f"hardly {'change' if verb == 'take' else 'changes'}"
        impacts = sum(cause.blows for cause in causes)
        shown = f"; {impacts} impacts show it" if impacts else ""
        return [f"{what} {hardly} the error {AHEAD[SHOWN]} ahead, {format_ahead(tables, SHOWN, False)} {where}{shown}."]
    at, changed = found
    chance = ", perhaps by chance" if all(table.is_doubtful(at) for table in changed) else ""
    told = [f"{what} {verb} the error {AHEAD[at]} ahead {format_ahead(changed, at)}{chance} {where}."]
    late = [t for t in changed if t.share(-1) > max(LESS * t.share(at), HALF)]
    return [*told, *([f"{AHEAD[-1].capitalize()} ahead it goes {format_ahead(late, -1)}."] if late else [])]


def find_changes(tables: Sequence[ErrorTable]) -> tuple[int, list[ErrorTable]] | None:
    """The horizon that a headline tells, and what changes there: `SHOWN`, or where a pose or else a rate falls most.

    Where none falls, the one that grows most; None where nothing changes.
    """
    for sign in (1.0, -1.0):
        for some in ([t for t in tables if t.pose], [t for t in tables if not t.pose]):
            far = {at: max((sign * (1.0 - t.share(at)) for t in some), default=0.0) for at in range(len(HORIZONS_S))}
            for at in (SHOWN, max(far, key=far.__getitem__)):
                if far[at] > CHANGED:
                    return at, [t for t in some if abs(1.0 - t.share(at)) > CHANGED]
    return None


def format_ahead(tables: Sequence[ErrorTable], at: int, change: bool = True) -> str:
    """Errors at a horizon: `from 135 to 2.5 mm and from 20 to 3 mrad`, or without the change `2.5 mm and 3 mrad`."""
    told = []
    for table in [table for table in tables if table.pose] or tables:
        last = (table.second or table.first)[at]
        errors = [table.first[at], last] if change else [last]
        told.append(f"{'from ' * change}{format_errors(table.unit, *errors)}")
    return " and ".join(told)


def format_errors(unit: str, *errors: float) -> str:
    """One error, or two, in a unit that suits them: `135 to 2.5 mm`."""
    size = max((error for error in errors if math.isfinite(error)), default=0.0)
    factor, unit = (1e-3, unit[1:]) if size >= 1e3 and unit.startswith("m") else (1.0, unit)
    return f"{' to '.join(format_error(factor * error) for error in errors)} {unit}"


def is_floor(verdict: Verdict) -> bool:
    """Whether the error that is left may be noise."""
    return verdict.after.chi2 <= FLOOR


def find_place(told: Cause | Rival) -> str:
    """Where a cause or a rival acts, as its summary ends; "" where it does not."""
    fits = SIZE_FITS.match(told.summary)
    return fits[2] if fits else ""


def describe_sure(cause: Cause, meanings: Mapping[str, str], place: str = "") -> str:
    """A cause with its size, without its `place`, and how probable it is where that is not sure."""
    told = describe_size(cause, meanings, True, place)
    if cause.confidence > SURE:
        return told
    certain = cause.kind_confidence > max(SURE, cause.confidence + SURER)
    doubt = "law not certain" if certain else f"{format_probability(cause.confidence)} probable"
    return f"{told[:-1]}; {doubt})" if told.endswith(")") else f"{told} ({doubt})"


def format_probability(confidence: float) -> str:
    """In percent, with a digit behind the point only near 1."""
    if confidence < NOTHING:
        return "<1 %"
    return f"{100.0 * confidence:.3g} %" if confidence > 0.99 else f"{100.0 * confidence:.0f} %"


def describe_size(told: Cause | Rival, meanings: Mapping[str, str], brief: bool = False, place: str = "") -> str:
    """What and how much: `dry friction of 0.31 ± 0.01 N on joint slide`, `a wrong gain of actuator m2 (0.86 ± 0.01)`.

    Args:
        told: a cause or a rival.
        meanings: effect id → summary.
        brief: of many parameters only the first.
        place: words that are left out, as they stand in front.
    """
    summary = told.summary or meanings.get(told.effect, told.effect)
    if not told.parameters:
        return summary.removesuffix(place)
    (name, strength), *shape = told.parameters.items()
    size = format_value(strength, signed=summary.startswith("a wrong ") and strength.nominal == 0.0)
    beside = [f"{n} {format_value(e)}" for n, e in shape if not brief or len(shape) < MOST_SHAPED]
    given = format_plain(strength.nominal, strength) if 0.0 < abs(strength.nominal) < REACHABLE else ""
    if fits := SIZE_FITS.match(summary) if strength.unit else None:
        beside = [*([f"in the twin {given}"] if given else []), *beside]
        what = f"{fits[1]} of {size}{fits[2]}".removesuffix(place)
    else:
        named = size if not beside and (strength.unit or name in summary.split()) else f"{name} {size}"
        what, beside = summary, [named, *([f"in the twin {given}"] if given else []), *beside]
    return f"{what} ({', '.join(beside)})" if beside else what


def list_rows(verdict: Verdict, meanings: Mapping[str, str]) -> list[Row]:
    """A row for the causes of each kind and place, strongest first."""
    groups: dict[tuple[str, ...], list[Cause]] = {}
    for cause in verdict.named:
        groups.setdefault(find_kind(cause), []).append(cause)
    known = {cause.effect for cause in verdict.causes}
    return [describe_group(kind, causes, known, meanings) for kind, causes in groups.items()]


def find_kind(told: Cause | Rival) -> tuple[str, ...]:
    """What makes causes and rivals one: kind and place, or the effect alone where it has no kind."""
    return (told.kind, told.effect.rpartition(".")[0]) if told.kind else (told.effect,)


def describe_group(
    kind: tuple[str, ...], causes: Sequence[Cause], known: Container[str], meanings: Mapping[str, str]
) -> Row:
    """The row of causes of a kind, with rivals but those that are `known` as causes."""
    rivals: dict[tuple[str, ...], dict[str, Rival]] = {kind: {}}
    told = [rival for cause in causes for rival in cause.also_explained_by]
    for rival in sorted(told, key=lambda rival: -rival.confidence):
        if rival.effect not in known and rival.confidence >= FAINT and is_there(rival):
            rivals.setdefault(find_kind(rival), {}).setdefault(rival.effect, rival)
    place, alike = find_place(causes[0]), list(rivals.pop(kind).values())
    own = [describe_probable(cause, meanings, place * bool(i)) for i, cause in enumerate(causes)]
    own[0] += " probable"
    text = " · or ".join([" · and ".join(own), *(describe_probable(rival, meanings, place) for rival in alike)])
    sure = max(cause.kind_confidence for cause in causes)
    if sure > max(cause.confidence for cause in causes) + SURER:
        text += f" ({causes[0].kind} of any law: {format_probability(sure)})"
    instead = []
    for first, *rest in (list(row.values()) for row in rivals.values()):
        there = find_place(first)
        others = [describe_probable(first, meanings, place), *(describe_probable(r, meanings, there) for r in rest)]
        instead.append(f"or instead {' · or '.join(others)}")
    return Row(", ".join(cause.effect for cause in causes), f"{text[0].upper()}{text[1:]}", instead)


def is_there(rival: Rival) -> bool:
    """Whether a rival's size is told apart from none; what has none explains nothing."""
    strength = next(iter(rival.parameters.values()), None)
    return strength is None or not abs(strength.value - strength.nominal) < strength.std


def describe_probable(told: Cause | Rival, meanings: Mapping[str, str], place: str = "") -> str:
    """What, how much, and how probable."""
    return f"{describe_size(told, meanings, place=place)}, {format_probability(told.confidence)}"


def describe_remainder(verdict: Verdict, tables: Sequence[ErrorTable]) -> str:
    """What is left, in the units and at the horizon of the headline, and what it is like."""
    left = verdict.unexplained
    if not verdict.named and (verdict.suggests or (not left.significant and is_floor(verdict))):
        return ""  # the headline says it
    error = f"{format_ahead(tables, SHOWN, False)} {AHEAD[SHOWN]} ahead"
    like = f"It acts like {describe_force(left)}" if left.force is not None else ""
    if verdict.misfit is not None:
        told = describe_misfit(verdict.misfit)
    elif left.significant:
        told = f"It follows {join_words(left.depends_on)}" if left.depends_on else ""
        told = f"{like}, more than disturbances usually do" if like and not told else told
        mostly = f", mostly in {left.channel}" if left.channel else ""
        told = told or f"It has structure that no effect explains{mostly}"
    elif is_floor(verdict):
        told = "It is consistent with noise and disturbances"
    elif like:
        told = f"{like}, as disturbances do"
    else:
        told = f"It has no structure; {describe_times(math.sqrt(verdict.after.chi2))}"
    return f"What remains is {error}. {told}." if verdict.named else f"{told}."


def describe_times(times: float) -> str:
    """How far above the noise an error is."""
    return f"over short windows it is {format_digits(times)} times the sensor noise"


def describe_misfit(misfit: Misfit) -> str:
    """How far the twin is off where that is far: how much, in which joint, from when on."""
    told = f"No candidate explains it{' alone' * bool(misfit.within)}; {describe_times(misfit.times)}"
    if not misfit.joint:
        return told
    told += f", largest in {misfit.joint}"
    if not math.isfinite(misfit.rmse):
        return f"{told}, whose simulation diverges"
    if misfit.horizon_s == HORIZONS_S[-1]:
        return f"{told}, where it shows {AHEAD[-1]} ahead only"
    return told if misfit.horizon_s is None else f"{told}, where it shows from {misfit.horizon_s:g} s ahead on"


def describe_remedy(verdict: Verdict) -> str:
    """What would help against a misfit; "" without one."""
    if verdict.misfit is None or verdict.suggests:
        return ""
    if verdict.misfit.within:
        few = join_words(verdict.misfit.within[:MOST_WITHIN])
        much = "most of it" if verdict.misfit.explained < 0.9 else "it"
        return (
            f"What may help: {few} may be off within their build tolerances, and together make {much}, so "
            "none of them is named: measure one, or log a motion that separates them."
        )
    joint = verdict.misfit.joint or "the joints"
    check = f"check unit, sign, scale, zero and stamps of {joint} and of its drive in the log"
    if verdict.unexplained.depends_on:
        follows = join_words(verdict.unexplained.depends_on)
        return f"What may help: an effect of your own, because the missing force follows {follows}; first {check}."
    if verdict.misfit.horizon_s == HORIZONS_S[0]:
        return (
            f"What may help: {check}, and its inertia; an error at so short a horizon often is one of the log or model."
        )
    if not verdict.unexplained.significant and verdict.unexplained.force is not None:
        return (
            f"What may help: perhaps nothing, because {describe_force(verdict.unexplained)} (air, cables, the ground) "
            f"explains the error; if it should be quieter, {check}."
        )
    return f"What may help: {check}; leave out what somebody touched; log other motion, {joint} alone."


def describe_share(cause: Cause, chi2: float) -> str:
    """Which share of the held-out excess chi² a cause removes, or of the error in impacts; `chi2` is that before.

    Where that hardly was above the floor there are none. Beyond 1 are those that go below it.
    """
    if chi2 <= FLOOR and not cause.blows:
        return "-"
    share = f"{100.0 * min(cause.gain, 1.0):.0f} %" + (f" in {cause.blows} impacts" if cause.blows else "")
    if cause.gain_interval is not None and cause.gain_interval[0] <= 0.0:
        low, high = (100.0 * bound for bound in cause.gain_interval)
        share += f" ({low:.0f} to {high:.0f} %)"
    return share.replace("-", "−")


def describe_force(left: Unexplained) -> str:
    """How strong a random force would have to be that makes what is left."""
    joint = f"joint {left.channel}" if left.channel else "a joint"
    force = left.force or 0.0
    if not force < WHOLE:
        return f"a random force as strong as what drives {joint}"
    return f"a random force of {100.0 * force:.2g} % of what drives {joint}"


def describe_experiment(experiment: Experiment, meanings: Mapping[str, str]) -> str:
    """The manoeuvre that would decide, and how clearly."""
    values = ", ".join(f"{name} {value:g}" for name, value in experiment.parameters.items())
    given = f" ({values})" if values else ""
    between = join_words([name_effect(effect, meanings) for effect in experiment.separates])
    return f"{experiment.manoeuvre}{given}: it is predicted to separate {between} by {experiment.sigma:.1f} sigma."
