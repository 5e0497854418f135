"""docs/fly.md: its table is the library, its commands are ones that the command line takes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from vpptwin.cli.main import build_parser
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import find_manoeuvre, parse_settings

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "fly.md").read_text(encoding="utf-8")


def test_the_table_is_the_library() -> None:
    """One row a manoeuvre, in the library's order."""
    rows = [f"| {m.name} | {m.summary} | {', '.join(m.reveals)} |" for m in LIBRARY]
    assert "\n".join(rows) in PAGE


def test_commands_are_understood() -> None:
    """Every command of the page parses; manoeuvres and settings that it names exist."""
    commands = re.findall(r"^ +vpptwin (.*?)(?:  +#.*)?$", PAGE, flags=re.MULTILINE)
    assert len(commands) >= 5
    for command in commands:
        options = build_parser().parse_args(shlex.split(command))
        if getattr(options, "manoeuvre", None):
            find_manoeuvre(LIBRARY, options.manoeuvre).choose(parse_settings(options.set))
