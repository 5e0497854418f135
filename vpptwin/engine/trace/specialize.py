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
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from vpptwin.actuators.numbers import choose
from vpptwin.engine.trace.arithmetic import MATH, Arithmetic
from vpptwin.engine.trace.paths import BREAK, CONTINUE, NORMAL, Ending
from vpptwin.engine.trace.terms import WHOLE, Cells, Record, Repeat, Ring, Scope, Term, Unwritable, Value


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


class Writer(Arithmetic):
    """Runs statements, and writes down what is left to be done; see `Paths`.

    Args:
        single: numbers are float32.
        names: functions' global names that mean something else here.
    """

    def __init__(self, single: bool, names: dict[str, Value] | None = None) -> None:
        super().__init__(single)
        self.names = names or {}

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
            return self.run(tree.body, Scope(plain, dict(bound.arguments), self.serial))
        except Unwritable as error:
            if not error.stack:
                error.stack = list(self.stack)
            raise
        finally:
            self.stack.pop()

    def run(self, statements: Sequence[ast.stmt], scope: Scope) -> Value:
        """Run the statements of a whole function; what it returns."""
        self.loops.append(None)
        end = ast.Return(None, lineno=getattr(statements[-1], "end_lineno", 1))
        ending = self.block([*statements, end], scope)
        self.loops.pop()
        return ending[1]

    def block(self, statements: Sequence[ast.stmt], scope: Scope) -> Ending:
        """Run statements one after the other."""
        queue = list(statements)
        while queue:
            node = queue.pop(0)
            if self.stack:
                self.stack[-1] = (self.stack[-1][0], node.lineno)
            if not isinstance(node, ast.If):
                ending = self.statement(node, scope)
                if ending != NORMAL:
                    return ending
                continue
            test = self.truth(self.value(node.test, scope))
            if not isinstance(test, Term):
                queue = [*(node.body if test else node.orelse), *queue]
                continue
            # What comes after a branch that ends elsewhere belongs to the other one.
            jumps = any(map(may_jump, (node.body, node.orelse)))
            rest = queue if jumps else []
            ways = [partial(self.block, [*way, *rest], scope) for way in (node.body, node.orelse)]
            ending = self.fork(test, *ways)
            if jumps:
                return ending
        return NORMAL

    def statement(self, node: ast.stmt, scope: Scope) -> Ending:
        """Run one statement."""
        match node:
            case ast.Return():
                return ("return", None if node.value is None else self.value(node.value, scope))
            case ast.Assign():
                value = self.value(node.value, scope)
                for target in node.targets:
                    self.assign(target, value, scope)
            case ast.AnnAssign():
                if node.value is not None:
                    self.assign(node.target, self.value(node.value, scope), scope)
            case ast.AugAssign():
                now = self.value(node.target, scope)
                result = self.operate(node.op, now, self.value(node.value, scope))
                if isinstance(now, Cells):
                    self.fill(now, ..., result)
                else:
                    self.assign(node.target, result, scope)
            case ast.For():
                return self.count_through(node, scope)
            case ast.While():
                return self.unroll(node.body, self.while_true(node.test, scope), scope)
            case ast.Expr():
                if not isinstance(node.value, ast.Constant):
                    self.value(node.value, scope)
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

    def while_true(self, test: ast.expr, scope: Scope) -> Iterator[None]:
        """Once for every time that a condition holds, which has to be known."""
        while True:
            holds = self.truth(self.value(test, scope))
            if isinstance(holds, Term):
                raise Unwritable("uses while with a condition that changes, which Warp cannot compile")
            if not holds:
                return
            yield

    def unroll(self, body: Sequence[ast.stmt], turns: Iterator[None], scope: Scope) -> Ending:
        """The body of a loop, as often as it turns."""
        self.loops.append(None)
        ending: Ending = NORMAL
        for _ in turns:
            ending = self.block(body, scope)
            if ending == BREAK or isinstance(ending, tuple):
                break
        self.loops.pop()
        return ending if isinstance(ending, tuple) else NORMAL

    def count_through(self, node: ast.For, scope: Scope) -> Ending:
        """A loop: over numbers that are known it unrolls; over `Repeat` it stays one."""
        if node.orelse:
            raise Unwritable("uses for with else, which Warp cannot compile")
        over = self.value(node.iter, scope)
        if isinstance(over, Repeat):
            name = self.fresh(WHOLE)

            def turn() -> Ending:
                self.assign(node.target, name, scope)
                return self.block(node.body, scope)

            self.repeat(f"for {name.text} in range({over.times}):", turn)
            return NORMAL
        if not isinstance(over, (range, tuple, list, Cells, np.ndarray)):
            raise Unwritable("goes through what is not known before")
        items = [self.item(over, i) for i in range(len(over.index) if isinstance(over, Cells) else len(over))]
        return self.unroll(node.body, self.assign_each(node.target, items, scope), scope)

    def assign_each(self, target: ast.expr, items: list[Value], scope: Scope) -> Iterator[None]:
        """Give one value after the other."""
        for item in items:
            self.assign(target, item, scope)
            yield

    def assign(self, target: ast.expr, value: Value, scope: Scope) -> None:
        """Give a value to a name, some names, an element or a field."""
        match target:
            case ast.Name():
                self.put(scope, target.id, value)
            case ast.Tuple() | ast.List():
                parts = [self.item(value, i) for i in range(len(target.elts))] if isinstance(value, Cells) else value
                if len(parts) != len(target.elts):
                    raise Unwritable(f"unpacks {len(parts)} values into {len(target.elts)}")
                for each, part in zip(target.elts, parts, strict=True):
                    self.assign(each, part, scope)
            case ast.Subscript():
                base, key = self.value(target.value, scope), self.value(target.slice, scope)
                if isinstance(base, Record):
                    self.fill(base.fields[key], (), value)
                elif isinstance(base, Ring):
                    self.lines.append(f"{self.locate(base, key)} = {self.write_out(value)}")
                elif isinstance(base, Cells):
                    self.fill(base, key, value)
                else:
                    raise Unwritable("writes into what is known before")
            case ast.Attribute():
                base = self.value(target.value, scope)
                if not isinstance(base, Record):
                    raise Unwritable(f"writes to {target.attr}")
                self.fill(base.fields[target.attr], (), value)
            case _:
                raise Unwritable("assigns to what Warp cannot")

    def value(self, node: ast.expr, scope: Scope) -> Value:
        """The value of an expression."""
        match node:
            case ast.Constant():
                return node.value
            case ast.Name():
                return self.look_up(node.id, scope)
            case ast.Attribute():
                return self.attribute(self.value(node.value, scope), node.attr)
            case ast.Subscript():
                return self.item(self.value(node.value, scope), self.value(node.slice, scope))
            case ast.Slice():
                ends = [None if e is None else self.value(e, scope) for e in (node.lower, node.upper, node.step)]
                return slice(*ends)
            case ast.Tuple() | ast.List():
                return tuple(self.value(e, scope) for e in node.elts)
            case ast.BinOp():
                return self.operate(node.op, self.value(node.left, scope), self.value(node.right, scope))
            case ast.UnaryOp():
                return self.turn(node.op, self.value(node.operand, scope))
            case ast.Compare():
                values = [self.value(e, scope) for e in (node.left, *node.comparators)]
                pairs = [self.compare(op, a, b) for op, a, b in zip(node.ops, values, values[1:])]
                return self.join("and", [partial(self.load, pair) for pair in pairs])
            case ast.BoolOp():
                word = "and" if isinstance(node.op, ast.And) else "or"
                return self.join(word, [partial(self.value, e, scope) for e in node.values])
            case ast.IfExp():
                test = self.truth(self.value(node.test, scope))
                if not isinstance(test, Term):
                    return self.value(node.body if test else node.orelse, scope)
                return self.choose(test, self.value(node.body, scope), self.value(node.orelse, scope))
            case ast.Call():
                given = [self.value(a, scope) for a in node.args]
                named = {str(k.arg): self.value(k.value, scope) for k in node.keywords}
                return self.invoke(self.value(node.func, scope), ast.unparse(node.func), given, named)
        raise Unwritable(f"uses {type(node).__name__.lower()}, which Warp cannot compile")

    def look_up(self, name: str, scope: Scope) -> Value:
        """What a name stands for."""
        if name in scope:
            return self.load(scope[name])
        if name in self.names:
            return self.names[name]
        if scope.function is not None:
            closed = dict(zip(scope.function.__code__.co_freevars, scope.function.__closure__ or ()))
            if name in closed:
                return closed[name].cell_contents
            if name in scope.function.__globals__:
                return scope.function.__globals__[name]
        if hasattr(builtins, name):
            return getattr(builtins, name)
        raise Unwritable(f"uses {name}, which may not be defined there")

    def attribute(self, base: Value, name: str) -> Value:
        """A field."""
        if isinstance(base, Record):
            return self.of_record(base, name)
        if isinstance(base, Term) or not hasattr(base, name):
            raise Unwritable(f"uses .{name}, which Warp cannot compile")
        return self.load(getattr(base, name))

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
