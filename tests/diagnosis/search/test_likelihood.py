"""The covariance of a window's residual on a rig simple enough to write it down: a free cart of 2 kg."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.rigs import CARTS, MASS, write_rig
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.evidence.runs import Variation
from vpptwin.diagnosis.search import motion
from vpptwin.diagnosis.search.likelihood import (
    Likelihood,
    Response,
    Whitening,
    couple_gusts,
    gust_std,
    measure_response,
)
from vpptwin.diagnosis.search.motion import follow_motion
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.robot import robot
from vpptwin.twin.spec import load_twin

WINDOW, SEGMENTS, BINS, COUNT = 0.4, 4, 40, 8
POSITION_STD, VELOCITY_STD = 1e-3, 1e-2
SPEED = 0.3
GUST = robot.GUST * MASS * 10.0
"""N: the share of a typical force, which accelerates the cart by 10 m/s²."""
APART = 0.1 * np.abs(np.arange(SEGMENTS)[:, None] - np.arange(SEGMENTS))
ALIKE = np.exp(-APART / robot.GUST_TIME)
"""How much the pulses of a window are alike, a tenth or more apart."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Eight windows of a cart that coasts at 0.3 m/s, measured without error at 200 Hz.

    They are so far apart that pulses in one say nothing of those in the next.
    """
    spec = load_twin(write_rig(CARTS, tmp_path_factory.mktemp("cart")))
    time = np.arange(0.0, 12.5, 0.005)
    position = Series("slide", "m", time, SPEED * time, POSITION_STD, white=False)
    velocity = Series("slide rate", "m/s", time, np.full_like(time, SPEED), VELOCITY_STD, white=False)
    command = Series("control", "", time, np.zeros((len(time), 1)), 0.0)
    flight = Measurements("coasting", {0: position}, {0: velocity}, None, command, None, (), 0.0, time[-1])
    return build_bench(spec, [flight], [0.5 + 1.5 * np.arange(COUNT)], WINDOW, False)


@pytest.fixture(scope="module")
def response(bench: Bench) -> Response:
    """Of the right twin."""
    return measure_response(bench, {})


@pytest.fixture(scope="module")
def likelihood(bench: Bench, response: Response) -> Likelihood:
    """About the right twin, gusts as assumed."""
    return couple_gusts(bench, response, np.ones(1))


def covariance_of(whiten: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The covariance of every window, (K, M, M), that whitening undoes."""
    size = 2 * BINS
    whole = np.broadcast_to(np.eye(size)[:, None], (size, COUNT, size))
    root = np.linalg.inv(np.moveaxis(whiten(whole.copy()), 0, -1))
    return root @ np.swapaxes(root, 1, 2)


def write_covariance(gust: float = 1.0) -> np.ndarray:
    """S of one window, (80, 80), from x = x₀ + v₀ t + Σ pulses at the bins' mean instants: samples at 0 and 5 ms."""
    t = 0.0025 + 0.01 * np.arange(BINS)
    one, zero = np.ones(BINS), np.zeros(BINS)
    covariance = np.diag(np.concatenate([POSITION_STD**2 * one, VELOCITY_STD**2 * one]))
    columns = [CRITERIA.start_pose * np.concatenate([one, zero]), CRITERIA.start_velocity * np.concatenate([t, one])]
    for column in columns:
        covariance += np.outer(column, column)
    pulses = []
    for segment in range(SEGMENTS):
        begin = 0.1 * segment
        under, after = np.clip(t - begin, 0.0, 0.1), np.clip(t - begin - 0.1, 0.0, None)
        pulses.append(GUST / MASS * np.concatenate([0.5 * under**2 + 0.1 * after, under]))
    push = np.stack(pulses, axis=1)
    return np.asarray(covariance + gust**2 * push @ ALIKE @ push.T)


def test_a_response_by_hand(bench: Bench, response: Response) -> None:
    """Gusts are 0.2 % of 20 N; of eight windows of 80 values each has a fitted position and velocity."""
    np.testing.assert_allclose(gust_std(bench), [GUST])
    assert response.freedom == COUNT * (2 * BINS - 2)


