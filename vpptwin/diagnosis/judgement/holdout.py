"""Flights that no fit has seen: what a twin's predictions are worth on them, before and after it was extended."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.special import logsumexp

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import SHOWN
from vpptwin.diagnosis.evidence.runs import Key, Track, Variation, keep_last
from vpptwin.diagnosis.judgement.blocks import blocks_of, improvement, resample, sum_blocks
from vpptwin.diagnosis.judgement.errors import PredictionErrors, mean_over
from vpptwin.diagnosis.search.fits import Fit, check_frames
from vpptwin.diagnosis.search.likelihood import Likelihood, Response, couple_gusts, measure_response
from vpptwin.diagnosis.search.motion import follow_motion, shift_track
from vpptwin.effects import find_effect
from vpptwin.inference.covariance import logdet, solve

Folds = tuple[np.ndarray, Sequence[Mapping[Key, float]]]
"""Fold of every window, and parameters fitted to all other folds."""
Values = frozenset[tuple[Key, float]]
RESPONSES = 8
"""Responses that are kept, those asked for last: each has tens of megabytes."""
SURPRISES = 256
"""Surprises that are kept: one fit is weighed against many, and against one more than once."""
REWEIGHTED = 5
"""Times that parameters are found anew with windows that go astray counting less."""
ROUNDING = 1e-6
"""Share by which chi² may differ for the six digits that a twin file has."""
LEAST = 0.01
"""Least excess chi² of which there are shares."""


@dataclass(frozen=True)
class Score:
    """Error of one twin on held-out windows.

    Attributes:
        position_rmse_m: root mean square over slide joints per horizon; None where the rig has none.
        angle_rmse_rad: the same over hinges.
        velocity_rmse: joint → root mean square error of its velocity per horizon [m/s or rad/s], where logged.
        chi2: mean squared pose residual over sensor variance, starting states fitted; 1 is the noise floor.
    """

    position_rmse_m: list[float] | None
    angle_rmse_rad: list[float] | None
    velocity_rmse: dict[str, list[float]]
    chi2: float

    @property
    def ahead(self) -> dict[str, float]:
        """Errors of the pose `SHOWN` ahead, by their keys."""
        poses = {"position_rmse_m": self.position_rmse_m, "angle_rmse_rad": self.angle_rmse_rad}
        return {name: errors[SHOWN] for name, errors in poses.items() if errors is not None}

    def as_dict(self) -> dict[str, object]:
        """The score as `before` and `after` of verdict.json have it (docs/diagnose.md)."""
        return asdict(self)


class HeldOut:
    """Held-out windows, short ones to judge likelihood and long ones for errors over the horizon.

    Args:
        short: windows of the length that is fitted, channels observed.
        long: windows as long as the last horizon, started from states estimated without looking ahead.
    """

    def __init__(self, short: Bench, long: Bench) -> None:
        self.short, self.errors, self.criteria = short, PredictionErrors(long), short.criteria
        self._responses: dict[Values, Response] = {}
        self._misfits: dict[Values, tuple[np.ndarray, np.ndarray]] = {}
        self._missed: dict[Values, tuple[np.ndarray, Track | None]] = {}
        self._spreads: dict[tuple[Values, bytes, bool], tuple[np.ndarray, np.ndarray]] = {}
        self._surprises: dict[Hashable, np.ndarray] = {}
        self._plain = short.about(None)
        self._tracks: dict[Values, tuple[Response, np.ndarray, Track]] = {}

    def divide(self, short: Folds, long: Folds) -> None:
        """Judge every window by parameters of fits that have not seen it: see `Bench.folds`."""
        for bench, folds in ((self.short, short), (self._plain, short), (self.errors.bench, long)):
            bench.folds = folds

    @property
    def count(self) -> int:
        """Number of windows that judge."""
        return len(self.short.windows)

    def response(self, values: Mapping[Key, float]) -> Response:
        """What starting states and unmodelled forces do to a twin with `values` on the short windows."""
        key = frozenset(values.items())
        found = self._responses.pop(key, None) or measure_response(self.short, values)
        return keep_last(self._responses, key, found, RESPONSES)

    def likelihood(self, values: Mapping[Key, float], gust: np.ndarray | None = None) -> Likelihood:
        """How improbable residuals of a twin with `values` are, gusts `gust` times as strong as assumed, (nv,)."""
        strength = np.ones(self.short.spec.model.nv) if gust is None else gust
        return couple_gusts(self.short, self.response(values), strength)

    def surprise(self, fit: Fit, sticks: bool, gust: np.ndarray | None = None) -> np.ndarray:
        """Twice the negative log of the density that a fit predicts for every short window, (K,).

        Args:
            fit: effects with their values, the strength of the gusts beside them, and the frame.
            sticks: one of them is dry friction. Then every window may have the response of the nominal twin as well as
                the fit's own: a real slider slips a little earlier or later than the twin's.
            gust: strength of the gusts, (nv,); None for the fit's own.
        """
        gust, found = fit.likelihood.gust if gust is None else gust, []
        point = frozenset(fit.likeliest.items()), frozenset(fit.values), fit.covariance.tobytes()
        key = *point, fit.frame.scale, sticks, gust.tobytes()
        if key in self._surprises:
            return self._surprises[key]
        seen = [(self.short, self.response(self.short.loosen(fit.values)), *self.miss(fit.likeliest))]
        seen += [(self.short.about(found[2]), *found) for found in ([self.follow(fit)] if sticks else [])]
        for bench, response, missed, track in seen:
            likelihood = couple_gusts(self.short, response, gust)
            left, price = likelihood.whiten(response.restore(missed, track)) / np.sqrt(fit.frame.scale), 0.0
            if self.short.guessed and fit.effects:
                left, price = self._adapt(fit, likelihood, left, bench)
            found.append(self._temper(left)[0] + likelihood.logdet + price / self.count)
        surprise = -2.0 * (logsumexp(-0.5 * np.array(found), axis=0) - np.log(len(found)))
        return keep_last(self._surprises, key, surprise, SURPRISES)

    def _temper(self, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squares of whitened residuals, and by how much of theirs they grow with them, (K,) each.

        As in the fit, a window that goes astray must not outvote the others.
        """
        square = (left**2).sum(axis=1)
        usual = self.criteria.usual_misfit * float(np.median(square))
        share = usual / np.maximum(square, max(usual, 1e-300))
        return np.where(share < 1.0, usual * (1.0 - np.log(share)), square), share

    def _adapt(
        self, fit: Fit, likelihood: Likelihood, left: np.ndarray, bench: Bench
    ) -> tuple[np.ndarray, float]:  # fmt: skip
        """Whitened residual (K, M) with the likeliest of the parameters that the fit leaves open, and what that costs.

        Where what was fitted tells less of them than the held-out windows do, as where these are longer and a rig falls
        over, chance decides else between two causes that do the same (Laplace: squares there, with their price, are
        twice the negative log of the density that all parameters together predict).
        """
        axes, changed = self._spread(fit, bench)
        unit = np.sqrt(fit.frame.scale)
        moved, step, hessian = likelihood.whiten(changed) / unit, np.zeros(len(axes)), np.eye(len(axes))
        for _ in range(REWEIGHTED):
            weighed = moved * self._temper(left - np.tensordot(step, moved, 1))[1][:, None]
            hessian = np.eye(len(axes)) + np.einsum("ikm,jkm->ij", weighed, moved)
            step = solve(hessian, np.einsum("ikm,km->i", weighed, left))
        price, away = float(logdet(hessian)), float(step @ step)
        found = shift_track(bench, self._move(fit, axes @ step), likelihood.response)
        there = likelihood.whiten(likelihood.response.restore(*found)) / unit
        better = self._temper(there)[0].sum() + away < self._temper(left)[0].sum()
        return (there, price + away) if better else (left, price)

    def _spread(self, fit: Fit, bench: Bench) -> tuple[np.ndarray, np.ndarray]:
        """Axes of what a fit leaves open, columns a standard deviation long, and changes along them, (n, K, M)."""
        key = frozenset(fit.likeliest.items()), fit.covariance.tobytes(), bench is self.short
        if key not in self._spreads:
            variance, axes = np.linalg.eigh(self.criteria.temper * fit.covariance)
            axes = axes * np.sqrt(np.maximum(variance, 0.0))
            variations = [Variation(values) for values in (fit.likeliest, *(self._move(fit, axis) for axis in axes.T))]
            predicted = bench.predict(variations, fit.likeliest)
            changed = self.short.bound(predicted[1:] - predicted[0])
            keep_last(self._spreads, key, (axes, changed), RESPONSES)
        return self._spreads[key]

    def _move(self, fit: Fit, step: np.ndarray) -> dict[Key, float]:
        """The likeliest parameters of a fit with those of its effects so far away, within bounds."""
        values = fit.likeliest
        for key, by in zip(fit.std, step):
            parameter = find_effect(self.short.spec.catalogue, key[0]).parameter(key[1])
            values[key] = float(parameter.clip(np.array(fit.values[key] + by)))
        return values

    def follow(self, fit: Fit) -> tuple[Response, np.ndarray, Track]:
        """Response and residual of a fit's twin about the motion that is likeliest with it, and that."""
        key = frozenset(fit.likeliest.items())
        found = self._tracks.pop(key, None)
        if found is None:
            track = follow_motion(self.short, fit.likeliest, fit.likelihood.gust)
            bench = self.short.about(track)
            found = measure_response(bench, fit.likeliest), bench.residual(fit.likeliest), track
        return keep_last(self._tracks, key, found, RESPONSES)

    def weigh(self, before: tuple[Fit, bool], after: tuple[Fit, bool]) -> tuple[float, float]:
        """Drop in surprise from one fit to another and its standard error.

        Both are tried with the gusts of either and judged with those that suit them: how strongly it blew on the
        flights that were fitted must not decide about these.

        Args:
            before: a fit, and whether it sticks.
            after: another of the same frame.
        """
        check_frames([before[0], after[0]])
        gusts = [fit.likelihood.gust for fit, _ in (before, after)]
        found = [
            min((self.surprise(fit, sticks, gust) for gust in gusts), key=lambda surprise: float(surprise.sum()))
            for fit, sticks in (before, after)
        ]
        return improvement(found[0], found[1], self.criteria.most_drop)

    def is_worse(self, before: Mapping[Key, float], after: Mapping[Key, float], sticks: bool) -> bool:
        """Whether a twin with `after` predicts worse than one with `before`: nearby, or altogether."""
        return self.errors.worsens(before, after) or self.is_farther(before, after, sticks)

    def is_farther(self, before: Mapping[Key, float], after: Mapping[Key, float], sticks: bool) -> bool:
        """Whether a twin with `after` has the larger chi²; below 1, the sensors' noise, none is.

        Where it sticks, when a slider slips that another twin lets glide makes chi² up to `even` larger by chance.
        Where disturbances are but assumed, so does a single window that one disturbs: all of them must show it.
        """
        if self.chi2(after) <= max((1.0 + self.criteria.even * sticks) * self.chi2(before), 1.0):
            return False
        if not self.short.guessed:
            return True
        drop, error = self.drop_of_chi2(before, after)
        return drop < -self.criteria.sigmas_against * error

    def breaks_promise(self, before: Mapping[Key, float], after: Mapping[Key, float], sticks: bool) -> bool:
        """Whether a twin with `after` may not be written in place of one with `before`: its held-out chi² is larger.

        Or an error of the pose ahead is, beyond chance. No window is excused here, as in `is_farther`: what is written
        predicts as well as what was given, or better. The exceptions are chi² below 1, the sensors' noise, and
        `even` where it sticks.
        """
        most = max((1.0 + self.criteria.even * sticks) * self.chi2(before), 1.0)
        return self.chi2(after) > most * (1.0 + ROUNDING) or self.errors.grow(before, after)

    def settles(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> bool:
        """Whether most of a chi² far above the noise goes, and not by chance: gusts are but assumed to make it."""
        (first, second), criteria = map(self.chi2, (before, after)), self.criteria
        if first <= criteria.missed or second - 1.0 > criteria.settled * (first - 1.0):
            return False
        drop, error = self.drop_of_chi2(before, after)
        return drop > criteria.sigmas_held_out * error

    def drop_of_chi2(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> tuple[float, float]:
        """Drop in squares over sensor variance, summed over the short windows, and its standard error."""
        given, extended = (self.chi2_by_window(values)[0] for values in (before, after))
        return improvement(given, extended, self.criteria.most_drop)

    def miss(self, values: Mapping[Key, float]) -> tuple[np.ndarray, Track | None]:
        """Measured less predicted in the short windows, (K, M), and the track of a twin with `values`, if any."""
        key = frozenset(values.items())
        if key not in self._missed:
            response = self.response(self.short.loosen(values))
            self._missed[key] = shift_track(self.short, values, response)
        return self._missed[key]

    def residual(self, values: Mapping[Key, float]) -> np.ndarray:
        """The same without a track, to first order, (K, M); 0 where nothing was measured."""
        return self.response(self.short.loosen(values)).restore(*self.miss(values))

    def chi2(self, values: Mapping[Key, float]) -> float:
        """Mean squared pose residual over sensor variance, starting states fitted; 1 is the noise floor."""
        squares, count = self.chi2_by_window(values)
        return float(squares.sum() / max(count.sum(), 1))

    def chi2_by_window(self, values: Mapping[Key, float]) -> tuple[np.ndarray, np.ndarray]:
        """Squared pose residual over sensor variance and its degrees of freedom in every short window, (K,) each."""
        key = frozenset(values.items())
        if key not in self._misfits:
            pose, residual = self.short.of_poses, self._plain.residual(values)
            # What sticks leaves a wrong starting state no way out; a real slider yields.
            twins = {frozenset(twin.items()): twin for twin in (self.short.loosen(values), values)}
            starts = [
                self._responses.get(name) or measure_response(self.short, twin, pushed=False)
                for name, twin in twins.items()
            ]
            found = [(start.whiten_some(pose).apply(residual[:, pose]) ** 2).sum(axis=1) for start in starts]
            free = self.short.valid[:, pose].sum(axis=1) - 2 * self.short.windows.free_dofs
            self._misfits[key] = min(found, key=lambda square: float(square.sum())), free
        return self._misfits[key]

    def score(self, values: Mapping[Key, float]) -> Score:
        """Errors over the horizon from causally estimated states, and chi2."""
        found = {name: mean_over(parts) for name, parts in self.errors.squares(values).items()}
        rates = {name: found[name] for name in found if name not in ("m", "rad")}
        return Score(found.get("m"), found.get("rad"), rates, self.chi2(values))

    def share_removed(
        self, without: Mapping[Key, float], after: Mapping[Key, float], before: Mapping[Key, float]
    ) -> tuple[float, tuple[float, float]]:
        """Share of the excess chi2 of `before` by which `after` is better than `without`, with its 90 % interval."""
        found = [self.chi2_by_window(values) for values in (without, after, before)]
        squares = np.stack([squares for squares, _ in found])
        number = found[0][1]
        blocks = blocks_of(self.short.windows, self.criteria.block)
        sums = np.stack([sum_blocks(row[:, None], blocks) for row in (*squares, number)])
        drawn = resample(sums)[..., 0]
        drawn = np.concatenate([sums.sum(axis=1).T, drawn])
        excess = np.maximum(drawn[:, 2] - drawn[:, 3], LEAST * drawn[:, 3])
        share = (drawn[:, 0] - drawn[:, 1]) / excess
        low, high = np.quantile(share[1:], [0.05, 0.95])
        return float(share[0]), (float(low), float(high))
