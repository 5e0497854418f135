"""Effects that act every inner step: compiled, in plain Python and on arrays they are one and the same function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest

from vpptwin.effects import CATALOGUE, Craft, Effect, Motion, Rotor, Stage, effects_for_rig, generic_place

CART_EFFECTS = effects_for_rig(
    [generic_place("slide", False, 1.0, room=1.0), generic_place("swing", True, 1.0, room=1.0)], {"motor": 1.0}
)
EVERY_STEP = {e.apply: e for e in (*CATALOGUE, *CART_EFFECTS) if e.stage is not Stage.CONSTANT}.values()
"""One effect of each law."""
COUNT = 200
ROUNDING = 4 * np.finfo(float).eps
"""numpy's exp on arrays and the C library's differ in the last bit, and a product and a sum follow it.

New states are differences, which may be small, of numbers up to 1: theirs is absolute."""

pytestmark = pytest.mark.parametrize("effect", EVERY_STEP, ids=lambda effect: effect.id)


def draw_inputs(effect: Effect, rng: np.random.Generator) -> tuple[Any, ...]:
    """What the effect is called with before its parameters, COUNT of each, zero and either sign among them."""

    def draw(low: float, high: float) -> Any:  # noqa: ANN401
        return np.append(np.clip([0.0], low, high), rng.uniform(low, high, COUNT - 1))

    level = draw(0.0, 2.0)
    sign: Any = rng.choice([-1.0, 1.0], COUNT)
    motion = Motion(draw(-2, 2), draw(-2, 2), sign, draw(-10, 10), draw(0, 25), draw(0.005, 2.0))
    rotor = Rotor(sign, draw(0, 550), draw(-0.25, 0.25), draw(-1, 3), draw(-5, 5))
    angle = draw(-np.pi, np.pi)
    pose = (draw(-1.5, 1.5), draw(-1, 3), draw(-4, 4), draw(-4, 4), draw(-15, 15), np.sin(angle), np.cos(angle))
    craft = Craft(*pose, draw(0.1, 0.4), draw(0, 550), draw(0, 550), draw(0, 60))
    inputs = {
        Stage.FORCE: (motion if effect.target else craft,), Stage.FRICTION: (level, motion),
        Stage.SLIP: (motion, level, draw(0.0, 2.0)), Stage.THRUST: (draw(-6, 6), rotor),
    }[effect.stage]  # fmt: skip
    return (*inputs, *(draw(-1, 1) for _ in effect.states), *([np.full(COUNT, 1e-3)] if effect.states else []))


def draw_parameters(effect: Effect, rng: np.random.Generator) -> list[np.ndarray]:
    """Values within the bounds, (COUNT,) each."""
    return [rng.uniform(p.low, p.high, COUNT) for p in effect.parameters]


def call_one_by_one(
    function: Callable[..., Any], inputs: tuple[Any, ...], parameters: list[np.ndarray]
) -> list[tuple[float, ...]]:
    """Results of calling with numbers, (COUNT,)."""

    def pick(values: Any, i: int) -> Any:  # noqa: ANN401
        if isinstance(values, tuple):
            make: Any = type(values)
            return make(*(float(v[i]) for v in values))
        return float(values[i])

    return [
        function(*(pick(given, i) for given in inputs), *(float(values[i]) for values in parameters))
        for i in range(COUNT)
    ]


def as_columns(result: Any) -> np.ndarray:  # noqa: ANN401
    """A result on arrays as rows of numbers: (COUNT,), or (COUNT, k) for k of them, as of a force on the craft."""
    if isinstance(result, tuple):
        return np.stack(np.broadcast_arrays(*result), axis=1)
    return np.broadcast_to(result, COUNT)


def test_compiled_equals_plain(effect: Effect) -> None:
    """Compiled by numba the function returns what it returns as it is written, and plain numbers."""
    rng = np.random.default_rng(1)
    inputs, parameters = draw_inputs(effect, rng), draw_parameters(effect, rng)
    compiled = call_one_by_one(numba.njit(effect.apply), inputs, parameters)
    plain = call_one_by_one(effect.apply, inputs, parameters)
    np.testing.assert_allclose(compiled, plain, rtol=ROUNDING, atol=ROUNDING if effect.states else 0)
    numbers = compiled[0] if isinstance(compiled[0], tuple) else (compiled[0],)
    assert all(isinstance(number, float) for number in numbers)
    assert np.isfinite(compiled).all()


def test_arrays_equal_numbers_one_by_one(effect: Effect) -> None:
    """Called with arrays the function returns what it returns for each element, and writes to none of them."""
    rng = np.random.default_rng(2)
    inputs, parameters = draw_inputs(effect, rng), draw_parameters(effect, rng)
    fields = [f for given in inputs for f in (given if isinstance(given, tuple) else (given,))]
    for array in (*fields, *parameters):
        array.flags.writeable = False  # writing would raise
    together = as_columns(effect.apply(*inputs, *parameters))
    one_by_one = np.array(call_one_by_one(effect.apply, inputs, parameters))
    np.testing.assert_allclose(together, one_by_one, rtol=ROUNDING, atol=ROUNDING if effect.states else 0)


def test_off_leaves_every_bit(effect: Effect) -> None:
    """At its off value, whatever the parameters that shape it, the function returns its input, and no force.

    What evolves may go on, as may what a SLIP effect makes of friction: while they are off they are not called.
    """
    if effect.stage is Stage.SLIP:
        return
    rng = np.random.default_rng(3)
    inputs, parameters = draw_inputs(effect, rng), draw_parameters(effect, rng)
    parameters[0][:] = effect.parameters[0].off  # the strength comes first
    untouched = inputs[0] if effect.stage is not Stage.FORCE else 0.0
    for function in (effect.apply, numba.njit(effect.apply)):
        result = np.array(call_one_by_one(function, inputs, parameters))
        result = result[:, 0] if effect.states else result
        np.testing.assert_array_equal(result, np.broadcast_to(untouched, COUNT) if result.ndim == 1 else 0.0)


def test_dissipative_effects_take_energy(effect: Effect) -> None:
    """Friction never pushes, and what calls itself dissipative never does work on a craft or its rotors."""
    rng = np.random.default_rng(4)
    inputs, parameters = draw_inputs(effect, rng), draw_parameters(effect, rng)
    result = as_columns(effect.apply(*inputs, *parameters))
    if effect.stage is Stage.SLIP:  # it pushes with no more than friction can muster, or the bristles hold already
        motion, forward, backward, deflection, dt = inputs
        held = np.abs(deflection) / np.maximum(parameters[0], 4.0 * dt**2 / motion.inertia)
        assert (np.abs(result[:, 0]) <= np.maximum(held, np.maximum(forward, backward)) * (1.0 + ROUNDING)).all()
    elif effect.stage is Stage.FRICTION:
        assert (result >= 0.0).all()
    elif effect.dissipative and effect.stage is Stage.FORCE:
        (mover,) = inputs
        if isinstance(mover, Motion):
            power = result * mover.velocity
        else:
            power = result[:, 0] * mover.v_x + result[:, 1] * mover.v_z + result[:, 2] * mover.rate
        assert (power <= 0.0).all()
        assert (power < 0.0).mean() > 0.9
    elif effect.dissipative:
        thrust, rotor = inputs
        assert ((result - thrust) * rotor.axial <= 0.0).all()
