"""The search for causes: closed forms against brute force, and a cart whose friction is to be found."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests.builders import linear
from tests.diagnosis.carts import load_cart, measure_cart, open_search
from tests.diagnosis.rigs import FRICTION, drive_cart
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.search.fits import Fit, find_cheapest
from vpptwin.diagnosis.search.frame import Rows, weigh_windows
from vpptwin.diagnosis.search.likelihood import couple_gusts
from vpptwin.diagnosis.search.search import Search, Step
from vpptwin.diagnosis.search.shortlist import Start, rank_trials
from vpptwin.diagnosis.search.solution import solve_hypothesis
from vpptwin.diagnosis.search.suspects import Trial, Unknown
from vpptwin.effects.friction import coulomb
from vpptwin.effects.joint import JointScale, bias, spring
from vpptwin.inference.bounded import solve_bounded

MEASURED = 200
PLACE = JointScale("a", "on a", tolerance=0.3)
HELD = (
    Unknown(bias(PLACE), bias(PLACE).parameters[0], 0.2),
    Unknown(coulomb(PLACE), coulomb(PLACE).parameters[0], 0.9),
)
STIFFNESS, REST = (Unknown(spring(PLACE), p, p.off) for p in spring(PLACE).parameters)


def rank(residual: np.ndarray, columns: np.ndarray, trials: list[Trial], tried: np.ndarray) -> list[Start]:
    """The starts of trials beside two parameters that sit within their tolerance, noise of variance 1.7."""
    unknowns = (*HELD, STIFFNESS, REST)
    at = np.array([u.nominal for u in unknowns])
    about = linear(at, np.concatenate([columns, np.zeros((2, MEASURED))]), residual, tried, 1.7)
    base = solve_hypothesis(about, unknowns, frozenset())
    return rank_trials(about, unknowns, trials, base, frozenset({"barred"}))


def find_drop(
    residual: np.ndarray, columns: np.ndarray, column: np.ndarray, times: float | None
) -> tuple[float, float]:
    """Drop in cost and multiple of a column that is added, everything refitted by least squares with its priors."""
    scale, tolerance = 1.7, np.array([u.parameter.tolerance for u in HELD])
    priors = np.diag(1.0 / tolerance)
    plain = np.concatenate([columns.T / np.sqrt(scale), priors])
    target = np.concatenate([residual / np.sqrt(scale), np.zeros(2)])

    def cost(design: np.ndarray, wanted: np.ndarray) -> tuple[float, np.ndarray]:
        found = np.linalg.lstsq(design, wanted, rcond=None)[0]
        return float(((wanted - design @ found) ** 2).sum()), found

    before, _ = cost(plain, target)
    added = np.concatenate([column / np.sqrt(scale), np.zeros(2)])
    if times is not None:
        return before - cost(plain, target - times * added)[0], times
    after, found = cost(np.column_stack([plain, added]), target)
    return before - after, float(found[-1])


@pytest.fixture(scope="module")
def problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, two columns and three trials, which look alike; the residual holds 1.4 times the first trial."""
    rng = np.random.default_rng(2)
    common = rng.standard_normal(MEASURED)
    columns = rng.standard_normal((2, MEASURED)) + common
    tried = rng.standard_normal((3, MEASURED)) + 0.7 * common
    residual = 1.4 * tried[0] - 0.1 * columns[0] + rng.standard_normal(MEASURED)
    return residual, columns, tried


