"""Gusts that outlast a window: what couples the windows of a flight, and how strong gusts are found to be."""

from __future__ import annotations

import numpy as np
import pytest

from tests import builders
from tests.builders import SLIDERS, disturb, load_rig
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.likelihood import (
    FORGOTTEN,
    MOST_COUPLED,
    Response,
    couple_gusts,
    likeness_of_gusts,
    list_stretches,
    middles_of_segments,
    tune_gust,
)
from vpptwin.robots.planar_drone.craft import GUST_TIME
from vpptwin.twin.robot.robot import Disturbance

SEGMENTS, NV, VALUES = 3, 2, 12
LENGTH = 0.3
"""Length of a window [s]."""
STRENGTH = np.array([0.6, 3.0])
"""Multiples of the assumed gusts."""


def lay_bench(start: np.ndarray, flight: np.ndarray | None = None, outdoors: bool = True) -> Bench:
    """Windows of 0.3 s on a rig of two degrees of freedom, with gusts as on the drone or as indoors."""
    wind = Disturbance(np.ones(NV), GUST_TIME if outdoors else 0.0, outdoors)
    return builders.lay_bench(start, flight, disturb(load_rig(SLIDERS), wind), steps=300, segments=SEGMENTS)


def draw_response(count: int, seed: int = 0) -> Response:
    """What states and pulses do in windows of 12 values, drawn at random; pulses move values by about 2 sigma."""
    rng = np.random.default_rng(seed)
    state, push = (
        rng.standard_normal((count, VALUES, 2 * NV)),
        2.0 * rng.standard_normal((count, VALUES, SEGMENTS * NV)),
    )
    std, freedom = np.ones((count, VALUES)), count * (VALUES - 2 * NV)
    return Response(state, np.ones(2 * NV), push, std, freedom, np.ones(NV))


def correlate_gusts(bench: Bench, strength: np.ndarray, stretches: list[list[int]]) -> np.ndarray:
    """Covariance of all pulses of all windows, (K G, K G), written pair by pair from the exponential law."""
    size = SEGMENTS * NV
    covariance = np.zeros((len(bench.windows) * size, len(bench.windows) * size))
    for part in stretches:
        for k in part:
            for j in part:
                for s in range(SEGMENTS):
                    for t in range(SEGMENTS):
                        apart = (bench.windows.start[k] + 0.1 * s) - (bench.windows.start[j] + 0.1 * t)
                        for d in range(NV):
                            row, column = k * size + s * NV + d, j * size + t * NV + d
                            covariance[row, column] = strength[d] ** 2 * np.exp(-abs(apart) / GUST_TIME)
    return covariance


def write_joint(bench: Bench, response: Response, stretches: list[list[int]]) -> np.ndarray:
    """S of all windows together, (K M, K M)."""
    count = len(bench.windows)
    gusts = correlate_gusts(bench, STRENGTH, stretches)
    joint = np.zeros((count, VALUES, count, VALUES))
    blocks = gusts.reshape(count, SEGMENTS * NV, count, SEGMENTS * NV)
    for k in range(count):
        joint[k, :, k] = np.eye(VALUES) + response.state[k] @ response.state[k].T
        for j in range(count):
            joint[k, :, j] += response.push[k] @ blocks[k, :, j] @ response.push[j].T
    return joint.reshape(count * VALUES, count * VALUES)


SHUFFLED = np.array([1.3, 0.4, 9.0, 1.0, 0.7, 0.4, 0.9])
FLIGHT = np.array([0, 0, 0, 0, 0, 1, 1])
TOGETHER = [[1, 4, 3, 0], [2], [5, 6]]
"""In the order of time: four windows of the first flight, one 7 s later, two of the second flight."""


def test_gusts_are_alike_within_a_third_of_a_second() -> None:
    """Outdoors pulses a tenth apart share e^(-1/3), two tenths e^(-2/3); indoors each is a draw of its own."""
    time = np.array([[1.0, 1.1, 1.2]])
    a, b = np.exp(-0.1 / GUST_TIME), np.exp(-0.2 / GUST_TIME)
    start = np.array([1.0])
    np.testing.assert_allclose(likeness_of_gusts(lay_bench(start), time), [[[1, a, b], [a, 1, a], [b, a, 1]]])
    np.testing.assert_array_equal(likeness_of_gusts(lay_bench(start, outdoors=False), time), [np.eye(3)])
    # A window from 2 s on has gusts about 2.05, 2.15 and 2.25 s.
    np.testing.assert_allclose(middles_of_segments(lay_bench(np.array([2.0]))), [[2.05, 2.15, 2.25]])


