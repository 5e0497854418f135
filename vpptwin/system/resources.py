"""Files that ship with the package: MJCF models, the nominal vehicle, flights."""

from __future__ import annotations

from pathlib import Path

from vpptwin.system.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1]


def models_dir() -> Path:
    """Folder of the shipped models: inside the package when installed, at the top of a checkout otherwise."""
    installed = PACKAGE / "models"
    return installed if installed.is_dir() else PACKAGE.parent / "models"


def flights_dir() -> Path:
    """Folder of the flights that `vpptwin demo` diagnoses, likewise."""
    installed = PACKAGE / "flights"
    return installed if installed.is_dir() else PACKAGE.parent / "demo" / "flights"


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
