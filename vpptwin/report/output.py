"""The folder of results: all files of a run appear together, or the old ones stay as they were."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from vpptwin.system.errors import InputError, describe_failure
from vpptwin.system.files import STDOUT, check_own, replace_files, without_nan, write_json

Found = TypeVar("Found")


@dataclass(frozen=True)
class Pieces:
    """Parts of results that can be missing: one that fails costs only itself.

    Attributes:
        lost: what could not be made and why, one line each.
    """

    lost: list[str] = field(default_factory=list)

    def attempt(self, what: str, work: Callable[[], Found], otherwise: Found) -> Found:
        """What `work` makes; `otherwise` where it fails, which is noted."""
        try:
            return work()
        except Exception as error:  # whatever it is: what is whole must not be lost for it
            self.lost.append(f"{what} could not be made: {describe_failure(error)}")
            return otherwise


@contextmanager
def stage_results(
    out: Path, names: Collection[str], stale: Collection[str] = (), force: bool = False
) -> Iterator[Path]:
    """A hidden folder to write results into, as `vpptwin.system.files.replace_files` has it.

    Raises:
        InputError: if `out` cannot be written to, or a result's name is taken by a folder, or, without `force`, by a
            file that is not ours.
    """
    if not force:
        check_own(out / name for name in names)
    with ExitStack() as opened:
        try:
            drafts = opened.enter_context(replace_files(out, names, stale))
        except OSError as error:
            found = f"cannot write to {out} ({error.strerror or error})"
            if error.filename and Path(error.filename).parent == out:
                found = f"{error.filename} {error.strerror}"
            raise InputError(found, "a folder to write to", "choose another --out") from error
        yield drafts


def give_json(content: object, target: Path) -> None:
    """Write a --json, to a file or, for `-`, to standard output."""
    if target == STDOUT:
        json.dump(without_nan(content), sys.stdout, indent=2)
        print()
    else:
        write_json(content, target)
