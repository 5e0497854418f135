"""Arithmetic on what is known and what is not, a line of text for each operation that is left to be done."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

import numpy as np

from vpptwin.engine.trace.paths import MISSING, Paths
from vpptwin.engine.trace.terms import (
    REAL,
    TRUTH,
    WHOLE,
    Cells,
    Record,
    Ring,
    Term,
    Unwritable,
    Value,
    common_kind,
    same,
)

NUMPY = {
    "exp": "wp.exp", "log": "wp.log", "sqrt": "wp.sqrt", "sin": "wp.sin", "cos": "wp.cos", "tan": "wp.tan",
    "tanh": "wp.tanh", "sinh": "wp.sinh", "cosh": "wp.cosh", "floor": "wp.floor", "arctan": "wp.atan",
    "arcsin": "wp.asin", "arccos": "wp.acos", "arctan2": "wp.atan2", "abs": "wp.abs", "minimum": "wp.min",
    "maximum": "wp.max", "sign": "sign", "expm1": "expm1",
}  # fmt: skip
"""numpy's functions of numbers → what Warp has for them."""
MATH = {"fabs": "abs", "atan": "arctan", "asin": "arcsin", "acos": "arccos", "atan2": "arctan2"}
"""Python's names for some of them."""
FOLDED = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.Mod: "%", ast.FloorDiv: "//"}
COMPARED = {ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


class Arithmetic(Paths):
    """Reads values, and works out what comes of them; see `Paths`."""

    def fill(self, cells: Cells, key: Any, value: Value) -> None:  # noqa: ANN401
        """Write into elements of an array."""
        places = np.asarray(cells.index[key])
        if isinstance(value, (Cells, np.ndarray)):
            values = np.broadcast_to(self.elements(value), places.shape).ravel().tolist()
        else:
            values = [value] * places.size
        for place, each in zip(places.ravel().tolist(), values, strict=True):
            self.put(cells.store, place, each)

    def load(self, value: Value) -> Value:
        """A value as it is worked with: read from memory, where it lies there."""
        return self.keep(value.text, value.kind) if isinstance(value, Term) and value.lasting else value

    def item(self, base: Value, key: Any) -> Value:  # noqa: ANN401
        """An element or a part of an array, a tuple or a record."""
        if isinstance(base, Record):
            return self.of_record(base, key)
        if isinstance(base, Ring):
            if isinstance(key, tuple) and isinstance(key[0], slice):
                return Ring(base.place, base.shape[:1], (None, key[1]))
            if isinstance(key, tuple) or len(base.shape) == 1:
                return self.copy_out(self.locate(base, key))
            return Cells.of([self.copy_out(self.locate(base, (key, j))) for j in range(base.shape[1])])
        if isinstance(key, Term) or (isinstance(key, tuple) and any(isinstance(k, Term) for k in key)):
            raise Unwritable("takes an item at a place that changes")
        if isinstance(base, Cells):
            places = base.index[key]
            return Cells(base.store, places) if isinstance(places, np.ndarray) else self.load(base.store[places])
        if isinstance(base, np.ndarray):
            part = base[key]
            return part if isinstance(part, np.ndarray) else part.item()
        if isinstance(base, (tuple, list, range)):
            return base[key]
        raise Unwritable("takes items of what has none")

    def copy_out(self, text: str) -> Term:
        """What is in memory now."""
        term = self.fresh(REAL)
        self.lines.append(f"{term.text} = {text}")
        return term

    def locate(self, ring: Ring, key: Any) -> str:  # noqa: ANN401
        """Where an element of a ring is in memory."""
        row, column = (key, ring.fixed[1]) if not isinstance(key, tuple) else key
        return ring.place(self.write_out(row, WHOLE), int(column or 0))

    def of_record(self, record: Record, name: str) -> Value:
        """A field of a record: a number, or an array."""
        cells = record.fields[name]
        return self.load(cells.store[int(cells.index)]) if isinstance(cells, Cells) and cells.index.ndim == 0 else cells

    def truth(self, value: Value) -> Value:
        """A value as a condition."""
        if isinstance(value, Term):
            return Term(self.write_out(value, TRUTH), TRUTH)
        return bool(value)

    def turn(self, op: ast.unaryop, value: Value) -> Value:
        """Minus, or not."""
        if isinstance(op, ast.Not):
            test = self.truth(value)
            return self.keep(f"not {test.text}", TRUTH) if isinstance(test, Term) else not test
        if not isinstance(value, Term):
            return -value if isinstance(op, ast.USub) else +value
        if isinstance(op, ast.USub):
            kind = WHOLE if value.kind == WHOLE else REAL
            return self.keep(f"-{self.write_out(value, kind)}", kind)
        return value

    def join(self, word: str, parts: list[Callable[[], Value]]) -> Value:
        """Conditions that hold all, or one of which does; what is known decides alone."""
        terms: list[Term] = []
        for part in parts:
            test = self.truth(part())
            if isinstance(test, Term):
                terms.append(test)
            elif test == (word == "or"):
                return test
        if not terms:
            return word == "and"
        result = terms[0]
        for other in terms[1:]:
            result = self.keep(f"{result.text} {word} {other.text}", TRUTH)
        return result

    def compare(self, op: ast.cmpop, left: Value, right: Value) -> Value:
        """Which is larger."""
        if type(op) not in COMPARED:
            raise Unwritable(f"uses {type(op).__name__.lower()}, which Warp cannot compile")
        if not isinstance(left, Term) and not isinstance(right, Term):
            return bool(eval(f"a {COMPARED[type(op)]} b", {"a": left, "b": right}))
        kind = common_kind(left, right)
        kind = WHOLE if kind == TRUTH else kind
        return self.keep(f"{self.write_out(left, kind)} {COMPARED[type(op)]} {self.write_out(right, kind)}", TRUTH)

    def choose(self, test: Value, first: Value, second: Value) -> Value:
        """One or the other."""
        if not isinstance(test, Term):
            return first if test else second
        if first is second or (not isinstance(first, Term) and not isinstance(second, Term) and same(first, second)):
            return first
        kind = common_kind(first, second)
        return self.keep(f"wp.where({test.text}, {self.write_out(first, kind)}, {self.write_out(second, kind)})", kind)

    def operate(self, op: ast.operator, left: Value, right: Value) -> Value:
        """Arithmetic; with what is known as far as it goes."""
        if isinstance(left, (Cells, np.ndarray)) or isinstance(right, (Cells, np.ndarray)):
            return self.spread(op, left, right)
        if type(op) not in FOLDED:
            raise Unwritable(f"uses {type(op).__name__.lower()}, which Warp cannot compile")
        sign = FOLDED[type(op)]
        if not isinstance(left, Term) and not isinstance(right, Term):
            with np.errstate(all="ignore"):
                if sign == "/":
                    return float(np.float64(left) / np.float64(right))
                return eval(f"a {sign} b", {"a": left, "b": right})
        kind = common_kind(left, right)
        kind = WHOLE if kind == TRUTH else kind
        if kind == WHOLE and sign in ("%", "//"):  # Python's remainder has the sign of the divisor
            m, n = self.write_out(left, WHOLE), self.write_out(right, WHOLE)
            inner = self.keep(f"{m} % {n}", WHOLE)
            rest = self.keep(f"wp.where({inner.text} < 0, {inner.text} + {n}, {inner.text})", WHOLE)
            return rest if sign == "%" else self.keep(f"({m} - {rest.text}) // {n}", WHOLE)
        if kind == WHOLE and sign in ("/", "**"):
            kind = REAL
        if sign in ("%", "//") and kind == REAL:
            raise Unwritable(f"uses {sign} of numbers, which Warp has otherwise")
        known = self.simplify(sign, left, right)
        if known is not MISSING:
            return known
        if sign == "**":
            if isinstance(right, (int, float)) and right in (2, 3):
                base = Term(self.write_out(left), REAL)
                square = self.keep(f"{base.text} * {base.text}", REAL)
                return square if right == 2 else self.keep(f"{square.text} * {base.text}", REAL)
            return self.keep(f"wp.pow({self.write_out(left)}, {self.write_out(right)})", REAL)
        return self.keep(f"{self.write_out(left, kind)} {sign} {self.write_out(right, kind)}", kind)

    def simplify(self, sign: str, left: Value, right: Value) -> Value:
        """What comes out of one number that is known: zero and one do nothing, or all."""
        for value, other, turned in ((left, right, False), (right, left, True)):
            if isinstance(value, Term) or not isinstance(other, Term) or other.kind == TRUTH:
                continue
            if sign == "*" and value in (0, 1):
                return 0.0 if value == 0 else other
            if value == 0 and (sign == "+" or (sign == "-" and turned)):
                return other
            if value == 0 and sign == "-":
                return self.turn(ast.USub(), other)
            if value == 0 and sign == "/" and not turned:
                return 0.0
            if sign in ("/", "**") and turned and value == 1:
                return other
        return MISSING

    def spread(self, op: ast.operator, left: Value, right: Value) -> Cells:
        """Arithmetic on arrays, element by element."""
        arrays = [self.elements(side) for side in (left, right)]
        one, two = np.broadcast_arrays(*arrays)
        values = [self.operate(op, a, b) for a, b in zip(one.ravel(), two.ravel())]
        result = np.empty(len(values), dtype=object)
        result[:] = values
        return Cells.of(result.reshape(one.shape))

    def elements(self, side: Value) -> np.ndarray:
        """An array, or a number, as an array of objects."""
        if isinstance(side, Cells):
            result = np.empty(side.index.size, dtype=object)
            result[:] = [self.load(side.store[i]) for i in side.index.ravel()]
            return result.reshape(side.index.shape)
        if isinstance(side, np.ndarray):
            return side.astype(object)
        single = np.empty((), dtype=object)
        single[()] = side
        return single

    def convert(self, kind: type, value: Value) -> Value:
        """A number of another kind."""
        if not isinstance(value, Term):
            return kind(value)
        wanted = {int: WHOLE, float: REAL, bool: TRUTH}[kind]
        return Term(self.write_out(value, wanted), wanted)

    def calculate(self, function: Value, name: str, called: str, given: list[Value]) -> Value:
        """A function of numbers."""
        if not any(isinstance(value, Term) for value in given):
            with np.errstate(all="ignore"):
                result = function(*given)
            return result.item() if isinstance(result, np.generic) else result
        if name not in NUMPY:
            raise Unwritable(f"calls {called}, which Warp cannot compile")
        result = given[0]
        if name in ("minimum", "maximum"):
            for other in given[1:]:
                result = self.keep(f"{NUMPY[name]}({self.write_out(result)}, {self.write_out(other)})", REAL)
            return result
        return self.keep(f"{NUMPY[name]}({', '.join(self.write_out(value) for value in given)})", REAL)
