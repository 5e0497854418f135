"""What columns of tables are called: names without their units, the clock among them, and what it counts in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vpptwin.logs.formats.tables import list_names, make_unique
from vpptwin.system.errors import InputError
from vpptwin.system.fields import NANOSECONDS, Stamp

_UNIT = re.compile(r"(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]")
_ENDING = re.compile(
    r".*[a-zA-Z0-9]_(deg_per_s|deg_per_sec|deg_sec|deg_s|degps|dps|rad_per_s|rad_per_sec|rad_sec|rad_s|radps|"
    r"deg|degrees?|rad|radians|mrad_s|mm_s|mm|cm_s|cm|m_per_s|m_s|mps|m_s2|mps2|kmh|km_h|rpm|rev_s|mNm|Nm|gf|kgf|kN|N|"
    r"mV|V|mA|A|percent|pct)"
)
"""What names of columns end with that is a unit, by upper and lower case: `q_m` or `phase_a` may be anything."""
_TIMES = ("t", "time", "timestamp", "stamp", "time_stamp", "clock", "elapsed", "elapsed_time", "seconds", "date_time",
          "datetime", "header_stamp", "log_time", "sec", "timestamps", "epoch", "unix_time", "ts", "zeit")  # fmt: skip
_SPELLED = {"s": "s sec secs second seconds", "ms": "ms msec millis milliseconds",
            "us": "us usec micros microseconds µs μs",
            "ns": "ns nsec nanoseconds"}  # fmt: skip
_WORDS = {word: unit for unit, words in _SPELLED.items() for word in words.split()}
_SUFFIXES = {f"_{word}": unit for word, unit in _WORDS.items()} | {"us": "us", "ms": "ms", "ns": "ns"}
"""What names of clocks end with → unit."""
_CLOCKS = ("millis", "micros", "milliseconds", "microseconds", "nanoseconds")
"""Units that are clocks by themselves."""
_SLOWEST, _FASTEST = 5.0, 5000.0  # samples a second of a log whose clock tells no unit; three decades leave one unit

_DATES = 1e9, 4e9  # seconds since 1970: 2001 to 2096
_STEP = 60.0  # s, between samples of a log that shows dates


def clean_unit(text: str) -> str:
    """A unit as `vpptwin.system.fields.UNITS` spells it, as far as it is one of those."""
    text = text.strip().strip("[]()").strip()
    text = re.sub(r"(_per)?_s(ec)?$|(?<=deg|rad)ps$", "/s", text)
    text = {"°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "°/s": "deg/s", "dps": "deg/s",
            "mps": "m/s", "mNm": "mN m", "Nm": "N m",
            "N·m": "N m", "m/s²": "m/s^2", "m/s2": "m/s^2", "m/s/s": "m/s^2", "RPM": "rpm", "percent": "%",
            "meters": "m", "metres": "m", "m_s2": "m/s^2", "mps2": "m/s^2", "kmh": "km/h", "km_h": "km/h", "pct": "%",
            "gram-force": "gf", "grf": "gf", "newton": "N", "newtons": "N", "N*m": "N m", "N.m": "N m", "N-m": "N m",
            "kgf·cm": "kgf cm", "kgf*cm": "kgf cm", "kgf.cm": "kgf cm", "kgf-cm": "kgf cm"}.get(text, text)  # fmt: skip
    return _WORDS.get(text, text)


def split_units(names: Sequence[str], units: dict[str, str]) -> list[str]:
    """Names without the units that some of them bring, each once; nameless ones are called by their place."""
    firsts, brought = list[str](), list[str]()
    for place, given in enumerate(names):
        match = _UNIT.fullmatch(given)
        is_index = match is not None and match.group(2).isdigit()
        firsts.append((match.group(1) if match and match.group(1) and not is_index else given) or f"c{place}")
        brought.append(match.group(2) if match is not None and not is_index else "")
    parted = make_unique(firsts)
    units |= {name: clean_unit(unit) for name, unit in zip(parted, brought) if unit}
    for name in parted:
        ending = _ENDING.fullmatch(name)
        if ending and name not in units:
            units[name] = clean_unit(ending.group(1))
        stem, unit = split_time(name)
        if stem and unit and name not in units:
            units[name] = unit
    return parted


def split_time(name: str) -> tuple[bool, str]:
    """Whether a column is called as clocks are, and the unit that its name ends with, "" for none."""
    plain = list_names(re.sub("[\u00b5\u03bc]", "u", name))[2]
    if plain in _TIMES:
        return True, ""
    if plain in _CLOCKS:
        return True, _WORDS[plain]
    for suffix, unit in _SUFFIXES.items():
        if plain.endswith(suffix) and plain.removesuffix(suffix).rstrip("_") in _TIMES:
            return True, unit
    return False, ""


def find_times(
    path: Path, topic: str, names: Sequence[str], stamp: Stamp | None, units: Mapping[str, str]
) -> TimeColumn:
    """The column of the time, by its name or, where it is the only one, by its unit."""

    def rank(name: str) -> int:
        if name == "T":  # a thrust, torque or temperature, if anything else may be the time
            return len(_TIMES) + 1
        plain = list_names(name)[2]
        return next((i for i, t in enumerate(_TIMES) if plain == t or plain.startswith(f"{t}_")), len(_TIMES))

    if stamp is not None:
        known = [name for name in names if stamp.path in list_names(name)]
    else:
        known = sorted((name for name in names if split_time(name)[0]), key=rank)
        timed = [name for name in names if units.get(name) in NANOSECONDS]
        known = known or (timed if len(timed) == 1 else [])
    if not known:
        wanted = stamp.path if stamp is not None else "time, t or timestamp"
        listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
        action = "call it so, or name it: `stamp: {path: NAME, unit: ms}`"
        parts = [[n for n in names if list_names(n)[2] in _SPELLED[unit].split()] for unit in ("s", "ns")]
        if all(parts):
            action = f"write {parts[0][0]} + 1e-9 {parts[1][0]} as one column, `time`"
        raise InputError(f"{path}: columns {listed}", f"a column {wanted} with the time", action)
    return TimeColumn(path, topic, known[0], stamp, units)


def guess_unit(time: np.ndarray) -> str:
    """Unit of a clock: in which it shows a date of these years, otherwise in which its steps are those of a log."""
    steps = np.abs(np.diff(time[:10_000].astype(float)))
    rising = steps[steps > 0.0]
    step = float(np.median(rising)) if len(rising) else 0.0
    latest = float(np.abs(time).max())
    for unit, factor in NANOSECONDS.items():
        if _DATES[0] < latest * factor / 1e9 < _DATES[1] and step * factor / 1e9 < _STEP:
            return unit
    if 2 * len(rising) < len(steps):  # rows share stamps: the clock is rounded
        step *= len(rising) / len(steps)
    if step < 1.0:  # ticks are whole, seconds need not be
        return "s"
    for unit, factor in NANOSECONDS.items():
        if _SLOWEST < 1e9 / (step * factor) <= _FASTEST:
            return unit
    return "s"


def count_ns(time: np.ndarray, factor: int) -> np.ndarray:
    """Times (n,) in units of `factor` ns as whole ns, (n,) int64; those that have no room are 2^62."""
    if time.dtype.kind != "f":
        return time.astype(np.int64) * factor
    whole = np.floor(time)  # seconds and fraction apart, or a double loses the nanoseconds of today's dates
    wild = ~(np.abs(time) < 2.0**62 / factor)
    whole = np.where(wild, 0.0, whole)
    counted = whole.astype(np.int64) * factor + np.rint((np.where(wild, 0.0, time) - whole) * factor).astype(np.int64)
    return np.where(wild, np.int64(2**62), counted)


@dataclass
class TimeColumn:
    """The column of a table that holds its timestamps.

    Attributes:
        path, topic: of the log and the table.
        name: of the column.
        stamp: what somebody says of it, None for nobody.
        units: of columns, by their headings.
        unit: in which it counts, once that is known.
    """

    path: Path
    topic: str
    name: str
    stamp: Stamp | None
    units: Mapping[str, str]
    unit: str | None = None

    def count(self, time: np.ndarray, notes: list[str]) -> np.ndarray:
        """Its values in some rows in ns, (n,) int64; a note tells of a unit that only they tell."""
        if not np.isfinite(time).all():
            row = int(np.argmin(np.isfinite(time)))
            found = f"{self.path}: no time in row {row} of {self.name}"
            raise InputError(found, "a time in every row", "remove the row")
        heading = self.units.get(self.name)
        if self.unit is None:
            self.unit = (self.stamp.unit if self.stamp else None) or (heading if heading in NANOSECONDS else None)
        if self.unit is None and len(time):
            self.unit = guess_unit(time)
            if self.unit != "s":
                notes.append(f"{self.topic}: {self.name} is taken to count {self.unit}")
        return count_ns(time, NANOSECONDS[self.unit or "s"])
