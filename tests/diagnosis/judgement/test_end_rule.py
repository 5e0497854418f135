"""The rule at the end: what predicts held-out log worse than the twin that was given is never written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from tests.builders import AFTER, BEFORE, CART, CAUSE, VERDICT, guess, lay_bench, load_known, load_rig
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.judgement import diagnose
from vpptwin.diagnosis.judgement.conclusion import list_passing, share_ahead
from vpptwin.diagnosis.judgement.diagnose import Diagnosis, keep_better, suggest
from vpptwin.diagnosis.judgement.errors import PredictionErrors
from vpptwin.diagnosis.judgement.holdout import HeldOut, Score
from vpptwin.diagnosis.judgement.material import Material
from vpptwin.diagnosis.judgement.selection import Selection
from vpptwin.diagnosis.judgement.verdict import Rival, Unseen
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import friction, joint
from vpptwin.effects.catalogue import generic_place
from vpptwin.twin.robot.robot import Loads

KEY = ("rail_x.coulomb", "force")


@pytest.mark.parametrize(("waves", "passing"), [(0.4, {"swing.cogging", "swing.spring"}), (1.0, set())])
def test_a_wave_that_does_not_come_again_is_no_cogging(waves: float, passing: set[str]) -> None:
    """0.8 of it in 2 rad of travel: nor is what depends on place beside it sure; friction there, and 2 waves, are."""
    ones, place = np.ones(1), generic_place("swing", True, 1.0)
    effects = [make(place) for make in (joint.cogging, joint.spring, friction.coulomb)]
    spec = load_rig(CART.replace('"a" type="slide"', '"swing" type="hinge"').replace('joint="a"', 'joint="swing"'))
    spec = replace(spec, robot=spec.robot.scale(Loads(ones, ones, ones, 0.0 * ones, ones, ones)))
    unknowns = tuple(Unknown(effect, p, p.off) for effect in effects for p in effect.parameters)
    fit = guess({u.key: waves if u.parameter.name == "waves" else u.nominal for u in unknowns})
    assert list_passing(Search(lay_bench([0.0], spec=spec), unknowns), fit) == passing


OTHER = ("rail_x.bias", "force")
KNOWN = lay_bench([0.0], spec=load_known())
Values = Mapping[tuple[str, str], float]


class Given(PredictionErrors):
    """Squared errors over the horizon that are given, (blocks, horizons): of the twin as it was, and extended."""

    noise = {"rad": np.ones(len(HORIZONS_S))}  # noqa: RUF012 (a property there)

    def __init__(self, before: np.ndarray, after: np.ndarray) -> None:
        super().__init__(lay_bench([3.0 * i for i in range(len(before))]))
        self.given = before, after

    def squares(self, values: Values) -> dict[str, np.ndarray]:
        """Of angles."""
        return {"rad": self.given[bool(values)]}


def keep(errors: Callable[[set[str]], PredictionErrors], monkeypatch: pytest.MonkeyPatch) -> tuple[Selection, ...]:
    """A selection of two causes, friction the stronger, and what is kept of it; errors by what is extended."""

    class Judges(HeldOut):
        """Held-out windows on which these are known."""

        def __init__(self, effects: set[str]) -> None:
            super().__init__(KNOWN, KNOWN)
            self.errors = errors(effects)

    names = KEY[0], OTHER[0]
    told = {KEY[0]: [Rival(OTHER[0], 0.1), Rival("rail_x.viscous", 0.2)], OTHER[0]: []}
    instead = {KEY[0]: [guess({(rival.effect, "force"): 0.1, OTHER: 0.1}) for rival in told[KEY[0]]], OTHER[0]: []}
    odds, kinds = dict.fromkeys(names, 2.2), dict.fromkeys(names, ("", 0.0))
    fit = guess({KEY: 0.3, OTHER: 0.1})
    given = Selection(fit, [], told, instead, dict(zip(names, (99.0, 40.0))), odds, kinds)

    def leave_out(material: Material, selection: Selection, effects: list[str]) -> tuple[Material, Selection]:
        """As if nothing else moved."""
        left = guess({key: value for key, value in selection.fit.values.items() if key[0] not in effects})
        return replace(material, held_out=Judges(set(left.effects))), selection.reduce_to(left)

    monkeypatch.setattr(diagnose, "leave_out", leave_out)
    material = Material([], [], Search(KNOWN, ()), Judges(set(names)), None, None)  # type: ignore[arg-type]
    return given, keep_better(material, given)[1]


CALM = Given(np.full((8, len(HORIZONS_S)), 9.0), np.full((8, len(HORIZONS_S)), 4.0))
"""Errors that fall."""
WORSE = Given(np.full((8, len(HORIZONS_S)), 9.0), np.full((8, len(HORIZONS_S)), 16.0))


def test_a_twin_that_predicts_worse_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the evidence; the cause is named as left out, and nothing is extended."""
    _, kept = keep(lambda effects: WORSE, monkeypatch)
    assert kept.fit.effects == frozenset()
    assert kept.fit.values == {}
    assert kept.left_out == {KEY[0], OTHER[0]}
    assert kept.rivals == kept.evidence == kept.instead == {}


