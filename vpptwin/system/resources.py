"""Files by name: those that ship with us, and those in ROS packages."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

from vpptwin.system.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1]
VARIABLE = "VPPTWIN_PACKAGES"
"""Environment variable with NAME=DIR of packages, separated as PATH is; processes that work for this one have it."""


def models_dir() -> Path:
    """Folder of the shipped models: inside the package when installed, at the top of a checkout otherwise."""
    return find_shipped("models", "models")


def flights_dir() -> Path:
    """Folder of the flights that `vpptwin demo` diagnoses, likewise."""
    return find_shipped("flights", "demo/flights")


def so101_dir() -> Path:
    """Folder of the twin, and in it of the `motions`, that `vpptwin demo so101` diagnoses, likewise."""
    return find_shipped("so101", "examples/so101")


def find_shipped(name: str, place: str) -> Path:
    """A folder inside the package when installed, at this place of a checkout otherwise."""
    installed = PACKAGE / name
    return installed if installed.is_dir() else PACKAGE.parent / place


def find_model_file(name: str, relative_to: Path | None = None) -> Path:
    """Resolve a file named in a twin YAML.

    Args:
        name: a path, relative to the file that names it, or the name of a shipped model file.
        relative_to: folder of the file that names it; None for the current folder.

    Returns:
        The existing file's absolute path; a file of the user's wins over a shipped one.

    Raises:
        InputError: if there is no such file.
    """
    candidates = [(relative_to or Path.cwd()) / name, models_dir() / name]
    for path in candidates:
        if path.is_file():
            return path.resolve()
    shipped = ", ".join(sorted(p.name for p in models_dir().glob("*.*")))
    expected = f"a file relative to {candidates[0].parent} or one of {shipped}"
    raise InputError(f"no file {name}", expected, "check the name")


def name_packages(given: Iterable[str]) -> None:
    """Note where packages are, for this process and those that it starts.

    Args:
        given: NAME=DIR each.

    Raises:
        InputError: if one is not that, or the folder is not there.
    """
    for text in given:
        name, _, folder = text.partition("=")
        if not name or not Path(folder or "?").is_dir():
            found = f"--package {text}" if not folder else f"--package {text}: no folder {folder}"
            raise InputError(found, "NAME=DIR, a ROS package and its folder", "correct it")
        before = [entry for entry in os.environ.get(VARIABLE, "").split(os.pathsep) if entry]
        os.environ[VARIABLE] = os.pathsep.join([f"{name}={Path(folder).resolve()}", *before])


def find_package(name: str, near: Path) -> Path | None:
    """The folder of a ROS package, None if there is none.

    It is what `name_packages` noted; or a folder of that name in ROS_PACKAGE_PATH, in the `share` of
    AMENT_PREFIX_PATH, or on the way up from a file; or one on that way whose `package.xml` says that name.

    Args:
        name: of the package.
        near: a file that names it.
    """
    if not name or name in (".", ".."):
        return None
    return next((folder for folder in list_places(name, near) if folder.is_dir()), None)


def list_places(name: str, near: Path) -> Iterator[Path]:
    """Where a package may be, the likeliest first."""
    for entry in split(VARIABLE):
        if entry.startswith(f"{name}="):
            yield Path(entry.removeprefix(f"{name}="))
    for entry in split("ROS_PACKAGE_PATH"):  # a package itself, or a folder of packages, or of folders of them
        if Path(entry).name == name:
            yield Path(entry)
        yield from chain([Path(entry, name)], Path(entry).glob(f"*/{name}"))
    for entry in split("AMENT_PREFIX_PATH"):
        yield Path(entry, "share", name)
    for folder in near.resolve().parents:
        if folder.name == name or says_name(folder / "package.xml", name):
            yield folder
        yield folder / name


def says_name(manifest: Path, name: str) -> bool:
    """Whether a package.xml is that of a package."""
    return manifest.is_file() and f"<name>{name}</name>" in manifest.read_text(errors="replace")


def split(variable: str) -> list[str]:
    """Entries of an environment variable that is written as PATH is."""
    return [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
