"""A verdict in sentences, the same for the terminal and the report."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from vpptwin.diagnosis.evidence.flights import HORIZONS_S
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
from vpptwin.report.error_table import ErrorTable, tabulate_errors
from vpptwin.report.words import (
    choose_unit,
    format_digits,
    format_plain,
    format_value,
    is_plural,
    join_words,
    name_effect,
)
from vpptwin.system.deadline import tell_time

SHOWN_HORIZON = 2
"""Place of the horizon that the sentence names, 0.25 s: past the noise, before a drone without control is lost."""
REACHABLE = 0.1 * UNLIMITED
"""Limits below this are some; a twin with more has none."""
SUGGESTED = 0.89
"""Confidence up to which a cause is but suggested; `Criteria.suggested` caps it there."""
FLOOR = 1.5
"""Held-out chi² up to which an error may be called noise; a right explanation leaves 1.05 to 1.15 on the drone."""
FAR = 4.0
"""Held-out chi² beyond which an error that disturbances of a usual size make is not told as so many times the noise."""
WHOLE = 0.95
"""Shares of what drives a joint from which a force is as strong as that."""
MOST_WITHIN = 4
"""Effects within their tolerance that are told of at most."""
NOTHING = 0.005
"""Shares of the error up to this are written as less than one percent."""
WEAK = 0.05
"""Confidence below which a cause or a rival is folded away."""
MOST_RIVALS = 1
"""Rivals that the headline names at most."""
SHARE = (
    "Percentages are shares of the held-out excess chi²: the squared error on held-out data beyond sensor noise. "
    "Short horizons dominate them; the error 1 s ahead may change less."
)
"""What the percentages beside causes are shares of; those of what is left are shares of the missing force."""
ALONE = "On held-out stretches of this log"
"""Where errors are from, of one log: no other confirms them."""
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
class Summary:
    """What a verdict says, in sentences."""

    headline: str  # the sentence to read if one reads no other
    partial: str  # what was not looked at; "" where everything was
    remedy: str  # what would help against an error far above the sensors' noise; "" where there is none
    others: list[str]  # one sentence for each cause that the headline is not about
    weak: list[str]  # the same of causes that are hardly probable
    certainty: list[str]  # for each cause how sure it is, then what else it could be
    share: str  # what shares of the error are shares of; "" where none is named
    error: str  # the error before and after
    tables: list[ErrorTable]  # errors by horizon
    unexplained: str  # what is left
    experiment: str | None  # what to fly next; None if nothing is to be decided


def summarise(verdict: Verdict, noise: NoiseFloor, meanings: Mapping[str, str]) -> Summary:
    """Put a verdict into sentences; meanings: effect id → summary of the catalogue."""
    tables = tabulate_errors(verdict.before, verdict.after if verdict.causes else None, noise, verdict.improvement)
    told = [
        describe_cause(cause, meanings, verdict.before.chi2, is_suggested(cause, verdict)) for cause in verdict.causes
    ]
    first = 0 if verdict.misfit is not None else 1
    behind = list(zip(verdict.causes, told))[first:]
    return Summary(
        headline=headline(verdict, meanings), partial=describe_partial(verdict), remedy=describe_remedy(verdict),
        others=[sentence for cause, sentence in behind if cause.confidence >= WEAK],
        weak=[sentence for cause, sentence in behind if cause.confidence < WEAK],
        certainty=[
            line
            for cause in verdict.causes
            if cause.confidence >= WEAK or cause is verdict.causes[0]
            for line in describe_certainty(cause, meanings, is_suggested(cause, verdict), verdict.partial)
        ],
        share=SHARE if any("of the error" in sentence for sentence in told) else "",
        error=describe_error(verdict, tables), tables=tables, unexplained=describe_unexplained(verdict),
        experiment=describe_experiment(verdict.experiment, meanings) if verdict.experiment is not None else None,
    )  # fmt: skip


def headline(verdict: Verdict, meanings: Mapping[str, str]) -> str:
    """The sentence to read if one reads no other, which says so if not everything was looked at."""
    told = say_first(verdict, meanings)
    if verdict.stopped is None:
        return f"Of some candidates only: {told}" if verdict.only else told
    return f"Partial, stopped by {verdict.stopped.why}: {told}"


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


def say_first(verdict: Verdict, meanings: Mapping[str, str]) -> str:
    """How far off the twin is where that is far, else the first cause."""
    if verdict.misfit is not None:
        return describe_misfit(verdict.misfit, verdict, meanings)
    if verdict.causes:
        first = verdict.causes[0]
        return describe_cause(first, meanings, verdict.before.chi2, is_suggested(first, verdict))
    if verdict.unexplained.significant and not verdict.partial:
        return "The twin has an error that no known effect explains."
    if verdict.unexplained.significant:
        return f"The twin has an unexplained error; {name_nothing(verdict)}."
    if not is_floor(verdict):
        return f"The error of the twin is {describe_miss(verdict)}; {name_nothing(verdict)}."
    if verdict.partial:
        return "The error of the twin may be noise; no cause was found among what was tried."
    return "The residuals are consistent with sensor noise and disturbances; no effect is needed."


def name_nothing(verdict: Verdict) -> str:
    """That nothing is named, for good or so far."""
    return "no cause was found among what was tried" if verdict.partial else "no cause was found"


def is_floor(verdict: Verdict) -> bool:
    """Whether the error that is left may be noise."""
    return verdict.after.chi2 <= FLOOR


def describe_miss(verdict: Verdict) -> str:
    """How large the error that is left is."""
    chi2 = verdict.after.chi2
    times = format_digits(math.sqrt(chi2))
    return f"{times} times the sensor noise (held-out chi² {format_digits(chi2)}, noise floor 1)"


def describe_misfit(misfit: Misfit, verdict: Verdict, meanings: Mapping[str, str]) -> str:
    """How far the twin is off where that is far: how much, in which joint, from when on, and by how much at the end."""
    last = f"{HORIZONS_S[-1]:g} s ahead"
    if not misfit.joint:
        where = ""
    elif not math.isfinite(misfit.rmse):
        where = f", largest in {misfit.joint}, whose simulation diverges"
    elif misfit.horizon_s is None:
        where = f", largest in {misfit.joint}: {format_error_of(misfit)} {last}"
    elif misfit.horizon_s == HORIZONS_S[-1]:
        where = f", largest in {misfit.joint}: {format_error_of(misfit)} {last}, not before"
    else:
        where = f", largest in {misfit.joint} from {misfit.horizon_s:g} s ahead on: {format_error_of(misfit)} {last}"
    named = ""
    if verdict.causes:  # of which each has a sentence of its own
        count = len(verdict.causes)
        named = (
            f" with {name_effect(verdict.causes[0].effect, meanings) if count == 1 else f'the {count} causes below'}"
        )
    nothing = "" if verdict.causes else f"; {name_nothing(verdict)}"
    return f"The error of the twin{named} is {describe_miss(verdict)}{where}{nothing}."


def format_error_of(misfit: Misfit) -> str:
    """The error at the last horizon with its unit."""
    unit, factor = choose_unit(misfit.unit, abs(misfit.rmse))
    return f"{factor * misfit.rmse:.3g} {unit}"


def describe_remedy(verdict: Verdict) -> str:
    """What would help against a misfit; "" without one."""
    if verdict.misfit is None:
        return ""
    if verdict.misfit.within:
        few, share = join_words(verdict.misfit.within[:MOST_WITHIN]), verdict.misfit.explained
        much = f"{100.0 * share:.0f} % of it" if share < 0.9 else "it"
        return (
            f"What may help: {few} may be off within their build tolerances, and together that explains {much}, so "
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


def is_suggested(cause: Cause, verdict: Verdict) -> bool:
    """Whether a cause is only suggested: not sure, while something material is left, or was not looked at."""
    left = verdict.unexplained.significant or verdict.misfit is not None or not is_floor(verdict)
    return (left or verdict.partial) and cause.confidence <= SUGGESTED


def describe_cause(cause: Cause, meanings: Mapping[str, str], chi2: float = math.inf, suggested: bool = False) -> str:
    """One sentence: what, how much, what the twin has instead, what it explains of held-out `chi2`, and rivals."""
    (name, strength), *shape = cause.parameters.items()
    wrong = cause.summary.startswith("a wrong ")
    size = format_value(strength, signed=wrong and strength.nominal == 0.0)
    if fits := SIZE_FITS.match(cause.summary) if strength.unit else None:
        what = f"{fits[1]} of {size}{fits[2]}"
        what += f" ({', '.join(f'{n} {format_value(e)}' for n, e in shape)})" if shape else ""
    elif shape or not strength.unit:
        size = size if not shape and name in cause.summary.split() else f"{name} {size}"
        what = f"{cause.summary}, {join_words([size] + [f'{n} {format_value(e)}' for n, e in shape])}"
    else:
        what = f"{cause.summary}, {size}"
    if 0.0 < abs(strength.nominal) < REACHABLE:
        what += f", where the twin has {format_plain(strength.nominal, strength)},"
    else:
        what += "," if wrong else ", which the twin lacks,"
    shown = [rival for rival in cause.also_explained_by if rival.confidence >= WEAK]
    named = [name_effect(rival.effect, meanings) for rival in shown[:MOST_RIVALS]]
    more = [count_effects(len(shown) - MOST_RIVALS)] if len(shown) > MOST_RIVALS else []
    rivals = join_words(named + more, "or")
    also = f"; so might {rivals}" if rivals else ""
    told = f"{what} {describe_gain(cause, chi2)}{also}."
    return f"Suggested: {told}" if suggested else f"{told[0].upper()}{told[1:]}"


def describe_gain(cause: Cause, chi2: float) -> str:
    """The verb of a cause's sentence: which share of the error goes away with it, or that none does.

    Beyond 1 are gains that go below the noise floor, or that the other causes made necessary, and all gains where
    `chi2`, before, hardly was above that floor.
    """
    many = is_plural(cause.summary)
    explain, reduce = ("explain", "reduce") if many else ("explains", "reduces")
    if cause.gain > -NOTHING and not cause.gain > NOTHING:
        return f"{'change' if many else 'changes'} the error on held-out data by less than 1 %"
    if not cause.gain > NOTHING:
        return f"{'do' if many else 'does'} not reduce the error on held-out data"
    if cause.gain > 1.0 and chi2 <= FLOOR:
        return f"{reduce} the error on held-out data, which hardly exceeded the assumed noise"
    share = f"{explain} {'all' if cause.gain > 1.0 else f'{100.0 * cause.gain:.0f} %'} of the error"
    if cause.blows:
        return f"{share} in {cause.blows} impacts, each predicted from the others"
    if cause.gain_interval is not None and cause.gain_interval[0] <= 0.0:
        low, high = (100.0 * bound for bound in cause.gain_interval)
        return f"{share}, perhaps by chance (90 % interval {low:.0f} to {high:.0f} %)".replace("-", "−")
    return share


def describe_certainty(
    cause: Cause, meanings: Mapping[str, str], suggested: bool = False, partial: bool = False
) -> list[str]:
    """How sure the naming is, and a sentence for everything else that it could be.

    Args:
        cause: what is named.
        meanings: effect id → summary.
        suggested: whether it is no more than suggested.
        partial: whether not everything was looked at.
    """
    sure = f"{name_effect(cause.effect, meanings)}: {100.0 * cause.confidence:.3g} % probable"
    sure = sure[0].upper() + sure[1:] if cause.effect in meanings else sure
    if cause.kind_confidence > cause.confidence + SURER:
        sure += f" ({cause.kind} of any law: {100.0 * cause.kind_confidence:.3g} %)"
    if partial:
        sure += ", only suggested, because not every rival was fitted"
    else:
        sure += ", only suggested while something is unexplained" if suggested else ""
    if not cause.also_explained_by and partial:
        return [f"{sure}."]
    if not cause.also_explained_by:
        held = ", if the assumed noise is right" if suggested else ""
        return [f"{sure}; no other effect explains these data as well{held}."]
    return [f"{sure}.", describe_rivals(cause, meanings)]


def describe_rivals(cause: Cause, meanings: Mapping[str, str]) -> str:
    """What else it could be, with probabilities and distances from the cause; rivals that are weak are counted."""
    shown = [rival for rival in cause.also_explained_by if rival.confidence >= WEAK]
    told = [f"{name_effect(rival.effect, meanings)}, {describe_distance(rival)}" for rival in shown]
    if weak := len(cause.also_explained_by) - len(shown):
        told.append(f"{count_effects(weak)} below {100.0 * WEAK:.0f} % each")
    return f"It may instead be {'; or '.join(told)}."


def count_effects(number: int) -> str:
    """So many other effects, in words."""
    return f"{number} other effect{'s' if number != 1 else ''}"


def describe_distance(rival: Rival) -> str:
    """How probable a rival is, and by how much worse it fits."""
    fits = "fits equally well" if rival.sigma < 0.05 else f"fits worse by {rival.sigma:.1f} sigma"
    return f"{100.0 * rival.confidence:.0f} % probable, {fits}"


def describe_error(verdict: Verdict, tables: list[ErrorTable]) -> str:
    """The error before and after at one horizon, on held-out data."""
    table = tables[0]
    row = table.rows[SHOWN_HORIZON]
    ahead = f"{table.quantity} error {row.horizon} ahead"
    floor = f"; {table.noise_label} alone is {table.noise} {table.unit}" if table.noise else ""
    where = "On held-out data" if len(verdict.logs) > 1 else ALONE
    if not row.after:
        return f"{where}, the {ahead} is {row.before} {table.unit}{floor}."
    change = f" ({row.change}, 90 % interval)" if row.change else ""
    errors = f"{row.before} to {row.after} {table.unit}"
    return f"{where}, the {ahead} goes from {errors}{change}{floor}."


def describe_unexplained(verdict: Verdict) -> str:
    """What remains unexplained: what stands out, and how large the error still is where no headline has said it."""
    left = verdict.unexplained
    told = is_floor(verdict) or verdict.misfit is not None
    if not left.significant and is_floor(verdict):
        like = f"; the remainder acts like {describe_force(left)}" if left.force is not None else ""
        return f"Nothing beyond noise and disturbances is unexplained{like}."
    if not left.significant:
        like = f" The remainder acts like {describe_force(left)}." if left.force is not None else ""
        if told:
            return f"No candidate explains the remaining error.{like}"
        if left.force is not None and verdict.after.chi2 > FAR:
            return f"The remainder acts like {describe_force(left)}, as disturbances usually do."
        return f"The error is still {describe_miss(verdict)}; no candidate explains it.{like}"
    miss = "" if told else f" The error is still {describe_miss(verdict)}."
    follows = f"it follows {join_words(left.depends_on)}" if left.depends_on else ""
    if left.force is not None:
        more = f"; {follows}" if follows else ", more than disturbances usually do"
        return f"Something is unexplained: it acts like {describe_force(left)}{more}.{miss}"
    beyond = f", {left.sigma:.1f} sigma beyond chance" if left.sigma else ""
    where = f", mostly in {left.channel}" if left.channel else ""
    what = f"{100.0 * left.share:.0f} % of the missing force" if left.share > NOTHING else "Something"
    return f"{what} is unexplained{beyond}{where}{f'; {follows}' if follows else ''}.{miss}"


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