def test_a_twin_that_predicts_as_well_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left out."""
    given, kept = keep(lambda effects: CALM, monkeypatch)
    assert kept is given


def test_the_weakest_cause_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors grow with both causes and fall with the stronger alone: that is written, what went is told."""
    given, kept = keep(lambda effects: CALM if len(effects) < 2 else WORSE, monkeypatch)
    assert (kept.fit.effects, kept.left_out, kept.reduced) == ({KEY[0]}, {OTHER[0]}, True)
    assert kept.evidence == {KEY[0]: 99.0}
    assert [rival.effect for rival in kept.rivals[KEY[0]]] == ["rail_x.viscous"]
    assert [fit.effects for fit in kept.instead[KEY[0]]] == [{"rail_x.viscous"}]
    assert not given.reduced


@pytest.mark.parametrize(
    ("blocks", "growth", "scatter", "kept"),
    [(8, 0.3, 0.1, False), (8, 0.3, 2.0, True), (8, 0.015, 0.0, True), (8, -0.2, 0.1, True), (1, 0.5, 0.0, True),
     (2, 0.3, 0.28, True), (2, 0.3, 0.1, False)],
)  # fmt: skip
@pytest.mark.parametrize("horizon", [0, 4])
def test_no_error_ahead_grows(
    horizon: int, blocks: int, growth: float, scatter: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """By more than 2 % and what blocks of log disagree about it, near or far; of one block nothing.

    The logarithm of the error grows by so much, in every other block by `scatter` more and in the rest by less.
    """
    before, after = np.full((2, blocks, len(HORIZONS_S)), 1e6)
    grown = growth + scatter * (-1.0) ** np.arange(blocks) * (blocks > 1)
    after[:, horizon] *= np.exp(2.0 * grown)
    _, found = keep(lambda effects: Given(before, after), monkeypatch)
    assert bool(found.fit.effects) == kept


def test_a_horizon_without_measurements_leaves_no_share() -> None:
    """The least of 0.5 and 0.25, whatever was not measured; 1 where nothing was."""
    nan = float("nan")
    before, after = Score([2.0, 4.0, nan], None, {}, 9.0), Score([1.0, 1.0, nan], None, {}, 1.0)
    assert share_ahead(before, after) == 0.25
    assert share_ahead(Score(None, None, {}, 9.0), after) == 1.0


def test_weak_causes_stay_out_of_the_extended_twin() -> None:
    """The verdict has errors without them, and with them as a suggestion; there is a gap if that is worth something."""
    faint = replace(CAUSE, effect="rail_z.coulomb", confidence=0.0988, weak=True)
    unseen = [Unseen("rail_z.coulomb", "too slow"), Unseen("air.drag", "too slow")]
    for after, gap in ((BEFORE, True), (AFTER, False)):
        lesser = replace(VERDICT, causes=[], after=after, unseen=unseen, gap=False)
        given = Diagnosis(lesser, {}, [], None)  # type: ignore[arg-type]
        found = suggest(given, [faint], AFTER, {OTHER: 0.1})
        assert (found.verdict.named, found.verdict.weak) == ([], [faint])
        assert (found.verdict.after, found.verdict.suggested, found.verdict.gap) == (after, AFTER, gap)
        assert (found.values, found.suggested) == ({}, {OTHER: 0.1})
        assert [each.effect for each in found.verdict.unseen] == ["air.drag"]
