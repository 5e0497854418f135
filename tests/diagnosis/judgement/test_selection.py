"""Which suspects become causes: the rules one by one, on judges and searches that are made up."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm, t

from tests.builders import FRAME, Unsearched, guess, lay_bench, linear, load_known, load_rig, whiten_nothing
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.blocks import improvement
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.rivals import (
    evidence_against_rival,
    find_better,
    find_simpler,
    look_alike,
    tell_nothing,
    tell_roughness,
    weigh_freedom,
    weigh_rivals,
)
from vpptwin.diagnosis.judgement.selection import (
    Selection,
    accept_cause,
    choose_cause,
    confirms,
    find_near,
    fit_together,
    is_cause,
    is_faint,
    select_causes,
)
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.fits import Fit, find_cheapest
from vpptwin.diagnosis.search.frame import Frame
from vpptwin.diagnosis.search.likelihood import Likelihood
from vpptwin.diagnosis.search.search import Search, Step
from vpptwin.diagnosis.search.shortlist import Start
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects.body import FreeBody, effects_for_body
from vpptwin.effects.friction import asymmetry, coulomb, stiction
from vpptwin.effects.joint import JointScale, bias, spring, viscous
from vpptwin.effects.link import Link, effects_for_links

PLACE = JointScale("a", "on a", tolerance=0.02)
UNKNOWNS = tuple(
    Unknown(effect, p, 0.1 if effect.id == "a.viscous" else p.off)
    for effect in (
        coulomb(PLACE),
        viscous(PLACE, look_alikes=("a.spring",)),
        bias(PLACE),
        spring(PLACE),
        stiction(PLACE),
        coulomb(JointScale("b", "on b")),
        asymmetry(PLACE),
    )
    for p in effect.parameters
)
WINDOWS = 25
BAR = CRITERIA.bar
HINT = CRITERIA.bars_fitted
STRONG = CRITERIA.bars_strong * BAR


def fit(cost: float, **values: float) -> Fit:
    """A fit of strengths, e.g. a_viscous=0.3, with its cost."""
    keys = {u.effect.id: u.key for u in reversed(UNKNOWNS)}
    named = {name.replace("_", "."): value for name, value in values.items()}
    return guess({keys[effect]: value for effect, value in named.items()}, cost)


class Judges:
    """Held-out windows whose surprise drops by `gain` standard errors with every effect that is named.

    Args:
        gain: in standard errors of the sum over windows, which is 5 as so few windows tell it.
        power: whitened change of prediction, squared and summed.
        worse: whether an effect makes errors worse.
        favour: by how many standard errors the errors favour whatever is fitted later.
    """

    def __init__(
        self, gain: float, power: float = 10.0 * CRITERIA.powerless, worse: bool = False, favour: float = 0.0
    ) -> None:
        scatter = np.tile([1.0, -1.0], WINDOWS)[:WINDOWS] - 1.0 / WINDOWS
        scatter /= scatter.std(ddof=1)
        scatter *= gain / t.isf(norm.sf(gain), WINDOWS - 1) if gain else 1.0
        self.drop = scatter + gain / np.sqrt(WINDOWS)
        self.power, self.worse, self.favour = power, worse, favour
        self.left: dict[int, float] = {}
        self.errors = self  # the same say of both

    def weigh(self, before: tuple[Fit, bool], after: tuple[Fit, bool]) -> tuple[float, float]:
        """Drop in surprise and its standard error."""
        surprise = [-len(fit.effects) * self.drop for fit, _ in (before, after)]
        return improvement(*surprise, CRITERIA.most_drop)

    count = 100

    def chi2(self, values: dict) -> float:
        """As set for so many parameters, else what noise makes."""
        return self.left.get(len(values), 1.0)

    def worsens(self, *_: Any) -> bool:  # noqa: ANN401
        """As made."""
        return self.worse

    def settles(self, before: dict, after: dict) -> bool:
        """By chi²."""
        return self.chi2(after) < CRITERIA.settled * self.chi2(before)

    def is_farther(self, before: dict, after: dict, sticks: bool) -> bool:
        """By chi²."""
        return self.chi2(after) > self.chi2(before)

    def prefer(self, *_: Any) -> float:  # noqa: ANN401
        """As made."""
        return self.favour

    def likelihood(self, *_: Any) -> Likelihood:  # noqa: ANN401
        """Residuals are white already."""
        return whiten_nothing(1)

    def residual(self, values: dict) -> np.ndarray:
        """One number."""
        return np.full((1, 1), len(values) * np.sqrt(self.power))


class Still(Unsearched):
    """A search in which nothing sticks, on a rig whose disturbances are known, as the drone's, or assumed."""

    def __init__(self, known: bool, unknowns: tuple[Unknown, ...] = UNKNOWNS) -> None:
        super().__init__(lay_bench(2.0 * np.arange(16.0), spec=load_known() if known else load_rig()), unknowns)

    def sticks(self, effects: frozenset[str]) -> bool:
        """Nothing does."""
        return False


