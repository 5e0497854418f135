"""A pipeline as Warp functions: the Python text of the effects, read as a tree and written down in Warp's dialect.

Warp knows no module of ours, mixes no integers or booleans with numbers, and unpacks no results into arrays; else both
texts are the same, line by line. Constants of modules become numbers in it, and functions that are called come along.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import linecache
import math
import re
import textwrap
from dataclasses import dataclass, field
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from vpptwin.effects.base import Body, Craft, Motion, Rotor
from vpptwin.errors import InputError, load_extra
from vpptwin.twin.pipeline import Function, Pipeline

NEED = "a twin on Warp"
SEEN = {kind.__name__: kind for kind in (Motion, Craft, Body, Rotor)}
"""What effects see, structs of the same names in Warp."""
SAME = {name: f"wp.{name}" for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "tanh", "sinh", "cosh", "floor")}
CALLS = SAME | {
    "arctan": "wp.atan", "arctan2": "wp.atan2", "arcsin": "wp.asin", "arccos": "wp.acos", "abs": "wp.abs",
    "minimum": "wp.min", "maximum": "wp.max", "sign": "sign", "expm1": "expm1",
}  # fmt: skip
"""numpy's functions of numbers → what Warp has for them."""
ITSELF = {"min": "wp.min", "max": "wp.max", "abs": "wp.abs"}
LISTS = {"on": "wp.array(dtype=wp.bool)", "p": "wp.array(dtype=Real)", "s": "wp.array(dtype=Real)"}
ARGUMENTS = LISTS | {"thrust": "Real", "rotor": "Rotor", "craft": "Craft", "dt": "Real"}
"""Types of the arguments of those functions of a chain that act on the craft."""
CRAFT = ("shape_thrust", "push_craft")
SMALL = re.compile(r"Real\((\d[\d.]*e-\d+)\)")
"""Numbers of the text that may be too small for float32."""
HEAD = """
@wp.func
def sign(x: Real):
    return wp.where(x > Real(0.0), Real(1.0), wp.where(x < Real(0.0), Real(-1.0), Real(0.0)))


@wp.func
def expm1(x: Real):
    grown = wp.exp(x)
    if grown == Real(1.0):
        return x
    less = grown - Real(1.0)
    if less == Real(-1.0):
        return less
    return less * x / wp.log(grown)
"""
# Warp's sign of zero is 1. expm1: Kahan's way, exact to rounding (Higham, Accuracy and Stability, 2002, section 1.14).


def run_text(text: str, single: bool) -> dict[str, Any]:
    """The Warp functions and structs that a text of `write_warp` defines, and kernels added to it, by name.

    Args:
        text: in which `wp` is Warp, and `Real` the type of a number.
        single: numbers are float32 instead of float64.

    Raises:
        InputError: if Warp is not installed.
    """
    wp = load_extra("warp", NEED)
    namespace: dict[str, Any] = {"wp": wp, "Real": wp.float32 if single else wp.float64}
    if single:  # what only keeps a divisor from zero would be zero itself
        text = SMALL.sub(lambda found: f"Real({max(float(found[1]), float(np.finfo(np.float32).tiny))})", text)
    digest = hashlib.sha256(f"{text} {single}".encode()).hexdigest()[:16]
    file = f"<warp {digest}>"
    namespace["__name__"] = f"vpptwin_warp_{digest}"  # Warp keeps compiled modules by name and text
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    exec(compile(text, file, "exec", dont_inherit=True), namespace)
    # A product and a sum fused would round once where numba rounds twice.
    wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=namespace["push_craft"].module)
    return namespace


def write_warp(pipeline: Pipeline) -> str:
    """The text of a pipeline's effects, and of its `shape_thrust` and `push_craft`, in Warp's dialect.

    Raises:
        InputError: if an effect does what Warp cannot compile, with its id, the file and the line.
    """
    parts = [write_struct(kind) for kind in SEEN.values()] + [HEAD]
    written: dict[Function, str] = {}
    ids = dict(zip(pipeline.functions, pipeline.places, strict=True))
    for name, function in pipeline.functions.items():
        if function in written:
            parts.append(f"{name} = {written[function]}")
            continue
        written[function] = name
        effect = ids[name]
        parts += Writer(function, name, effect).write()
    chain = {node.name: node for node in ast.parse(pipeline.source).body if isinstance(node, ast.FunctionDef)}
    names = {*pipeline.functions, *SEEN}
    for name in CRAFT:
        writer = Writer(None, name, name, known=names)
        parts.append(writer.define(chain[name], {a.arg: ARGUMENTS[a.arg] for a in chain[name].args.args}))
    return "\n\n\n".join(part.strip("\n") for part in parts) + "\n"


