"""Imports run one way through packages, rooms and files, as docs/architecture.md says."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from pkgutil import resolve_name

import pytest

from vpptwin.robots.planar_drone.craft import PlanarDrone

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "vpptwin"
ORDER = (
    "system", "effects", "engine", "robots.planar_drone.vehicle", "robots.planar_drone.effects", "actuators",
    "engine.trace", "twin.robot", "robots.planar_drone.craft", "twin", "logs", "estimation", "mapping",
    "robots.planar_drone", "viz", "inference", "diagnosis", "robots.planar_drone.experiment", "report",
    "robots.planar_drone.report", "robots.planar_drone.display", "drift", "robots.planar_drone.thrust_stand", "train",
    "deploy", "cli",
)  # fmt: skip
"""Each room imports only from those before it. The longest name that fits a file is its room."""
ROOMS = ("evidence", "search", "judgement")
"""The rooms of diagnosis: likewise."""
MOST_FILES = 15
"""More than that in one folder, and nobody finds anything."""


@cache
def parse(file: Path) -> ast.Module:
    """A file's code."""
    return ast.parse(file.read_text())


@cache
def list_imports(file: Path) -> frozenset[str]:
    """What `find_imports` finds in a file."""
    return frozenset(find_imports(parse(file)))


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


def find_room(module: str) -> str | None:
    """The entry of `ORDER` that a module of vpptwin belongs to; None for what lies at the top."""
    fits = [room for room in ORDER if f"{module}.".startswith(f"vpptwin.{room}.")]
    return max(fits, key=len, default=None)


def test_every_room_has_its_place() -> None:
    """No folder is left out, and the page names them in this order."""
    rooms = {find_room(name_module(file)) for file in PACKAGE.glob("*/*.py") if file.parent.name != "robots"}
    assert None not in rooms
    (line,) = re.findall(r"\*\*Imports run one way\*\*: (.*)\.\n", (ROOT / "docs/architecture.md").read_text())
    assert tuple(line.replace(",", " →").replace(" →", "").split()) == ORDER


def test_no_room_is_crowded() -> None:
    """Some fifteen files are what a reader can overlook."""
    count = {folder: len(list(folder.glob("[!_]*.py"))) for folder in PACKAGE.rglob("*") if folder.is_dir()}
    assert not {folder.name: number for folder, number in count.items() if number > MOST_FILES}


def test_rooms_of_diagnosis_run_one_way() -> None:
    """From what flights say to what is told: no room imports from one that comes after it."""
    assert {folder.parent.name for folder in (PACKAGE / "diagnosis").glob("*/__init__.py")} == set(ROOMS)
    wrong = []
    for i, room in enumerate(ROOMS):
        later = tuple(f"vpptwin.diagnosis.{name}" for name in ROOMS[i + 1 :])
        for file in (PACKAGE / "diagnosis" / room).rglob("*.py"):
            wrong += [f"{file.name}: {m}" for m in list_imports(file) if m.startswith(later)]
    assert not wrong


def test_criteria_lie_below_the_rooms() -> None:
    """All rooms read them, so that they import nothing of ours."""
    assert not [module for module in list_imports(PACKAGE / "diagnosis/criteria.py") if module.startswith("vpptwin")]


def test_no_files_import_each_other() -> None:
    """Not in circles of any length, nor inside of functions: the files can be read in one order."""
    files = {name_module(file): file for file in PACKAGE.rglob("*.py")}
    graph = {name: imported_files(file, files) - {name} for name, file in files.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(files)


def imported_files(file: Path, files: Collection[str]) -> set[str]:
    """Dotted names of the files that one imports; a package only for what is in it itself."""
    found = {name for name in list_imports(file) if name in files}
    return {name for name in found if not any(other.startswith(f"{name}.") for other in found)}


def name_module(file: Path) -> str:
    """The dotted name that a file is imported by."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("room", ORDER)
def test_imports_run_one_way(room: str) -> None:
    """A room imports nothing from one that comes after it."""
    files = {name_module(file): file for file in PACKAGE.rglob("*.py")}
    inside = {name: file for name, file in files.items() if find_room(name) == room}
    later = ORDER[ORDER.index(room) + 1 :]
    wrong = {name: {m for m in imported_files(file, files) if find_room(m) in later} for name, file in inside.items()}
    assert inside
    assert not {name: modules for name, modules in wrong.items() if modules}


def test_what_is_imported_is_there() -> None:
    """No module that has moved: a type checker that lets others' be missing lets ours be too."""
    files = [file for folder in ("vpptwin", "proving", "tests") for file in (ROOT / folder).rglob("*.py")]
    nodes = [node for file in files for node in ast.walk(parse(file))]
    wanted = {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    ours = {module for module in wanted if module.startswith(("vpptwin.", "proving.", "tests."))}
    assert ours - {name_module(file) for file in files} == set()


def test_a_wrong_import_would_be_seen() -> None:
    """Inside of a function too, but not below TYPE_CHECKING."""
    text = (
        "if TYPE_CHECKING:\n from vpptwin.train import a\n"
        "def f():\n from vpptwin.cli import main\n import vpptwin.viz.pages"
    )
    assert set(find_imports(ast.parse(text))) == {"vpptwin.cli", "vpptwin.cli.main", "vpptwin.viz.pages"}


def test_hooks_of_the_drone_lead_somewhere() -> None:
    """Each has the name of a function that asks robots, and names a function of the drone's room."""
    text = "\n".join(file.read_text() for file in PACKAGE.rglob("*.py"))
    asking = set(re.findall(r"@by_robot\ndef (\w+)\(", text))
    assert set(PlanarDrone.hooks) == asking
    for place in PlanarDrone.hooks.values():
        assert place.startswith("vpptwin.robots.planar_drone.")
        assert callable(resolve_name(place))
