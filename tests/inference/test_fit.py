"""Fits of hypotheses on toy simulators: the optimum, its evidence, and tolerances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.inference.toys import Linear, Toy, draw_linear, name_unknown, simulate
from vpptwin.inference.fit import SETTLED, STEPS, WIDEST, Fitter, Point
from vpptwin.inference.model import Scales

RATE, OFFSET = ("decay", "rate"), ("zero", "offset")
TOLERANCE = 0.2
"""Of an effect; a tolerance of this size is two to three times its standard error."""


def decay(point: Point) -> np.ndarray:
    """Ten windows of 1.2 s in two channels, each a decay from another height onto an offset, (10, 24)."""
    rate, offset = point.get(RATE, 1.0), point.get(OFFSET, 0.0)
    height = np.linspace(1.0, 3.0, 10)[:, None]
    return height * np.exp(-rate * np.tile(np.linspace(0.1, 1.2, 12), 2)) + offset


def draw_decay(rate: float, seed: int) -> Toy:
    """Measurements of a decay, with an offset of 0.3, noise that is known, and starting states known well."""
    toy = simulate(decay, {RATE: rate, OFFSET: 0.3}, seed)
    prior = replace(toy.scale_prior, sensor_std=np.full(2, 1e-3), process_median=np.full(2, 1.0))
    return replace(toy, scale_prior=replace(prior, process_std=np.full(2, 1e-3)))


DECAY = [replace(name_unknown(*RATE, mean=1.0), std=2.0, low=0.05, high=20.0), name_unknown(*OFFSET)]


@pytest.mark.parametrize("rate", [0.3, 1.0, 3.0, 6.0])
def test_fit_finds_the_optimum_of_a_dense_grid(rate: float) -> None:
    """From a rate of 1/s; it may stop once a step gains less than what counts as settled."""
    toy = draw_decay(rate, 1)
    fit = Fitter(toy, DECAY).fit(frozenset({"decay", "zero"}), {})
    scales = fit.posterior.scales
    inverse = np.linalg.inv(toy.covariance(scales))
    constant = toy.density(np.zeros(toy.noise.shape), scales)

    def density(point: Point) -> float:
        left, away = toy.measured - decay(point), [(point[u.key] - u.mean) / u.std for u in DECAY]
        return constant - 0.5 * float(np.einsum("ki,kij,kj->", left, inverse, left) + np.square(away).sum())

    rates, offsets = rate * np.linspace(0.8, 1.25, 46), np.linspace(0.2, 0.4, 21)
    grid = {(r, o): density({RATE: r, OFFSET: o}) for r in rates for o in offsets}
    best = max(grid, key=grid.__getitem__)
    assert rates[0] < best[0] < rates[-1]
    assert offsets[0] < best[1] < offsets[-1]
    assert density(fit.values) > grid[best] - SETTLED
    assert np.isclose(-0.5 * (fit.posterior.deviance - toy.scale_prior.cost(scales)), density(fit.values), atol=1e-5)
    spacing = rates[1] - rates[0], offsets[1] - offsets[0]
    for found, at, apart, std in zip(fit.values.values(), best, spacing, fit.std.values()):
        assert abs(found - at) < 0.5 * std + apart


@pytest.mark.parametrize(("start", "steps"), [(-1.5, STEPS), (2.5, STEPS), (1.5, STEPS)])
def test_a_fit_converges_where_whole_steps_overshoot(start: float, steps: int) -> None:
    """Steps of Gauss-Newton grow without end on an arc tangent from there; shorter ones lead to its middle."""
    height = np.linspace(0.5, 1.5, 10)[:, None] * np.ones(24)

    def bend(point: Point) -> np.ndarray:
        return height * np.arctan(2.0 * point.get(("bend", "size"), 0.0))

    fitter = Fitter(simulate(bend, {("bend", "size"): 0.1}, 5), [name_unknown("bend")])
    near, far = (fitter.fit(frozenset({"bend"}), {("bend", "size"): value}, steps=steps) for value in (0.1, start))
    assert far.evidence == pytest.approx(near.evidence, abs=SETTLED)
    assert far.values["bend", "size"] == pytest.approx(near.values["bend", "size"], abs=near.std["bend", "size"])


def test_errors_of_a_nonlinear_fit_hold_the_truth() -> None:
    """Over 40 sets of data a rate's errors have the size that their standard deviations say."""
    fits = [Fitter(draw_decay(2.0, 10 + seed), DECAY).fit(frozenset({"decay", "zero"}), {}) for seed in range(40)]
    errors = np.array([(fit.values[RATE] - 2.0) / fit.std[RATE] for fit in fits])
    assert 0.4 < (errors**2).mean() < 1.8  # a mean of 40 squares, to 3.5 of its standard deviations of 0.22


