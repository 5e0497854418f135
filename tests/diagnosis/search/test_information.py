"""Which flights judge: those that the fit can best do without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.carts import load_cart, measure_cart
from tests.diagnosis.rigs import FRICTION, drive_cart
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.search.information import choose_judges, measure_information
from vpptwin.diagnosis.search.suspects import list_unknowns


@pytest.mark.parametrize(("flights", "judges"), [(2, 1), (3, 1), (5, 1), (6, 2), (9, 3)])
def test_a_third_of_the_flights_judge(flights: int, judges: int) -> None:
    """At least one, and of flights that tell the same the last ones."""
    found = choose_judges(np.full((flights, 4), CRITERIA.half_seen), CRITERIA)
    assert found == set(range(flights - judges, flights))


def test_judges_by_hand() -> None:
    """The second effect shows in the last of three flights alone: the second, which the first makes up for, judges."""
    assert choose_judges(np.array([[9.0, 0.0], [9.0, 0.0], [0.0, 9.0]]) * CRITERIA.half_seen, CRITERIA) == {1}
    # Of three flights that show all there is and one that shows nothing, a full one judges: the empty would be blind.
    assert choose_judges(np.array([[9.0], [0.0], [9.0], [9.0]]) * CRITERIA.half_seen, CRITERIA) == {3}
    assert 0.9 * CRITERIA.judging_worth > 27.0 / 28.0 - 18.0 / 19.0
    # Two pairs of flights that tell the same, of six: one of each pair judges, what is alone is fitted.
    shows = [[9.0, 0.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0]]
    alone = [[0.0, 0.0, 9.0, 0.0], [0.0, 0.0, 0.0, 9.0]]
    assert choose_judges(np.array(shows + alone) * CRITERIA.half_seen, CRITERIA) == {1, 3}


def test_information_is_signal_to_noise_of_a_typical_size(tmp_path: Path) -> None:
    """A cart that drives shows every effect of its catalogue, one that stands nothing that its motor drives.

    By hand: a constant force F on 2 kg moves it by F t²/4 and speeds it up by F t/2 in windows of a second, against
    the sensors' noise; each of 23 windows of 100 bins adds the same.
    """
    spec = load_cart(tmp_path)
    driving = drive_cart(0.0, 3)
    still = np.zeros_like(driving[0])
    flights = [measure_cart(track, 7) for track in (driving, (still, still, still))]
    unknowns = tuple(u for u in list_unknowns(spec) if not u.effect.modifies)  # of no friction nothing shows
    effects = list(dict.fromkeys(u.effect.id for u in unknowns))
    found = measure_information(spec, flights, unknowns, None, CRITERIA)
    assert found.shape == (2, len(effects) + 1)
    assert (found[0, :-1] > CRITERIA.half_seen).all()
    seen = {effect for effect, signal in zip(effects, found[1]) if signal > CRITERIA.half_seen}
    assert "slide.bias" in seen
    assert not seen & {"slide.inertia", "motor.gain", "motor.delay", "motor.lag", "motor.rate_limit"}
    (force,) = (u.parameter.size for u in unknowns if u.effect.id == "slide.bias")
    t = 0.0025 + 0.01 * np.arange(100)
    noise = flights[1].positions[0].std, flights[1].velocities[0].std
    signal = ((force * t**2 / 4.0 / noise[0]) ** 2 + (force * t / 2.0 / noise[1]) ** 2).sum()
    assert found[1, effects.index("slide.bias")] == pytest.approx(23.0 * signal, rel=0.02)


def test_the_flight_in_which_there_is_something_to_find_is_fitted(tmp_path: Path) -> None:
    """Both carts show all there is, the one that rubs misses its twin by far more than noise, and the other judges."""
    spec = load_cart(tmp_path)
    flights = [measure_cart(drive_cart(force, 3), 7) for force in (0.0, FRICTION, 0.0)]
    for order in ([0, 1], [1, 0], [0, 1, 2], [1, 0, 2]):
        chosen = [flights[i] for i in order]
        found = measure_information(spec, chosen, list_unknowns(spec), None, CRITERIA)
        rubs = order.index(1)
        assert found[rubs, -1] == pytest.approx(CRITERIA.shown * CRITERIA.half_seen)
        assert np.delete(found[:, -1], rubs).max() < 0.1 * CRITERIA.half_seen
        assert not choose_judges(found, CRITERIA) & {rubs}
