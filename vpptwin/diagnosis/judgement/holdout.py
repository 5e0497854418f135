"""Flights that no fit has seen: what a twin's predictions are worth on them, before and after it was extended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from vpptwin.diagnosis.evidence.bench import Bench, Key, Track, Variation, keep_last
from vpptwin.diagnosis.evidence.channels import BIN
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.judgement.blocks import blocks_of, improvement, resample, sum_blocks, tell_apart, to_deviations
from vpptwin.diagnosis.search.fits import Fit, check_frames
from vpptwin.diagnosis.search.likelihood import Likelihood, Response, couple_gusts, measure_response
from vpptwin.diagnosis.search.motion import follow_motion, shift_track
from vpptwin.effects import find_effect
from vpptwin.estimation.initial import estimate_states
from vpptwin.twin.manifold import difference_poses

Values = frozenset[tuple[Key, float]]
RESPONSES = 8
"""Responses that are kept, those asked for last: each has tens of megabytes."""
REWEIGHTED = 5
"""Times that parameters are found anew with windows that go astray counting less."""
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

    def as_dict(self) -> dict[str, object]:
        """The score in the form of SPEC 7, velocities added."""
        return asdict(self)


class HeldOut:
    """Held-out windows, short ones to judge likelihood and long ones for errors over the horizon.

    Args:
        short: windows of the length that is fitted, channels observed.
        long: windows as long as the last horizon, started from states estimated without looking ahead.
    """

    def __init__(self, short: Bench, long: Bench) -> None:
        self.short, self.long, self.criteria = short, long, short.criteria
        self._responses: dict[Values, Response] = {}
        self._misfits: dict[Values, tuple[np.ndarray, np.ndarray]] = {}
        self._missed: dict[Values, tuple[np.ndarray, Track | None]] = {}
        self._errors: dict[Values, dict[str, np.ndarray]] = {}
        self._spreads: dict[tuple[Values, bytes], tuple[np.ndarray, np.ndarray]] = {}
        self._plain = short.about(None)
        self._tracks: dict[Values, tuple[Response, np.ndarray, Track]] = {}

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
        loose = self.response(self.short.loosen(fit.values)), *self.miss(fit.likeliest)
        for response, missed, track in (loose, self.follow(fit)) if sticks else (loose,):
            likelihood = couple_gusts(self.short, response, gust)
            left, price = likelihood.whiten(response.restore(missed, track)) / np.sqrt(fit.frame.scale), 0.0
            if self.short.guessed and fit.effects and response is loose[0]:
                left, price = self._adapt(fit, likelihood, left)
            found.append(self._temper(left)[0] + likelihood.logdet + price / self.count)
        return -2.0 * (logsumexp(-0.5 * np.array(found), axis=0) - np.log(len(found)))

    def _temper(self, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squares of whitened residuals, and by how much of theirs they grow with them, (K,) each.

        As in the fit, a window that goes astray must not outvote the others.
        """
        square = (left**2).sum(axis=1)
        usual = self.criteria.usual_misfit * float(np.median(square))
        share = usual / np.maximum(square, max(usual, 1e-300))
        return np.where(share < 1.0, usual * (1.0 - np.log(share)), square), share

    def _adapt(self, fit: Fit, likelihood: Likelihood, left: np.ndarray) -> tuple[np.ndarray, float]:
        """Whitened residual (K, M) with the likeliest of the parameters that the fit leaves open, and what that costs.

        Where what was fitted tells less of them than the held-out windows do, as where these are longer and a rig falls
        over, chance decides else between two causes that do the same (Laplace: squares there, with their price, are
        twice the negative log of the density that all parameters together predict).
        """
        axes, changed = self._spread(fit)
        unit = np.sqrt(fit.frame.scale)
        moved, step, hessian = likelihood.whiten(changed) / unit, np.zeros(len(axes)), np.eye(len(axes))
        for _ in range(REWEIGHTED):
            weighed = moved * self._temper(left - np.tensordot(step, moved, 1))[1][:, None]
            hessian = np.eye(len(axes)) + np.einsum("ikm,jkm->ij", weighed, moved)
            step = np.linalg.solve(hessian, np.einsum("ikm,km->i", weighed, left))
        price, away = float(np.linalg.slogdet(hessian)[1]), float(step @ step)
        found = shift_track(self.short, self._move(fit, axes @ step), likelihood.response)
        there = likelihood.whiten(likelihood.response.restore(*found)) / unit
        better = self._temper(there)[0].sum() + away < self._temper(left)[0].sum()
        return (there, price + away) if better else (left, price)

    def _spread(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """Axes of what a fit leaves open, in columns a standard deviation long, and changes along them, (n, K, M)."""
        key = frozenset(fit.likeliest.items()), fit.covariance.tobytes()
        if key not in self._spreads:
            variance, axes = np.linalg.eigh(self.criteria.temper * fit.covariance)
            axes = axes * np.sqrt(np.maximum(variance, 0.0))
            variations = [Variation(values) for values in (fit.likeliest, *(self._move(fit, axis) for axis in axes.T))]
            predicted = self._plain.predict(variations, fit.likeliest)
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

    def worsens(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> bool:
        """Whether an error of the pose up to `watched` ahead grows by more than `worse` and a standard error."""
        near = sum(horizon <= self.criteria.watched for horizon in HORIZONS_S)
        ratios = self.error_ratios(before, after)
        few = len(self.long.windows) < self.criteria.judges and self.long.guessed
        if few:  # a scatter of two or three tells nothing, and chi² has the word
            return False
        grown = [tell_apart(ratios[name][:, :near]) for name in set(ratios) & {"m", "rad"}]
        return any(bool(np.any(mean - error > np.log1p(self.criteria.worse))) for mean, error in grown)

    def is_worse(self, before: Mapping[Key, float], after: Mapping[Key, float], sticks: bool) -> bool:
        """Whether a twin with `after` predicts worse than one with `before`: nearby, or altogether."""
        return self.worsens(before, after) or self.is_farther(before, after, sticks)

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

    def prefer(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> float:
        """By how many standard errors the errors over all horizons favour `after`, fewer where few blocks tell them."""
        ratios = np.stack([np.nanmean(rows, axis=1) for rows in self.error_ratios(before, after).values()])
        growth = np.nanmean(ratios, axis=0)
        mean, error = tell_apart(growth[:, None])
        times, number = float(-mean[0] / max(error[0], 1e-12)), int(np.isfinite(growth).sum())
        return to_deviations(times, number) if number < self.criteria.judges else times

    def feels(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> bool:
        """Whether errors of the pose up to `watched` ahead fall by as much as noise makes, and not by chance.

        In short windows, whose starting states are fitted, those take up much of what such errors show.
        """
        (first, second), noise = map(self.squares, (before, after)), self._noise
        near = sum(horizon <= self.criteria.watched for horizon in HORIZONS_S)
        drops = [(np.nanmean(first[n] - second[n], axis=0) / noise[n])[:near] for n in set(first) & {"m", "rad"}]
        return bool(np.max(drops) > self.criteria.felt) and self.prefer(before, after) > self.criteria.sigmas_held_out

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

    def error_ratios(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> dict[str, np.ndarray]:
        """Log of error after over error before in every block of flight and per horizon, (B, H); as `squares` names.

        Root mean squares of blocks are compared, noise of the sensors added to both: no single slip decides.
        """
        first, second, noise = self.squares(before), self.squares(after), self._noise
        blocks = blocks_of(self.long.windows, self.criteria.block)
        found = {}
        for name in first:
            measured = sum_blocks(np.isfinite(first[name]).astype(float), blocks)
            sums = [sum_blocks(np.nan_to_num(part[name]), blocks) + noise[name] * measured for part in (first, second)]
            with np.errstate(invalid="ignore"):  # a block without measurements is NaN
                found[name] = 0.5 * np.log(sums[1] / sums[0])
        return found

    @cached_property
    def _noise(self) -> dict[str, np.ndarray]:
        """Variance that sensors, and estimates of starting states, put into errors near every horizon, (H,) each.

        Where nobody told how good sensors are, so do the estimates: by how far one that looks ahead too is from one
        that doesn't.
        """
        rotary, windows, horizons = self.long.spec.robot.rotary, self.long.windows, np.array(HORIZONS_S)
        off = np.zeros((2, len(rotary)))
        if self.long.guessed and self.long.flights:
            model = self.long.spec.model
            for i in np.unique(windows.flight):
                rows = windows.flight == i
                seen = estimate_states(self.long.flights[i], windows.start[rows], model, False)
                moved = difference_poses(model, seen[0], windows.pose[rows])
                off += ((moved**2).sum(axis=0), ((seen[1] - windows.velocity[rows]) ** 2).sum(axis=0))
            off /= len(windows)
        found: dict[str, np.ndarray] = {}
        for channel in self.long.channels:
            if channel.kind in ("position", "velocity"):
                unit, (place, speed) = "rad" if rotary[channel.axis] else "m", off[:, channel.axis]
                name, start = (
                    (unit, place + speed * horizons**2) if channel.kind == "position" else (channel.name, speed)
                )
                found[name] = found.get(name, 0.0) + channel.sensor_std**2 + start + 0.0 * horizons
        return found

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
        """Mean squared pose residual over sensor variance with each window's starting state fitted (SPEC 7)."""
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
        found = {name: mean_over(parts) for name, parts in self.squares(values).items()}
        rates = {name: found[name] for name in found if name not in ("m", "rad")}
        return Score(found.get("m"), found.get("rad"), rates, self.chi2(values))

    def squares(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        """Squared errors of every long window near every horizon, (K, H): of slides "m", hinges "rad", and rates."""
        errors, rotary = self.errors(values), self.long.spec.robot.rotary
        squares: dict[str, np.ndarray] = {}
        for channel in self.long.channels:
            if channel.name in errors:
                unit = "rad" if rotary[channel.axis] else "m"
                name, near = unit if channel.kind == "position" else channel.name, errors[channel.name]
                squares[name] = squares[name] + near if name in squares else near
        return squares

    def errors(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        """The same of every channel of a position or a velocity, by its name."""
        key = frozenset(values.items())
        if key not in self._errors:
            self._errors[key] = self._measure_errors(values)
        return self._errors[key]

    def locate_miss(self, values: Mapping[Key, float]) -> tuple[str, float | None, float, str]:
        """Where a twin is off most of what its sensors make: joint, from which horizon [s] on, error at the last, unit.

        An error stands out at twice the sensors' noise, or at none: then the horizon is None.
        """
        worst: tuple[float, str, float | None, float, str] = (-1.0, "", None, 0.0, "")
        for channel in self.long.channels:
            if channel.kind == "position":
                rmse, noise = mean_over(self.errors(values)[channel.name]), channel.sensor_std
                out = next((h for h, error in zip(HORIZONS_S, rmse) if error > 2.0 * noise), None)
                found = rmse[-1] / noise, channel.name, out, rmse[-1], channel.unit
                worst = max(worst, found, key=lambda each: each[0])
        return worst[1:]

    def _measure_errors(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        square = np.where(self.long.valid, self.long.residual(values), np.nan) ** 2
        return {
            channel.name: np.stack([last_bins(square[:, columns], h) for h in HORIZONS_S], axis=1)
            for channel, columns in zip(self.long.channels, self.long.columns)
            if channel.kind in ("position", "velocity")
        }

    def change(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> dict[str, list[tuple[float, float]]]:
        """90 % intervals of the change in error per horizon, as a share of the error before, by resampling blocks."""
        first, second = self.squares(before), self.squares(after)
        blocks = blocks_of(self.long.windows, self.criteria.block)
        named = {"m": "position_rmse_m", "rad": "angle_rmse_rad"}
        result = {}
        for name, old in first.items():
            sums = np.stack([sum_blocks(np.nan_to_num(part), blocks) for part in (old, second[name])])
            drawn = resample(sums)  # both are divided by the same number of windows
            share = np.sqrt(drawn[:, 1] / np.maximum(drawn[:, 0], 1e-30)) - 1.0
            low, high = np.quantile(share, [0.05, 0.95], axis=0)
            result[named.get(name, name)] = [(float(a), float(b)) for a, b in zip(low, high)]
        return result

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


def last_bins(square: np.ndarray, horizon: float) -> np.ndarray:
    """Mean of the last two bins up to a horizon [s] in every window, (K,); NaN where nothing was measured."""
    end = round(horizon / BIN)
    part = square[:, max(end - 2, 0) : end]
    number = np.isfinite(part).sum(axis=1)
    return np.where(number > 0, np.nansum(part, axis=1) / np.maximum(number, 1), np.nan)


def mean_over(squares: np.ndarray) -> list[float]:
    """Root of the mean over windows that were measured, per horizon."""
    number = np.isfinite(squares).sum(axis=0)
    mean = np.where(number > 0, np.nansum(squares, axis=0) / np.maximum(number, 1), np.nan)
    return [float(v) for v in np.sqrt(mean)]