@pytest.mark.parametrize("effects", ["", "a", "b", "ab", "abc"])
def test_evidence_is_the_marginal_likelihood(effects: str) -> None:
    """On a linear simulator Laplace's approximation is exact: a normal with parameters in its covariance."""
    law = draw_linear("abc", 1)
    toy = simulate(law, {("a", "size"): 1.0, ("b", "size"): -0.3}, 1)
    fit = Fitter(toy, [name_unknown(name) for name in "abc"]).fit(frozenset(effects), {})
    scales, slopes = fit.posterior.scales, np.stack([law.slopes[name, "size"] for name in effects] or [0.0 * toy.noise])
    expected = toy.density(toy.measured, scales, slopes, np.eye(len(slopes))) - 0.5 * toy.scale_prior.cost(scales)
    assert fit.evidence == pytest.approx(expected, abs=0.01)


def test_parameters_stay_within_their_bounds() -> None:
    """A rate of 6/s that may be 3/s at most ends there, whatever it starts from."""
    unknowns = [replace(DECAY[0], high=3.0, step=lambda value: -0.01), DECAY[1]]
    fitter = Fitter(draw_decay(6.0, 2), unknowns)
    for start in (0.05, 1.0, 3.0):
        assert fitter.fit(frozenset({"decay", "zero"}), {RATE: start}).values[RATE] == pytest.approx(3.0, abs=1e-6)


def draw_tolerated(times: float, seed: int = 3) -> Fitter:
    """An effect `a` of size 1 and another, `b`, that is off by so many of its tolerances."""
    law = draw_linear("ab", seed)
    toy = simulate(law, {("a", "size"): 1.0, ("b", "size"): times * TOLERANCE}, seed)
    return Fitter(toy, [name_unknown("a"), name_unknown("b", tolerance=TOLERANCE)])


@pytest.mark.parametrize("times", [-1.0, 0.0, 1.0, 1.5])
def test_a_tolerance_absorbs_what_is_of_its_size(times: float) -> None:
    """The fit without the effect is the more probable, its noise is the true one, and its intervals hold the truth."""
    fitter = draw_tolerated(times)
    without, beside = fitter.fit(frozenset("a"), {}), fitter.fit(frozenset("ab"), {})
    assert without.evidence > beside.evidence
    assert np.all(np.abs(without.posterior.scales.sensor) < 0.3)  # four standard errors of a scale
    mean, std = without.posterior.mean, np.sqrt(np.diag(without.posterior.covariance))
    assert np.all(np.abs(mean - [1.0, times * TOLERANCE]) < 3.0 * std)


def test_a_tolerance_does_not_absorb_ten_times_its_size() -> None:
    """It stops at its reach; noise would have to make up for the rest, and the effect itself is far more probable."""
    fitter = draw_tolerated(10.0)
    without, beside = fitter.fit(frozenset("a"), {}), fitter.fit(frozenset("ab"), {})
    assert without.posterior.mean[1] == pytest.approx(WIDEST * TOLERANCE)
    assert beside.evidence > without.evidence + 20.0
    assert np.all(without.posterior.scales.sensor > beside.posterior.scales.sensor + 0.3)
    assert abs(beside.values["b", "size"] - 10.0 * TOLERANCE) < 3.0 * beside.std["b", "size"]


def test_a_tolerance_that_nobody_would_notice_is_left_out() -> None:
    """Its column would only cost time."""
    law = draw_linear("ab", 3)
    toy = simulate(law, {}, 3)
    assert Fitter(toy, [name_unknown("a", tolerance=0.01), name_unknown("b", tolerance=TOLERANCE)]).loose("") == [1]


def test_a_fit_does_not_depend_on_what_was_asked_before() -> None:
    """Also where the same set was fitted from other noise scales."""
    law = draw_linear("ab", 4)
    toy = simulate(law, {("a", "size"): 1.0}, 4)
    unknowns, near = [name_unknown(name) for name in "ab"], Scales(np.zeros(2), np.zeros(2))
    fresh, used = Fitter(toy, unknowns), Fitter(toy, unknowns)
    for asked in ("", "b", "a", "ab"):
        used.fit(frozenset(asked), {}, Scales(np.full(2, 2.0), np.full(2, -4.0)))
    for asked in ("ab", "a"):
        assert used.fit(frozenset(asked), {}, near).evidence == fresh.fit(frozenset(asked), {}, near).evidence


def test_a_smaller_set_starts_where_the_posterior_of_the_larger_has_it() -> None:
    """Two effects that are alike share a size; without one of them the other has all of it, before any fit."""
    law = draw_linear("ab", 3)
    alike = Linear({("a", "size"): law.array[0], ("b", "size"): law.array[0] + 0.1 * law.array[1]})
    fitter = Fitter(simulate(alike, {("a", "size"): 2.0}, 3), [name_unknown("a"), name_unknown("b")])
    both, alone = (fitter.fit(frozenset(effects), {}) for effects in ("ab", "a"))
    begun = fitter.condition(both, frozenset("a"))
    assert begun == pytest.approx(alone.values, abs=0.5 * alone.std["a", "size"])
    assert abs(both.values["b", "size"]) > 2.0 * abs(begun["a", "size"] - alone.values["a", "size"])
    assert fitter.condition(both, frozenset()) == {}
