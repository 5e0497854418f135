"""The text of a kernel as it is written: variables, branches that meet again, loops that carry values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FunctionType
from typing import Any

import numpy as np

from vpptwin.engine.trace.terms import REAL, TRUTH, WHOLE, ZERO, Scope, Term, Unwritable, Value, common_kind, same

ASSIGNED, VARIABLE = re.compile(r"\s*([rnbt]\d+) = "), re.compile(r"\b[rnbt]\d+\b")
NORMAL, CONTINUE, BREAK = "normal", "continue", "break"
MISSING = object()
Ending = Any
"""How a block of statements ends: `NORMAL`, `CONTINUE`, `BREAK`, or ("return", value)."""


@dataclass
class Loop:
    """A loop of the text.

    Attributes:
        carried: its variables, by where their values stand as it is written.
        at_break: what was written where it is left.
    """

    carried: dict[tuple[int, Any], tuple[Any, Any, Term]] = field(default_factory=dict)
    at_break: dict[tuple[int, Any], tuple[Any, Any, Value]] = field(default_factory=dict)


class Paths:
    """Writes lines down, and remembers what stands where.

    Args:
        single: numbers are float32: what would be zero in it becomes its smallest.

    Attributes:
        lines: written so far.
    """

    def __init__(self, single: bool) -> None:
        self.least = float(np.finfo(np.float32).tiny) if single else 0.0
        self.lines: list[str] = []
        self.known: list[dict[str, Term]] = [{}]
        self.logs: list[dict[tuple[int, Any], tuple[Any, Any, Value]]] = []
        self.loops: list[Loop | None] = []
        self.stack: list[tuple[FunctionType | None, int]] = []
        self.count = self.serial = 0

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
        with self.branch() as (then_lines, then_written):
            one = then()
        with self.branch() as (else_lines, else_written):
            two = other()
        before: list[str] = []
        if one != BREAK and two != BREAK:
            for here in {**then_written, **else_written}:
                container, key, _ = then_written.get(here) or else_written[here]
                old = container[key] if isinstance(container, list) else container.get(key, MISSING)
                pair = [side[here][2] if here in side else old for side in (then_written, else_written)]
                if MISSING in pair:  # defined in one of them: for that one alone
                    continue
                self.put(container, key, self.merge(pair[0], pair[1], before, then_lines, else_lines))
        else:
            loop = self.loops[-1]
            if loop is None:
                raise Unwritable("leaves a loop in one case only")
            loop.at_break |= then_written if one == BREAK else else_written
            for container, key, value in (else_written if one == BREAK else then_written).values():
                self.put(container, key, value)
        ending = two if one in (BREAK, CONTINUE) else one
        if isinstance(one, tuple) != isinstance(two, tuple) and BREAK not in (one, two):
            raise Unwritable("returns in one case, and goes on in a loop in the other")
        if isinstance(one, tuple) and isinstance(two, tuple):
            ending = ("return", self.merge(one[1], two[1], before, then_lines, else_lines))
        self.lines += before
        self.lines += [f"if {test.text}:", *("    " + line for line in then_lines or ["pass"])]
        if else_lines:
            self.lines += ["else:", *("    " + line for line in else_lines)]
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
                here: (container, key, value) for here, (container, key, value) in (loop.at_break | written).items()
                if here not in loop.carried and not (isinstance(container, Scope) and container.serial > born)
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
        carried = {variable.text for *_, variable in loop.carried.values()}
        texts = [(v, self.write_out(container[key], v.kind)) for container, key, v in loop.carried.values()]
        later = []
        for variable, text in texts:
            if text == variable.text:
                continue
            if text in carried:
                self.count += 1
                self.lines.append(f"t{self.count} = {text}")
                text = f"t{self.count}"
            later.append(f"{variable.text} = {text}")
        self.lines += later


def drop_unused(lines: list[str]) -> list[str]:
    """The lines without those that give a value to a variable which nothing reads."""
    while True:
        halves = [(m[1], line[m.end() :]) if (m := ASSIGNED.match(line)) else ("", line) for line in lines]
        used = {name for target, text in halves for name in VARIABLE.findall(text) if name != target}
        kept = [line for line, (target, _) in zip(lines, halves) if not target or target in used]
        if len(kept) == len(lines):
            break
        lines = kept
    result = []  # with something in every block
    for line, after in zip(lines, [*lines[1:], ""]):
        result.append(line)
        inner = len(line) - len(line.lstrip()) + 4
        if line.endswith(":") and len(after) - len(after.lstrip()) < inner:
            result.append(" " * inner + "pass")
    return result
