"""What a manoeuvre is: a name, what it reveals, settings with unit and bounds, and how its reference is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vpptwin.robots.planar_drone.pilot.reference import Plan, Reference
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError, suggest

ROOM = 0.15
"""A reference keeps this distance from the ends of both rails [m]: steps overshoot, forces push aside."""
SHORTEST, LONGEST = 5.0, 600.0
"""Durations that can be flown [s]; the diagnosis takes no shorter flight."""


@dataclass(frozen=True)
class Setting:
    """One number of a manoeuvre that may be chosen."""

    name: str  # as in `--set NAME=VALUE`
    unit: str  # SI unit, "" for none
    default: float  # value when nothing is said
    low: float  # bounds; inside them the manoeuvre is safe
    high: float  # bounds; inside them the manoeuvre is safe
    meaning: str  # in a few words


@dataclass(frozen=True)
class Manoeuvre:
    """A named manoeuvre."""

    name: str  # as in `--manoeuvre NAME`
    summary: str  # what is flown, in a phrase
    reveals: tuple[str, ...]  # ids of effects that it is made to show
    settings: tuple[Setting, ...]  # what may be chosen
    fill: Callable[..., None] = field(repr=False)  # fills a plan, given the settings by name
    duration: float = 20.0  # when nothing is said [s]

    def choose(self, given: Mapping[str, float]) -> dict[str, float]:
        """All settings, those given in place of the defaults.

        Raises:
            InputError: on a setting that it has not, or a value out of bounds.
        """
        known = {s.name: s for s in self.settings}
        for name, value in given.items():
            if name not in known:
                raise InputError(f"{self.name} has no setting {name!r}", f"one of {', '.join(known)}", "rename it")
            setting = known[name]
            if not setting.low <= value <= setting.high:
                found = f"{self.name}: {name} = {value:g} {setting.unit}".rstrip()
                bounds = f"{setting.low:g} to {setting.high:g} {setting.unit}".rstrip()
                raise InputError(found, f"{bounds} ({setting.meaning})", "correct --set")
        return {s.name: float(given.get(s.name, s.default)) for s in self.settings}

    def plan(self, vehicle: Vehicle, given: Mapping[str, float], duration: float | None = None) -> Reference:
        """The reference for a vehicle.

        Args:
            vehicle: whose rails it has to fit and whose policy rate sets the ticks.
            given: settings other than the defaults.
            duration: s; None for the manoeuvre's own.

        Raises:
            InputError: on settings or a duration that are not allowed, or rails that are too short.
        """
        settings = self.choose(given)
        duration = check_duration(self.duration if duration is None else duration)
        plan = Plan(duration, 1.0 / vehicle.control.policy_rate, vehicle.gravity)
        self.fill(plan, **settings)
        reference = plan.finish()
        self._check_room(reference, vehicle)
        return reference

    def _check_room(self, reference: Reference, vehicle: Vehicle) -> None:
        for axis, (name, travel) in enumerate((("x", vehicle.rig.travel_x), ("z", vehicle.rig.travel_z))):
            low, high = reference.pose[:, axis].min(), reference.pose[:, axis].max()
            first, last = travel[0] + ROOM, travel[1] - ROOM
            if low < first - 1e-9 or high > last + 1e-9:
                found = f"{self.name} goes from {name} = {low:.2f} to {high:.2f} m"
                expected = f"{first:.2f} to {last:.2f} m, {ROOM:g} m off the stops"
                raise InputError(found, expected, "choose smaller settings")


def check_duration(duration: float) -> float:
    """The duration [s]."""
    if not SHORTEST <= duration <= LONGEST:
        raise InputError(f"a flight of {duration:g} s", f"{SHORTEST:g} to {LONGEST:g} s", "correct --duration")
    return duration


def find_manoeuvre(library: Sequence[Manoeuvre], name: str) -> Manoeuvre:
    """The manoeuvre of that name."""
    known = {manoeuvre.name: manoeuvre for manoeuvre in library}
    if name not in known:
        advice = suggest(name, known, "see `vpptwin fly --list`")
        raise InputError(f"unknown manoeuvre {name!r}", f"one of {', '.join(known)}", advice)
    return known[name]


def parse_settings(given: Sequence[str]) -> dict[str, float]:
    """Settings from the command line, `NAME=VALUE` each."""
    settings = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            settings[name.strip()] = float(value)
        except ValueError as error:
            raise InputError(f"--set {text}", "NAME=VALUE with a number", "see `vpptwin fly --list`") from error
        if not np.isfinite(settings[name.strip()]):
            raise InputError(f"--set {text}", "a finite number", "correct it")
    return settings
