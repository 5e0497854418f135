"""report.html: one file that opens offline, with the sentence first and the evidence after it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.report.html.advice import NextStep
from vpptwin.report.html.pictures import Pictures
from vpptwin.report.html.ranking import Suspect
from vpptwin.report.provenance import Provenance
from vpptwin.report.summary import HORIZON, SHARE, Summary, describe_share, format_probability
from vpptwin.report.words import format_digits, format_plain, format_value, name_effect, name_effects

FIRST_SUSPECTS = 10
"""Suspects of the ranking that are not folded away."""


def render_report(
    verdict: Verdict, summary: Summary, steps: Sequence[NextStep], files: Sequence[str], ranking: Sequence[Suspect],
    pictures: Pictures, preflight: Sequence[str], origin: Provenance, meanings: Mapping[str, str],
) -> str:  # fmt: skip
    """The report of a diagnosis as one HTML page.

    Args:
        verdict: the verdict.
        summary: the same in sentences.
        steps: what to do next.
        files: names of the other results, which lie beside the page; none where it stands alone.
        ranking: all suspects, strongest first.
        pictures: as SVG.
        preflight: what each log could show, in words.
        origin: where all that comes from.
        meanings: effect id → summary of the catalogue.
    """
    environment = open_templates("vpptwin.report")
    environment.filters |= {"tie": tie_units, "name": partial(name_effects, meanings=meanings)}
    return environment.get_template("report.html.j2").render(
        verdict=verdict, summary=summary, steps=steps, files=files, ranking=ranking, first_suspects=FIRST_SUSPECTS,
        pictures=pictures, name=partial(name_effect, meanings=meanings),
        preflight=preflight, origin=origin, format_value=format_value, format_plain=format_plain,
        format_digits=format_digits,
        horizon=HORIZON, shares=SHARE, share=partial(describe_share, chi2=verdict.before.chi2),
        probability=format_probability,
    )  # fmt: skip


def open_templates(package: str) -> Environment:
    """The HTML templates of a package, and those that all share; an undefined name is an error."""
    folders = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "vpptwin.report"))])
    return Environment(loader=folders, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def tie_units(text: str) -> str:
    """The text with its numbers tied to their deviations and units, so that no line breaks between them."""
    parts = r"(?<=\d) (?=%|± |\S*[A-Za-z]\b)|(?<=±) |(?<=\bN) (?=[ms]\W|s²|m²)|(?<=\bN m) (?=s\W)|(?<=\d) (?=N )"
    return re.sub(parts, "\N{NO-BREAK SPACE}", text)
