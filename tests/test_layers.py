"""Imports run one way through packages, rooms and files, as docs/architecture.md says."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "vpptwin"
ORDER = (
    "effects", "engine", "actuators", "twin", "logs", "estimation", "pilot", "viz", "diagnosis", "identification",
    "train", "deploy",
)  # fmt: skip
"""Each package imports only from those before it."""
ROOMS = ("evidence", "search", "judgement", "report")
"""The rooms of diagnosis: likewise."""


def find_imports(tree: ast.AST) -> Iterator[str]:
    """Modules that code imports when it runs, also inside of functions; not what only type checkers see."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        yield from find_imports(node)


def imported_packages(file: Path) -> set[str]:
    """Packages of vpptwin that a file imports from."""
    modules = find_imports(ast.parse(file.read_text()))
    return {parts[1] for parts in (module.split(".") for module in modules) if parts[0] == "vpptwin" and len(parts) > 1}


def test_every_package_has_its_place() -> None:
    """No package is left out, and the page names them in this order."""
    assert {file.parent.name for file in PACKAGE.glob("*/__init__.py")} == set(ORDER)
    (line,) = re.findall(r"\*\*Imports run one way\*\*: (.*)\.\n", (ROOT / "docs/architecture.md").read_text())
    named = [name for name in re.findall(r"\w+", line) if name in ORDER]
    assert named == list(ORDER)


def test_rooms_of_diagnosis_run_one_way() -> None:
    """From what flights say to what is told: no room imports from one that comes after it."""
    assert {folder.parent.name for folder in (PACKAGE / "diagnosis").glob("*/__init__.py")} == set(ROOMS)
    wrong = []
    for i, room in enumerate(ROOMS):
        later = tuple(f"vpptwin.diagnosis.{name}" for name in ROOMS[i + 1 :])
        for file in (PACKAGE / "diagnosis" / room).rglob("*.py"):
            wrong += [f"{file.name}: {m}" for m in find_imports(ast.parse(file.read_text())) if m.startswith(later)]
    assert not wrong


def test_criteria_lie_below_the_rooms() -> None:
    """All rooms read them, so that they import nothing of ours."""
    tree = ast.parse((PACKAGE / "diagnosis/criteria.py").read_text())
    assert not [module for module in find_imports(tree) if module.startswith("vpptwin")]


def test_no_files_import_each_other() -> None:
    """Not in circles of any length, nor inside of functions: the files can be read in one order."""
    files = {name_module(file): file for file in PACKAGE.rglob("*.py")}
    graph = {name: imported_files(file, files) - {name} for name, file in files.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(files)


def imported_files(file: Path, files: Collection[str]) -> set[str]:
    """Dotted names of the files that one imports; a package only for what is in it itself."""
    found = {name for name in find_imports(ast.parse(file.read_text())) if name in files}
    return {name for name in found if not any(other.startswith(f"{name}.") for other in found)}


def name_module(file: Path) -> str:
    """The dotted name that a file is imported by."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_one_way(package: str) -> None:
    """A package imports nothing that comes after it, nor the command line."""
    later = {*ORDER[ORDER.index(package) + 1 :], "cli", "commands", "demo"}
    wrong = {str(f.relative_to(ROOT)): imported_packages(f) & later for f in (PACKAGE / package).rglob("*.py")}
    assert not {file: names for file, names in wrong.items() if names}


def test_a_wrong_import_would_be_seen() -> None:
    """Inside of a function too, but not below TYPE_CHECKING."""
    text = (
        "if TYPE_CHECKING:\n from vpptwin.train import a\ndef f():\n from vpptwin import cli\n import vpptwin.viz.page"
    )
    assert set(find_imports(ast.parse(text))) == {"vpptwin", "vpptwin.cli", "vpptwin.viz.page"}
