"""What is held of a large log while it is read: the numbers that are wanted, no more than there is room for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vpptwin.logs.channels import JOINT_COLUMNS, is_joint_state, is_spatial
from vpptwin.logs.formats.decode import DecodeError, decode_channel
from vpptwin.logs.formats.raw import Batch, RawChannel, extend_all
from vpptwin.logs.formats.tables import find_field
from vpptwin.logs.recording import refuse_messages
from vpptwin.logs.streams.convert import list_fields
from vpptwin.logs.streams.samples import list_stamp_fields, list_vectors
from vpptwin.logs.topic_map import TopicMap, slash
from vpptwin.system.errors import InputError
from vpptwin.system.fields import Stamp

MAX_BYTES = 1e9
"""What the numbers of one flight may take [bytes], with `SAMPLE_BYTES`."""
SAMPLE_BYTES = 16
"""What every sample takes beside its numbers: times in s, and whatever is made of a column for a moment [bytes]."""


class Condenser:
    """Takes numbers out of a large log's messages as they come, which are forgotten."""

    def __init__(self, path: str, topics: TopicMap) -> None:
        self.path, self.topics = path, topics
        self.held: dict[int, tuple[float, float]] = {}

    def __call__(self, channels: Sequence[RawChannel]) -> None:
        """Decode what channels hold."""
        for channel in channels:
            if channel.blocks:
                paths, texts = list_wanted(self.topics, channel)
                fresh = RawChannel(**{**vars(channel), "batches": []})
                try:
                    for new in decode_channel(fresh, paths, texts):
                        for held in channel.batches:
                            pairs = [(held.number, new.number), (held.log_time, new.log_time)]
                            pairs += [(held.values[path], values) for path, values in new.values.items()]
                            if held.texts == new.texts and extend_all(pairs):
                                break
                        else:
                            values = {path: np.array(data) for path, data in new.values.items()}
                            fields = np.array(new.number), np.array(new.log_time), values, new.texts
                            channel.batches.append(Batch(*fields))
                except DecodeError as error:
                    raise refuse_messages(self.path, channel, paths, error) from None
                channel.blocks = []
            self.held[id(channel)] = measure(channel)
        needed, seconds = (max(values) if i else sum(values) for i, values in enumerate(zip(*self.held.values())))
        if needed > MAX_BYTES:
            raise InputError(
                f"{self.path}: the needed numbers of {seconds:.0f} s take {needed / 1e9:.1f} GB",
                f"at most {MAX_BYTES / 1e9:.1f} GB a log",
                f"give a stretch of it, such as {self.path}@0-{0.5 * seconds:.0f} (seconds)",
            )


def measure(channel: RawChannel) -> tuple[float, float]:
    """What is needed for what a channel holds [bytes], and the time that it covers [s]."""
    stamped = [(rows.time, rows.columns) for rows in channel.rows]
    stamped += [(b.log_time.view(np.int64), {"": b.number, **b.values}) for b in channel.batches]
    if not stamped:
        return 0.0, 0.0
    size = sum(t.nbytes + SAMPLE_BYTES * len(t) + sum(data.nbytes for data in held.values()) for t, held in stamped)
    return float(size), float(max(t[-1] for t, _ in stamped) - min(t[0] for t, _ in stamped)) / 1e9


def list_wanted(topics: TopicMap, channel: RawChannel) -> tuple[list[str], tuple[str, ...]]:
    """The numbers, and the lists of names, that a flight takes of a channel's messages."""
    paths: dict[str, None] = {}
    texts: tuple[str, ...] = ()
    if is_joint_state(channel.message_type):
        texts, paths = ("name",), dict.fromkeys([*list_stamp_fields(Stamp()), *JOINT_COLUMNS])
    elif is_spatial(channel.message_type):
        vectors = list_vectors(channel.message_type).values()
        paths = dict.fromkeys([*list_stamp_fields(Stamp()), *(path for vector in vectors for path in vector)])
    for route in topics.list_routes():
        if slash(route.topic) == slash(channel.topic):
            sources = route.list_sources(channel.message_type)
            named = [*list_stamp_fields(route.stamp), *(path for source in sources for path in list_fields(source))]
            paths |= dict.fromkeys(find_field(channel, path) for path in named)
    return list(paths), texts