SEARCH, OTHER_RIG = Still(True), Still(False)


def judge(
    judges: Judges,
    drop: float,
    earlier_drops: dict[str, float] | None = None,
    search: Search = SEARCH,
    **values: float,
) -> bool:
    """Whether the last of the values is a cause beside the others, beside which it brings a drop in cost."""
    tried = fit(50.0 - drop, **values)
    *beside, effect = (name.replace("_", ".") for name in values)
    before = fit(50.0, **{name: v for name, v in values.items() if name.replace("_", ".") in beside})
    return is_cause(search, judges, Step(before, {effect: tried}), effect, earlier_drops or {})  # type: ignore[arg-type]


SURE = Judges(10.0)


@pytest.mark.parametrize(
    ("drop", "named"),
    [
        (1.01 * BAR, True),
        (1.01 * HINT * BAR, True),
        (0.99 * HINT * BAR, False),
        (-5.0, False),
    ],
)
def test_causes_clear_the_bar(drop: float, named: bool) -> None:
    """Evidence below the bar of the fitted windows names nothing, however well held-out windows are predicted."""
    assert judge(SURE, drop, a_coulomb=0.5) is named


def test_fitted_and_held_out_windows_clear_a_higher_bar_together() -> None:
    """Held-out ones that bring 2.2 standard errors of 5 leave so much for the fitted ones."""
    least = CRITERIA.bars_together * BAR - 2.2 * 0.25
    for drop, named in ((least - 0.1, False), (least + 0.1, True)):
        judges = Judges(2.2)
        judges.drop = 0.05 * judges.drop
        assert judge(judges, drop, a_coulomb=0.5) is named


def test_errors_must_not_grow() -> None:
    """A cause that makes the prediction of held-out poses worse is none; on other rigs it must make it better."""
    assert not judge(Judges(10.0, worse=True), 10.0 * BAR, a_coulomb=0.5)
    assert judge(Judges(10.0, favour=-1.0), 10.0 * BAR, a_coulomb=0.5)
    assert not judge(Judges(10.0, favour=-2.0), 10.0 * BAR, None, OTHER_RIG, a_coulomb=0.5)
    assert judge(Judges(10.0, favour=0.1), 10.0 * BAR, None, OTHER_RIG, a_coulomb=0.5)