def test_windows_that_follow_each_other_are_coupled() -> None:
    """Flights apart, and parts of a flight that lie so far apart that gusts have forgotten each other."""
    found = list_stretches(lay_bench(SHUFFLED, FLIGHT))
    assert [list(part) for part in found] == TOGETHER
    assert [list(part) for part in list_stretches(lay_bench(SHUFFLED, FLIGHT, False))] == [[k] for k in range(7)]
    # A break is one of more than FORGOTTEN times their memory after a window's end.
    reach = LENGTH + FORGOTTEN * GUST_TIME
    near, far = (list_stretches(lay_bench(np.array([0.0, reach + d]))) for d in (-1e-3, 1e-3))
    assert [len(part) for part in near] == [2]
    assert [len(part) for part in far] == [1, 1]


def test_long_stretches_are_cut() -> None:
    """2.5 times as many windows as are coupled at most: three stretches, in order, none lost, none longer.

    Pulses are what costs: of 432, with three tenths and two degrees of freedom, 72 windows.
    """
    most = MOST_COUPLED // (SEGMENTS * NV)
    count = int(2.5 * most)
    found = list_stretches(lay_bench(LENGTH * np.arange(count)))
    assert len(found) == 3
    assert max(len(part) for part in found) <= most
    np.testing.assert_array_equal(np.concatenate(found), np.arange(count))


def test_coupled_windows_are_whitened_together() -> None:
    """W S Wᵀ = 1 for the joint covariance of windows whose gusts are alike, in whatever order they come."""
    bench, response = lay_bench(SHUFFLED, FLIGHT), draw_response(7)
    likelihood = couple_gusts(bench, response, STRENGTH)
    joint = write_joint(bench, response, TOGETHER)
    size = len(joint)
    whitener = likelihood.whiten(np.eye(size).reshape(size, 7, VALUES)).reshape(size, size).T
    np.testing.assert_allclose(whitener @ joint @ whitener.T, np.eye(size), atol=1e-9)
    # Windows taken one by one would leave neighbours alike.
    single = couple_gusts(lay_bench(SHUFFLED, np.arange(7)), response, STRENGTH)
    apart = single.whiten(np.eye(size).reshape(size, 7, VALUES)).reshape(size, size).T
    assert np.abs(apart @ joint @ apart.T - np.eye(size)).max() > 0.3


def test_draws_of_a_gusty_flight_become_white() -> None:
    """Residuals drawn from starting states, noise and gusts that go on from window to window: variance 1, all of them.

    2000 draws of 84 values know the mean square to 0.35 %.
    """
    rng = np.random.default_rng(4)
    bench, response = lay_bench(SHUFFLED, FLIGHT), draw_response(7)
    gusts = rng.multivariate_normal(np.zeros(7 * SEGMENTS * NV), correlate_gusts(bench, STRENGTH, TOGETHER), 2000)
    residual = rng.standard_normal((2000, 7, VALUES))
    residual += np.einsum("kmi,vki->vkm", response.state, rng.standard_normal((2000, 7, 2 * NV)))
    residual += np.einsum("kmg,vkg->vkm", response.push, gusts.reshape(2000, 7, -1))
    likelihood = couple_gusts(bench, response, STRENGTH)
    assert (likelihood.whiten(residual) ** 2).mean() == pytest.approx(1.0, abs=0.015)
    innovations = likelihood.innovate(response.along(residual)).reshape(2000, -1)
    # 42 innovations from 2000 draws: the largest of 861 correlations is about 3.5/√2000 = 0.08.
    np.testing.assert_allclose(np.cov(innovations.T), np.eye(7 * SEGMENTS * NV), atol=0.16)
    np.testing.assert_allclose(np.corrcoef(innovations.T), np.eye(7 * SEGMENTS * NV), atol=0.11)


def test_determinants_add_up_along_a_stretch() -> None:
    """A window's share is that of its S given those before it: the first n shares sum to the determinant of n windows.

    The sum over all is the log determinant of the dense joint covariance.
    """
    bench, response = lay_bench(SHUFFLED, FLIGHT), draw_response(7)
    logdet = couple_gusts(bench, response, STRENGTH).logdet
    joint = write_joint(bench, response, TOGETHER).reshape(7, VALUES, 7, VALUES)
    for part in TOGETHER:
        for n in range(1, len(part) + 1):
            first = joint[part[:n]][:, :, part[:n]].reshape(n * VALUES, n * VALUES)
            assert logdet[part[:n]].sum() == pytest.approx(np.linalg.slogdet(first)[1])
    assert logdet.sum() == pytest.approx(np.linalg.slogdet(joint.reshape(7 * VALUES, -1))[1])


