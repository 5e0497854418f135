"""The unknowns of a diagnosis: every parameter of every effect, with what is believed of it before any data."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import mujoco
import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.search.places import find_places
from vpptwin.effects import Effect, Parameter
from vpptwin.effects.link import apply_payload
from vpptwin.twin.spec import TwinSpec

SIZES = (1.0, 5.0, 25.0)
"""Strengths at which an effect is tried, in typical sizes."""
LOADS = (125.0, 625.0)
"""The same of a load on a link, which may be many times as heavy as that."""
MANY = 40
"""Suspects beyond which none is tried at the first of them, which derivatives tell."""
LIMIT_STEP = 0.15
"""Secant step of a limit, as a share of its value."""
CUT = (*(0.5**halved for halved in range(7, 0, -1)), 0.75, 0.88, 0.94)
"""What limits that are tried cut off an input, as shares of its root mean square."""

CROSSED, SLOWLY = (0.015, 0.03, 0.06, 0.12, 0.25, 0.5), (1.0, 2.0, 4.0)
"""Times in which a rate that is tried crosses what commands span; of a rig that nobody knows the latter too [s]."""


@dataclass(frozen=True)
class Unknown:
    """One parameter under suspicion: nominal is its value in the twin that is diagnosed."""

    effect: Effect
    parameter: Parameter
    nominal: float

    @cached_property
    def key(self) -> Key:
        """Effect id and parameter name."""
        return self.effect.id, self.parameter.name

    @cached_property
    def is_limit(self) -> bool:
        """A rate, an angle, an output that nothing exceeds: off at the upper bound, it acts far below it or not."""
        return self.parameter.off >= self.parameter.high and self.nominal > self.typical

    @property
    def typical(self) -> float:
        """Of a limit, the value that its prior expects, or the largest that it does."""
        prior = self.parameter.prior
        return prior.b if prior.kind == "uniform" else prior.a

    @cached_property
    def width(self) -> float:
        """Range within which the parameter is looked for once its effect is under suspicion."""
        prior, parameter = self.parameter.prior, self.parameter
        if self.is_limit:
            return prior.b
        spread = prior.b - prior.a if prior.kind == "uniform" else 3.0 * prior.b
        return min(max(spread, 3.0 * parameter.size), parameter.high - parameter.low)

    def step_from(self, value: float) -> float:
        """Secant step from a value: a physically typical size, turned or shortened where the bounds leave no room."""
        low, high = self.parameter.low, self.parameter.high
        if self.is_limit:
            return -LIMIT_STEP * value if value * (1.0 - LIMIT_STEP) >= low else LIMIT_STEP * value
        for step in (self.parameter.size, -self.parameter.size):
            if low <= value + step <= high:
                return step
        return high - value if high - value > value - low else low - value


def list_unknowns(spec: TwinSpec, only: Collection[str] = ()) -> tuple[Unknown, ...]:
    """All parameters of all effects, or of `only` those named, that this rig can have and a log can show."""
    own = (e for e in spec.catalogue if not spec.robot.hides(e) and e.id not in spec.settled)
    suspects = (e for e in own if not only or e.id in only)
    return tuple(Unknown(e, p, spec.value(e, p.name)) for e in suspects for p in e.parameters)


@dataclass(frozen=True)
class Trial:
    """An effect switched on at one place of its range: shapes and limits show in no derivative at the off value."""

    effect: str
    values: Mapping[Key, float]
    limit: bool


def list_trials(unknowns: tuple[Unknown, ...], bench: Bench) -> tuple[Trial, ...]:
    """Trials of every effect that has a limit, or a shape that matters more than its typical size tells.

    On a rig whose scales a log told, an effect may be far larger than its typical size, and the twin's own may be
    wrong altogether: every one is tried at several sizes, and without.
    """
    effects: dict[str, list[Unknown]] = {}
    for unknown in unknowns:
        effects.setdefault(unknown.effect.id, []).append(unknown)
    guessed = bench.guessed
    sized = SIZES if len(effects) <= MANY else SIZES[1:]
    trials = []
    placed = [u.effect for u, *_ in effects.values() if u.effect.placed and u.nominal == u.parameter.off and guessed]
    places = find_places(bench, placed)
    limiting = [u for u, *_ in effects.values() if "actuator_forcerange" in u.effect.writes and guessed]
    forces = list_force_limits(limiting, bench)
    for effect, (strength, *shapes) in effects.items():
        if effect in places:
            trials += [Trial(effect, {(effect, n): v for n, v in each.items()}, False) for each in places[effect]]
            continue
        if strength.is_limit:
            trials += [Trial(effect, {strength.key: value}, True) for value in list_limits(strength, bench)]
            continue
        if effect in forces:
            trials += [Trial(effect, {strength.key: value}, True) for value in forces[effect]]
            continue
        there = strength.nominal != strength.parameter.off
        if there and not guessed:
            continue
        grids = [grid_of_shape(shape, len(shapes) == 1) for shape in shapes]
        shaped = [()] if there else list(product(*grids))
        sizes = (
            list_sizes(strength, there, sized) if guessed else [strength.nominal + strength.step_from(strength.nominal)]
        )
        if len(shaped) * len(sizes) < 2:
            continue
        for size, place in product(sizes, shaped):
            values = {shape.key: float(value) for shape, value in zip(shapes, place)}
            trials.append(Trial(effect, {strength.key: size, **values}, False))
    return tuple(trials)


def list_sizes(strength: Unknown, there: bool, sizes: Sequence[float] = SIZES) -> list[float]:
    """Strengths at which an effect is tried: from small to large, or from what the twin has down to none and up."""
    parameter, nominal = strength.parameter, strength.nominal
    if there:
        away = nominal - parameter.off
        found = [parameter.off, parameter.off + 0.5 * away, parameter.off + 2.0 * away]
    else:
        sizes = (*sizes, *LOADS) if strength.effect.apply is apply_payload else sizes
        steps = [side * times * parameter.size for times in sizes for side in (1.0, -1.0)]
        found = [nominal + step for step in steps]
    return [value for value in found if parameter.low <= value <= parameter.high]


def grid_of_shape(shape: Unknown, alone: bool) -> np.ndarray:
    """Values of a parameter of shape from which a fit may start.

    Args:
        shape: a place, a speed, a width.
        alone: it is the only one of its effect. Then speeds and widths are tried at either side of their typical size;
            places always are, three of their typical sizes apart over the likely part of their prior, and frequencies,
            one apart over most of it: what rings is blind to all but its own.
    """
    parameter = shape.parameter
    grid: np.ndarray
    if parameter.unit == "Hz":
        count = int(2.0 * parameter.prior.b / parameter.size)
        grid = np.arange(-count, count + 1) * parameter.size + shape.nominal
    elif parameter.low > 0.0:
        grid = np.array([0.6, 1.0, 1.6] if alone else [1.0]) * shape.nominal
    else:
        count = int(1.5 * parameter.prior.b / (3.0 * parameter.size))
        grid = np.arange(-count, count + 1) * 3.0 * parameter.size + shape.nominal
    return grid[(grid >= parameter.low) & (grid <= parameter.high)]


def list_limits(limit: Unknown, bench: Bench) -> list[float]:
    """Limits that the logged commands would run into, from hardly to badly.

    On a rig that nobody knows those of its own actuator: what drives another joint may be a thousand times as large.
    """
    command, parameter = bench.windows.command, limit.parameter
    if bench.guessed and (own := bench.spec.robot.locate(limit.effect).actuator) >= 0:
        command = command[..., own]
    if limit.effect.follows == "command change":
        span = float(np.ptp(np.percentile(command, [2.0, 98.0])))
        found = span / np.array(CROSSED + SLOWLY if bench.guessed else CROSSED)
    else:
        found = cut_off(command)
    return [float(value) for value in found[(found >= parameter.low) & (found <= parameter.high)]]


def list_force_limits(limits: Sequence[Unknown], bench: Bench) -> dict[str, list[float]]:
    """Shares of its range of force that every servo would run into as the twin moves now, and twice what it has."""
    if not limits:
        return {}
    model, windows, found = bench.spec.model, bench.windows, {}
    motion = bench.simulate([bench.without_sensors(Variation({}))], {})
    for limit in limits:
        own, values = bench.spec.robot.locate(limit.effect).actuator, np.array([2.0 * limit.nominal])
        joint, gear, bias = int(model.actuator_trnid[own, 0]), model.actuator_gear[own, 0], model.actuator_biasprm[own]
        if model.actuator_trntype[own] == mujoco.mjtTrn.mjTRN_JOINT:
            length = gear * motion.pose[0, :, :-1, model.jnt_qposadr[joint]]
            speed = gear * motion.velocity[0, :, :-1, model.jnt_dofadr[joint]]
            force = model.actuator_gainprm[own, 0] * windows.command[..., own]
            force = force + bias[0] + bias[1] * length + bias[2] * speed
            values = np.append(cut_off(force) / np.abs(model.actuator_forcerange[own]).max(), values)
        low, high = limit.parameter.low, limit.parameter.high
        found[limit.effect.id] = [float(value) for value in values if low <= value <= high]
    return found


def cut_off(command: np.ndarray) -> np.ndarray:
    """Limits beyond which commands of any shape have the shares `CUT` of their root mean square, highest first.

    One that is run into now and then cuts as little as one that shaves off every peak, wherever that is.
    """
    size = np.sort(np.abs(command), axis=None)[::-1]
    squares = np.cumsum(size**2)
    beyond = squares - 2.0 * size * np.cumsum(size) + np.arange(1, len(size) + 1) * size**2
    return np.interp(CUT, np.sqrt(np.maximum(beyond, 0.0) / max(squares[-1], 1e-300)), size)
