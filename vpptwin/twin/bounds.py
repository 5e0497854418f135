"""How large a model may be: MJCF of anyone's is compiled within so much memory, as it may ask for any amount."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from html.parser import HTMLParser
from pathlib import Path

import mujoco

from vpptwin.errors import InputError

MOST_BYTES = 1 << 30
"""Memory that compiling a model may take [bytes]."""
MOST_DATA = 1 << 28
"""What one simulation of it may take [bytes]."""
MOST_COPIES = 100_000
"""How often `replicate` and `composite` may repeat an element."""
MOST_CELLS = 4_000_000
SIDES = (("nrow", "ncol"), ("width", "height"))
"""Cells of a height field or texture: they are counted before MuJoCo allocates, which it does not survive unharmed."""


@contextmanager
def bound_memory() -> Iterator[None]:
    """Let this process grow by `MOST_BYTES` at most; beyond, what asks for memory fails. Nothing where it can't be."""
    try:
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([used + MOST_BYTES, *limits]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def check_claims(path: Path) -> None:
    """Refuse an MJCF that repeats an element, or spans a grid, so often that MuJoCo would not come back.

    Files that it includes too, each once, as MuJoCo has it.

    Raises:
        InputError: naming the element.
    """
    read, waiting = set[Path](), [(path, 1.0)]
    while waiting:
        file, times = waiting.pop()
        if not file.is_file() or file.resolve() in read:
            continue
        read.add(file.resolve())
        claims = Claims(times)
        with suppress(OSError):  # MuJoCo says what is wrong
            claims.feed(file.read_bytes().decode("iso-8859-1"))
        for tag, given, times in claims.found:
            for most, number in ((MOST_COPIES, times), *((MOST_CELLS, multiply(given, *sides)) for sides in SIDES)):
                if number > most:
                    named = " ".join(f"{name}={value!r}" for name, value in given.items() if value[:1].isdecimal())
                    raise InputError(f"{path}: <{tag} {named}>", f"at most {most} of anything", "lower it")
            if tag == "include":
                waiting.append((path.parent / given.get("file", ""), times))


class Claims(HTMLParser):
    """Elements of an MJCF with their attributes, and how many of each there will be.

    MuJoCo reads what no parser of XML would, so that one of HTML does, which refuses nothing either.

    Args:
        times: how often the file is included.
    """

    def __init__(self, times: float) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str], float]] = []
        self._times = [times]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An element whose children follow."""
        self.handle_startendtag(tag, attrs)
        self._times.append(self.found[-1][2])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An element without children."""
        given = {name: value or "" for name, value in attrs}
        self.found.append((tag, given, self._times[-1] * multiply(given, "count")))

    def handle_endtag(self, tag: str) -> None:
        """The children of the last element end."""
        if len(self._times) > 1:
            self._times.pop()


def multiply(given: Mapping[str, str], *names: str) -> float:
    """Product of all whole numbers in some attributes; 1 where there are none."""
    words = [word for name in names for word in given.get(name, "").split()]
    return math.prod(float(word) for word in words if word.isdecimal())


def check_size(model: mujoco.MjModel, path: Path) -> None:
    """Refuse a model whose simulations take more than `MOST_DATA` each.

    Raises:
        InputError: with what one takes.
    """
    size = mujoco.mj_sizeModel(model) + int(model.narena)
    if size > MOST_DATA:
        found = f"{path}: a model of {size / 1e6:.0f} MB with what it asks for in <size>"
        raise InputError(found, f"at most {MOST_DATA / 1e6:.0f} MB", "leave out meshes and height fields, lower <size>")