def test_evidence_against_a_rival() -> None:
    """Cost, and what held-out windows say beyond a standard error; on other rigs errors have the last word."""
    pair = fit(100.0, a_coulomb=1.0, a_bias=1.0), fit(130.0, a_viscous=1.0)
    assert evidence_against_rival(SEARCH, Judges(3.0), *pair) == pytest.approx(30.0 + 2.0 * 5.0)  # type: ignore[arg-type]
    assert evidence_against_rival(SEARCH, Judges(-3.0), *pair) == pytest.approx(30.0 - 2.0 * 5.0)  # type: ignore[arg-type]
    assert evidence_against_rival(SEARCH, Judges(-0.5), *pair) == pytest.approx(30.0)  # type: ignore[arg-type]
    for favour, found in ((-3.0, -9.0), (-1.9, 30.0), (3.0, 30.0), (6.0, 36.0)):
        judges = Judges(0.0, favour=favour)
        assert evidence_against_rival(OTHER_RIG, judges, *pair) == pytest.approx(found)  # type: ignore[arg-type]
        assert evidence_against_rival(SEARCH, judges, *pair) == pytest.approx(30.0)  # type: ignore[arg-type]
    # They are the last word where the error of the pose does not say otherwise.
    one, other = fit(300.0, a_bias=1.0), fit(310.0, a_spring=1.0, a_coulomb=1.0)
    judges = Judges(0.0, favour=-5.0)
    assert evidence_against_rival(OTHER_RIG, judges, one, other) == -25.0  # type: ignore[arg-type]
    judges.left = {1: 1.7, 2: 7.9}
    assert evidence_against_rival(OTHER_RIG, judges, one, other) > 0.0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("there", "left", "other", "search", "as_good"),
    [
        (3e5, 300.0, 329.0, OTHER_RIG, True),
        (3e5, 300.0, 331.0, OTHER_RIG, False),
        (350.0, 300.0, 304.0, OTHER_RIG, True),
        (350.0, 300.0, 306.0, OTHER_RIG, False),  # of the 50 that the cause removes it leaves more than a tenth
        (3e5, 300.0, 300.0, SEARCH, False),
    ],
)
def test_what_leaves_as_little_of_much_is_as_good(
    there: float,
    left: float,
    other: float,
    search: Search,
    as_good: bool,
) -> None:
    """Where far more is left than noise makes, on rigs whose noise is assumed."""
    judges = Judges(0.0)
    judges.left = {0: there, 2: left, 1: other}
    fits = fit(300.0), fit(100.0, a_coulomb=1.0, a_bias=1.0), fit(180.0, a_viscous=1.0)
    assert tell_nothing(search, judges, *fits, 80.0) == (np.inf if as_good else 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gain", "rival", "as_good"), [(0.5, "a_spring", True), (3.0, "a_spring", False), (0.5, "b_coulomb", False)]
)
def test_look_alikes_are_told_apart_by_more_than_a_point(gain: float, rival: str, as_good: bool) -> None:
    """Twice the chi² of the points of two fits, but held-out windows with all that these leave open favour neither."""
    judges, fits = Judges(0.0), (fit(300.0), fit(100.0, a_viscous=1.0), fit(180.0, **{rival: 1.0}))
    left = {id(each.values): chi2 for each, chi2 in zip(fits, (3e5, 300.0, 600.0))}
    judges.chi2 = lambda values: left[id(values)]  # type: ignore[method-assign]
    judges.weigh = lambda before, after: (gain, 1.0)  # type: ignore[method-assign]
    assert tell_nothing(OTHER_RIG, judges, *fits, 80.0) == (np.inf if as_good else 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("spread", "left", "other", "counts"),
    [
        (6.0, 3.0, 3.1, 1.5625),  # standard errors: 32/24.8, squared, less by one degree of freedom
        (1.0, 3.0, 3.1, 32.0 / CRITERIA.temper),
        (6.0, 3.0, 3.3, 32.0 / CRITERIA.temper),  # it leaves a tenth more error
        (6.0, 1.0, 1.05, 1.5625),
    ],
)
def test_evidence_that_scatters_tells_little(spread: float, left: float, other: float, counts: float) -> None:
    """Sixteen windows favour a cause by 2 each and scatter about that: so much is left of 32, over the temper."""
    drops = 2.0 + spread * np.tile([1.0, -1.0], 8)
    search, judges, cause, rival = Still(False), Judges(0.0), fit(100.0, a_coulomb=1.0), fit(132.0, a_bias=1.0)
    search.cost_by_window = lambda fit: drops if fit is rival else 0.0 * drops
    judges.chi2 = lambda values: {0: 300.0}.get(len(values), other if rival.values is values else left)  # type: ignore
    nothing = tell_nothing(search, judges, fit(400.0), cause, rival, 32.0)  # type: ignore[arg-type]
    told = (32.0 - max(nothing, 0.0)) / CRITERIA.temper
    assert told == pytest.approx(counts, rel=0.1)


def test_freedom_tells_no_weight_hung_on_from_one_that_lies_elsewhere() -> None:
    """A payload pays for four numbers where a centre of mass pays for one: that tells them apart no more than data do.

    Between a wrong mass and a payload, which also say how heavy a body is, it does; and the simpler one has no excuse.
    """
    effects = effects_for_links([Link("a", 1.0, (0.0, 0.0, -0.1), 0.1, ways="z")])
    unknowns = tuple(Unknown(e, p, p.off) for e in effects for p in e.parameters)
    search = Still(True, unknowns)
    rows = np.eye(len(unknowns)) / [u.parameter.size for u in unknowns]
    about = linear(np.array([u.nominal for u in unknowns]), 30.0 * rows, np.zeros(len(unknowns)))
    fits = {e.id: replace(guess({(e.id, e.parameters[0].name): 0.0}), about=about) for e in effects}

    def weigh(cause: str, rival: str) -> float:
        return weigh_freedom(search, fits[cause], fits[rival], cause, rival)  # type: ignore[arg-type]

    price = {e.id: sum(np.log(1.0 + 900.0 * (u.width / u.parameter.size) ** 2) for u in unknowns if u.effect is e)
             for e in effects}  # fmt: skip
    assert weigh("a.com", "a.payload") == pytest.approx(price["a.payload"] - price["a.com"], rel=1e-3)
    assert weigh("a.com", "a.payload") > 20.0
    assert weigh("a.payload", "a.com") == weigh("a.mass", "a.payload") == weigh("a.com", "a.mass") == 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_stays_within_tolerance_is_no_cause(sign: float) -> None:
    """A force of 2.4 tolerances is what a well-built rig may have; 2.6 are not; counted from the twin's own value."""
    for times, named in ((CRITERIA.tolerances - 0.1, False), (CRITERIA.tolerances + 0.1, True)):
        assert judge(SURE, 10.0 * BAR, a_bias=sign * times * 0.02) is named
        assert judge(SURE, 10.0 * BAR, a_viscous=0.1 + sign * times * 0.02) is named


