"""Fits of hypotheses in the twin: Gauss-Newton, each judged by what gusts and starting states do to its own twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Track, Variation
from vpptwin.diagnosis.search.frame import Derivatives, Frame, Linearisation, Rows, weigh_windows, whiten
from vpptwin.diagnosis.search.likelihood import Likelihood, Response, couple_gusts, find_storms, tune_gust
from vpptwin.diagnosis.search.motion import choose_track
from vpptwin.diagnosis.search.responses import Regime, Responses
from vpptwin.diagnosis.search.shortlist import advance
from vpptwin.diagnosis.search.solution import Solution, price_of_freedom, scatter_by_stretch, solve_hypothesis
from vpptwin.diagnosis.search.suspects import Trial, Unknown, list_trials
from vpptwin.effects import Stage

ITERATIONS = 6
POLISH = 2
"""Steps of Gauss-Newton once a hypothesis has its own likelihood."""
ROUNDS, CALM = 4, 0.25
"""Times at most that gusts and parameters are fitted in turn; change of the log of the gusts under which that ends."""
SETTLED = 0.3
"""Drop in cost under which Gauss-Newton stops."""
NEAR = 0.25
"""Share of what a secant spans within which a derivative holds."""
SMALL = 0.1
"""Share of its typical size by which a parameter is moved for a derivative about a motion that is followed."""


@dataclass(frozen=True)
class Fit:
    """Effects fitted together in the twin.

    Attributes:
        effects: ids that were freed.
        values: their parameters.
        std: standard deviation of each, the other effects uncertain within their tolerance.
        covariance: of them, in that order, (n, n).
        cost: twice the negative log of the evidence on the fitted windows, up to a constant of the frame.
        about: linearisation near `values`.
        tolerated: what the effects that were not freed moved within their tolerance, parameter → value.
    """

    effects: frozenset[str]
    values: dict[Key, float]
    std: dict[Key, float]
    covariance: np.ndarray
    cost: float
    about: Linearisation
    tolerated: dict[Key, float]

    @property
    def frame(self) -> Frame:
        """What the cost is measured in."""
        return self.about.frame

    @property
    def likelihood(self) -> Likelihood:
        """What gusts and starting states do to a twin with `values`, or with values close to them."""
        return self.about.likelihood

    @property
    def likeliest(self) -> dict[Key, float]:
        """Every parameter where it is likeliest: those of the effects, the others within their tolerance."""
        return self.tolerated | self.values

    def stated_std(self, unknown: Unknown) -> float:
        """Standard deviation as reported: tempered as evidence is; of a strength also what its law may be wrong by."""
        criteria = self.frame.criteria
        std = float(np.sqrt(criteria.temper)) * self.std[unknown.key]
        if unknown.parameter not in unknown.effect.strengths:
            return std
        share = criteria.inexact_friction if unknown.effect.stage is Stage.FRICTION else criteria.inexact
        value = self.values[unknown.key]
        return float(np.hypot(std, share * abs(value if unknown.is_limit else value - unknown.nominal)))

    def evidence_against(self, other: Fit) -> float:
        """By how much the other costs more: twice the log of how much likelier this one is.

        Raises:
            ValueError: if they are of two frames.
        """
        check_frames([self, other])
        return other.cost - self.cost


def check_frames(fits: Sequence[Fit]) -> None:
    """Refuse to compare fits of two frames: other weights, other noise, other costs."""
    if any(fit.frame is not fits[0].frame for fit in fits):
        raise ValueError("fits of two frames have costs that cannot be compared; `reframe` and refit one of them")


def find_cheapest(fits: Sequence[Fit]) -> Fit:
    """The fit of least cost, the first of several; ValueError if they are of two frames."""
    check_frames(fits)
    return min(fits, key=lambda fit: fit.cost)


class Fitter:
    """Fits on one set of windows. It has no state but what it has computed: every fit brings its frame along.

    Args:
        bench: the windows to fit.
        unknowns: parameters under suspicion.
    """

    def __init__(self, bench: Bench, unknowns: Sequence[Unknown]) -> None:
        self.bench, self.unknowns = bench, tuple(unknowns)
        self.criteria = bench.criteria
        self.trials = list_trials(self.unknowns, bench)
        self.responses = Responses(bench)
        self._derivatives: dict[Regime, Derivatives] = {}
        floor = np.zeros(bench.valid.shape)
        self.start = self._settle(frozenset(), {}, self.dry_friction_of(frozenset()), floor, bench.track)
        """The twin as it is, in a frame of its own."""

    def dry_friction_of(self, effects: frozenset[str]) -> frozenset[str]:
        """Those of the effects, and of the nominal twin's, that make dry friction."""
        on = effects | {effect for effect, _ in self.bench.without_dry_friction}
        return frozenset(u.effect.id for u in self.unknowns if u.effect.stage is Stage.FRICTION) & on

    def sticks(self, effects: frozenset[str]) -> bool:
        """Whether any of the effects makes dry friction."""
        return bool(self.dry_friction_of(effects))

    def fit(
        self, effects: frozenset[str], values: Mapping[Key, float], known: Linearisation, iterations: int = ITERATIONS,
        turned: frozenset[str] | None = None,
    ) -> Fit:  # fmt: skip
        """Gauss-Newton on the parameters of `effects`; the others stay linear within their tolerance.

        Args:
            effects: ids to free.
            values: where to start.
            known: linearisation whose frame and likelihood are kept, and its derivatives by all other effects.
            iterations: at most.
            turned: effects by which derivatives are taken anew on the way, the others' as in `known`; None for all.
        """
        turned = effects if turned is None else turned
        point = {key: value for key, value in values.items() if key[0] in effects}
        about = self._linearise(point, turned, known)
        best, stride = (about, point, self._tolerate(about, effects).cost), 1.0
        for _ in range(iterations if effects else 0):
            about, point, cost = best
            ahead = advance(about, self.unknowns, effects, solve_hypothesis(about, self.unknowns, effects), stride)
            there = self._look(ahead, about)
            # The cost at a point, not at the minimum predicted from it, decides whether the step helped.
            cost_there = self._tolerate(there, effects).cost
            if not cost_there <= cost:
                if about.taken is not None and not np.array_equal(about.at, about.taken):  # a derivative misled it
                    best = (self._linearise(point, turned, about, 0.0), point, cost)
                    continue
                stride *= 0.4
                if stride < 0.1:
                    break
                continue
            best, stride = (there, ahead, cost_there), min(1.0, 2.0 * stride)
            if cost - cost_there < SETTLED:
                break
            best = (self._linearise(ahead, turned, there), ahead, cost_there)
        return self._sum_up(effects, *best)

    def judge_alone(self, fit: Fit) -> Fit:
        """The same hypothesis judged by its own likelihood: gusts as strong as it needs, acting through its own twin.

        A slider that sticks hardly feels its starting velocity or a gust; other effects leave the response to them
        nearly as it is. A real slider may yield where the twin's stands still, so that the likelier of its response
        and the nominal one sets the cost; parameters come from its own unless that is far less likely. The fit is
        polished; derivatives by effects that are not freed are kept. A rig that weighs otherwise costs its `doubt` too.
        """
        floor, sticking = fit.frame.floor, self.dry_friction_of(fit.effects)
        loose = self._polish(fit, self.responses.without_dry_friction(floor, fit.values))
        doubt = self.doubt(loose)
        if not sticking:
            return replace(loose, cost=loose.cost + doubt)
        tight = self._polish(fit, self.responses.find(sticking, floor, fit.values, fit.likelihood.gust))
        chosen = tight if tight.evidence_against(loose) > -self.criteria.yielding else loose
        return replace(chosen, cost=find_cheapest([tight, loose]).cost + doubt)

    def doubt(self, fit: Fit) -> float:
        """How much more a fit costs if gusts push a rig as heavy as its own, and are believed as with the nominal one.

        Noise in logged inputs and what a controller does against gusts act through the rig as it is: judged by what
        they do to a nominal twin, a heavier one, which they move less, is the likelier for that alone; judged with all
        that they do to its own, the smaller volume of what can happen makes it so. A cause must hold either way
        (Deming, Statistical Adjustment of Data, 1943: errors in both what is regressed and what on). What flies is left
        out: its inputs are commands, which have no noise, and less thrust is more weight.
        """
        floor, likelihood = fit.frame.floor, fit.likelihood
        if not self.bench.guessed or self.bench.spec.robot.afloat or not self.bench.weights(fit.values):
            return 0.0
        nominal = self.responses.find(frozenset(), floor, self.bench.loosen({}))
        heavy = couple_gusts(self.bench, self.responses.as_heavy(floor, fit.values), likelihood.gust, likelihood.storm)
        believed = couple_gusts(self.bench, nominal, likelihood.gust, likelihood.storm)
        about = fit.about.under(replace(heavy, logdet=believed.logdet), fit.frame)
        return max(self.fit(fit.effects, fit.values, about, POLISH).cost - fit.cost, 0.0)

    def reframe(self, fit: Fit) -> Fit:
        """Take a fit as the new state of knowledge: derivatives that belong to it, a frame of its own, and a refit.

        What is left of the misfit sets the scale: noise stronger than assumed makes every finding less certain.
        """
        return self._settle(fit.effects, fit.values, fit.likelihood.response.sticking, fit.frame.floor, fit.about.track)

    def rederive(self, fit: Fit) -> Fit:
        """The same fit with derivatives that belong to it, in the same frame."""
        known = self._derive(fit.effects, fit.values, fit.likelihood, fit.frame, fit.about.track)
        return self.judge_alone(replace(fit, about=self._linearise(fit.values, fit.effects, known)))

    def _polish(self, fit: Fit, response: Response) -> Fit:
        """Gusts as the fit needs them, and the fit as those gusts let it be, until neither moves the other."""
        for _ in range(ROUNDS):
            before = np.log(fit.likelihood.gust)
            likelihood = self._tune(fit.about, fit.effects, response)
            fit = self.fit(fit.effects, fit.values, fit.about.under(likelihood, fit.frame), POLISH)
            if np.abs(np.log(likelihood.gust) - before).max() < CALM:
                break
        return fit

    def _settle(
        self, effects: frozenset[str], values: Mapping[Key, float], sticking: frozenset[str], floor: np.ndarray,
        track: Track | None,
    ) -> Fit:  # fmt: skip
        """A fit in a new frame, which is found from what the hypothesis misses; `floor` serves until then."""
        plain = Frame(np.ones(self.bench.valid.size), 1.0, floor, self.criteria)
        assumed = np.ones(self.bench.spec.model.nv)
        likelihood = couple_gusts(self.bench, self.responses.find(sticking, floor, values), assumed)
        about = self._linearise(values, effects, self._derive(effects, values, likelihood, plain, track))
        floored = replace(plain, floor=self._find_floor(about.missed))
        response = self.responses.find(sticking, floored.floor, values)
        likelihood = self._tune(about, effects, response)
        about = about.under(likelihood, floored)
        residual = about.residual - about.columns.weigh(self._tolerate(about, effects).deviation)
        residuals = residual.reshape(len(self.bench.windows), -1)
        weight = weigh_windows(residuals, self.bench.valid, self.criteria.usual_misfit)
        scale = max(1.0, float(((residual * weight) ** 2).sum()) / response.freedom)
        frame = replace(floored, weight=weight, scale=scale)
        return self.judge_alone(self.fit(effects, values, about.under(likelihood, frame)))

    def _find_floor(self, missed: np.ndarray) -> np.ndarray:
        """A floor from what a twin misses, (K, M): a part of it is beyond what linearisation can follow."""
        floor = np.empty_like(missed)
        for columns in self.bench.columns:
            number = np.maximum(self.bench.valid[:, columns].sum(axis=1, keepdims=True), 1)
            rms = np.sqrt((missed[:, columns] ** 2).sum(axis=1, keepdims=True) / number)
            floor[:, columns] = self.criteria.nonlinear * rms
        return floor

    def _tune(self, about: Linearisation, effects: frozenset[str], response: Response) -> Likelihood:
        """The likelihood of a response under gusts as strong as the residual of a linearisation tells."""
        deviation = self._tolerate(about, effects).deviation
        left = response.restore(about.missed, about.track) - about.slopes.weigh(deviation)
        gust = tune_gust(self.bench, response, left, about.frame.scale)
        storm = find_storms(self.bench, response, left, gust, about.frame.scale) if self.bench.guessed else None
        return couple_gusts(self.bench, response, gust, storm)

    def _tolerate(self, about: Linearisation, effects: frozenset[str]) -> Solution:
        """Freed parameters held where they are, the others at their best within tolerance."""
        return solve_hypothesis(about, self.unknowns, effects, frozen=True)

    def cost_by_window(self, fit: Fit) -> np.ndarray:
        """What every window costs of a fit, (K,), what tolerances and freedom cost left out."""
        residual = fit.about.residual - fit.about.columns.weigh(self._tolerate(fit.about, fit.effects).deviation)
        square = (residual.reshape(len(self.bench.windows), -1) ** 2).sum(axis=1)
        return np.asarray(square / fit.frame.scale + fit.likelihood.logdet)

    def _sum_up(self, effects: frozenset[str], about: Linearisation, point: dict[Key, float], cost: float) -> Fit:
        solution = solve_hypothesis(about, self.unknowns, effects)
        std, tolerated = {}, {}
        scatter = scatter_by_stretch(about, solution, self.bench)
        for i, unknown in enumerate(self.unknowns):
            if unknown.effect.id in effects:
                std[unknown.key] = float(max(np.sqrt(solution.covariance[i, i]), scatter[i]))
            elif not unknown.is_limit:  # a limit has no tolerance about its nominal, which is far away
                tolerated[unknown.key] = float(unknown.parameter.clip(about.at[i] + solution.deviation[i]))
        freed = [i for i, unknown in enumerate(self.unknowns) if unknown.key in std]
        spread = np.array(list(std.values())) / np.sqrt(np.diag(solution.covariance)[freed])
        covariance = solution.covariance[np.ix_(freed, freed)] * spread * spread[:, None]
        cost += float(about.likelihood.logdet.sum()) + price_of_freedom(solution, self.unknowns, effects)
        return Fit(effects, point, std, covariance, cost, about, tolerated)

    def _derive(
        self, effects: frozenset[str], values: Mapping[Key, float], likelihood: Likelihood, frame: Frame,
        track: Track | None,
    ) -> Linearisation:  # fmt: skip
        """Derivatives about a twin with these effects.

        Only what sticks, and what is large, changes the derivatives by everything else much, so that they are taken
        once for every set of such effects, at the parameters that are asked for first. No frame changes them.
        """
        regime = self.dry_friction_of(effects), self.bench.regime(values)
        if regime not in self._derivatives:
            every, guessed = range(len(self.unknowns)), self.bench.guessed
            first = next(iter(self._derivatives.values()), None) if guessed else None
            found = self._differentiate(values, every, self.trials if first is None else (), track)
            # Where every effect is tried at several sizes, that is done once: it only finds where to start.
            self._derivatives[regime] = found if first is None else (*found[:4], first[4])
        return whiten(self._derivatives[regime], likelihood, frame)

    def _linearise(
        self, values: Mapping[Key, float], effects: frozenset[str], known: Linearisation, near: float = NEAR
    ) -> Linearisation:
        """About a twin with `values`: derivatives by `effects` anew, unless `known` has them; all else as there.

        Within a share `near` of what secants span, derivatives stay as they are.
        """
        wanted = [i for i, unknown in enumerate(self.unknowns) if unknown.effect.id in effects]
        place = self._place(values)
        if effects == known.turned and known.taken is not None:
            spans = np.array([self._span(u, at) for u, at in zip(self.unknowns, known.taken)])
            if np.all(np.abs(place - known.taken) <= near * np.abs(spans)):
                return known if np.array_equal(known.at, place) else self._look(values, known)
        at, slopes, missed, track, _ = self._differentiate(values, wanted, (), self._retrack(values, known))
        return replace(known.move(at, wanted, slopes.common, missed, track), turned=effects, taken=at)

    def _look(self, values: Mapping[Key, float], known: Linearisation) -> Linearisation:
        """About a twin with `values`, all derivatives as in `known`."""
        track = self._retrack(values, known)
        missed = self.bench.about(track).residual(values)
        return known.move(self._place(values), [], known.slopes.common[:0], missed, track)

    def _retrack(self, values: Mapping[Key, float], known: Linearisation) -> Track | None:
        """The track that is likeliest with a twin with `values`, to first order, if tracks are followed.

        What a parameter explains the pulses need not: about a track with both, it would act twice.
        """
        if self.bench.followed is None:
            return known.track
        return choose_track(self.bench, known.likelihood, known.foretell(self._place(values)))

    def _place(self, values: Mapping[Key, float]) -> np.ndarray:
        """All unknowns in a twin with `values`, (P,)."""
        return np.array([values.get(u.key, u.nominal) for u in self.unknowns])

    def _span(self, unknown: Unknown, at: float) -> float:
        """What a secant from a value spans: a small share of a step of what acts smoothly where motion is followed.

        Pulses of a track leave of a parameter what is alike in all windows: about the same motion, which a typical size
        would turn by a third of a radian.
        """
        rough = unknown.is_limit or unknown.effect.placed or unknown.effect.stage in (Stage.FRICTION, Stage.SLIP)
        return unknown.step_from(at) * (1.0 if self.bench.followed is None or rough else SMALL)

    def _differentiate(
        self, values: Mapping[Key, float], wanted: Sequence[int], trials: Sequence[Trial], track: Track | None
    ) -> Derivatives:
        """Of a twin with `values` about a track: see `Derivatives`; slopes are those by the unknowns `wanted`."""
        at = self._place(values)
        steps = np.array([self._span(self.unknowns[i], at[i]) for i in wanted])
        variations = [Variation(dict(values))]
        for i, step in zip(wanted, steps):
            moved = self.unknowns[i].parameter.clip(at[i] + step)  # rounding may lead past a bound
            variations.append(Variation({**values, self.unknowns[i].key: float(moved)}))
        # A trial of what is switched on already would replace it.
        on = {key[0] for key in values}
        variations += [Variation({**values, **({} if t.effect in on else t.values)}) for t in trials]
        predicted = self.bench.about(track).predict(variations, values)
        missed, changed = self.bench.miss(predicted[0]), self.bench.bound(predicted[1:] - predicted[0])
        return at, Rows(changed[: len(wanted)] / steps[:, None, None]), missed, track, changed[len(wanted) :]
