"""What a terminal shows of text of anyone's."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TextIO

from vpptwin.system.errors import escape_text

if TYPE_CHECKING:
    from rich.console import Console

OWN = re.compile(r"(\x1b\[(?:[0-3];?)+m|[\n\t])")
"""What passes as it is: ends of lines, and the bold and dim of rich."""
MOST = 12
"""Columns that are named."""


class Screen:
    """A text stream that shows control characters instead of obeying them, and what its encoding lacks as escapes.

    Attributes:
        midline: whether what was written last, such as a progress bar, waits for the end of its line.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.midline = False

    def write(self, text: str) -> int:
        """Write it; a carriage return leads what a progress bar draws."""
        lead = "\r" if text.startswith("\r") else ""
        rest = text.removeprefix(lead)
        if not rest.isprintable():
            rest = "".join(part if i % 2 else escape_text(part) for i, part in enumerate(OWN.split(rest)))
        encoding = self._stream.encoding or "utf-8"
        self.midline = not text.endswith(("\n", "\r")) if text else self.midline
        self._stream.write(lead + rest.encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Everything else is the stream's."""
        return getattr(self._stream, name)


@contextlib.contextmanager
def show_plainly() -> Iterator[None]:
    """Whatever is printed in the block goes through a `Screen`."""
    with contextlib.redirect_stdout(Screen(sys.stdout)), contextlib.redirect_stderr(Screen(sys.stderr)):
        yield


def print_warnings(warnings: Iterable[str]) -> None:
    """Say each once, on standard error."""
    for warning in dict.fromkeys(warnings):
        print(f"warning: {warning}", file=sys.stderr)


def print_dropped(dropped: Mapping[str, Sequence[str]]) -> None:
    """Say which columns of each log nothing reads, on standard error."""
    for name, columns in dropped.items():
        more = f" and {len(columns) - MOST} more" if len(columns) > MOST else ""
        if columns:
            print(f"note: {name}: columns that no signal names are dropped: {', '.join(columns[:MOST])}{more}",
                  file=sys.stderr)  # fmt: skip


def open_console(width: int | None = None) -> Console:
    """Rich's console for text of anyone's: brackets are no markup, colons no emoji."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False, width=width)