@pytest.mark.parametrize(
    ("gain", "drop", "named"),
    [
        (CRITERIA.sigmas_held_out + 0.2, 0.9 * STRONG, True),
        (CRITERIA.sigmas_held_out - 0.2, 0.9 * STRONG, False),
        (CRITERIA.sigmas_held_out - 0.2, 1.1 * STRONG, True),
        (-0.8, 1.1 * STRONG, True),
        (-1.2, 1.1 * STRONG, False),
        (-5.0, 100.0 * STRONG, False),
    ],
)
def test_held_out_windows_must_agree(gain: float, drop: float, named: bool) -> None:
    """By two standard errors; less is enough where evidence is overwhelming, but not what they contradict by one."""
    assert judge(Judges(gain), drop, a_coulomb=0.5) is named


@pytest.mark.parametrize(
    ("known", "left", "gain", "named"),
    [(False, 1.7, 0.5, True), (True, 1.7, 0.5, False), (False, 8.0, 0.5, False), (False, 1.7, -1.1, False)],
)
def test_gusts_that_are_but_assumed_stand_for_no_cause(known: bool, left: float, gain: float, named: bool) -> None:
    """What takes nearly all of a large chi² away is named beside gusts that could have made it, if none contradicts."""
    judges = Judges(gain)
    judges.left = {0: 28.0, 1: left}
    assert judge(judges, 1.2 * BAR, None, Still(known), a_coulomb=0.5) is named


@pytest.mark.parametrize(
    ("gain", "drop", "named"),
    [
        (0.0, 2.1 * BAR, True),
        (0.0, 1.9 * BAR, False),
        (-CRITERIA.sigmas_held_out + 0.2, 2.1 * BAR, True),
        (-CRITERIA.sigmas_held_out - 0.2, 2.1 * BAR, False),
    ],
)
def test_held_out_windows_that_cannot_judge_are_not_asked(gain: float, drop: float, named: bool) -> None:
    """Where an effect hardly moves them, twice the evidence names it unless they speak against it."""
    assert judge(Judges(gain, 0.9 * CRITERIA.powerless), drop, a_coulomb=0.5) is named
    assert not judge(Judges(0.0, 1.1 * CRITERIA.powerless), 2.1 * BAR, a_coulomb=0.5)


@pytest.mark.parametrize(
    ("gain", "favour", "confirmed"), [(2.1, 0.1, True), (2.1, -0.1, False), (1.9, 0.1, False), (-1.0, 3.0, False)]
)
def test_what_held_out_log_alone_does_not_show_is_suggested(gain: float, favour: float, confirmed: bool) -> None:
    """Two standard errors, and smaller errors; on the drone, whose gusts are known, fitted windows may stand alone.

    But not for a place that was looked for along a joint: somewhere chance always is.
    """
    before, after = fit(50.0), fit(-100.0, a_coulomb=1.0)
    judges: Any = Judges(gain, favour=favour)
    assert confirms(OTHER_RIG, judges, before, after) == confirmed
    assert confirms(SEARCH, judges, before, after)
    somewhere = tuple(replace(u, effect=replace(u.effect, placed=True)) for u in UNKNOWNS)
    assert confirms(Still(True, somewhere), judges, before, after) == (gain > CRITERIA.sigmas_held_out)


