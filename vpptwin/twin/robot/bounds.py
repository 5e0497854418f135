"""How large a model may be: MJCF of anyone's is compiled within so much memory, as it may ask for any amount."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco

from vpptwin.system.errors import InputError
from vpptwin.twin.robot.parts import Element, multiply

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


def check_claims(path: Path, elements: Iterable[Element]) -> None:
    """Refuse an MJCF that repeats an element, or spans a grid, so often that MuJoCo would not come back.

    Raises:
        InputError: naming the element.
    """
    for _, tag, given, times in elements:
        for most, number in ((MOST_COPIES, times), *((MOST_CELLS, multiply(given, *sides)) for sides in SIDES)):
            if number > most:
                named = " ".join(f"{name}={value!r}" for name, value in given.items() if value[:1].isdecimal())
                raise InputError(f"{path}: <{tag} {named}>", f"at most {most} of anything", "lower it")


def check_size(model: mujoco.MjModel, path: Path) -> None:
    """Refuse a model whose simulations take more than `MOST_DATA` each.

    Raises:
        InputError: with what one takes.
    """
    size = mujoco.mj_sizeModel(model) + int(model.narena)
    if size > MOST_DATA:
        found = f"{path}: a model of {size / 1e6:.0f} MB with what it asks for in <size>"
        raise InputError(found, f"at most {MOST_DATA / 1e6:.0f} MB", "leave out meshes and height fields, lower <size>")
