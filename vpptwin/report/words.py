"""Numbers with their units and lists, as sentences want them."""

from __future__ import annotations

import re
from collections.abc import Mapping

from vpptwin.diagnosis.judgement.verdict import Estimate

MILLI = {"m": "mm", "s": "ms", "rad": "mrad", "kg": "g", "N m": "mN m"}
"""Units that are written with a thousandth where the number is below 0.1."""
MICRO = {"m/N": ("mm/N", "µm/N"), "rad/(N m)": ("mrad/(N m)", "µrad/(N m)")}
"""Units that are written with a thousandth or a millionth."""
HEAD = re.compile(r"^(.*?)(?: (?:of|that|on|in|from|between|at|near|older|lost|along|beside|above|whose)\b.*)?$")
"""What a summary is about: everything before its first preposition."""


def format_value(estimate: Estimate, signed: bool = False) -> str:
    """Value ± standard deviation with unit, to the digits that the deviation leaves meaningful."""
    unit, factor = choose_unit(estimate.unit, max(abs(estimate.value), abs(estimate.nominal)))
    value, std, plus = factor * estimate.value, factor * estimate.std, "+" if signed else ""
    if not 0.0 < std < float("inf"):
        return f"{value:{plus}.4g} {unit}".rstrip()
    first, exponent = f"{std:.0e}".split("e")
    digits = max(0, (first == "1") - int(exponent))
    value = round(value, digits) + 0.0  # no negative zero
    return f"{value:{plus}.{digits}f} ± {std:.{digits}f} {unit}".rstrip()


def format_digits(value: float) -> str:
    """Three digits without an exponent for large numbers: 575,000."""
    return f"{float(f'{value:.3g}'):,.0f}" if 1000.0 <= abs(value) < 1e12 else f"{value:.3g}"


def format_plain(value: float, estimate: Estimate) -> str:
    """Another value of a parameter, written in the unit that its estimate is written in."""
    unit, factor = choose_unit(estimate.unit, max(abs(estimate.value), abs(estimate.nominal)))
    return f"{factor * value:.4g} {unit}".rstrip()


def choose_unit(unit: str, size: float) -> tuple[str, float]:
    """A readable unit for values of a size, and the factor to it."""
    if unit in MILLI and size < 0.1:
        return MILLI[unit], 1e3
    if unit in MICRO and size < 0.1:
        return (MICRO[unit][0], 1e3) if size >= 1e-4 else (MICRO[unit][1], 1e6)
    return unit.replace("^2", "²"), 1.0


def is_plural(phrase: str) -> bool:
    """Whether a summary speaks of several things: `rotors of unequal thrust`."""
    head = HEAD.match(phrase)
    last = (head[1] if head else phrase).split()[-1]
    return last.endswith("s") and not last.endswith("ss") and not phrase.startswith(("a ", "an "))


def join_words(items: list[str], conjunction: str = "and") -> str:
    """A list in words: a, b and c."""
    return f" {conjunction} ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def name_effect(effect: str, meanings: Mapping[str, str]) -> str:
    """An effect in words, its id behind them; meanings: effect id → summary of the catalogue."""
    return f"{meanings[effect]} ({effect})" if effect in meanings else effect


def name_effects(text: str, meanings: Mapping[str, str]) -> str:
    """A text with every id in it put into words, as `name_effect` does."""
    return re.sub(r"[^\s,;:()]+", lambda word: name_effect(word[0], meanings), text)