@pytest.mark.parametrize(
    ("drop", "gain", "favour", "named"),
    [
        (0.4 * STRONG, 4.0, 0.1, True),
        (0.4 * STRONG, 1.7, 0.1, True),  # 40 together, two fifths of the way from two to one standard error: 1.58
        (0.4 * STRONG, 1.5, 0.1, False),
        (0.4 * STRONG, 4.0, -0.9, True),
        (0.4 * STRONG, 4.0, -1.1, False),
        (1.1 * STRONG, 4.0, -1.1, True),
        (1.1 * STRONG, 4.0, -2.1, False),
        (0.9 * STRONG, 1.9, -1.1, True),  # both together are overwhelming
        (0.9 * STRONG, 1.5, -1.1, False),
        (1.1 * STRONG, -3.0, 1.9, False),
        (1.1 * STRONG, -3.0, 2.1, True),
    ],
)
def test_on_other_rigs_errors_have_the_last_word(drop: float, gain: float, favour: float, named: bool) -> None:
    """They veto by a standard error, by two what is overwhelming, and outvote by two windows that contradict."""
    assert judge(Judges(gain, favour=favour), drop, search=OTHER_RIG, a_coulomb=0.5) is named


@pytest.mark.parametrize(("y", "faint"), [(0.0, True), (2e-4, True), (0.008, False), (-0.008, False)])
def test_a_vector_is_faint_if_all_its_axes_are(y: float, faint: bool) -> None:
    """A wind across is no less a wind for not blowing along, by standard deviations of 0.1 mN."""
    body = FreeBody("quad", 0.03, (1e-5, 1e-5, 2e-5), 0.02, 0.3, 1e-3, 1.0)
    (wind,) = (effect for effect in effects_for_body(body) if effect.id == "quad.wind")
    search = Still(False, tuple(Unknown(wind, p, p.off) for p in wind.parameters))
    found = guess({("quad.wind", axis): {"x": 1e-5, "y": y, "z": 0.0}[axis] for axis in "xyz"})
    found = replace(found, std=dict.fromkeys(found.values, 1e-4))
    assert is_faint(search, found, "quad.wind") is faint


def test_lopsided_friction_and_a_force_beside_friction_are_one_law() -> None:
    """What they differ by, to the inexactness of laws of friction, tells nothing; of other pairs everything does."""
    rough = CRITERIA.kinship * 1000.0
    for one, other in (("a.bias", "a.asymmetry"), ("a.asymmetry", "a.bias")):
        assert tell_roughness(SEARCH, one, other, {one: 1000.0}) == rough
        assert tell_roughness(SEARCH, one, other, {one: 300.0, "a.coulomb": 1000.0, "a.viscous": 2000.0}) == rough
    for one, other in (("a.coulomb", "a.viscous"), ("a.coulomb", "a.asymmetry"), ("a.bias", "a.spring")):
        assert tell_roughness(SEARCH, one, other, {one: 1000.0}) == 0.0
    (rival,) = weigh_rivals({"a.asymmetry": rough - 1.0}, CRITERIA, {"a.asymmetry": rough})
    assert rival.confidence == 0.5


def test_what_falls_behind_is_heard_where_no_other_is_left() -> None:
    """On another rig; the leader makes errors grow. On the drone, and where a cause was found, nobody is asked."""
    before = fit(50.0)
    step = Step(before, {"a.coulomb": fit(-100.0, a_coulomb=1.0)}, {"a.bias": fit(20.0, a_bias=1.0)})

    class Half(Judges):
        def worsens(self, _: object, after: dict) -> bool:
            return any(effect == "a.coulomb" for effect, _ in after)

    def judged(step: Step) -> Step:
        return Step(step.before, step.tried | step.behind)

    for search, heard in ((OTHER_RIG, "a.bias"), (SEARCH, None)):
        asking = copy(search)
        asking.judge_behind = judged  # type: ignore[method-assign]
        found, accepted = accept_cause(asking, Half(10.0, favour=3.0), step, {})  # type: ignore[arg-type]
        assert accepted == heard
        assert set(found.tried) == {"a.coulomb"} | ({"a.bias"} if heard else set())


