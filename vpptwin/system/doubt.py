"""What looks as if columns of a log were misread: refused, unless the user said that they are taken as they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from vpptwin.system.errors import InputError

AS_IS = "or say --as-is (Python: as_is=True) to go on as it is"
_overruled: ContextVar[dict[str, None] | None] = ContextVar("overruled", default=None)


@contextmanager
def take_as_is(as_is: bool = True) -> Iterator[None]:
    """Within the block `object_to` notes what it would refuse; without `as_is` the block changes nothing."""
    if not as_is or _overruled.get() is not None:
        yield
        return
    token = _overruled.set({})
    try:
        yield
    finally:
        _overruled.reset(token)


def object_to(error: InputError) -> None:
    """Refuse what looks misread, or note it where columns are taken as they are.

    Raises:
        InputError: the error, with `--as-is` named as a way to go on.
    """
    noted = _overruled.get()
    if noted is None:
        raise InputError(error.found, error.expected, f"{error.action}, {AS_IS}")
    noted.setdefault(f"{error.found}; expected {error.expected}; taken as it is")


def is_as_is() -> bool:
    """Whether columns are taken as they are."""
    return _overruled.get() is not None


def list_overruled() -> list[str]:
    """What was noted in the block so far."""
    return list(_overruled.get() or ())
