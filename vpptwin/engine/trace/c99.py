"""Python run on what is known, the rest written down as C99: float and int, in place, without a library."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vpptwin.engine.trace.arithmetic import COMPARED, FOLDED
from vpptwin.engine.trace.paths import ASSIGNED, VARIABLE, drop_unused
from vpptwin.engine.trace.specialize import Writer
from vpptwin.engine.trace.terms import REAL, Cells, Term, Unwritable, Value

TYPES = {"r": "float", "n": "int", "b": "int", "t": "float"}
"""C's types by the first letter of a variable."""
CALLS = {"wp.sqrt": "root", "wp.abs": "size", "wp.min": "smaller", "wp.max": "larger", "sign": "sign"}
"""Functions of traced text → what a file of C has to define."""
OPERATORS = {op: (sign, 6 if sign in "*/%" else 5) for op, sign in FOLDED.items() if sign in "+-*/%"} | {
    op: (sign, 3 if sign in ("==", "!=") else 4) for op, sign in COMPARED.items()
}
"""C's signs and how strongly they bind."""
JOINED = {ast.Or: ("||", 1), ast.And: ("&&", 2)}
WIDTH = 110
"""Characters a line, up to which an expression takes in those that only it uses."""


@dataclass(frozen=True, eq=False)
class StoragePlace(Term):
    """A number in memory that is read and written there, in the order of the program."""


class Memory(list[StoragePlace]):
    """The store of such an array."""


def make_array(texts: Sequence[str] | str) -> Cells:
    """An array of numbers in memory, by the C expression of each; a number of one expression. `.` stands for `->`."""
    store = Memory(StoragePlace(text, REAL) for text in ([texts] if isinstance(texts, str) else texts))
    return Cells(store, np.array(0) if isinstance(texts, str) else np.arange(len(store)))


class CWriter(Writer):
    """Writes C99 of float32 numbers.

    Args:
        apart: functions that stay calls → the text of a call, of its arguments' values.
    """

    def __init__(self, apart: Mapping[Callable[..., Any], Callable[..., str]] | None = None) -> None:
        super().__init__(single=True)
        self.apart = apart or {}

    def call(self, function: Callable[..., Any], given: Sequence[Value], **named: Value) -> Value:
        """See `Writer.call`; the names of functions become comments."""
        if function in self.apart:
            return self.copy_out(self.apart[function](*given, **named))
        self.lines.append(f"# {function.__name__}")
        result = super().call(function, given, **named)
        if self.stack:
            self.lines.append(f"# {getattr(self.stack[-1][0], '__name__', '')}")
        return result

    def load(self, value: Value) -> Value:
        """See `Arithmetic.load`."""
        return self.copy_out(value.text) if isinstance(value, StoragePlace) else super().load(value)

    def put(self, container: Any, key: Any, value: Value) -> None:  # noqa: ANN401
        """See `Paths.put`: what is in memory is written at once."""
        if isinstance(container, Memory):
            self.lines.append(f"{container[key].text} = {self.write_out(value)}")
        else:
            super().put(container, key, value)

    def finish(self) -> str:
        """The lines written so far as the body of a C function."""
        return "\n".join(print_blocks(inline_single(drop_unused(self.lines))))


@dataclass
class CodeLine:
    """A line of traced text: `target` = `expression` where it assigns, else `head` with a condition, or a comment."""

    indent: int
    head: str
    target: str
    expression: ast.expr | None


def read_line(text: str) -> CodeLine:
    """A line as its parts."""
    bare = text.lstrip()
    indent = len(text) - len(bare)
    if bare.startswith("#") or bare in ("else:", "pass"):
        return CodeLine(indent, bare, "", None)
    if bare.startswith("if "):
        return CodeLine(indent, "if", "", ast.parse(bare[3:-1], mode="eval").body)
    target, _, rest = bare.partition(" = ")
    if bare.startswith("return "):
        target, rest = "return", bare[7:]
    return CodeLine(indent, "", target, ast.parse(rest, mode="eval").body)


def inline_single(texts: Sequence[str]) -> list[CodeLine]:
    """The lines, expressions with one use put where they are used, unless memory may have changed in between."""
    uses: Counter[str] = Counter()
    set_at: Counter[str] = Counter(m[1] for text in texts if (m := ASSIGNED.match(text)))
    for text in texts:
        uses.update(VARIABLE.findall(text[m.end() :] if (m := ASSIGNED.match(text)) else text))
    lines: list[CodeLine | None] = []
    born: dict[str, int] = {}  # where a variable is made that can move
    stored = -1  # where memory was written last
    for text in texts:
        line = read_line(text)
        if line.expression is not None:
            for name in sorted(VARIABLE.findall(ast.unparse(line.expression)), key=lambda n: born.get(n, -1)):
                made = lines[born[name]] if name in born else None
                if made is None or made.expression is None or uses[name] > 1:
                    continue
                if stored > born[name] and reads_memory(made.expression):
                    continue
                whole = Substitute({name: made.expression}).visit(ast.parse(ast.unparse(line.expression), mode="eval"))
                if line.indent + len(line.target) + len(print_expression(whole.body)) + 18 <= WIDTH:
                    line.expression, lines[born[name]] = whole.body, None
        if not VARIABLE.fullmatch(line.target):
            stored = len(lines) if line.target else stored
        elif calls_out(line.expression):
            stored = len(lines)
        elif set_at[line.target] == 1:
            born[line.target] = len(lines)
        lines.append(line)
    return drop_headings([line for line in lines if line is not None])