def test_all_windows_together_choose_where_errors_have_the_last_word() -> None:
    """Fitted ones like a dead band better, held-out ones dry friction, by more; the drone's go by the fitted ones."""
    before = fit(500.0)
    step = Step(before, {"a.coulomb": fit(390.0, a_coulomb=1.0), "a.bias": fit(360.0, a_bias=1.0)})

    class Favour(Judges):
        def weigh(self, before: tuple[Fit, bool], after: tuple[Fit, bool]) -> tuple[float, float]:
            gain = {frozenset[str](): 0.0, frozenset({"a.coulomb"}): 80.0, frozenset({"a.bias"}): 40.0}
            return gain[after[0].effects] - gain[before[0].effects], 5.0

    for search, chosen in ((OTHER_RIG, "a.coulomb"), (SEARCH, "a.bias")):
        assert choose_cause(search, Favour(0.0, favour=1.0), step, {}) == chosen  # type: ignore[arg-type]
    assert find_near(OTHER_RIG, step, "a.bias") == {"a.coulomb"}  # type: ignore[arg-type]
    assert find_near(SEARCH, step, "a.bias") == frozenset()  # type: ignore[arg-type]


def test_of_two_that_nothing_tells_apart_the_simpler_is_named() -> None:
    """A spring with a place of rest and a constant force, where far more is left than noise makes."""
    evidence, alike = {"a.spring": {"a.bias": 30.0, "a.stiction": -2.0}}, {"a.bias": np.inf, "a.stiction": np.inf}
    assert find_simpler(OTHER_RIG, evidence, {"a.spring": alike}) == ("a.spring", "a.bias")  # type: ignore[arg-type]
    assert find_simpler(OTHER_RIG, evidence, {"a.spring": dict.fromkeys(alike, 3.0)}) is None  # type: ignore[arg-type]
    assert find_simpler(OTHER_RIG, {"a.bias": {"a.spring": 1.0}}, {"a.bias": {"a.spring": np.inf}}) is None  # type: ignore[arg-type]


def test_kin_of_a_cause_must_bring_a_good_part_of_it() -> None:
    """Beside sliding friction that brought 1000, breakaway must clear the bar by 50; another joint's need not."""
    drops, more = {"a.coulomb": 1000.0}, HINT * BAR + CRITERIA.kinship * 1000.0
    for drop, named in ((0.98 * more, False), (1.02 * more, True)):
        assert judge(SURE, drop, drops, a_coulomb=1.0, a_stiction=0.5) is named
    assert judge(SURE, 1.01 * BAR, drops, a_coulomb=1.0, b_coulomb=0.5)
    assert judge(SURE, 1.01 * BAR, drops, a_coulomb=1.0, a_bias=0.5)
    # What was dropped since is no kin.
    assert judge(SURE, 1.01 * BAR, drops, a_bias=1.0, a_stiction=0.5)


def test_look_alikes_are_those_of_the_catalogue_and_frictions_of_one_joint() -> None:
    """Whichever of the two names the other."""
    assert look_alike(SEARCH, "a.viscous", "a.spring")
    assert look_alike(SEARCH, "a.spring", "a.viscous")
    assert look_alike(SEARCH, "a.coulomb", "a.asymmetry")
    assert not look_alike(SEARCH, "a.coulomb", "b.coulomb")
    assert not look_alike(SEARCH, "a.bias", "a.spring")


def test_rivals_and_confidence_by_hand() -> None:
    """4 worse than the cause is exp(-2/T) as probable, 9 T or more is out, better is as good; they sum to one."""
    evidence = {"a.viscous": 4.0, "a.spring": -1.0, "a.bias": 1.01 * CRITERIA.rival_sigma**2 * CRITERIA.temper}
    first, second = weigh_rivals(evidence, CRITERIA)
    less = np.exp(-2.0 / CRITERIA.temper)
    assert (first.effect, second.effect) == ("a.spring", "a.viscous")
    assert first.confidence == pytest.approx(1.0 / (2.0 + less))
    assert second.confidence == pytest.approx(less / (2.0 + less))
    assert (first.sigma, second.sigma) == (0.0, pytest.approx(np.sqrt(4.0 / CRITERIA.temper)))
    assert weigh_rivals({}, CRITERIA) == []
    # What rivals leave, less half of the odds that nothing is there; never beyond 0.999, never below a half of it.
    doubt = 0.5 * np.exp(-0.5 * 6.0 / CRITERIA.temper)
    rivals = Rival("a.viscous", 0.25), Rival("a.spring", 0.15)
    assert select(6.0).confidence("a.coulomb") == pytest.approx(1.0 - doubt)
    assert select(6.0, *rivals).confidence("a.coulomb") == pytest.approx(0.6 * (1.0 - doubt))
    assert select(1e9).confidence("a.coulomb") == 0.999
    assert select(-3.0, *rivals).confidence("a.coulomb") == pytest.approx(0.3)


