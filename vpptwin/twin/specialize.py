"""A pipeline's Python, run once on what is known of a rig, written down for Warp where it is not.

What a model says (how it hangs together, its constants, which effects are on) are plain numbers as this runs: loops
over joints unroll, branches on switches are taken, products with zero vanish. Numbers that differ by simulation are
`Term`s: an operation on one becomes a line of text, a branch on one an `if`, and arrays come apart into variables,
which a compiler keeps in registers. The text is straight, of one function, and has no array but those in memory.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import linecache
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from vpptwin.actuators.numbers import choose

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
ASSIGNED, VARIABLE = re.compile(r"\s*([rnbt]\d+) = "), re.compile(r"\b[rnbt]\d+\b")
REAL, WHOLE, TRUTH = "Real", "wp.int32", "wp.bool"
ZERO = {REAL: "Real(0.0)", WHOLE: "wp.int32(0)", TRUTH: "bool(False)"}
Value = Any
"""A Python value, or a `Term`, or a tuple with such in it."""


@dataclass(frozen=True, eq=False)
class Term:
    """A number that is known only when the text runs.

    Attributes:
        text: its name, or where it is in memory.
        kind: `REAL`, `WHOLE` or `TRUTH`.
        lasting: it is in memory that nothing writes to, and read where it is wanted.
    """

    text: str
    kind: str = REAL
    lasting: bool = False


@dataclass(frozen=True, eq=False)
class Cells:
    """An array of numbers that come apart into variables; a part of it shares them, as numpy's views do."""

    store: list[Value]
    index: np.ndarray

    @classmethod
    def of(cls, values: Any) -> Cells:  # noqa: ANN401
        """An array of its own with these values, an array of objects or of numbers."""
        array = np.asarray(values, dtype=object)
        return cls(array.ravel().tolist(), np.arange(array.size).reshape(array.shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Its shape."""
        return self.index.shape

    def reshape(self, *shape: int) -> Cells:
        """The same numbers in another shape."""
        return Cells(self.store, self.index.reshape(*shape))


@dataclass(frozen=True, eq=False)
class Ring:
    """An array in memory that is read and written at places known only when the text runs.

    Attributes:
        place: text of the row of an element, of its indices.
        memory: name of the table that it lies in.
        shape: its shape.
        fixed: indices that are known, None for the others.
    """

    place: Callable[[str, int], str]
    memory: str
    shape: tuple[int, ...]
    fixed: tuple[int | None, ...] = (None, None)


class Record:
    """Numbers and arrays by name, written in place."""

    def __init__(self, **fields: Any) -> None:  # noqa: ANN401
        self.fields = fields


class Unwritable(Exception):  # noqa: N818
    """What cannot be written for Warp: why, and where in which function."""

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.stack: list[tuple[FunctionType | None, int]] = []


class Frame(dict[str, Value]):
    """Names of a function that runs."""

    def __init__(self, function: FunctionType | None, names: dict[str, Value], serial: int) -> None:
        super().__init__(names)
        self.function, self.serial = function, serial


NORMAL, CONTINUE, BREAK = "normal", "continue", "break"
MISSING = object()
Ending = Any
"""How a block of statements ends: `NORMAL`, `CONTINUE`, `BREAK`, or ("return", value)."""


@dataclass
class Loop:
    """A loop of the text.

    Attributes:
        carried: its variables, by where their values stand as it is written.
        left: what was written where it is left.
    """

    carried: dict[tuple[int, Any], tuple[Any, Any, Term]] = field(default_factory=dict)
    left: dict[tuple[int, Any], tuple[Any, Any, Value]] = field(default_factory=dict)


@cache
def read_function(function: FunctionType) -> tuple[ast.FunctionDef, int]:
    """A function as a tree, and the line of its file before it starts."""
    try:
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    except (OSError, TypeError, SyntaxError):
        raise Unwritable("has no source text") from None
    if not isinstance(tree, ast.FunctionDef):
        raise Unwritable("is no function written with def")
    return tree, first - 1


def keep_source(text: str, file: str) -> None:
    """Let functions of a text that is compiled as `file` be read."""
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)


class Writer:
    """Runs statements, and writes down what is left to be done.

    Args:
        single: numbers are float32: what would be zero in it becomes its smallest.
        names: functions' global names that mean something else here.

    Attributes:
        lines: written so far.
    """

    def __init__(self, single: bool, names: dict[str, Value] | None = None) -> None:
        self.least = float(np.finfo(np.float32).tiny) if single else 0.0
        self.names = names or {}
        self.lines: list[str] = []
        self.known: list[dict[str, Term]] = [{}]
        self.logs: list[dict[tuple[int, Any], tuple[Any, Any, Value]]] = []
        self.loops: list[Loop | None] = []
        self.stack: list[tuple[FunctionType | None, int]] = []
        self.count = self.serial = 0

    # Text

    def fresh(self, kind: str) -> Term:
        """A variable of its own."""
        self.count += 1
        return Term(f"{'r' if kind == REAL else 'n' if kind == WHOLE else 'b'}{self.count}", kind)

    def keep(self, text: str, kind: str) -> Term:
        """A variable that holds what `text` says; the same one for the same text."""
        for scope in reversed(self.known):
            if text in scope:
                return scope[text]
        term = self.fresh(kind)
        self.lines.append(f"{term.text} = {text}")
        self.known[-1][text] = term
        return term

    def write_out(self, value: Value, kind: str = REAL) -> str:
        """The text of a value as a number of a kind."""
        if not isinstance(value, Term):
            if kind == REAL:
                number = float(value)
                if math.isinf(number):
                    return f"Real({'-' if number < 0 else ''}wp.inf)"
                if 0.0 < abs(number) < self.least:
                    number = math.copysign(self.least, number)
                return f"Real({number!r})"
            return f"wp.int32({int(value)})" if kind == WHOLE else f"bool({bool(value)})"
        if value.kind == kind:
            return value.text
        if kind == TRUTH:
            return self.keep(f"{value.text} != {ZERO[value.kind]}", TRUTH).text
        if value.kind == TRUTH:
            return self.keep(f"wp.where({value.text}, {self.write_out(1, kind)}, {self.write_out(0, kind)})", kind).text
        return self.keep(f"{kind}({value.text})", kind).text

    # What is written to, and undone or merged where branches meet

    def put(self, container: Any, key: Any, value: Value) -> None:  # noqa: ANN401
        """Write into a list or a dict, and remember what was there."""
        if self.logs:
            here = (id(container), key)
            if here not in self.logs[-1]:
                old = container[key] if isinstance(container, list) else container.get(key, MISSING)
                self.logs[-1][here] = container, key, old
        container[key] = value

    @contextmanager
    def branch(self) -> Iterator[tuple[list[str], dict[tuple[int, Any], tuple[Any, Any, Value]]]]:
        """Lines of their own, and all that is written, (list or dict, key, value), undone at the end."""
        lines, self.lines = self.lines, []
        written: dict[tuple[int, Any], tuple[Any, Any, Value]] = {}
        self.known.append({})
        self.logs.append({})
        mine = self.lines
        try:
            yield mine, written
            for here, (container, key, _) in self.logs[-1].items():
                written[here] = container, key, container[key]
        finally:
            for container, key, old in self.logs.pop().values():
                if old is MISSING:
                    del container[key]
                else:
                    container[key] = old
            self.known.pop()
            self.lines = lines

    def fork(self, test: Term, then: Callable[[], Ending], other: Callable[[], Ending]) -> Ending:
        """Both branches of an `if`, and what they leave behind; endings are merged where both return."""
        with self.branch() as (first, left):
            one = then()
        with self.branch() as (second, right):
            two = other()
        before: list[str] = []
        if one != BREAK and two != BREAK:
            for here in {**left, **right}:
                container, key, _ = left.get(here) or right[here]
                old = container[key] if isinstance(container, list) else container.get(key, MISSING)
                pair = [side[here][2] if here in side else old for side in (left, right)]
                if MISSING in pair:  # defined in one of them: for that one alone
                    continue
                self.put(container, key, self.merge(pair[0], pair[1], before, first, second))
        else:
            loop = self.loops[-1]
            if loop is None:
                raise Unwritable("leaves a loop in one case only")
            loop.left |= left if one == BREAK else right
            for container, key, value in (right if one == BREAK else left).values():
                self.put(container, key, value)
        ending = two if one in (BREAK, CONTINUE) else one
        if isinstance(one, tuple) != isinstance(two, tuple) and BREAK not in (one, two):
            raise Unwritable("returns in one case, and goes on in a loop in the other")
        if isinstance(one, tuple) and isinstance(two, tuple):
            ending = ("return", self.merge(one[1], two[1], before, first, second))
        self.lines += before
        self.lines += [f"if {test.text}:", *("    " + line for line in first or ["pass"])]
        if second:
            self.lines += ["else:", *("    " + line for line in second)]
        return NORMAL if ending in (BREAK, CONTINUE) else ending

    def merge(self, one: Value, two: Value, before: list[str], first: list[str], second: list[str]) -> Value:
        """What is either of two values after an `if`."""
        if one is two or (not isinstance(one, Term) and not isinstance(two, Term) and same(one, two)):
            return one
        if isinstance(one, tuple) and isinstance(two, tuple) and len(one) == len(two):
            parts = [self.merge(a, b, before, first, second) for a, b in zip(one, two)]
            return type(one)(*parts) if hasattr(one, "_fields") else tuple(parts)
        kind = common_kind(one, two)
        variable = self.fresh(kind)
        before.append(f"{variable.text} = {ZERO[kind]}")
        for value, lines in ((one, first), (two, second)):
            outer, self.lines = self.lines, lines
            text = self.write_out(value, kind)
            self.lines = outer
            lines.append(f"{variable.text} = {text}")
        return variable

    def repeat(self, head: str, body: Callable[[], Ending]) -> None:
        """A loop of the text: what its body writes of what was there before is carried from one time to the next."""
        loop, born = Loop(), self.serial
        while True:
            self.loops.append(loop)
            with self.branch() as (lines, written):
                for container, key, variable in loop.carried.values():
                    self.put(container, key, variable)
                ending = body()
                if ending not in (NORMAL, CONTINUE):
                    raise Unwritable("leaves a loop at every turn")
                self.carry(loop)
            self.loops.pop()
            fresh = {
                here: (container, key, value) for here, (container, key, value) in (loop.left | written).items()
                if here not in loop.carried and not (isinstance(container, Frame) and container.serial > born)
                and (isinstance(container, list) or key in container)
            }  # fmt: skip
            numbers = {}
            for here, (container, key, value) in fresh.items():
                if isinstance(value, (Term, int, float, np.number)) and not same(container[key], value):
                    numbers[here] = container, key, self.fresh(common_kind(container[key], value))
            if not numbers:
                break
            loop.carried |= numbers
        for container, key, variable in loop.carried.values():
            self.lines.append(f"{variable.text} = {self.write_out(container[key], variable.kind)}")
            self.put(container, key, variable)
        self.lines += [head, *("    " + line for line in lines or ["pass"])]

    def carry(self, loop: Loop) -> None:
        """Hand on the values of now to a loop's variables, all at once."""
        own = {variable.text for *_, variable in loop.carried.values()}
        texts = [(v, self.write_out(container[key], v.kind)) for container, key, v in loop.carried.values()]
        later = []
        for variable, text in texts:
            if text == variable.text:
                continue
            if text in own:
                self.count += 1
                self.lines.append(f"t{self.count} = {text}")
                text = f"t{self.count}"
            later.append(f"{variable.text} = {text}")
        self.lines += later

    # Statements

    def call(self, function: Callable[..., Any], given: Sequence[Value], **named: Value) -> Value:
        """Run a function of Python text on values."""
        plain = inspect.unwrap(function)
        plain = getattr(plain, "py_func", plain)
        if not isinstance(plain, FunctionType):
            raise Unwritable(f"calls {getattr(function, '__name__', function)}, which Warp cannot compile")
        if any(plain is caller for caller, _ in self.stack):
            raise Unwritable("calls itself")
        self.stack.append((plain, 0))
        try:
            tree, _ = read_function(plain)
            bound = inspect.signature(plain).bind(*given, **named)
            bound.apply_defaults()
            self.serial += 1
            return self.run(tree.body, Frame(plain, dict(bound.arguments), self.serial))
        except Unwritable as error:
            if not error.stack:
                error.stack = list(self.stack)
            raise
        finally:
            self.stack.pop()

    def run(self, statements: Sequence[ast.stmt], frame: Frame) -> Value:
        """Run the statements of a whole function; what it returns."""
        self.loops.append(None)
        end = ast.Return(None, lineno=getattr(statements[-1], "end_lineno", 1))
        ending = self.block([*statements, end], frame)
        self.loops.pop()
        return ending[1]

    def block(self, statements: Sequence[ast.stmt], frame: Frame) -> Ending:
        """Run statements one after the other."""
        queue = list(statements)
        while queue:
            node = queue.pop(0)
            if self.stack:
                self.stack[-1] = (self.stack[-1][0], node.lineno)
            if not isinstance(node, ast.If):
                ending = self.statement(node, frame)
                if ending != NORMAL:
                    return ending
                continue
            test = self.truth(self.value(node.test, frame))
            if not isinstance(test, Term):
                queue = [*(node.body if test else node.orelse), *queue]
                continue
            # What comes after a branch that ends elsewhere belongs to the other one.
            jumps = any(map(may_jump, (node.body, node.orelse)))
            rest = queue if jumps else []
            ways = [partial(self.block, [*way, *rest], frame) for way in (node.body, node.orelse)]
            ending = self.fork(test, *ways)
            if jumps:
                return ending
        return NORMAL

    def statement(self, node: ast.stmt, frame: Frame) -> Ending:
        """Run one statement."""
        match node:
            case ast.Return():
                return ("return", None if node.value is None else self.value(node.value, frame))
            case ast.Assign():
                value = self.value(node.value, frame)
                for target in node.targets:
                    self.assign(target, value, frame)
            case ast.AnnAssign():
                if node.value is not None:
                    self.assign(node.target, self.value(node.value, frame), frame)
            case ast.AugAssign():
                now = self.value(copy_load(node.target), frame)
                result = self.operate(node.op, now, self.value(node.value, frame))
                if isinstance(now, Cells):
                    self.fill(now, ..., result)
                else:
                    self.assign(node.target, result, frame)
            case ast.For():
                return self.count_through(node, frame)
            case ast.While():
                return self.unroll(node.body, self.while_true(node.test, frame), frame)
            case ast.Expr():
                if not isinstance(node.value, ast.Constant):
                    self.value(node.value, frame)
            case ast.Break():
                loop = self.loops[-1] if self.loops else None
                if loop is not None:
                    self.carry(loop)
                    self.lines.append("break")
                return BREAK
            case ast.Continue():
                return CONTINUE
            case ast.Pass():
                pass
            case _:
                raise Unwritable(f"uses {type(node).__name__.lower()}, which Warp cannot compile")
        return NORMAL

    def while_true(self, test: ast.expr, frame: Frame) -> Iterator[None]:
        """Once for every time that a condition holds, which has to be known."""
        while True:
            holds = self.truth(self.value(test, frame))
            if isinstance(holds, Term):
                raise Unwritable("uses while with a condition that changes, which Warp cannot compile")
            if not holds:
                return
            yield

    def unroll(self, body: Sequence[ast.stmt], turns: Iterator[None], frame: Frame) -> Ending:
        """The body of a loop, as often as it turns."""
        self.loops.append(None)
        ending: Ending = NORMAL
        for _ in turns:
            ending = self.block(body, frame)
            if ending == BREAK or isinstance(ending, tuple):
                break
        self.loops.pop()
        return ending if isinstance(ending, tuple) else NORMAL

    def count_through(self, node: ast.For, frame: Frame) -> Ending:
        """A loop: over numbers that are known it unrolls; over `Repeat` it stays one."""
        if node.orelse:
            raise Unwritable("uses for with else, which Warp cannot compile")
        over = self.value(node.iter, frame)
        if isinstance(over, Repeat):
            name = self.fresh(WHOLE)

            def turn() -> Ending:
                self.assign(node.target, name, frame)
                return self.block(node.body, frame)

            self.repeat(f"for {name.text} in range({over.times}):", turn)
            return NORMAL
        if not isinstance(over, (range, tuple, list, Cells, np.ndarray)):
            raise Unwritable("goes through what is not known before")
        items = [self.item(over, i) for i in range(len(over.index) if isinstance(over, Cells) else len(over))]
        return self.unroll(node.body, self.assign_each(node.target, items, frame), frame)

    def assign_each(self, target: ast.expr, items: list[Value], frame: Frame) -> Iterator[None]:
        """Give one value after the other."""
        for item in items:
            self.assign(target, item, frame)
            yield

    def assign(self, target: ast.expr, value: Value, frame: Frame) -> None:
        """Give a value to a name, some names, an element or a field."""
        match target:
            case ast.Name():
                self.put(frame, target.id, value)
            case ast.Tuple() | ast.List():
                parts = [self.item(value, i) for i in range(len(target.elts))] if isinstance(value, Cells) else value
                if len(parts) != len(target.elts):
                    raise Unwritable(f"unpacks {len(parts)} values into {len(target.elts)}")
                for each, part in zip(target.elts, parts, strict=True):
                    self.assign(each, part, frame)
            case ast.Subscript():
                base, key = self.value(target.value, frame), self.value(target.slice, frame)
                if isinstance(base, Record):
                    self.fill(base.fields[key], (), value)
                elif isinstance(base, Ring):
                    self.lines.append(f"{self.locate(base, key)} = {self.write_out(value)}")
                elif isinstance(base, Cells):
                    self.fill(base, key, value)
                else:
                    raise Unwritable("writes into what is known before")
            case ast.Attribute():
                base = self.value(target.value, frame)
                if not isinstance(base, Record):
                    raise Unwritable(f"writes to {target.attr}")
                self.fill(base.fields[target.attr], (), value)
            case _:
                raise Unwritable("assigns to what Warp cannot")

    def fill(self, cells: Cells, key: Any, value: Value) -> None:  # noqa: ANN401
        """Write into elements of an array."""
        places = np.asarray(cells.index[key])
        if isinstance(value, (Cells, np.ndarray)):
            values = np.broadcast_to(self.elements(value), places.shape).ravel().tolist()
        else:
            values = [value] * places.size
        for place, each in zip(places.ravel().tolist(), values, strict=True):
            self.put(cells.store, place, each)

    # Values

    def load(self, value: Value) -> Value:
        """A value as it is worked with: read from memory, where it lies there."""
        return self.keep(value.text, value.kind) if isinstance(value, Term) and value.lasting else value

    def item(self, base: Value, key: Any) -> Value:  # noqa: ANN401
        """An element or a part of an array, a tuple or a record."""
        if isinstance(base, Record):
            return self.of_record(base, key)
        if isinstance(base, Ring):
            if isinstance(key, tuple) and isinstance(key[0], slice):
                return Ring(base.place, base.memory, base.shape[:1], (None, key[1]))
            return self.copy_out(self.locate(base, key))
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
        return f"{ring.memory}[{ring.place(self.write_out(row, WHOLE), int(column or 0))}, i]"

    def of_record(self, record: Record, name: str) -> Value:
        """A field of a record: a number, or an array."""
        found = record.fields[name]
        return self.load(found.store[int(found.index)]) if isinstance(found, Cells) and found.index.ndim == 0 else found

    def value(self, node: ast.expr, frame: Frame) -> Value:
        """The value of an expression."""
        match node:
            case ast.Constant():
                return node.value
            case ast.Name():
                return self.look_up(node.id, frame)
            case ast.Attribute():
                return self.attribute(self.value(node.value, frame), node.attr)
            case ast.Subscript():
                return self.item(self.value(node.value, frame), self.value(node.slice, frame))
            case ast.Slice():
                ends = [None if e is None else self.value(e, frame) for e in (node.lower, node.upper, node.step)]
                return slice(*ends)
            case ast.Tuple() | ast.List():
                return tuple(self.value(e, frame) for e in node.elts)
            case ast.BinOp():
                return self.operate(node.op, self.value(node.left, frame), self.value(node.right, frame))
            case ast.UnaryOp():
                return self.turn(node.op, self.value(node.operand, frame))
            case ast.Compare():
                values = [self.value(e, frame) for e in (node.left, *node.comparators)]
                pairs = [self.compare(op, a, b) for op, a, b in zip(node.ops, values, values[1:])]
                return self.join("and", [partial(self.load, pair) for pair in pairs])
            case ast.BoolOp():
                word = "and" if isinstance(node.op, ast.And) else "or"
                return self.join(word, [partial(self.value, e, frame) for e in node.values])
            case ast.IfExp():
                test = self.truth(self.value(node.test, frame))
                if not isinstance(test, Term):
                    return self.value(node.body if test else node.orelse, frame)
                return self.choose(test, self.value(node.body, frame), self.value(node.orelse, frame))
            case ast.Call():
                given = [self.value(a, frame) for a in node.args]
                named = {str(k.arg): self.value(k.value, frame) for k in node.keywords}
                return self.invoke(self.value(node.func, frame), ast.unparse(node.func), given, named)
        raise Unwritable(f"uses {type(node).__name__.lower()}, which Warp cannot compile")

    def look_up(self, name: str, frame: Frame) -> Value:
        """What a name stands for."""
        if name in frame:
            return self.load(frame[name])
        if name in self.names:
            return self.names[name]
        if frame.function is not None:
            closed = dict(zip(frame.function.__code__.co_freevars, frame.function.__closure__ or ()))
            if name in closed:
                return closed[name].cell_contents
            if name in frame.function.__globals__:
                return frame.function.__globals__[name]
        if hasattr(builtins, name):
            return getattr(builtins, name)
        raise Unwritable(f"uses {name}, which may not be defined there")

    def attribute(self, base: Value, name: str) -> Value:
        """A field."""
        if isinstance(base, Record):
            return self.of_record(base, name)
        if isinstance(base, Term) or not hasattr(base, name):
            raise Unwritable(f"uses .{name}, which Warp cannot compile")
        found = getattr(base, name)
        return self.load(found)

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
        if kind == WHOLE and sign == "%":  # Python's has the sign of the divisor
            n = self.write_out(right, WHOLE)
            inner = self.keep(f"{self.write_out(left, WHOLE)} % {n}", WHOLE)
            return self.keep(f"wp.where({inner.text} < 0, {inner.text} + {n}, {inner.text})", WHOLE)
        if kind == WHOLE and sign in ("/", "**", "//"):
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

    # Calls

    def invoke(self, function: Value, called: str, given: list[Value], named: dict[str, Value]) -> Value:
        """Call a function: of numpy's, of Python's own, a named tuple, or one with text of its own."""
        if function is choose:
            return self.choose(self.truth(given[0]), given[1], given[2])
        if isinstance(function, type) and hasattr(function, "_fields"):
            return function(*given, **named)
        name = getattr(function, "__name__", "")
        module = getattr(function, "__module__", None)
        if isinstance(function, np.ufunc) or module in ("math", "numpy") or function in (abs, min, max):
            if named:
                raise Unwritable(f"calls {called} with names of arguments")
            name = MATH.get(name, {"min": "minimum", "max": "maximum", "absolute": "abs"}.get(name, name))
            return self.calculate(function, name, called, given)
        if function is len:
            (array,) = given
            return array.shape[0] if isinstance(array, (Cells, Ring)) else len(array)
        if function is range:
            return given[0] if isinstance(given[0], Repeat) else range(*given)
        if function in (int, float, bool):
            return self.convert(function, given[0])
        if isinstance(function, (ModuleType, type)) or not callable(function):
            raise Unwritable(f"calls {called}, which Warp cannot compile")
        return self.call(function, given, **named)

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


@dataclass(frozen=True)
class Repeat:
    """Numbers from 0 that a loop of the text counts through, instead of one that unrolls."""

    times: int


def common_kind(one: Value, two: Value) -> str:
    """The kind of number that both fit into."""
    kinds = set()
    for value in (one, two):
        if isinstance(value, Term):
            kinds.add(value.kind)
        elif isinstance(value, (bool, np.bool_)):
            kinds.add(TRUTH)
        elif isinstance(value, (int, np.integer)):
            kinds.add(WHOLE)
        elif isinstance(value, (float, np.floating)):
            kinds.add(REAL)
        else:
            raise Unwritable("is a number in one case, and something else in the other")
    return REAL if REAL in kinds else WHOLE if WHOLE in kinds else TRUTH


def same(one: Value, two: Value) -> bool:
    """Whether two values are one."""
    if isinstance(one, Term) or isinstance(two, Term):
        return one is two
    numbers = (int, float, bool, np.number)
    if isinstance(one, numbers) and isinstance(two, numbers):
        return bool(one == two) and type(one) is type(two)
    return one is two


def drop_unused(lines: list[str]) -> list[str]:
    """The lines without those that give a value to a variable which nothing reads."""
    while True:
        halves = [(m[1], line[m.end() :]) if (m := ASSIGNED.match(line)) else ("", line) for line in lines]
        used = {name for own, text in halves for name in VARIABLE.findall(text) if name != own}
        kept = [line for line, (own, _) in zip(lines, halves) if not own or own in used]
        if len(kept) == len(lines):
            return keep_blocks(kept)
        lines = kept


def keep_blocks(lines: list[str]) -> list[str]:
    """The lines with something in every block."""
    result = []
    for line, after in zip(lines, [*lines[1:], ""]):
        result.append(line)
        inner = len(line) - len(line.lstrip()) + 4
        if line.endswith(":") and len(after) - len(after.lstrip()) < inner:
            result.append(" " * inner + "pass")
    return result


def may_jump(statements: Sequence[ast.stmt]) -> bool:
    """Whether statements may return, or leave the loop or the turn that they are in."""
    for node in statements:
        if isinstance(node, (ast.Return, ast.Break, ast.Continue)):
            return True
        if isinstance(node, ast.If) and (may_jump(node.body) or may_jump(node.orelse)):
            return True
        if isinstance(node, (ast.For, ast.While)) and any(isinstance(n, ast.Return) for n in ast.walk(node)):
            return True
    return False


def copy_load(node: ast.expr) -> ast.expr:
    """A target, to be read."""
    return ast.parse(ast.unparse(node), mode="eval").body