def drop_headings(lines: Sequence[CodeLine]) -> list[CodeLine]:
    """The lines without comments that nothing follows, or that say again where one is."""
    result: list[CodeLine] = []
    heading = ""
    for line, after in zip(lines, [*lines[1:], CodeLine(-1, "", "", None)]):
        if line.head.startswith("#"):
            if line.head == heading or after.head.startswith("#") or after.indent < line.indent:
                continue
            heading = line.head
        result.append(line)
    return result


class Substitute(ast.NodeTransformer):
    """Expressions in place of names."""

    def __init__(self, known: Mapping[str, ast.expr]) -> None:
        self.known = known

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """The expression of a name."""
        return self.known.get(node.id, node)


def reads_memory(node: ast.expr) -> bool:
    """Whether an expression has a place in memory in it."""
    places = [n for n in ast.walk(node) if isinstance(n, (ast.Attribute, ast.Subscript))]
    return any(not ast.unparse(place).startswith("wp.") for place in places)


def calls_out(node: ast.expr | None) -> bool:
    """Whether an expression calls a function that may write to memory."""
    calls = [ast.unparse(n.func) for n in ast.walk(node or ast.Constant(0)) if isinstance(n, ast.Call)]
    return any(name not in (*CALLS, "wp.where", "Real", "wp.int32", "bool") for name in calls)


def print_blocks(lines: Sequence[CodeLine]) -> list[str]:
    """Lines as C: variables declared where they begin, braces in place of indentation."""
    count = Counter(line.target for line in lines if VARIABLE.fullmatch(line.target))
    declared: set[str] = set()
    result: list[str] = []
    depth = 0
    for line in lines:
        while depth > line.indent:
            depth -= 4
            if not (line.head == "else:" and depth == line.indent):
                result.append(f"    {' ' * depth}}}")
        text = "" if line.expression is None else print_expression(line.expression)
        if line.head == "if":
            text, depth = f"if ({text}) {{", depth + 4
        elif line.head == "else:":
            text, depth = "} else {", depth + 4
        elif line.head == "pass":
            text = ";"
        elif line.head:
            text = f"/* {line.head[2:]} */"
        elif line.target == "return":
            text = f"return {text};"
        elif not VARIABLE.fullmatch(line.target):
            text = f"{line.target.replace('.', '->')} = {text};"
        elif line.target in declared:
            text = f"{line.target} = {text};"
        elif count[line.target] > 1:  # its value comes in every branch that follows
            text = f"{TYPES[line.target[0]]} {line.target};"
        else:
            text = f"const {TYPES[line.target[0]]} {line.target} = {text};"
        declared.add(line.target)
        result.append(f"    {' ' * line.indent}{text}")
    return [*result, *(f"    {' ' * d}}}" for d in range(depth - 4, -1, -4))]


def print_expression(node: ast.expr, level: int = 0) -> str:
    """An expression as C, in parentheses where what it stands in binds more strongly than `level`."""
    match node:
        case ast.Name():
            return node.id
        case ast.Constant():
            return str(node.value)
        case ast.Attribute():
            return f"{print_expression(node.value, 8)}->{node.attr}"
        case ast.Subscript():
            return f"{print_expression(node.value, 8)}[{print_expression(node.slice)}]"
        case ast.BinOp():
            sign, rank = OPERATORS[type(node.op)]
            text = f"{print_expression(node.left, rank)} {sign} {print_expression(node.right, rank + 1)}"
        case ast.Compare():
            sign, rank = OPERATORS[type(node.ops[0])]
            text = f"{print_expression(node.left, rank + 1)} {sign} {print_expression(node.comparators[0], rank + 1)}"
        case ast.BoolOp():
            sign, rank = JOINED[type(node.op)]
            text = f" {sign} ".join(print_expression(value, 3) for value in node.values)
        case ast.UnaryOp():
            rank, text = 7, print_expression(node.operand, 8)
            text = f"{'!' if isinstance(node.op, ast.Not) else '-'}{f'({text})' if text.startswith('-') else text}"
        case ast.Call():
            return print_call(node, level)
        case _:
            raise Unwritable(f"is {ast.unparse(node)}, for which C has no word")
    return f"({text})" if rank < level else text


def print_call(node: ast.Call, level: int) -> str:
    """A call as C: numbers become literals, conversions casts."""
    name, given = ast.unparse(node.func), node.args
    if name in ("Real", "wp.int32", "bool"):
        try:
            value = ast.literal_eval(given[0])
        except ValueError:
            text = f"({'float' if name == 'Real' else 'int'}){print_expression(given[0], 8)}"
            return f"({text})" if level > 7 else text
        return as_float(value) if name == "Real" else str(int(value))
    if name == "wp.where":
        text = f"{print_expression(given[0], 1)} ? {print_expression(given[1], 1)} : {print_expression(given[2], 1)}"
        return f"({text})" if level > 0 else text
    if name.startswith("wp.") and name not in CALLS:
        raise Unwritable(f"needs {name[3:]}, which C has in its library only")
    return f"{CALLS.get(name, name)}({', '.join(print_expression(value) for value in given)})"


def as_float(value: float) -> str:
    """A number as a C float literal, exact."""
    text = np.format_float_scientific(np.float32(value), unique=True, trim="0")
    return f"{text}f"
