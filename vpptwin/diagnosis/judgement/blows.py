"""What is wrong with contacts: blows, which the search for all other causes leaves out, looked at by themselves.

Where a rig strikes something all the time, they are not left out: then contacts come first, and the search after them.

A blow magnifies what came before it and is over within a few steps, so that how the steps happen to fall shows, too:
errors are many times the sensors', and no derivative holds for long. So windows begin just before a blow, starting
states are fitted, what counts is the logarithm of what is missed then, and every blow is judged by parameters that the
others gave.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from scipy.optimize import minimize

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.evidence.runs import Key, MakeTwin
from vpptwin.diagnosis.judgement.selection import CALIBRATION
from vpptwin.diagnosis.judgement.verdict import Cause, Cleared, Estimate, Rival, Unseen, Verdict
from vpptwin.diagnosis.search.likelihood import measure_response
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.estimation.gaps import LOOK_BACK, usable_starts
from vpptwin.estimation.measurements import Measurements
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

LEAD, LENGTH, SAMPLES = 0.1, 0.3, 12
"""A window begins so long before a blow and lasts so long [s], both longer where it has fewer samples of poses."""
MOST, FOLDS = 48, 6
"""Blows at most, more would tell little; and groups of them, judged by what the others gave."""
ROUNDS, STEPS, AWAY, NEAR = 2, 60, 0.3, 0.1
"""How often what starting states do is measured anew; evaluations of a simplex for each parameter, and its
size, at first and about what all blows gave."""
PHASE, FINEST = 0.2, 10.0
"""Radians of a contact's swing that should pass in a step at most, and parts at most into which one is cut for that."""
TRIED = 1.2
"""How far from the twin's own value a search begins, too, on the scale of the logarithm."""
FAINT = 0.003
"""How much being away from the twin's own values costs: of what blows do not tell these stay."""
COMPLIANCE = "contact.compliance"

Look = Callable[[Mapping[Key, float]], np.ndarray]
"""What tells log(1 + chi²) of every blow, (K,), with values set."""


@dataclass(frozen=True)
class Explained:
    """What some contact effects make of blows.

    Attributes:
        values: parameters, from all blows.
        std: how far they scatter if a group of blows is left out, jackknifed, and how far steps may bias them.
        missed: log(1 + chi²) of every blow, with parameters that the others gave, (K,).
    """

    values: dict[Key, float]
    std: dict[Key, float]
    missed: np.ndarray


@dataclass(frozen=True)
class Findings:
    """What blows tell: causes, what is cleared, what does not show, and a line about them."""

    causes: list[Cause] = field(default_factory=list)
    cleared: list[Cleared] = field(default_factory=list)
    unseen: list[Unseen] = field(default_factory=list)
    told: list[str] = field(default_factory=list)

    def add_to(self, verdict: Verdict) -> Verdict:
        """The verdict with them."""
        return replace(
            verdict, causes=[*verdict.causes, *self.causes], cleared=[*verdict.cleared, *self.cleared],
            unseen=[*verdict.unseen, *self.unseen], warnings=[*verdict.warnings, *self.told],
            gap=verdict.gap or bool(self.causes),
        )  # fmt: skip

    @property
    def values(self) -> dict[Key, float]:
        """Parameters of the causes."""
        return {(c.effect, name): e.value for c in self.causes for name, e in c.parameters.items()}

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """The causes, as a twin has them."""
        return {c.effect: {name: e.value for name, e in c.parameters.items()} for c in self.causes}

    @property
    def nominal(self) -> dict[Key, float]:
        """The same in the twin that was given."""
        return {(c.effect, name): e.nominal for c in self.causes for name, e in c.parameters.items()}


