"""Chunks of MCAP files unpacked within bounds: what a file claims about its own size is not believed."""

from __future__ import annotations

import zlib
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk
from zstandard import ZstdDecompressor

from vpptwin.errors import InputError

MOST_RATIO = 100
"""By which a log unpacks at most: flights do by 8, a simulated craft that stands still without noise by 40."""
FREE = 1 << 25
"""What a file of any size may unpack to [bytes]."""
MOST_CHUNK = 1 << 28
"""Largest chunk unpacked [bytes]: recorders write chunks of 1 to 8 MB."""


class Unpacker:
    """Unpacks the chunks of one file, of so many bytes, and keeps count of what comes out."""

    def __init__(self, path: Path, size: int) -> None:
        self.path, self.size = path, size
        self.left = MOST_RATIO * size + FREE

    def unpack(self, chunk: Chunk) -> bytes:
        """The records of a chunk; no more is unpacked than it claims to hold.

        Raises:
            InputError: if it claims more than a log can honestly hold.
            ValueError: if it holds something else than it claims.
        """
        claimed = chunk.uncompressed_size
        self.left -= claimed
        if self.left < 0 or claimed > MOST_CHUNK:
            raise InputError(
                f"{self.path}, {self.size} bytes, holds a chunk of {len(chunk.data)} that unpacks to {claimed}",
                f"chunks of at most {MOST_CHUNK} bytes, and at most {MOST_RATIO} times the file's length in all",
                "if it is a log after all, write the topics needed anew with `mcap filter`",
            )
        if chunk.compression == "zstd":
            data = ZstdDecompressor().stream_reader(chunk.data).read(claimed + 1)
        elif chunk.compression == "lz4":
            data = LZ4FrameDecompressor().decompress(chunk.data, max_length=claimed + 1)
        else:
            data = chunk.data
        if len(data) != claimed or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError("content other than it claims")
        return data
