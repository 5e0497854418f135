"""Parameters flight by flight, as data and in sentences."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from vpptwin import __version__
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.verdict import Estimate
from vpptwin.drift.free_flight import FlightFit
from vpptwin.drift.trend import LEAST, STAYS, Trend
from vpptwin.logs.spelling import name_log
from vpptwin.report.words import format_value, join_words

DAY = 86_400e9  # ns
Band = tuple[float, float]
"""Lowest and highest value, in the unit of the parameter."""


@dataclass(frozen=True)
class FittedFlight:
    """A flight and what it tells."""

    log: str  # path
    start_ns: int  # its first stamp
    fit: FlightFit  # what it tells of the parameters

    @property
    def date(self) -> datetime:
        """When it began, UTC."""
        return datetime.fromtimestamp(self.start_ns / 1e9, UTC)


@dataclass(frozen=True)
class Course:
    """One parameter over all flights."""

    effect: str  # its id
    parameter: str  # the parameter's name
    meaning: str  # what the effect is
    values: list[Estimate | None]  # flight by flight; None where a flight does not show it
    trend: Trend | None  # what it did over the flights that show it; None if no two do
    shown: list[int]  # numbers of those flights
    band: Band | None  # in which it belongs, None for none

    @property
    def name(self) -> str:
        """EFFECT.PARAMETER."""
        return f"{self.effect}.{self.parameter}"

    @property
    def title(self) -> str:
        """What sentences begin with."""
        return f"{self.meaning[:1].upper()}{self.meaning[1:]} ({self.name})"

    @property
    def unit(self) -> str:
        """The unit of the parameter after a space, "" for none."""
        units = [value.unit for value in self.values if value is not None]
        return f" {units[0]}" if units and units[0] else ""

    @property
    def outside(self) -> list[int]:
        """Numbers of the flights whose whole 90 % interval is outside of the band."""
        if self.band is None:
            return []
        ends = {i: value.interval for i, value in enumerate(self.values) if value is not None}
        return [i for i, (low, high) in ends.items() if high < self.band[0] or low > self.band[1]]


@dataclass(frozen=True)
class ParameterHistory:
    """Parameters flight by flight."""

    twin: str  # name of the twin that they were fitted in
    dated: bool  # whether flights are told by date; else by number, as their stamps do not tell
    flights: list[FittedFlight]  # by date, or in the order in which they were given
    courses: list[Course]  # of every parameter

    @property
    def left(self) -> list[Course]:
        """Parameters that left their bands."""
        return [course for course in self.courses if course.outside]

    @property
    def warnings(self) -> list[str]:
        """What looks odd about the logs."""
        return list(dict.fromkeys(warning for flight in self.flights for warning in flight.fit.warnings))

    @property
    def time(self) -> np.ndarray:
        """Of every flight: days since the first, or its number, (n,)."""
        begin = self.flights[0].start_ns
        return np.array([(f.start_ns - begin) / DAY if self.dated else i for i, f in enumerate(self.flights)])

    @property
    def sentences(self) -> list[str]:
        """What left its band first; then what every parameter does, those that change first; then other doubts."""
        told = [self.tell_left(course) for course in self.left]
        changing = sorted(self.courses, key=lambda c: -(c.trend.evidence if c.trend else -math.inf))
        told += [self.tell_trend(course) for course in changing]
        strange = [f.log for f in self.flights if f.fit.after.chi2 > CRITERIA.missed]
        if strange:
            told.append(
                f"More is wrong in {join_words([name_log(log) for log in strange])}, whose held-out chi² "
                f"stays above {CRITERIA.missed:g}: run vpptwin diagnose."
            )
        return told

    def label(self, number: int) -> str:
        """A flight by date, with the time where the day does not tell, or by number."""
        flight = self.flights[number]
        if not self.dated:
            return f"log {number + 1}"
        same = [other for other in self.flights if other.date.date() == flight.date.date()]
        return f"{flight.date:%Y-%m-%d %H:%M}" if len(same) > 1 else f"{flight.date:%Y-%m-%d}"

    def tell_left(self, course: Course) -> str:
        """That a parameter left its band, how often and when first."""
        low, high = course.band or (-math.inf, math.inf)
        first, number = course.outside[0], len(course.outside)
        value, unit = course.values[first], course.unit
        when = f"{'on' if self.dated else 'in'} {self.label(first)}"
        often = f"in {number} of {len(course.shown)} logs, first {when}"
        assert value is not None
        return f"{course.title} left its band of {low:g} to {high:g}{unit} {often}: {format_value(value)}."

    def tell_trend(self, course: Course) -> str:
        """What a parameter does over the flights, from when on, and how clear that is."""
        what, trend = course.title, course.trend
        if trend is None:
            return f"{what} is identifiable in fewer than two of these logs."
        sample = next(value for value in course.values if value is not None)
        levels = (trend.first, trend.last, trend.change)
        first, last, change = (Estimate(value, sample.unit, std, sample.nominal) for value, std in levels)
        more = f"; it scatters by {trend.scatter:.2g}{course.unit} more than its intervals"
        wide = more if trend.scatter > np.median([v.std for v in course.values if v is not None]) else ""
        if len(course.shown) < LEAST:
            return f"{what} is {format_value(first)} in {len(course.shown)} logs, too few for a trend{wide}."
        how_clear = f"evidence {trend.evidence:.1f} for a change against none"
        if trend.kind == "constant":
            stays = "stays at" if trend.evidence < STAYS else "is on average"
            doubt = "" if trend.evidence < STAYS else "a change is possible, the logs do not decide: "
            return f"{what} {stays} {format_value(first)} ({doubt}{how_clear}){wide}."
        grows = "grows" if trend.change[0] > 0.0 else "falls"
        by = replace(change, value=abs(change.value))
        size = f"by {format_value(by)}, from {format_value(first)} to {format_value(last)}"
        since, begin, end = (self.label(course.shown[i]) for i in (trend.since, *trend.between))
        range_ = f" (between {begin} and {end})" if begin != end else ""
        if trend.kind == "line":
            return f"{what} {grows} steadily {size}, over all {len(course.shown)} logs ({how_clear}){wide}."
        if trend.kind == "bend":
            return f"{what} {grows} {size}, steadily from {since} on{range_} ({how_clear}){wide}."
        alone = ", one log so far" if trend.since == len(course.shown) - 1 else ""
        return f"{what} {grows} at once {size}, from {since} on{range_}{alone} ({how_clear}){wide}."

    def as_dict(self) -> dict[str, object]:
        """Plain data: what history.json holds."""
        return {
            "vpptwin": __version__,
            "twin": self.twin,
            "axis": "date" if self.dated else "flight",
            "flights": [
                {
                    "log": f.log, "date": f.date.isoformat() if self.dated else None,
                    "windows": f.fit.windows[0], "held_out_windows": f.fit.windows[1],
                    "chi2": {"before": f.fit.before.chi2, "after": f.fit.after.chi2}, "warnings": f.fit.warnings,
                }
                for f in self.flights
            ],
            "parameters": [self._list_course(course) for course in self.courses],
            "left_band": bool(self.left),
            "sentences": self.sentences,
        }  # fmt: skip

    def _list_course(self, course: Course) -> dict[str, object]:
        trend: dict[str, Any] | None = None
        if course.trend is not None:
            trend = asdict(course.trend)
            for name in ("first", "last", "change"):
                trend[name] = dict(zip(("value", "std"), trend[name]))
            logs = [self.flights[i].log for i in course.shown]
            trend |= {
                "fitted": course.trend.fitted.tolist(),
                "since": logs[course.trend.since],
                "between": [logs[i] for i in course.trend.between],
            }
            if course.trend.kind == "constant":
                trend["since"] = trend["between"] = None
        return {
            "effect": course.effect, "parameter": course.parameter, "meaning": course.meaning,
            "unit": course.unit.strip(),
            "values": [
                None if v is None else {"value": v.value, "std": v.std, "interval_90": list(v.interval)}
                for v in course.values
            ],
            "trend": trend, "band": course.band and list(course.band),
            "left_band_in": [self.flights[i].log for i in course.outside],
        }  # fmt: skip