def select(evidence: float, *rivals: Rival) -> Selection:
    """A single cause with its evidence and rivals."""
    cause = fit(0.0, a_coulomb=1.0)
    return Selection(cause, Step(cause, {}), {"a.coulomb": list(rivals)}, {"a.coulomb": []}, {"a.coulomb": evidence})


def test_a_rival_that_is_clearly_better_takes_the_place() -> None:
    """The best rival of all causes, if the evidence prefers it by more than CRITERIA.better."""

    def find(coulomb: dict[str, float], bias: dict[str, float]) -> tuple[str, str] | None:
        return find_better(SEARCH, {"a.coulomb": coulomb, "a.bias": bias}, {})

    little, much, most = -0.9 * CRITERIA.better, -1.1 * CRITERIA.better, -2.0 * CRITERIA.better
    assert find({"a.spring": little}, {}) is None
    assert find({"a.spring": little, "a.viscous": much}, {}) == ("a.coulomb", "a.viscous")
    assert find({"a.spring": much}, {"a.spring": little, "a.viscous": most}) == ("a.bias", "a.viscous")
    assert find_better(SEARCH, {}, {}) is None
    # Unless the other is better by more than such laws are inexact, 5 % of what was brought; of one joint only.
    near = 0.98 * CRITERIA.kinship * 1000.0

    def find(effect: str, rival: str, evidence: float) -> tuple[str, str] | None:
        return find_better(SEARCH, {effect: {rival: evidence}}, {effect: 1000.0})

    assert find("a.stiction", "a.coulomb", near) == ("a.stiction", "a.coulomb")
    assert find("a.stiction", "a.coulomb", 1.05 * near) is None
    assert find("a.coulomb", "a.stiction", -near) is None
    assert find("a.coulomb", "a.stiction", -1.05 * near) == ("a.coulomb", "a.stiction")
    assert find("a.stiction", "b.coulomb", 0.0) is None
    assert find("a.stiction", "a.viscous", -1.1 * CRITERIA.better) == ("a.stiction", "a.viscous")


def test_what_nothing_shows_is_not_fitted() -> None:
    """An effect without any start is left out, instead of ending the fit of the others."""
    script = Script({}, set())
    assert fit_together(script, ["motor.rate_limit"]) is script.start


def test_costs_of_two_frames_are_not_compared() -> None:
    """Other weights, other noise: no difference, no step, no cheapest, no held-out flights."""
    here, elsewhere = fit(10.0, a_coulomb=1.0), guess({}, 50.0, Frame(FRAME.weight, FRAME.scale, FRAME.floor))
    for compare in (
        lambda: here.evidence_against(elsewhere),
        lambda: Step(elsewhere, {"a.coulomb": here}).ordered,
        lambda: find_cheapest([here, elsewhere]),
        lambda: HeldOut.weigh(SURE, (elsewhere, False), (here, False)),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match="fits of two frames"):
            compare()
    assert here.evidence_against(fit(50.0)) == 40.0


class Script(Still):
    """A search on another rig that finds what it is told to: every suspect in turn brings so much.

    Args:
        drops: suspect → drop in cost that it brings beside whatever is there.
        lasting: which of them stay once they are fitted with the others.
    """

    def __init__(self, drops: dict[str, float], lasting: set[str]) -> None:
        super().__init__(False)
        self.drops, self.lasting, self.tried = drops, lasting, list[str]()
        self.start = self.of(frozenset())
        self.refine = self.reframe = self.rederive = lambda fit: fit

    def rank(self, fit: Fit) -> list[Start]:
        """Linearisation promises nothing."""
        return []

    def of(self, effects: frozenset[str]) -> Fit:
        """The fit of a set."""
        found = fit(1e4 - sum(self.drops[e] for e in effects), **{e.replace(".", "_"): 1.0 for e in sorted(effects)})
        return found

    def extend(
        self, fit: Fit, barred: frozenset[str] = frozenset(), against: str = "", whole: Fit | None = None,
        near: frozenset[str] = frozenset(),
    ) -> Step:  # fmt: skip
        """Every other suspect beside a fit; none in the place of a cause."""
        if against:
            return Step(fit, {})
        names = [name for name in self.drops if name not in fit.effects | barred]
        self.tried += names[:1]
        return Step(fit, {name: self.of(fit.effects | {name}) for name in names})

    def drop_superfluous(self, fit: Fit, weigh: object = None) -> Fit:
        """What lasts."""
        return self.of(fit.effects & self.lasting)

    def without(self, fit: Fit, effect: str) -> Fit:
        """One less."""
        return self.of(fit.effects - {effect})

    def neighbours(self, fit: Fit) -> list[Fit]:
        """None."""
        return []