def write_struct(kind: Any) -> str:  # noqa: ANN401
    """A Warp struct with the fields of a named tuple."""
    return "\n".join(["@wp.struct", f"class {kind.__name__}:", *(f"    {name}: Real" for name in kind._fields)])


@dataclass
class Writer(ast.NodeTransformer):
    """Writes one function, and those that it calls, in Warp's dialect.

    Attributes:
        function: as it is in Python; None for a tree whose names are `known`.
        name: in the text.
        effect: whose it is, for messages.
        known: names that stand as they are.
        helpers: texts of the functions it calls.
        first_line: of the function in its file.
        index: of the last assignment to many names.
        values: what the function finds outside of itself, by name.
    """

    function: Function | None
    name: str
    effect: str
    known: set[str] = field(default_factory=set)
    helpers: list[str] = field(default_factory=list)
    first_line: int = 1
    index: int = 0
    values: dict[str, Any] = field(default_factory=dict)

    def write(self) -> list[str]:
        """The texts of the functions that it calls, then its own."""
        assert self.function is not None
        plain = getattr(inspect.unwrap(self.function), "py_func", inspect.unwrap(self.function))
        try:
            lines, self.first_line = inspect.getsourcelines(plain)
            tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
        except (OSError, TypeError, SyntaxError):
            raise self.refuse("has no source text", None) from None
        if not isinstance(tree, ast.FunctionDef):
            raise self.refuse("is no function written with def", tree)
        used = inspect.getclosurevars(plain)
        self.values = {**used.builtins, **used.globals, **used.nonlocals}
        given = [*tree.args.posonlyargs, *tree.args.args]
        kinds = {a.arg: ast.unparse(a.annotation) if a.annotation else "" for a in given}
        for a in given:
            if kinds[a.arg] != "float" and kinds[a.arg] not in SEEN:
                raise self.refuse(f"leaves open whether {a.arg} is float or one of {', '.join(SEEN)}", a)
        text = self.define(tree, {a: kind if kind in SEEN else "Real" for a, kind in kinds.items()})
        return [*self.helpers, text]

    def define(self, tree: ast.FunctionDef, arguments: dict[str, str]) -> str:
        """The text of a function with typed arguments."""
        doc = isinstance(tree.body[0], ast.Expr) and isinstance(tree.body[0].value, ast.Constant)
        body = [self.visit(node) for node in tree.body[int(doc) :]]
        flat = [line for part in body for line in (part if isinstance(part, list) else [part])]
        lines = "\n".join(ast.unparse(ast.fix_missing_locations(node)) for node in flat)
        listed = ", ".join(f"{name}: {kind}" for name, kind in arguments.items())
        return f"@wp.func\ndef {self.name}({listed}):\n{textwrap.indent(lines, '    ')}"

    def refuse(self, does: str, node: ast.AST | None) -> InputError:
        """The error for what Warp cannot compile."""
        line = self.first_line + getattr(node, "lineno", 1) - 1
        file = inspect.getsourcefile(self.function) if isinstance(self.function, FunctionType) else None
        return InputError(
            f"effect {self.effect} {does} (line {line} of {file})", "numbers, arithmetic, if, and numpy's functions of "
            f"numbers ({', '.join(CALLS)})", "write it so, or fly it on the processor, which compiles it with numba",
        )  # fmt: skip

    def generic_visit(self, node: ast.AST) -> Any:  # noqa: ANN401
        """Only what both understand."""
        if not isinstance(node, UNDERSTOOD):
            raise self.refuse(f"uses {type(node).__name__.lower()}, which Warp cannot compile", node)
        return super().generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> Any:  # noqa: ANN401
        """Every number is a Real."""
        if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
            raise self.refuse(f"uses {node.value!r}, which Warp cannot compile", node)
        return number(float(node.value))

    def visit_Subscript(self, node: ast.Subscript) -> Any:  # noqa: ANN401
        """Indices stay whole; only the lists of a chain have any."""
        if self.function is not None:
            raise self.refuse("takes items of an array", node)
        return node

    def visit_BinOp(self, node: ast.BinOp) -> Any:  # noqa: ANN401
        """A condition in arithmetic is 1 or 0."""
        left, right = (as_number(n, self.visit(n)) for n in (node.left, node.right))
        if isinstance(node.op, ast.Pow):
            return ast.Call(parse("wp.pow"), [left, right], [])
        return ast.BinOp(left, node.op, right)

    def visit_Attribute(self, node: ast.Attribute) -> Any:  # noqa: ANN401
        """Fields of what an effect sees stay; numbers of modules are written out."""
        if self.function is not None and isinstance(node.value, ast.Name):
            module = self.values.get(node.value.id)
            if isinstance(module, ModuleType):
                return self.freeze(getattr(module, node.attr, None), node)
        return node

    def visit_Name(self, node: ast.Name) -> Any:  # noqa: ANN401
        """Constants of the effect's module are written out."""
        return self.freeze(self.values[node.id], node) if self.function is not None and node.id in self.values else node

    def freeze(self, value: Any, node: ast.AST) -> ast.expr:  # noqa: ANN401
        """A number that the function finds outside of itself."""
        if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
            return number(float(value))
        raise self.refuse(f"uses {ast.unparse(node)}, which Warp cannot compile", node)

    def visit_IfExp(self, node: ast.IfExp) -> Any:  # noqa: ANN401
        """One or the other."""
        return ast.Call(parse("wp.where"), [self.visit(n) for n in (node.test, node.body, node.orelse)], [])

    def visit_Call(self, node: ast.Call) -> Any:  # noqa: ANN401
        """Functions of numpy by Warp's names, and functions of the effect's own."""
        called = ast.unparse(node.func)
        if node.keywords:
            raise self.refuse(f"calls {called} with names of arguments", node)
        if self.function is None:
            if called == "int":
                return parse(f"wp.where({ast.unparse(self.visit(node.args[0]))}, 1, 0)")
            return ast.Call(node.func, [self.visit(a) for a in node.args], [])
        arguments = [as_number(a, self.visit(a)) for a in node.args]
        if called == "float":
            return arguments[0]
        head, _, tail = called.rpartition(".")
        found = self.values.get(head) if head else self.values.get(called)
        if isinstance(found, ModuleType) and found in (np, math):
            name = CALLS.get(tail)
        else:
            name = ITSELF.get(called) or self.bring(found)
        if name is None:
            raise self.refuse(f"calls {called}, which Warp cannot compile", node)
        if name in ("wp.min", "wp.max"):
            while len(arguments) > 2:
                arguments = [ast.Call(parse(name), arguments[:2], []), *arguments[2:]]
        return ast.Call(parse(name), arguments, [])

    def bring(self, found: Any) -> str | None:  # noqa: ANN401
        """Write a function that this one calls; None if it is none."""
        plain = getattr(found, "py_func", found)
        if not isinstance(plain, FunctionType) or plain is self.function:
            return None
        name = f"{self.name}_{plain.__name__}"
        helper = Writer(plain, name, self.effect).write()
        self.helpers += [text for text in helper if text not in self.helpers]
        return name

    def visit_Assign(self, node: ast.Assign) -> Any:  # noqa: ANN401
        """One target at a time; results that go into lists pass through names."""
        if len(node.targets) > 1:
            return [self.visit_Assign(copy_assign(t, node.value, node)) for t in reversed(node.targets)]
        target, value = node.targets[0], node.value
        if not isinstance(target, ast.Tuple):
            return ast.Assign([target], self.visit(value))
        # Unpacked through names of their own: a target may stand on the right, and Warp assigns one after the other.
        self.index += 1
        names = [ast.Name(f"new_{self.index}_{i}", ast.Store()) for i in range(len(target.elts))]
        if isinstance(value, ast.Tuple):
            firsts: list[ast.stmt] = [ast.Assign([n], self.visit(v)) for n, v in zip(names, value.elts, strict=True)]
        else:
            firsts = [ast.Assign([ast.Tuple(list(names), ast.Store())], self.visit(value))]
        return [*firsts, *(ast.Assign([t], n) for t, n in zip(target.elts, names, strict=True))]


UNDERSTOOD = (
    ast.Return, ast.If, ast.Compare, ast.BoolOp, ast.UnaryOp, ast.Tuple, ast.Expr, ast.operator, ast.unaryop,
    ast.cmpop, ast.boolop, ast.expr_context, ast.AugAssign,
)  # fmt: skip
"""What is the same in both dialects, its parts apart."""


def parse(text: str) -> ast.expr:
    """The tree of an expression."""
    return ast.parse(text, mode="eval").body


def number(value: float) -> ast.expr:
    """A number in the text."""
    return ast.Call(ast.Name("Real", ast.Load()), [ast.Constant(value)], [])


def as_number(original: ast.expr, written: Any) -> Any:  # noqa: ANN401
    """A condition as 1 or 0, anything else as it is."""
    if isinstance(original, ast.Compare):
        return ast.Call(parse("wp.where"), [written, number(1.0), number(0.0)], [])
    return written


def copy_assign(target: ast.expr, value: ast.expr, at: ast.AST) -> ast.Assign:
    """The assignment of a value to one target, where the one to many stands."""
    return ast.copy_location(ast.Assign([target], value), at)
