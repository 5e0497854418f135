"""The search over sets of effects, on toy simulators whose truth is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.inference.toys import Linear, Toy, draw_linear, name_unknown, simulate
from vpptwin.inference.fit import Fitter, Key, Point, Trial, Unknown
from vpptwin.inference.select import Comparison, Searcher

EIGHT = "abcdefgh"
ODDS = dict.fromkeys([*EIGHT, "bump"], -float(np.log(len(EIGHT))))
STRENGTH, PLACE = ("bump", "strength"), ("bump", "place")


def draw_alike(seed: int, truth: Point) -> Toy:
    """Eight candidates of which `c` and `d` look alike: their columns differ by a fiftieth."""
    law = draw_linear(EIGHT, seed)
    other = law.slopes["d", "size"]
    return simulate(Linear({**law.slopes, ("d", "size"): law.slopes["c", "size"] + 0.02 * other}), truth, seed)


def search(
    toy: Toy, unknowns: Sequence[Unknown] = (), trials: Sequence[Trial] = (), temper: float = 1.0,
    modifies: Mapping[str, Sequence[str]] | None = None, told: list[frozenset[str]] | None = None,
    odds: Mapping[str, float] = ODDS,
) -> Comparison:  # fmt: skip
    """Search among eight candidates, or among those of some parameters."""
    fitter = Fitter(toy, unknowns or [name_unknown(name) for name in EIGHT], trials)
    heard = [] if told is None else told
    return Searcher(fitter, Comparison(temper, odds), modifies, heard.append).search()


TRUTH: dict[Key, float] = {("a", "size"): 1.0, ("c", "size"): -0.8}


@pytest.mark.parametrize("seed", range(5))
def test_two_true_effects_are_found_and_look_alikes_share(seed: int) -> None:
    """One is certain; the other is certainly one of two look-alikes, and either of them about as likely."""
    comparison = search(draw_alike(seed, TRUTH))
    inclusion = {name: comparison.inclusion(frozenset(name)) for name in EIGHT}
    assert comparison.best.effects in (frozenset("ac"), frozenset("ad"))
    assert inclusion["a"] > 0.99
    assert comparison.inclusion(frozenset("cd")) > 0.99
    assert 0.25 < inclusion["c"] < 0.75
    assert 0.25 < inclusion["d"] < 0.75
    assert max(inclusion[name] for name in "befgh") < 0.3
    size = comparison.best.values["a", "size"]
    assert abs(size - 1.0) < 3.0 * comparison.best.std["a", "size"]


@pytest.mark.parametrize("seed", range(3))
def test_what_imitates_two_effects_is_exchanged_for_them(seed: int) -> None:
    """A column near the sum of two explains more than either alone, and is taken first; both together explain all."""
    law = draw_linear(EIGHT, seed)
    a, c, other = (law.slopes[name, "size"] for name in "ace")
    toy = simulate(
        Linear({**law.slopes, ("e", "size"): 0.7 * (a + c) + 0.5 * other}), {**TRUTH, ("c", "size"): 1.0}, seed
    )
    comparison = search(toy)
    singles = {name: comparison.fits[frozenset(name)].evidence for name in "ace"}
    assert max(singles, key=singles.__getitem__) == "e"
    assert comparison.best.effects == frozenset("ac")
    assert comparison.inclusion(frozenset("e")) < 0.3


def test_the_best_fit_of_a_set_is_kept() -> None:
    """In whichever order fits are added."""
    fitter = Fitter(draw_alike(3, TRUTH), [name_unknown(name) for name in EIGHT])
    poor, good = (fitter.fit(frozenset("ac"), {}, steps=steps) for steps in (1, 6))
    assert good.evidence > poor.evidence + 10.0
    for order in ((poor, good), (good, poor)):
        comparison = Comparison(1.0, ODDS)
        for fit in order:
            comparison.add(fit)
        assert comparison.best is good


def test_inclusion_probabilities_sum_properly() -> None:
    """Sets sum to one; any effect is there unless none is; for two effects inclusion and exclusion hold."""
    comparison = search(draw_alike(1, TRUTH), temper=2.0)
    probabilities = comparison.probabilities
    both = sum(p for effects, p in probabilities.items() if effects >= frozenset("cd"))
    either = comparison.inclusion(frozenset("c")) + comparison.inclusion(frozenset("d")) - both
    assert sum(probabilities.values()) == pytest.approx(1.0)
    assert comparison.inclusion(frozenset(EIGHT)) == pytest.approx(1.0 - probabilities[frozenset()])
    assert comparison.inclusion(frozenset("cd")) == pytest.approx(either)
    assert comparison.inclusion(frozenset()) == 0.0
    assert comparison.best.effects == max(probabilities, key=probabilities.__getitem__)


def test_probabilities_follow_from_evidence_and_odds() -> None:
    """The log ratio of two sets is the difference of evidence over the temper, and odds for what one has more."""
    comparison = search(draw_alike(2, TRUTH), temper=2.0, odds={**ODDS, "a": -5.0, "c": -1.5})
    less, more = frozenset("a"), frozenset("ac")
    difference = comparison.fits[more].evidence - comparison.fits[less].evidence
    probabilities = comparison.probabilities
    assert np.log(probabilities[more] / probabilities[less]) == pytest.approx(difference / 2.0 - 1.5)


def test_with_nothing_hidden_the_empty_set_wins() -> None:
    """In at least 95 of 100 sets of data; the noise is assumed three times too large in every other."""
    empty = [
        not search(draw_alike(100 + seed, {}).misjudge((1.0, 3.0)[seed % 2])).best.effects for seed in range(100)
    ]  # fmt: skip
    assert sum(empty) >= 95


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_the_winner_stays_where_noise_is_misjudged(factor: float) -> None:
    """Noise assumed five times too small or too large changes neither the set nor how probable its effects are."""
    toy = simulate(draw_linear(EIGHT, 7), TRUTH, 7)
    right, wrong = search(toy), search(toy.misjudge(factor))
    assert right.best.effects == wrong.best.effects == frozenset("ac")
    for name in EIGHT:
        assert wrong.inclusion(frozenset(name)) == pytest.approx(right.inclusion(frozenset(name)), abs=0.02)


def draw_bump(seed: int, alike: bool = False) -> Toy:
    """Eight linear candidates, `a` and `c` there, and a bump at 0.8 of every window: nothing leads there from none.

    `c` and `d` are the same if they are to be `alike`.
    """
    law, time = draw_linear(EIGHT, seed), np.tile(np.linspace(0.0, 1.0, 12), 2)
    law = Linear({**law.slopes, ("d", "size"): law.slopes["c" if alike else "d", "size"]})

    def bumped(point: Point) -> np.ndarray:
        strength, place = point.get(STRENGTH, 0.0), point.get(PLACE, 0.0)
        return law(point) + strength * np.exp(-(((time - place) / 0.1) ** 2))

    return simulate(bumped, {**TRUTH, STRENGTH: 0.8, PLACE: 0.8}, seed)


BUMP = [name_unknown(name) for name in EIGHT] + [name_unknown(*STRENGTH), name_unknown(*PLACE)]
TRIALS = [Trial("bump", {STRENGTH: 0.3, PLACE: place}, BUMP[-2]) for place in (0.1, 0.4, 0.7)]


def test_trials_lead_to_what_slopes_do_not() -> None:
    """Without them the bump is not found where it is; with them it is, beside two linear effects."""
    best = search(draw_bump(1), BUMP, TRIALS).best
    assert best.effects == {"a", "c", "bump"}
    for key, value in {**TRUTH, STRENGTH: 0.8, PLACE: 0.8}.items():
        assert abs(best.values[key] - value) < 3.0 * best.std[key]
    assert search(draw_bump(1), BUMP).best.evidence < best.evidence - 10.0


def shuffle(toy: Toy, seed: int) -> Comparison:
    """Search with the bump, unknowns and trials in an order drawn from a seed."""
    rng = np.random.default_rng([seed, 5])
    unknowns = [BUMP[i] for i in rng.permutation(len(BUMP))]
    return search(toy, unknowns, [TRIALS[i] for i in rng.permutation(len(TRIALS))])


@pytest.mark.parametrize("seed", range(3))
def test_order_of_unknowns_and_trials_does_not_matter(seed: int) -> None:
    """The same sets in the same order, with the same evidence to rounding."""
    first, second = search(draw_bump(2), BUMP, TRIALS), shuffle(draw_bump(2), seed)
    assert second.ordered == first.ordered
    evidence = {effects: fit.evidence for effects, fit in first.fits.items()}
    assert {effects: fit.evidence for effects, fit in second.fits.items()} == pytest.approx(evidence, abs=1e-9)


def test_order_does_not_matter_to_the_last_bit() -> None:
    """Two effects that are one and the same tie, and names decide: rounding may not."""
    toy = draw_bump(2, alike=True)
    first = search(toy, BUMP, TRIALS)
    for second in (shuffle(toy, seed) for seed in range(4)):
        assert second.ordered == first.ordered
        assert all(second.fits[effects].evidence == fit.evidence for effects, fit in first.fits.items())


def test_what_modifies_is_never_fitted_alone() -> None:
    """An effect that only changes `a` or `b` is not asked for without one of them, not even to see what `a` adds."""
    told: list[frozenset[str]] = []
    toy = simulate(draw_linear(EIGHT, 5), {("a", "size"): 1.0, ("e", "size"): 1.0}, 5)
    comparison = search(toy, modifies={"e": ("a", "b")}, told=told)
    assert comparison.best.effects == frozenset("ae")
    alone = [sorted(effects) for effects in {*told, *comparison.fits} if "e" in effects and not effects & {"a", "b"}]
    assert alone == []


def test_log_odds_are_those_of_the_inclusion_probability() -> None:
    """Of one effect and of either of two; where no set, or every set, has one they are infinite."""
    comparison = search(draw_alike(1, TRUTH), temper=2.0)
    for effects in ("c", "cd"):
        inclusion = sum(p for found, p in comparison.probabilities.items() if found & frozenset(effects))
        assert comparison.log_odds(frozenset(effects)) == pytest.approx(np.log(inclusion / (1.0 - inclusion)), rel=1e-6)
    assert comparison.log_odds(frozenset()) == -np.inf


def test_a_first_guess_never_outlasts_a_fit_with_its_own_responses() -> None:
    """Whatever evidence borrowed responses give it, and whichever comes first."""
    fit = Fitter(draw_alike(1, TRUTH), [name_unknown(name) for name in EIGHT]).fit(frozenset("a"), {})
    guess = replace(fit, lent=True, posterior=replace(fit.posterior, deviance=fit.posterior.deviance - 1e3))
    for order in ((fit, guess), (guess, fit)):
        comparison = Comparison(1.0, ODDS)
        for each in order:
            comparison.add(each)
        assert comparison.best is fit