def test_trials_are_ranked_as_a_column_more_would_be(problem: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Drop in cost and best multiple of shapes are those of a fit with that column, everything else refitted."""
    residual, columns, tried = problem
    size, low, high = STIFFNESS.parameter.size, STIFFNESS.parameter.low, STIFFNESS.parameter.high
    trials = [Trial("a.spring", {STIFFNESS.key: size, REST.key: rest}, False) for rest in (-0.5, 0.0, 0.5)]
    starts = rank(residual, columns, trials, tried)
    assert [start.effect for start in starts] == ["a.spring"] * 3
    for start, column, rest in zip(starts, tried, (-0.5, 0.0, 0.5)):
        drop, times = find_drop(residual, columns, column, None)
        if times < 0.0:  # it can only push its own way
            drop, times = 0.0, 0.0
        assert start.drop == pytest.approx(drop, rel=1e-6, abs=1e-6)
        assert start.values[STIFFNESS.key] == pytest.approx(np.clip(times * size, low, high), rel=1e-6)
        assert start.values[REST.key] == rest
    assert starts[0].drop > 100.0


def test_limits_are_ranked_as_they_are(problem: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """A limit cannot be scaled: it is taken once, though that may make things worse; barred ones are left out."""
    residual, columns, tried = problem
    trials = [Trial("limit", {("limit", "rate"): 4.0}, True)] * 2 + [Trial("barred", {("barred", "x"): 1.0}, True)]
    starts = rank(residual, columns, trials, tried)
    assert [start.effect for start in starts] == ["limit", "limit"]
    for start, column in zip(starts, tried):
        assert start.drop == pytest.approx(find_drop(residual, columns, column, 1.0)[0], rel=1e-6)
        assert start.values == {("limit", "rate"): 4.0}


def test_windows_astray_count_less() -> None:
    """Mean squares 1, 1, 9 and 299 with median 5: usual misfit 15; weights 1, 1, 1, and √(30 / 314)."""
    residual = np.sqrt(np.array([1.0, 1.0, 9.0, 299.0]))[:, None] * np.ones((4, 2))
    weight = weigh_windows(residual, np.ones((4, 2), dtype=bool), 3.0)
    np.testing.assert_allclose(weight, np.repeat([1.0, 1.0, 1.0, np.sqrt(30.0 / 314.0)], 2))
    # A window measured in one bin of four has the mean square of that bin: 400, not 100.
    residual, valid = np.ones((3, 4)), np.ones((3, 4), dtype=bool)
    residual[2], valid[2] = [20.0, 0.0, 0.0, 0.0], [True, False, False, False]
    weight = weigh_windows(residual, valid, 3.0).reshape(3, 4)
    np.testing.assert_allclose(weight[2], np.sqrt(6.0 / 403.0))


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> Search:
    """Ten windows of a cart with 1.1 N of dry friction, and a twin without any."""
    return open_search(load_cart(tmp_path_factory.mktemp("cart")), measure_cart(drive_cart(FRICTION, 5), 7))


@pytest.fixture(scope="module")
def step(rubbing: Search) -> Step:
    """Its first step."""
    return rubbing.extend(rubbing.start)


def test_the_planted_effect_brings_most(step: Step) -> None:
    """Dry friction first, well before its look-alikes, and as strong as it is."""
    assert step.ordered[0] == "slide.coulomb"
    assert step.drop("slide.coulomb") > 10.0 * CRITERIA.bar
    assert all(step.drop("slide.coulomb") > step.drop(other) + CRITERIA.bar for other in step.ordered[1:])
    found = step.tried["slide.coulomb"]
    assert found.effects == {"slide.coulomb"}
    assert found.values["slide.coulomb", "force"] == pytest.approx(FRICTION, rel=0.05)
    assert 0.0 < found.std["slide.coulomb", "force"] < 0.1


def test_nothing_is_missed_beside_it(rubbing: Search, step: Step) -> None:
    """Once it is known, no suspect clears the bar; what is barred is not even tried."""
    found = rubbing.reframe(step.tried["slide.coulomb"])
    further = rubbing.extend(found)
    assert all(further.drop(effect) < CRITERIA.bar for effect in further.tried)
    assert not {"slide.viscous", "slide.bias"} & set(
        rubbing.extend(found, frozenset({"slide.viscous", "slide.bias"})).tried
    )


def test_friction_is_judged_by_its_own_response(rubbing: Search) -> None:
    """What sticks hardly feels where it started: its own response or a far likelier one; a bias keeps the old."""
    start = rubbing.start
    force, bias = {("slide.coulomb", "force"): FRICTION}, {("slide.bias", "force"): 0.1}
    stuck = rubbing.fit(frozenset({"slide.coulomb"}), force, start.about)
    alone = rubbing.judge_alone(stuck)
    assert alone.likelihood.response.push is not start.likelihood.response.push or alone.evidence_against(stuck) >= 0.0
    assert alone.evidence_against(stuck) > -CRITERIA.yielding
    pushed = rubbing.fit(frozenset({"slide.bias"}), bias, start.about)
    assert rubbing.judge_alone(pushed).likelihood.response.push is start.likelihood.response.push


def test_fits_go_downhill(rubbing: Search) -> None:
    """From a friction that is far too strong or far too weak, a fit ends lower than it began, inside the bounds."""
    start = rubbing.start
    for force in (0.4, 2.0):
        values = {("slide.coulomb", "force"): force}
        begun, done = (rubbing.fit(frozenset({"slide.coulomb"}), values, start.about, n) for n in (0, 6))
        assert begun.values == values
        assert done.evidence_against(begun) > -2.0 * CRITERIA.worth_a_refit
        assert done.values["slide.coulomb", "force"] > 0.0


def test_dry_friction_is_tried_farther_than_slopes_lead(rubbing: Search) -> None:
    """From a part of it to the friction that is there; where slopes lead nowhere, and for other laws, as it was."""
    key = "slide.coulomb", "force"
    for part in (3.0, 15.0):
        (found,) = rubbing._lead_on(rubbing.start, Start(key[0], {key: FRICTION / part}, 0.0))
        assert found.values[key] == pytest.approx(FRICTION, rel=0.1)
    for unmoved in (Start(key[0], {key: 0.0}, 0.0), Start("slide.bias", {("slide.bias", "force"): 0.3}, 0.0)):
        assert rubbing._lead_on(rubbing.start, unmoved) == [unmoved]


def test_shares_are_scanned_in_their_own_bounds(rubbing: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """A share of what drives a joint up to its bound; a force no further than there is friction."""
    tried: list[dict[Key, float]] = []
    monkeypatch.setattr(rubbing, "_pick_places", lambda fit, places: tried.extend(places) or places[:1])
    force, share = ("slide.coulomb", "force"), ("slide.load", "mu")
    fit = rubbing.fit(frozenset({force[0]}), {force: 0.1 * FRICTION}, rubbing.start.about, 0)
    rubbing._scan(fit, share[0])
    shares, forces = (np.array([place[key] for place in tried]) for key in (share, force))
    assert 0.0 <= shares.min() < 0.01 < 0.5 < shares.max() <= 0.9
    assert np.unique(shares).size > 0.5 * shares.size
    assert 0.0 <= forces.min() < 0.01 * FRICTION < 0.1 * FRICTION < forces.max() <= 0.15 * FRICTION


def test_what_is_superfluous_is_dropped(rubbing: Search) -> None:
    """Friction and a constant force that nothing asks for: friction stays alone."""
    values = {("slide.coulomb", "force"): FRICTION, ("slide.bias", "force"): 0.05}
    effects = frozenset({"slide.coulomb", "slide.bias"})
    both = rubbing.fit(effects, values, rubbing.start.about)
    assert rubbing.drop_superfluous(rubbing.reframe(rubbing.judge_alone(both))).effects == {"slide.coulomb"}


def test_a_rival_is_tried_beside_the_others_as_they_were(rubbing: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without friction the constant force moves to make up for it; a rival starts from both, the better one stays."""
    values = {("slide.coulomb", "force"): FRICTION, ("slide.bias", "force"): 0.05}
    start = rubbing.start
    both = rubbing.fit(frozenset({"slide.coulomb", "slide.bias"}), values, start.about, 0)
    without = rubbing.without(both, "slide.coulomb")
    made: list[tuple[float, Fit]] = []
    refit = rubbing.fit

    def record(effects: frozenset[str], values: Mapping[Key, float], *args: object) -> Fit:
        done = refit(effects, values, *args)
        if effects == {"slide.bias", "slide.viscous"}:
            made.append((values["slide.bias", "force"], done))
        return done

    monkeypatch.setattr(rubbing, "fit", record)
    monkeypatch.setattr(rubbing, "judge_alone", lambda fit: fit)
    step = rubbing.extend(without, against="slide.coulomb", whole=both)
    assert 0.05 in [bias for bias, _ in made]
    assert without.values["slide.bias", "force"] != pytest.approx(0.05, rel=0.1)
    assert step.tried["slide.viscous"] is find_cheapest([done for _, done in made])


def test_a_rival_starts_from_the_gusts_of_a_cause_too(rubbing: Search, step: Step) -> None:
    """Where gusts make up for friction it costs more than under those of a fit that has it, from which it starts again.

    As good as that it is kept, and so is what gusts as weak do not help.
    """
    found = step.tried["slide.coulomb"]
    blown = couple_gusts(rubbing.bench, found.likelihood.response, 30.0 * np.ones(1))
    stuck = rubbing.fit(found.effects, found.values, found.about.under(blown, found.frame))
    assert stuck.cost > found.cost + 3.0 * CRITERIA.bar
    assert rubbing.judge_beside(stuck, found).cost == pytest.approx(found.cost, abs=CRITERIA.better)
    assert rubbing.judge_beside(found, found) is found
    wrong = step.tried[step.ordered[1]]
    assert rubbing.judge_beside(wrong, found) is wrong


def test_neighbours_of_a_wrong_set_hold_the_right_one(rubbing: Search) -> None:
    """Damping and inertia in the place of dry friction: sets that differ in two, the best of them with friction."""
    search = rubbing
    wrong = frozenset({"slide.viscous", "slide.inertia"})
    values = {u.key: 0.1 for u in search.unknowns if u.effect.id in wrong}
    fit = search.judge_alone(search.fit(wrong, values, search.start.about))
    found = search.neighbours(fit)
    assert 0 < len(found) <= CRITERIA.more_neighbours  # its sensors are assumed
    for other in found:
        out, added = wrong - other.effects, other.effects - wrong
        assert 1 <= len(out) <= 2
        assert 1 <= len(added) <= 2
        assert len(out) + len(added) > 2  # one for one is what `extend` tries
    best = min(found, key=lambda other: other.cost)
    assert "slide.coulomb" in best.effects
    assert best.evidence_against(fit) > 100.0


@pytest.mark.parametrize("sets", [30, 0])
def test_bounded_minima_are_those_of_scipy(monkeypatch: pytest.MonkeyPatch, sets: int) -> None:
    """Of a few unknowns and of many, some of their bounds shut or at once at the minimum; either method alone."""
    monkeypatch.setattr("vpptwin.inference.bounded.SETS", sets)
    rng = np.random.default_rng(5)
    for size in (1, 2, 6, 40):
        for _ in range(10):
            matrix, wanted = rng.normal(size=(size + 3, size)), rng.normal(size=size + 3)
            low, width = rng.normal(size=size), rng.uniform(1e-6, 1.0, size) * rng.choice([0.001, 1.0], size)
            bounds = low, low + width
            found, _ = solve_bounded(matrix.T @ matrix, matrix.T @ wanted, bounds)
            assert np.all((found >= low - 1e-12) & (found <= low + width + 1e-12))
            best = lsq_linear(matrix, wanted, bounds=bounds, method="bvls").x
            np.testing.assert_allclose(found, best, atol=1e-7 * max(np.linalg.cond(matrix), 1.0))


def test_bounded_minima_are_found_where_sets_of_bounds_go_round() -> None:
    """Parameters that do much the same: if all change sides at once, every third time the same sets come for ever."""
    rng = np.random.default_rng(7)
    for _ in range(100):
        matrix = rng.normal(size=(31, 2)) @ rng.normal(size=(2, 30)) + 0.03 * rng.normal(size=(31, 30))
        target, width = rng.normal(size=30) * 10.0 ** rng.uniform(-2.0, 2.0, 30), 10.0 ** rng.uniform(-2.0, 1.0, 30)
        hessian, bounds = matrix.T @ matrix + 1e-3 * np.eye(30), (-width, width)
        believed = tuple(rng.random((2, 30)) < [[0.5], [0.0]])
        for found, (below, above) in (solve_bounded(hessian, target, bounds, each) for each in (None, believed)):
            downhill, free = target - hessian @ found, ~(below | above)
            scale = 1e-9 * (np.abs(hessian) @ np.abs(found) + np.abs(target))
            assert np.all(np.abs(found) <= width * (1.0 + 1e-12))
            assert np.all(downhill[below] <= scale[below])
            assert np.all(downhill[above] >= -scale[above])
            assert np.all(np.abs(downhill[free]) <= scale[free])


def test_bounded_minima_do_without_divide_and_conquer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where LAPACK gives up on a matrix, as in session 199 of seed 81580, the same answer comes another way."""
    rng = np.random.default_rng(5)
    matrix, target, bounds = rng.normal(size=(6, 6)), rng.normal(size=6), (np.full(6, -0.1), np.full(6, 0.2))
    usual = solve_bounded(matrix.T @ matrix, target, bounds)[0]

    def give_up(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge in Linear Least Squares")

    monkeypatch.setattr("scipy.optimize._lsq.bvls.lstsq", give_up)
    monkeypatch.setattr("vpptwin.inference.bounded.SETS", 0)
    found, _ = solve_bounded(matrix.T @ matrix, target, bounds)
    np.testing.assert_allclose(found, usual, atol=1e-5)
    assert np.all((found >= bounds[0]) & (found <= bounds[1]))


def test_rows_in_common_count_as_a_whole_matrix() -> None:
    """Rows of which two are its own, by every operation, against the matrix written out; the others are not copied."""
    rng = np.random.default_rng(3)
    common, new, vectors, weights = (rng.standard_normal(shape) for shape in [(5, 4), (2, 4), (4, 3), (5,)])
    rows, whole = Rows(common).change([3, 1], new), common.copy()
    whole[[3, 1]] = new
    np.testing.assert_allclose(rows.weigh(weights), weights @ whole)
    np.testing.assert_allclose(rows @ vectors, whole @ vectors)
    np.testing.assert_allclose(rows.multiply(), whole @ whole.T)
    np.testing.assert_array_equal(rows.take([0, 1]), whole[:2])
    doubled = rows.map(lambda part: 2.0 * part)
    np.testing.assert_array_equal(doubled.each(np.negative), -2.0 * whole)
    assert rows.common is common
