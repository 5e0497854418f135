"""Chunks of MCAP files, whole files and messages unpacked within bounds: what says its own size is not believed."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk
from zstandard import ZstdDecompressor, ZstdError

from vpptwin.logs.formats.raw import refuse_damaged
from vpptwin.system.errors import InputError

MAX_RATIO = 100
"""By which a log unpacks at most: flights do by 8, a simulated craft that stands still without noise by 40."""
FREE = 1 << 25
"""What a file of any size may unpack to [bytes]."""
MAX_CHUNK = 1 << 28
"""Largest chunk unpacked [bytes]: recorders write chunks of 1 to 8 MB."""
ZSTD = b"\x28\xb5\x2f\xfd"
"""What zstd's frames begin with."""
_PIECE = 1 << 12  # bytes unpacked at once, which may become ten thousand times as many


@contextmanager
def unpack_file(path: Path) -> Iterator[Path]:
    """A file that zstd compressed as a whole, unpacked for a while."""
    most = MAX_RATIO * path.stat().st_size + FREE
    with TemporaryDirectory() as folder, path.open("rb") as packed:
        plain, size, frame = Path(folder) / path.stem, 0, ZstdDecompressor().decompressobj()
        try:
            with plain.open("wb") as file:
                while size <= most and (piece := packed.read(_PIECE)):
                    while piece:
                        frame = ZstdDecompressor().decompressobj() if frame.eof else frame
                        size += file.write(frame.decompress(piece))
                        piece = frame.unused_data
            if size <= most and not frame.eof:
                raise ZstdError("it ends early")
        except ZstdError as error:
            raise refuse_damaged(path, "zstd file", error) from None
        if size > most:
            found, expected = f"{path} unpacks to more than {most} bytes", f"at most {MAX_RATIO} times its length"
            raise InputError(found, expected, "if it is a log after all, decompress it with `zstd -d`")
        yield plain


def unpack_message(content: bytes) -> bytes:
    """A message, which zstd may have compressed: CDR begins otherwise.

    Raises:
        ValueError: if it unpacks to more than a log can honestly hold.
    """
    if not content.startswith(ZSTD):
        return content
    most = MAX_RATIO * len(content) + (FREE >> 10)
    data = ZstdDecompressor().stream_reader(content).read(most + 1)
    if len(data) > most:
        raise ValueError(f"a message of {len(content)} bytes unpacks to more than {most}")
    return data


class Unpacker:
    """Unpacks the chunks of one file, of so many bytes, and keeps count of what comes out."""

    def __init__(self, path: Path, size: int) -> None:
        self.path, self.size = path, size
        self.remaining = MAX_RATIO * size + FREE

    def unpack(self, chunk: Chunk) -> bytes:
        """The records of a chunk; no more is unpacked than it claims to hold.

        Raises:
            InputError: if it claims more than a log can honestly hold.
            ValueError: if it holds something else than it claims.
        """
        claimed = chunk.uncompressed_size
        self.remaining -= claimed
        if self.remaining < 0 or claimed > MAX_CHUNK:
            raise InputError(
                f"{self.path}, {self.size} bytes, holds a chunk of {len(chunk.data)} that unpacks to {claimed}",
                f"chunks of at most {MAX_CHUNK} bytes, and at most {MAX_RATIO} times the file's length in all",
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