def judge_blows(
    spec: TwinSpec, measurements: Sequence[Measurements], known: Mapping[Key, float], stage: Callable[[str], None],
    progress: Callable[[int], None] | None = None, criteria: Criteria = CRITERIA, make_twin: MakeTwin = Twin,
    only: Collection[str] = (),
) -> Findings:  # fmt: skip
    """What blows tell of contacts, beside causes that other windows told.

    Args:
        spec: the twin.
        measurements: of the flights.
        known: parameters of the other causes.
        stage: called with the present step, in words.
        progress: as for `diagnose`, like the next two.
        criteria: thresholds.
        make_twin: makes simulations.
        only: effects that are candidates; none named for all.
    """
    contacts = [e for e in spec.catalogue if e.touching and e.id not in spec.settled and (not only or e.id in only)]
    suspects = {e.id: [Unknown(e, p, spec.value(e, p.name)) for p in e.parameters] for e in contacts}
    if not suspects:
        return Findings()
    clear = [replace(flight, strikes=np.zeros((0, 2))) for flight in measurements]
    rates = [len(s.time) / np.ptp(s.time) for flight in clear for s in flight.positions.values()]
    slow = max(SAMPLES / min(rates, default=np.inf) / LENGTH, 1.0)
    starts = [list_blows(flight, slow * LEAD, slow * LENGTH) for flight in clear]
    count = sum(map(len, starts))
    if count < criteria.fewest_blows:
        reason = f"{count} separate impacts, {criteria.fewest_blows} are needed" if count else "no impact was found"
        return Findings(unseen=[Unseen(effect, reason) for effect in suspects])
    starts = [some[:: -(-count // MOST)] for some in starts]
    stage(f"judging contacts by {sum(map(len, starts))} impacts")
    spec = shorten_steps(spec)
    given = slow * LENGTH, True, progress, criteria, True, make_twin
    return Judge(build_bench(spec, clear, starts, *given), suspects, known).judge()


def shorten_steps(spec: TwinSpec) -> TwinSpec:
    """The same twin with steps in which a blow swings by `PHASE` at most: its own may be too long to tell."""
    model = copy(spec.model)
    model.opt.timestep /= np.clip(np.ceil(tell_steps(model, {}) / PHASE), 1.0, FINEST)
    return spec.with_robot(model=model)


def strikes_on(spec: TwinSpec, measurements: Sequence[Measurements]) -> bool:
    """Whether a rig strikes something so often that no windows are left out for it."""
    suspected = any(effect.touching for effect in spec.catalogue)
    return suspected and any(len(flight.blows) and not len(flight.strikes) for flight in measurements)


def list_blows(flight: Measurements, lead: float, length: float) -> np.ndarray:
    """When windows of a length begin that hold a blow after `lead` [s], (K,) s; none of what comes in another's."""
    begins: list[float] = []
    for begin in flight.blows[:, 0] - lead:
        inside = flight.start + LOOK_BACK <= begin <= flight.end - length
        if inside and not (begins and begin < begins[-1] + length):
            begins.append(float(begin))
    found = np.array(begins)
    return found[usable_starts(flight, found, length)]


class Judge:
    """Blows on a bench, and suspects that may explain them."""

    def __init__(self, bench: Bench, suspects: Mapping[str, list[Unknown]], known: Mapping[Key, float]) -> None:
        self.bench, self.suspects, self.known, self.count = bench, suspects, dict(known), len(bench.windows)
        self.criteria = bench.criteria
        self._pose = bench.of_poses
        self._freedom = np.maximum(bench.valid[:, self._pose].sum(axis=1) - 2 * bench.windows.free_dofs, 1)
        self._folds = np.arange(self.count) % FOLDS
        self._explained: dict[frozenset[str], Explained] = {}

    def judge(self) -> Findings:
        """Name what explains the blows, one after the other, as long as that predicts others."""
        chosen, doubt = frozenset[str](), dict[str, float]()
        while True:
            here = self.explain(chosen)
            if here.missed.mean() < np.log1p(self.criteria.nothing_left):
                break
            tried = {e: self.explain(chosen | {e}) for e in self.suspects if e not in chosen}
            chances = {e: self.weigh(here.missed - found.missed) * len(tried) for e, found in tried.items()}
            passed = [e for e in tried if chances[e] < self.criteria.by_chance and self.matters(chosen, e)]
            if not passed:
                break
            best = min(passed, key=lambda e: float(tried[e].missed.mean()))
            doubt[best], chosen = chances[best], chosen | {best}
        causes = [self.tell(chosen, effect, doubt[effect]) for effect in doubt]
        alike = {rival.effect for cause in causes for rival in cause.also_explained_by}
        cleared, unseen = self.clear(here, [e for e in self.suspects if e not in chosen | alike])
        before, after = size_up(self.explain(frozenset())), size_up(here)
        told = f"{self.count} impacts, judged on their own, are off by {before:.3g} times the sensor noise"
        told += f", {after:.3g} times with {' and '.join(doubt)}" if doubt else ""
        return Findings(causes, cleared, unseen, [told])

    def explain(self, effects: frozenset[str]) -> Explained:
        """Fit effects to all blows, and to all but a group for each group."""
        if effects in self._explained:
            return self._explained[effects]
        unknowns = [u for e in sorted(effects) for u in self.suspects[e]]
        own = np.array([read(u, u.nominal) for u in unknowns])
        look, place = self.look(self.known), own
        starts = [own, *(own + side * TRIED * axis for axis in np.eye(len(own)) for side in (-1.0, 1.0))]
        for _ in range(ROUNDS if unknowns else 0):
            place = self.fit(unknowns, look, starts, np.ones(self.count, bool))
            look, starts = self.look(self.known | name(unknowns, place)), [place]
        missed, parts = look(self.known), []
        for fold in range(FOLDS if unknowns else 0):
            judged = self._folds == fold
            if judged.any():
                parts.append(list(name(unknowns, part := self.fit(unknowns, look, [place], ~judged)).values()))
                missed[judged] = look(self.known | name(unknowns, part))[judged]
        values, std = name(unknowns, place), dict[Key, float]()
        steps = tell_steps(self.bench.spec.model, values)
        for u, row in zip(unknowns, np.transpose(parts)):
            bias = steps * values[u.key] if u.effect.id == COMPLIANCE else 0.0
            std[u.key] = float(np.hypot(np.sqrt((len(row) - 1) * np.var(row)), bias))
        self._explained[effects] = Explained(values, std, missed)
        return self._explained[effects]

    def look(self, values: Mapping[Key, float]) -> Look:
        """What tells how far off blows are, starting states doing what they do with `values`."""
        whitening = measure_response(self.bench, values, pushed=False).whiten_some(self._pose)

        def look(values: Mapping[Key, float]) -> np.ndarray:
            missed = self.bench.residual(values)[:, self._pose]
            return np.asarray(np.log1p((whitening.apply(missed) ** 2).sum(axis=1) / self._freedom))

        return look

    def fit(
        self, unknowns: Sequence[Unknown], look: Look, starts: Iterable[np.ndarray], rows: np.ndarray
    ) -> np.ndarray:
        """Where effects explain the blows `rows` (K,) best, as `read` has it, from the best of several starts."""
        low, high, own = np.array(
            [[read(u, value) for value in (u.parameter.low, u.parameter.high, u.nominal)] for u in unknowns]
        ).T

        def cost(place: np.ndarray) -> float:
            missed = look(self.known | name(unknowns, place))[rows]
            return float(missed.mean() + FAINT * ((place - own) ** 2).sum())

        first = min((np.clip(start, low, high) for start in starts), key=cost)
        size = AWAY if rows.all() else NEAR
        steps = np.diag(np.where(first + size <= high, size, -size))
        options = {"initial_simplex": np.vstack([first, first + steps]), "maxfev": STEPS * len(own), "xatol": 0.02}
        bounds = list(zip(low, high))
        return np.asarray(
            minimize(cost, first, method="Nelder-Mead", bounds=bounds, options=options | {"fatol": 1e-4}).x
        )

    def weigh(self, drop: np.ndarray) -> float:
        """Odds of errors of blows, log(1 + chi²), being smaller by `drop` (K,) by chance alone.

        By as much as each error goes down or up, `most_told` at most: what is left of one is no noise of sensors.
        """
        return float(np.exp(-np.clip(drop, -self.criteria.most_told, self.criteria.most_told).sum()))

    def share(self, without: frozenset[str], beside: frozenset[str]) -> float:
        """Share of the error that goes away with more effects, in blows that they were not fitted to."""
        return float(1.0 - np.exp((self.explain(beside).missed - self.explain(without).missed).mean()))

    def matters(self, chosen: frozenset[str], effect: str) -> bool:
        """Whether an effect explains much beside others, and leaves its build tolerance."""
        found, own = self.explain(chosen | {effect}), self.suspects[effect]
        away = [abs(found.values[u.key] - u.nominal) - found.std[u.key] > u.parameter.tolerance for u in own]
        return any(away) and self.share(chosen, chosen | {effect}) > self.criteria.eased

    def tell(self, chosen: frozenset[str], effect: str, doubt: float) -> Cause:
        """A cause with what might be there instead."""
        found, rest, rivals = self.explain(chosen), chosen - {effect}, []
        for other in self.suspects.keys() - chosen:
            odds = self.weigh(self.explain(rest | {other}).missed - found.missed)
            if odds > self.criteria.by_chance and self.matters(rest, other):
                rivals.append(Rival(other, odds / (1.0 + odds)))
        sure = (1.0 - sum(rival.confidence for rival in rivals)) * (1.0 - doubt)
        own = self.suspects[effect]
        parameters = {
            u.parameter.name: Estimate(found.values[u.key], u.parameter.unit, found.std[u.key], u.nominal) for u in own
        }
        floor = size_up(found) ** 2 < self.criteria.missed
        sure = min(sure, CALIBRATION.highest if floor else self.criteria.suggested)
        gain = self.share(rest, chosen)
        return Cause(effect, sure, parameters, gain, rivals, own[0].effect.summary, None, self.count)

    def clear(self, here: Explained, others: Iterable[str]) -> tuple[list[Cleared], list[Unseen]]:
        """Of what is not named: that a typical size more or less would show, or that it would not."""
        cleared, unseen, values = list[Cleared](), list[Unseen](), self.known | here.values
        look = self.look(values)
        now = look(values)
        for effect in others:
            strength = self.suspects[effect][0]
            parameter, nominal = strength.parameter, strength.nominal
            low, high = nominal / (1.0 + parameter.size), nominal * (1.0 + parameter.size)
            if all(
                self.weigh(look(values | {strength.key: end}) - now) < self.criteria.by_chance for end in (low, high)
            ):
                cleared.append(Cleared(effect, parameter.name, low, high, parameter.unit))
            else:
                told = f"{parameter.name} of {low:.2g} or {high:.2g} predicts these {self.count} impacts as well"
                unseen.append(Unseen(effect, told))
        return cleared, unseen


def size_up(explained: Explained) -> float:
    """Root of the median chi² of blows."""
    return float(np.sqrt(np.expm1(np.median(explained.missed))))


def tell_steps(model: mujoco.MjModel, values: Mapping[Key, float]) -> float:
    """Radians of a contact's swing that pass in a step, which biases what is told of springs and dampers by as much."""
    own = np.concatenate([model.geom_solref[(model.geom_contype | model.geom_conaffinity) != 0], model.pair_solref])
    quick = np.maximum(np.prod(own, axis=1), 0.1 * model.opt.timestep)  # a damping ratio may be zero
    stiffness = np.where(own[:, 0] > 0.0, quick**-2.0, -own[:, 0]).max() * values.get((COMPLIANCE, "stiffness"), 1.0)
    return float(np.sqrt(stiffness) * model.opt.timestep)


def name(unknowns: Iterable[Unknown], place: np.ndarray) -> dict[Key, float]:
    """Coordinates as parameters."""
    logs = [u.parameter.low > 0.0 for u in unknowns]
    return {u.key: float(u.parameter.clip(np.exp(x) if log else x)) for u, x, log in zip(unknowns, place, logs)}


def read(unknown: Unknown, value: float) -> float:
    """A parameter as a coordinate: the logarithm of a factor that cannot be zero."""
    return float(np.log(value)) if unknown.parameter.low > 0.0 else value
