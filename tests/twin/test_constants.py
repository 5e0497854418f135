"""Setting parameters: many at once equals one after the other, and only the rows that changed are worked out again."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.twin import Twin, load_twin

SPEC = load_twin()
PRIORS = Priors.of(SPEC.catalogue)


def make_twin(count: int = 4) -> Twin:
    """Every effect switched on, at its off value."""
    return Twin(SPEC, count, active=[e.id for e in SPEC.catalogue], num_threads=1)


def test_many_at_once_equal_one_after_the_other() -> None:
    """Drawn parameters reach the flight bit-equal whichever way they are set, in whatever order rows are named."""
    at_once, in_turn = make_twin(), make_twin()
    values, ids = PRIORS.draw(np.random.default_rng(1), 3), np.array([3, 0, 2])
    at_once.set_parameters(PRIORS.keys, values, ids)
    for (effect, parameter), column in zip(PRIORS.keys, values.T):
        in_turn.set_parameter(effect, parameter, column, ids)
    for key in PRIORS.keys:
        np.testing.assert_array_equal(at_once.parameter(*key), in_turn.parameter(*key))
    np.testing.assert_array_equal(at_once.constants, in_turn.constants)
    one, other = (
        twin.step_policy(twin.initial_state(), np.tile([5.0, 1.0], (4, 1)), 0.05) for twin in (at_once, in_turn)
    )
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name])


def test_other_rows_keep_their_constants() -> None:
    """Constants of rows that were not named stay, and a row set often equals one set once, derived fields included."""
    twin, once = make_twin(), make_twin()
    for seed in range(5):
        randomize(twin, PRIORS, np.array([1]), np.random.default_rng(seed))
        twin.constant("body_mass")
    randomize(once, PRIORS, np.array([1]), np.random.default_rng(4))
    np.testing.assert_array_equal(twin.constants, once.constants)
    np.testing.assert_array_equal(twin.constants[[0, 2, 3]], make_twin(3).constants)
    command = np.tile([5.0, 1.0], (4, 1))
    for one, other in zip(*(t.step_policy(t.initial_state(), command, 0.05).arrays().values() for t in (twin, once))):
        np.testing.assert_array_equal(one, other)


def test_bad_values_are_refused_as_a_whole() -> None:
    """The first value out of bounds is named, and nothing is changed."""
    twin = make_twin(2)
    keys = [("airframe.mass", "mass"), ("mocap.delay", "delay")]
    with pytest.raises(ValueError, match=r"mocap.delay.delay = 0.06 s; expected 0 to 0.05"):
        twin.set_parameters(keys, np.array([[0.01, 0.01], [0.01, 0.06]]))
    with pytest.raises(ValueError, match=r"airframe.mass.mass = nan"):
        twin.set_parameters(keys, np.array([np.nan, 0.01]))
    with pytest.raises(KeyError, match=r"air.dragg.k_d is not switched on; these are: rail_x.coulomb.force"):
        twin.set_parameters([("air.dragg", "k_d")], 0.0)
    np.testing.assert_array_equal(twin.parameter("airframe.mass", "mass"), 0.0)


def test_start_of_some_rows() -> None:
    """A start for a few simulations has their constants and equals their rows of a start for all."""
    twin = make_twin()
    twin.set_parameter("servo.trim", "offset_1", np.array([0.0, 0.01, 0.02, 0.03]))
    ids, pose = np.array([2, 0]), np.random.default_rng(0).normal(size=(2, 3))
    whole = np.zeros((4, 3))
    whole[ids] = pose
    few, rows = twin.initial_state(pose, time=2.0, ids=ids), twin.initial_state(whole, time=2.0).take(ids)
    for name, array in few.arrays().items():
        np.testing.assert_array_equal(array, rows.arrays()[name], err_msg=name)
    np.testing.assert_array_equal(few.blade_pitch[:, 0], [0.02, 0.0])
