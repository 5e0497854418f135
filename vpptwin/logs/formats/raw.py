"""What a log holds before any topic is interpreted: its channels, with messages, rows of tables, or decoded numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from vpptwin.logs.parts import Span
from vpptwin.system.errors import InputError
from vpptwin.system.fields import Stamp
from vpptwin.system.progress import open_bar

LARGE = 1 << 27
"""What is held of a log at once where it is looked at as it comes [bytes]."""


@dataclass(frozen=True)
class Block:
    """Payloads of one length: record number in the file (n,), log time [ns] (n,), bytes (n, length)."""

    number: np.ndarray
    log_time: np.ndarray
    payload: np.ndarray


@dataclass(frozen=True)
class TableRows:
    """Rows of a table in the place of messages: number of the first, time [ns] (n,), field -> (n,) or (n, k)."""

    number: int
    time: np.ndarray
    columns: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Batch:
    """What is wanted of messages of one shape."""

    number: np.ndarray  # (n,) record numbers in the file
    log_time: np.ndarray  # (n,) ns
    values: dict[str, np.ndarray]  # path -> (n,) or (n, k)
    texts: dict[str, tuple[str, ...]]  # path of a string sequence -> its strings, the same in all messages of the batch


@dataclass
class RawChannel:
    """One channel of a file with its payloads, rows, or what was decoded of its payloads as they came.

    type and definition: of its schema; count: of messages seen.
    """

    topic: str
    message_type: str
    encoding: str
    schema_encoding: str
    definition: str
    count: int = 0
    blocks: list[Block] = field(default_factory=list)
    rows: list[TableRows] = field(default_factory=list)
    batches: list[Batch] = field(default_factory=list)

    @property
    def is_kept(self) -> bool:
        """Whether it holds messages, or rows."""
        return bool(self.blocks or self.rows or self.batches)

    def forget(self) -> None:
        """Hold nothing any more."""
        self.blocks, self.rows, self.batches = [], [], []


@dataclass(frozen=True)
class RawFile:
    """A file taken apart. profile: of its header; log_time: of its first and last message [ns]; notes: warnings."""

    path: Path
    profile: str
    channels: list[RawChannel]
    log_time: tuple[int, int]
    notes: list[str] = field(default_factory=list)


def extend_all(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Put numbers behind those held, in place, if all are of their kind: logs of gigabytes leave no room for both."""
    if any(held.dtype != new.dtype or held.shape[1:] != new.shape[1:] for held, new in pairs):
        return False
    for held, new in pairs:
        held.resize((len(held) + len(new), *held.shape[1:]), refcheck=False)
        held[-len(new) :] = new
    return True


Take = Callable[[Sequence[RawChannel]], None]
"""Looks at what the channels of a file hold so far, and may forget it."""


@dataclass(frozen=True)
class Query:
    """What of a log is wanted."""

    channel: Callable[[RawChannel], bool]  # tells whether a channel's messages are
    # topic -> the fields of a table that are enough; all of those that it leaves out
    fields: Mapping[str, Collection[str]] = field(default_factory=dict)
    stamps: Mapping[str, Stamp] = field(default_factory=dict)  # topic -> where its time lies, where somebody says
    take: Take | None = None  # what looks at a large log's channels as they fill
    span: Span | None = None  # which messages are wanted, None for all
    texts: bool = False  # whether columns of text are
    names: Mapping[str, str] = field(default_factory=dict)  # what a table is called -> what it is wanted as
    dropped: dict[str, list[str]] = field(default_factory=dict)  # topic -> columns that nobody wants; reading fills it


class HeldBytes:
    """Counts what channels hold [bytes], and lets it be looked at where that is much."""

    def __init__(self, take: Take | None) -> None:
        self.take, self.size = take, 0

    def add(self, size: int, channels: Collection[RawChannel]) -> None:
        """Channels have grown by so much."""
        self.size += size
        if self.take is not None and self.size > LARGE:
            self.take(list(channels))
            self.size = 0


def show_reading(path: Path, **options: object) -> tqdm:
    """A bar on standard error while a large file is read, with `options` of tqdm; of a small one none."""
    small = not path.is_file() or path.stat().st_size < LARGE
    return open_bar(desc=f"read {path.name}", disable=small, **options)


def refuse_damaged(path: Path, kind: str, error: Exception, advice: str = "copy it again") -> InputError:
    """What to say of a file of a kind that a library cannot read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(f"{path} is damaged ({reason})", f"a whole {kind}", advice)