class StrictJudges(Judges):
    """Judges who favour every step, but find each set with one of the `harmful` worse than the plain twin."""

    def __init__(self, *harmful: str) -> None:
        super().__init__(10.0, favour=10.0)
        self.harmful = set(harmful)

    def is_worse(self, before: dict, after: dict, sticks: bool) -> bool:
        """Whether a harmful one is there."""
        return bool({effect for effect, _ in after} & self.harmful)

    def chi2(self, values: dict) -> float:
        """One more for every harmful one."""
        return 1.0 + len({effect for effect, _ in values} & self.harmful)


def select_from(script: Script, judges: Judges) -> Selection:
    """Select from what a script finds."""
    return select_causes(script, judges, lambda text: None)  # type: ignore[arg-type]


def test_a_suspect_that_does_not_last_is_taken_in_once() -> None:
    """What is dropped as superfluous as soon as it is fitted with the others makes way for the next."""
    script = Script({"a.coulomb": 900.0, "a.bias": 500.0, "b.coulomb": 300.0}, {"a.coulomb", "b.coulomb"})
    found = select_from(script, StrictJudges())
    assert found.fit.effects == {"a.coulomb", "b.coulomb"}
    assert script.tried == ["a.coulomb", "a.bias", "b.coulomb"]
    assert found.left_out == frozenset()


@pytest.mark.parametrize(("search", "size", "doubt"), [(OTHER_RIG, 1.0, 0.9), (SEARCH, 1e-6, 0.1)])
def test_a_cause_that_fades_beside_a_later_one_goes(search: Search, size: float, doubt: float) -> None:
    """Clear of nothing when it was taken in; a standard error of it, or within its tolerance, in the end."""

    class Fading(Script):
        def __init__(self, drops: dict[str, float]) -> None:
            super().__init__(drops, set(drops))
            self.bench = search.bench

        def of(self, effects: frozenset[str]) -> Fit:
            found = super().of(effects)
            fades = [key for key in found.values if key[0] == "a.bias" and len(effects) > 1]
            values, std = dict(found.values), dict.fromkeys(found.values, 0.1)
            return replace(found, values=values | dict.fromkeys(fades, size), std=std | dict.fromkeys(fades, doubt))

    assert select_from(Fading({"a.bias": 900.0, "b.coulomb": 500.0}), StrictJudges()).fit.effects == {"b.coulomb"}


@pytest.mark.parametrize(("doubt", "named"), [(0.1, "a.bias"), (0.9, "a.coulomb")])
def test_a_rival_that_would_fade_takes_no_place(doubt: float, named: str) -> None:
    """Likelier than a cause, but so uncertain that it would be dropped as faint next, and nothing be named."""

    class Tempting(Script):
        def extend(self, fit: Fit, barred: frozenset[str] = frozenset(), against: str = "", **_: object) -> Step:
            if against != "a.coulomb":
                return super().extend(fit, barred | {"a.bias"}, against)
            rival = self.of(frozenset({"a.bias"}))
            return Step(fit, {"a.bias": replace(rival, std=dict.fromkeys(rival.values, doubt))})

    judges = StrictJudges()
    judges.favour = 0.0
    found = select_from(Tempting({"a.coulomb": 500.0, "a.bias": 900.0}, {"a.coulomb", "a.bias"}), judges)
    assert found.fit.effects == {named}
    judges.harmful = {"a.bias"}  # once it is fitted by itself it leaves more of held-out log, however likely it was
    found = select_from(Tempting({"a.coulomb": 500.0, "a.bias": 900.0}, {"a.coulomb", "a.bias"}), judges)
    assert found.fit.effects == {"a.coulomb"}


def test_causes_that_predict_other_logs_worse_are_left_out() -> None:
    """Step by step all is well, and the set predicts held-out log worse than the plain twin: the harmful one goes."""
    script = Script({"a.coulomb": 900.0, "a.bias": 500.0}, {"a.coulomb", "a.bias"})
    found = select_from(script, StrictJudges("a.bias"))
    assert found.fit.effects == {"a.coulomb"}
    assert found.left_out == {"a.bias"}
    alone = select_from(Script({"a.bias": 500.0}, {"a.bias"}), StrictJudges("a.bias"))
    assert alone.fit.effects == frozenset()
    assert alone.left_out == {"a.bias"}
