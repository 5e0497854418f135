"""What the writer of Warp's text makes of Python: run as Python it returns the same."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest

from vpptwin.effects.base import Motion
from vpptwin.engine.trace.paths import drop_unused
from vpptwin.engine.trace.specialize import Writer
from vpptwin.engine.trace.terms import Repeat, Term, Unwritable

WARP = SimpleNamespace(
    min=min, max=max, abs=abs, where=lambda test, a, b: a if test else b, int32=int, inf=math.inf, exp=math.exp,
    sqrt=math.sqrt,
)  # fmt: skip

BEND = 0.25


@numba.njit
def soften(speed: float, most: float) -> float:
    """Called by the effect below."""
    if speed > most:
        return most
    return max(speed, -most, -2 * BEND)


def hold_softly(motion: Motion, /, force: float) -> float:
    """A function of its own, a constant, a branch, a choice, a whole power, a loop."""
    pull = soften(motion.velocity, BEND) ** 2
    if motion.position > 0 and motion.velocity < 1:
        pull = -pull
    for share in (0.5, 0.25):
        pull += share * pull
    return force * (pull if motion.load > 0.0 else 2.0 * pull)


def find_root(square: float, most: float) -> tuple[float, float]:
    """A loop that is left, which swaps what it carries."""
    low, high, left = 0.0, 1.0, 0.0
    for _ in range(TURNS):
        low, high = high, 0.5 * (high + square / high)
        if abs(high - low) < 1e-9:
            left = most
            break
    return high, left


TURNS = 50


def add_rows(x: float, y: float) -> float:
    """Arrays that come apart, a part of one shared, an element left out."""
    table = np.array([[1.0, 2.0], [0.0, 4.0]])
    total = 0.0
    for row in table:
        for value in row:
            if value == 0.0:
                continue
            total += value * x
    if y > 1.0:
        total -= y
    elif y > 0.0:
        return -1.0
    return max(total, 0.0) + float(x > 0.0)


def wrap(x: float, y: float) -> float:
    """Whole numbers, with Python's remainder."""
    whole = int(x) - 7
    return 1.0 * (whole % 5) + y


def run(function: Any, numbers: list[Any], names: dict[str, Any] | None = None) -> Any:  # noqa: ANN401
    """What the text of a function returns for numbers; tuples of them go in as they are."""
    writer, count = Writer(False, names), 0
    given, known = [], {"wp": WARP, "Real": float}
    for value in numbers:
        parts = value if isinstance(value, tuple) else (value,)
        terms = []
        for part in parts:
            terms.append(Term(f"x{count}"))
            known[f"x{count}"] = part
            count += 1
        given.append(type(value)(*terms) if isinstance(value, tuple) else terms[0])
    result = writer.call(function, given)
    ends = result if isinstance(result, tuple) else (result,)
    writer.lines += [f"end{k} = {writer.write_out(end)}" for k, end in enumerate(ends)]
    exec("\n".join(drop_unused(writer.lines)), known)
    return tuple(known[f"end{k}"] for k in range(len(ends)))


@pytest.mark.parametrize("velocity", [-0.4, 0.1, 0.3, 1.5])
@pytest.mark.parametrize("position", [-1.0, 1.0])
def test_effect_brings_what_it_calls(velocity: float, position: float) -> None:
    """Functions and constants of the user's file come along; branches, choices and loops stay what they are."""
    motion = Motion(position, velocity, 0.0, position * velocity, 0.0, 1.0)
    assert run(hold_softly, [motion, 2.0]) == (pytest.approx(hold_softly(motion, 2.0)),)


@pytest.mark.parametrize("x", [-3.0, 0.5, 4.0])
@pytest.mark.parametrize("y", [-1.0, 0.5, 2.0])
def test_statements(x: float, y: float) -> None:
    """Early returns, elements left out, whole numbers."""
    assert run(add_rows, [x, y]) == (pytest.approx(add_rows(x, y)),)
    assert run(wrap, [x, y]) == (wrap(x, y),)


def test_loops_of_the_text() -> None:
    """Values are carried all at once, and what was written where a loop is left counts."""
    for square in (2.0, 81.0):
        assert run(find_root, [square, 3.0], {"TURNS": Repeat(50)}) == find_root(square, 3.0)
    assert run(find_root, [2.0, 3.0], {"TURNS": Repeat(2)})[1] == 0.0


def test_known_numbers_are_worked_out() -> None:
    """Zero and one leave nothing to do."""
    writer = Writer(False)
    x = Term("x")
    assert writer.call(take_away, [x, 0.0, 1.0]) is x
    assert not writer.lines


def take_away(x: float, none: float, one: float) -> float:
    """What it is given."""
    return none * x * 3.0 + one * x + none / x - none


def recurse(x: float) -> float:
    """Never ends."""
    return recurse(x)


def returns_in_a_loop(x: float) -> float:
    """Ends in the middle of what unrolls."""
    for k in range(3):
        if x > k:
            return x
    return 0.0


@pytest.mark.parametrize(("function", "said"), [(recurse, "itself"), (returns_in_a_loop, "returns in one case")])
def test_what_cannot_be_written_is_told(function: Any, said: str) -> None:  # noqa: ANN401
    """With the line."""
    with pytest.raises(Unwritable, match=said) as caught:
        Writer(False).call(function, [Term("x")])
    assert caught.value.stack[-1][1] > 1