@pytest.mark.parametrize("gust", [0.5, 1.0, 20.0])
def test_covariance_is_that_of_a_free_cart(bench: Bench, response: Response, gust: float) -> None:
    """Every window's S is what Newton says, to what the twin's steps of 2 ms leave: parts in a thousand."""
    expected = write_covariance(gust)
    scale = np.sqrt(np.diag(expected))
    found = covariance_of(couple_gusts(bench, response, np.array([gust])).whiten)
    assert found.shape == (COUNT, 2 * BINS, 2 * BINS)
    np.testing.assert_allclose(found / np.outer(scale, scale), [expected / np.outer(scale, scale)] * COUNT, atol=2e-3)


def test_response_holds_the_terms_of_the_covariance(bench: Bench, response: Response, likelihood: Likelihood) -> None:
    """S = R + J_x P J_xᵀ + J_n Q J_nᵀ to rounding, term by term from what the response says it holds.

    In Q is what pulses have in common.
    """
    state = response.state * response.state_std
    written = np.stack([np.diag(std**2) for std in bench.std])
    written += state @ np.swapaxes(state, 1, 2)
    np.testing.assert_allclose(covariance_of(response.sensors.apply), written, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(response.sensors.logdet, np.linalg.slogdet(written)[1], rtol=1e-9)
    written += response.push @ ALIKE @ np.swapaxes(response.push, 1, 2)
    np.testing.assert_allclose(covariance_of(likelihood.whiten), written, rtol=1e-7, atol=1e-12)


def test_determinant_is_that_of_the_covariance(bench: Bench, response: Response) -> None:
    """Without what couples windows each has the log determinant of its own S."""
    found = couple_gusts(bench, response, np.array([3.0]))
    np.testing.assert_allclose(found.logdet, np.linalg.slogdet(covariance_of(found.whiten))[1], rtol=1e-9)
    np.testing.assert_allclose(found.logdet, np.linalg.slogdet(write_covariance(3.0))[1], atol=0.05)


def test_whitened_draws_are_independent_and_unit(likelihood: Likelihood) -> None:
    """Residuals drawn from starting states, gusts and noise become white: unit variance, no correlation."""
    rng = np.random.default_rng(1)
    draws = 3000
    residual = rng.multivariate_normal(np.zeros(2 * BINS), write_covariance(), (draws, COUNT))
    white = likelihood.whiten(residual)
    samples = white.reshape(-1, 2 * BINS)
    # 24000 draws know each variance to 0.9 % and each correlation to 0.65 %; the largest of 3160 is 4.5 sigma.
    np.testing.assert_allclose(np.cov(samples.T), np.eye(2 * BINS), atol=0.05)
    assert (white**2).mean() == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize(("pose", "velocity"), [(0.02, 0.0), (0.0, 0.3), (-0.03, 0.2)])
def test_the_starting_state_is_marginalised(bench: Bench, likelihood: Likelihood, pose: float, velocity: float) -> None:
    """A start that is wrong costs at most what its prior says, though sensors alone would put it 100 sigma away.

    Measurements are perfect, so that the right start leaves no residual and the cost is that of the shift alone.
    """
    shift = Variation(pose=np.array([pose]), velocity=np.array([velocity]))
    right, wrong = bench.predict([Variation(), shift])
    np.testing.assert_allclose(right, bench.measured, atol=1e-9)
    cost = (likelihood.whiten(bench.measured - wrong) ** 2).sum(axis=1)
    prior = (pose / CRITERIA.start_pose) ** 2 + (velocity / CRITERIA.start_velocity) ** 2
    assert (cost <= prior * 1.001).all()
    assert (cost > 0.5 * prior).all()
    alone = (((bench.measured - wrong) / bench.std) ** 2).sum(axis=1)
    assert (alone > 1e3 * prior).all()


def test_forces_act_as_newton_says(bench: Bench) -> None:
    """5 N on 2 kg during the third tenth: nothing before 0.2 s, 0.25 m/s more after 0.3 s."""
    plain, pushed = bench.simulate([Variation(), Variation(push=(2, 0, 5.0))]).velocity[..., 0]
    gained = pushed - plain
    np.testing.assert_allclose(gained[:, :101], 0.0, atol=1e-12)
    np.testing.assert_allclose(gained[:, 125], 0.125, atol=1e-9)
    np.testing.assert_allclose(gained[:, 150:], 0.25, atol=1e-9)
    # 0.5 N on 2 kg: 0.3 m/s fall by 0.25 m/s² · 0.4 s = 0.1 m/s.
    velocity = bench.simulate([Variation({("slide.coulomb", "force"): 0.5})]).velocity
    np.testing.assert_allclose(velocity[0, :, -1, 0], SPEED - 0.1, atol=1e-3)


def test_variations_side_by_side_equal_each_alone(bench: Bench) -> None:
    """Simulated together or alone, a variation gives the same channels to the last bit."""
    variations = [
        Variation(),
        Variation({("slide.coulomb", "force"): 0.5}),
        Variation({("slide.viscous", "damping"): 1.0}, pose=np.array([0.01])),
        Variation(push=(0, 0, 1.0)),
    ]
    together = bench.predict(variations)
    for i, variation in enumerate(variations):
        np.testing.assert_array_equal(bench.predict([variation])[0], together[i])


def test_whitening_by_hand() -> None:
    """R = 4 I and A = (0, 2 √3)ᵀ: variances of 4 and 16; in the other window A = 0."""
    whitening = Whitening.of(np.full((2, 2), 2.0), np.array([[[0.0], [2.0 * 3.0**0.5]], [[0.0], [0.0]]]))
    np.testing.assert_allclose(whitening.apply(np.array([[4.0, 6.0], [4.0, 6.0]])), [[2.0, 1.5], [2.0, 3.0]])
    np.testing.assert_allclose(whitening.apply(np.ones((3, 2, 2))), [[[0.5, 0.25], [0.5, 0.5]]] * 3)
    np.testing.assert_allclose(np.exp(whitening.logdet), [64.0, 16.0])


def test_the_model_beside_the_twin_is_found(tmp_path: Path) -> None:
    """The bench's rig has one simulated joint and one motor."""
    spec = load_twin(write_rig(CARTS, tmp_path))
    assert (spec.model.nv, spec.model.nu) == (1, 1)


def test_a_track_follows_what_was_measured_and_changes_no_likelihood(bench: Bench) -> None:
    """A cart that a gust of three times the usual pushed: found within its prior; a linear rig's odds stay the same."""
    moved = Variation(velocity=np.array([0.02]), push=(1, 0, 3.0 * GUST))
    pushed, shown = copy(bench), bench.predict([moved])[0]
    pushed.__dict__["measured"] = shown
    missed = pushed.residual({})
    plain = couple_gusts(pushed, measure_response(pushed, {}), np.ones(1)).whiten(missed)
    pushed.track = follow_motion(pushed, {}, np.ones(1))
    response = measure_response(pushed, {})
    followed = couple_gusts(pushed, response, np.ones(1)).whiten(response.restore(pushed.residual({}), pushed.track))
    np.testing.assert_allclose(followed, plain, atol=1e-6 * np.abs(plain).max())
    assert np.square(pushed.residual({}) / pushed.std).mean() < 0.5 < np.square(missed / pushed.std).mean()
    assert np.all(np.argmax(pushed.track.push[:, :, 0], axis=1) == 1)


def test_a_twin_that_runs_away_is_followed_somewhere(bench: Bench, response: Response) -> None:
    """Beside what its starts do, all alike, nothing is left of the prior: no answer is right, none is a crash."""
    away = replace(response, state=np.full_like(response.state, 2.0**60) / response.state_std, push=0.0 * response.push)
    path = motion.Path(bench, away, motion.spread_gusts(bench, np.ones(1)))
    assert np.isfinite(path.step(np.ones(bench.valid.shape))).all()
