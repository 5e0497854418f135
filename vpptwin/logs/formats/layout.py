"""Where each field of a CDR message lies, derived from its ros2msg definition."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from vpptwin.logs.messages import shorten_type

CODES = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
HEADER_BYTES = 4
BIG_ENDIAN, LITTLE_ENDIAN = 0, 1
STAMP = "header.stamp"
"""Of rows: a field of whole ns."""


class LayoutError(ValueError):
    """A definition or a message that this decoder does not understand."""


@dataclass(frozen=True)
class Field:
    """One line of a definition. size: None for a single value, 0 for a sequence, k for an array of k values."""

    name: str
    base: str
    size: int | None


@dataclass(frozen=True)
class Leaf:
    """A primitive in a message: byte offset from the start of the payload, numpy type code, count (None: scalar)."""

    offset: int
    code: str
    count: int | None


@dataclass
class MessageLayout:
    """Fields of one message. counters: byte offsets of the lengths that shape it; size: bytes in all."""

    leaves: dict[str, Leaf] = field(default_factory=dict)
    strings: dict[str, tuple[int, int]] = field(default_factory=dict)
    counters: list[int] = field(default_factory=list)
    size: int = HEADER_BYTES


Definitions = Mapping[str, tuple[Field, ...]]
LengthOf = Callable[[str, int, bool], int]


@lru_cache(64)
def parse_definition(name: str, text: str) -> Definitions:
    """Fields of a message and of everything it is made of.

    Args:
        name: message type of the first section.
        text: ros2msg definition, dependencies behind lines of `=`.

    Returns:
        Short type name -> its fields in order.

    Raises:
        LayoutError: if a line is not understood, as in definitions of services.
    """
    definitions: dict[str, tuple[Field, ...]] = {}
    for section in re.split(r"^={3,}\s*$", text, flags=re.MULTILINE):
        lines = section.strip().splitlines()
        if lines and lines[0].startswith("MSG:"):
            name, lines = lines[0].removeprefix("MSG:").strip(), lines[1:]
        package = name.split("/")[0]
        fields = []
        for line in (line.split("#")[0].strip() for line in lines):
            base, _, rest = line.partition(" ")
            if not base or "=" in rest:  # blank, or a constant
                continue
            match = re.fullmatch(r"([\w/]+)(?:<=\d+)?(?:\[(<=)?(\d*)\])?", base)
            if not match or not rest.split():
                raise LayoutError(f"line '{line}'")
            kind, bounded, digits = match.groups()
            if kind not in CODES and kind not in ("string", "wstring"):
                kind = shorten_type(kind) if "/" in kind else f"{package}/{kind}"
            size = (0 if bounded or not digits else int(digits)) if base.endswith("]") else None
            fields.append(Field(rest.split()[0], kind, size))
        definitions[shorten_type(name)] = tuple(fields)
    time = (Field("sec", "int32", None), Field("nanosec", "uint32", None))
    return {"builtin_interfaces/Time": time, "builtin_interfaces/Duration": time} | definitions


def arrange_fields(definitions: Definitions, name: str, length_of: LengthOf) -> MessageLayout:
    """Offsets of all fields of a message by the alignment rules of CDR (relative to the byte behind its header).

    length_of: (path, byte offset of the counter, is it a string) -> number of elements, or of bytes of the string.
    """
    layout = MessageLayout()

    def count(path: str, of_string: bool) -> int:
        layout.size = _align(layout.size, 4)
        layout.counters.append(layout.size)
        number = length_of(path, layout.size, of_string)
        layout.size += 4
        return number

    def place(path: str, base: str, number: int | None) -> None:
        code = CODES[base]
        width = int(code[1])
        if number != 0:  # an empty sequence is not aligned
            layout.size = _align(layout.size, width)
        layout.leaves[path] = Leaf(layout.size, code, number)
        layout.size += width * (1 if number is None else number)

    def visit(path: str, base: str) -> None:
        if base == "string":
            length = count(path, True)
            layout.strings[path] = (layout.size, length)
            layout.size += length
        elif base in CODES:
            place(path, base, None)
        elif base not in definitions:
            raise LayoutError(f"no definition of {base}")
        else:
            layout.size += not definitions[base]  # an empty message takes one byte
            for item in definitions[base]:
                enter(f"{path}.{item.name}" if path else item.name, item)

    def enter(path: str, item: Field) -> None:
        if item.size is None:
            visit(path, item.base)
            return
        number = item.size or count(path, False)
        if item.base in CODES:
            place(path, item.base, number)
            return
        for index in range(number):
            visit(f"{path}[{index}]", item.base)

    visit("", shorten_type(name))
    return layout


def locate_fields(definitions: Definitions, name: str, payload: bytes) -> MessageLayout:
    """Layout of one recorded message.

    Raises:
        LayoutError: if the payload is too short for its type, or not plain CDR.
    """
    if len(payload) < HEADER_BYTES or payload[0] != 0 or payload[1] not in (BIG_ENDIAN, LITTLE_ENDIAN):
        raise LayoutError(f"not plain CDR, starting with bytes {payload[:HEADER_BYTES].hex(' ')}")
    counter = struct.Struct("<I" if payload[1] == LITTLE_ENDIAN else ">I")

    def read_length(path: str, offset: int, of_string: bool) -> int:
        if offset + 4 > len(payload):
            raise LayoutError(f"{len(payload)} bytes, which end before {path}")
        number = int(counter.unpack_from(payload, offset)[0])
        if offset + 4 + number > len(payload):
            raise LayoutError(f"{len(payload)} bytes, but {path} alone would hold {number} elements")
        return number

    layout = arrange_fields(definitions, name, read_length)
    if layout.size > len(payload):
        raise LayoutError(f"{len(payload)} bytes where its fields take {layout.size}")
    return layout


def describe_columns(columns: Mapping[str, np.ndarray]) -> MessageLayout:
    """Layout of rows of a table that has these columns, (n,) or (n, k); what is text has no leaf."""
    layout = MessageLayout({STAMP: Leaf(0, "i8", None)})
    for name, data in columns.items():
        if data.dtype.kind in "biuf":
            code = "u1" if data.dtype == bool else data.dtype.str[1:]
            layout.leaves[name] = Leaf(0, code, data.shape[1] if data.ndim > 1 else None)
    return layout


def compose_message(
    definitions: Definitions, name: str, strings: Mapping[str, str], lengths: Mapping[str, int]
) -> tuple[bytearray, MessageLayout]:
    """Build a little-endian message, all zeros but for its strings, with the layout to fill it in.

    strings: path -> text; lengths: path -> number of elements of a sequence; what is not named is empty.
    """
    counters: dict[int, int] = {}

    def choose_length(path: str, offset: int, of_string: bool) -> int:
        counters[offset] = len(strings.get(path, "").encode()) + 1 if of_string else lengths.get(path, 0)
        return counters[offset]

    layout = arrange_fields(definitions, name, choose_length)
    message = bytearray(layout.size)
    message[1] = LITTLE_ENDIAN
    for offset, number in counters.items():
        struct.pack_into("<I", message, offset, number)
    for path, (offset, length) in layout.strings.items():
        message[offset : offset + length] = strings.get(path, "").encode() + b"\0"
    return message, layout


def _align(offset: int, width: int) -> int:
    """The next multiple of `width` bytes behind the header: CDR, OMG DDS-RTPS 2.5, section 10."""
    return HEADER_BYTES + -(-(offset - HEADER_BYTES) // width) * width