def draw_flight(bench: Bench, response: Response, strength: np.ndarray, seed: int) -> np.ndarray:
    """Residuals of a flight through gusts, (K, M)."""
    rng = np.random.default_rng(seed)
    count = len(bench.windows)
    prior = correlate_gusts(bench, strength, [list(part) for part in list_stretches(bench)])
    # By Cholesky: eigenvectors of equal eigenvalues, and so the draws, would depend on the machine.
    gusts = rng.multivariate_normal(np.zeros(len(prior)), prior, method="cholesky").reshape(count, -1)
    residual = rng.standard_normal((count, VALUES)) + np.einsum("kmg,kg->km", response.push, gusts)
    return residual + np.einsum("kmi,ki->km", response.state, rng.standard_normal((count, 2 * NV)))


@pytest.mark.parametrize("strength", [(1.0, 1.0), (0.6, 3.0), (8.0, 0.5)])
def test_strength_of_gusts_is_recovered(strength: tuple[float, float]) -> None:
    """From 60 windows spread over a flight, six flights on average, to what six such flights know.

    One window tells of three tenths alike to e^(-1/3), about two draws: 120 draws know a standard deviation to
    1/√240 = 6.5 %, six flights to 3 %. Where gusts drown in noise it is somewhat worse.
    """
    bench, response = lay_bench(2.0 * np.arange(60.0)), draw_response(60)
    found = [tune_gust(bench, response, draw_flight(bench, response, np.array(strength), s)) for s in range(6)]
    np.testing.assert_allclose(np.mean(np.log(found), axis=0), np.log(strength), atol=0.1)
    assert (np.std(np.log(found), axis=0) < 0.2).all()


def test_a_window_astray_makes_no_storm() -> None:
    """An ordinary window made 30 times worse, which alone would nearly triple the gusts, moves them by under 10 %."""
    bench, response = lay_bench(2.0 * np.arange(60.0)), draw_response(60)
    residual = draw_flight(bench, response, np.ones(2), 3)
    calm = tune_gust(bench, response, residual)
    ordinary = np.argsort((response.along(residual) ** 2).sum(axis=1))[30]
    residual[ordinary] *= 30.0
    squares = (response.along(residual) ** 2).sum(axis=1)
    assert squares.mean() > 7.0 * np.delete(squares, ordinary).mean()
    np.testing.assert_allclose(tune_gust(bench, response, residual), calm, rtol=0.1)


def test_indoors_strength_is_fitted_too() -> None:
    """Of a rig that nobody knows the strength of pushes is an assumption: it is as the log asks for, 9 times as strong.

    20 windows of three pulses that have nothing in common know a standard deviation to 1/√120 = 9 %.
    """
    indoors = lay_bench(2.0 * np.arange(20.0), outdoors=False)
    rng, response = np.random.default_rng(1), draw_response(20)
    residual = rng.standard_normal((20, VALUES))
    residual += np.einsum("kmg,kg->km", response.push, 9.0 * rng.standard_normal((20, SEGMENTS * NV)))
    np.testing.assert_allclose(tune_gust(indoors, response, residual), 9.0, rtol=0.25)


def test_gusts_stay_within_what_can_be() -> None:
    """Nothing at all to be seen, or a catastrophe: the bounds, the upper one the rig's own."""
    bench, response = lay_bench(2.0 * np.arange(20.0)), draw_response(20)
    most = bench.spec.robot.disturbance.most
    np.testing.assert_allclose(tune_gust(bench, response, np.zeros((20, VALUES))), CRITERIA.least_gust, rtol=1e-6)
    storm = 1e3 * draw_flight(bench, response, np.full(2, most), 1)
    np.testing.assert_allclose(tune_gust(bench, response, storm), most, rtol=1e-6)


def test_a_twin_that_runs_away_is_whitened() -> None:
    """Starting states that move it by 1e9 times the noise, all alike: their covariance is none to rounding."""
    state = 1e9 * np.random.default_rng(0).standard_normal((3, 20, 1)) * np.ones(2)
    wild = Response(state, np.ones(2), np.ones((3, 20, 1)), np.ones((3, 20)), 57, np.ones(1))
    assert np.isfinite(wild.sensors.apply(np.ones((3, 20)))).all()
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(np.einsum("kmi,kni->kmn", state, state) + np.eye(20))


@pytest.mark.parametrize("outdoors", [True, False])
@pytest.mark.parametrize("times", [0.0, 1e8, 1e12])
def test_a_joint_that_answers_without_bounds_ends_nothing(times: float, outdoors: bool) -> None:
    """One joint moves so many times as far as the other under a push; strong ones push both: whitened all the same."""
    bench, response = lay_bench(LENGTH * np.arange(20.0), outdoors=outdoors), draw_response(20)
    response.push[:, :, 1::NV] *= times
    residual = np.ones((20, VALUES))
    gust = tune_gust(bench, response, residual)
    for strength in (gust, np.full(NV, 500.0)):
        likelihood = couple_gusts(bench, response, 100.0 * strength)
        assert np.isfinite(likelihood.logdet).all()
        assert np.abs(likelihood.whiten(residual)).max() < 1.0 + np.linalg.norm(residual[0])
