"""Decoding many messages at once gives what mcap-ros2-support gives one by one, for any definition."""

from __future__ import annotations

import struct
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from tests.logs.bags import (
    EPOCH,
    IMU,
    POSE,
    Bag,
    Message,
    make_imu,
    make_poses,
    refuse,
    stamp_header,
    write_payloads,
)  # fmt: skip
from vpptwin.logs import read_flight
from vpptwin.logs.channels import CHANNELS
from vpptwin.logs.formats import decode as decoding
from vpptwin.logs.formats.container import read_container
from vpptwin.logs.formats.decode import Batch, DecodeError, decode_channel
from vpptwin.logs.formats.layout import LayoutError, compose_message, locate_fields, parse_definition
from vpptwin.logs.formats.raw import Block, Query, RawChannel
from vpptwin.logs.messages import DEFINITIONS, compose_definition

RANGES = {"bool": (0, 1), "int8": (-128, 127), "uint8": (0, 255), "byte": (0, 255)}
RANGES |= {f"{'u' * u}int{b}": (-(2 ** (b - 1)) * (1 - u), 2 ** (b - 1 + u) - 1) for b in (16, 32, 64) for u in (0, 1)}
KINDS = st.sampled_from([*RANGES, "float32", "float64", "string"])
SIZES = st.sampled_from(["", "", "[3]", "[]", "[<=4]"])
Fields = list[tuple[str, str]]


@st.composite
def draw_definition(draw: st.DrawFn) -> tuple[Fields, Fields]:
    """Fields (type, name) of a message and of a message nested in it."""
    inner = [(draw(KINDS) + draw(SIZES), f"i{k}") for k in range(draw(st.integers(1, 3)))]
    outer = [(draw(KINDS | st.just("Inner")) + draw(SIZES), f"o{k}") for k in range(draw(st.integers(1, 5)))]
    return outer, inner


@st.composite
def draw_value(draw: st.DrawFn, kind: str, inner: Fields, lengths: dict[str, int], path: str = "") -> object:
    """A value of a field. Lengths are kept, so that all messages of a test share a shape."""
    base, bracket, size = kind.partition("[")
    if bracket:
        digits = size.rstrip("]")
        count = int(digits) if digits.isdigit() else lengths.setdefault(path, draw(st.integers(0, 3)))
        return [draw(draw_value(base, inner, lengths, f"{path}.{index}")) for index in range(count)]
    if base == "Inner":
        return {name: draw(draw_value(field, [], lengths, f"{path}.{name}")) for field, name in inner}
    if base == "string":
        return "x" * lengths.setdefault(path, draw(st.integers(0, 5)))
    if base.startswith("float"):
        return draw(st.floats(width=32 if base == "float32" else 64))
    return draw(st.integers(*RANGES[base]))


def write_text(fields: Fields) -> str:
    """Definition of some fields, with the comments and constants that real ones have."""
    return "# a comment\nuint8 LIMIT = 3\n\n" + "\n".join(f"{kind} {name}  # {name}" for kind, name in fields)


def read_channel(bag: Bag) -> RawChannel:
    """Write a bag of one channel and read it undecoded."""
    with tempfile.TemporaryDirectory() as folder:
        bag.path = Path(folder) / "bag.mcap"
        (channel,) = read_container(bag.write(), Query(lambda _: True)).channels
    return channel


def decode_one_by_one(channel: RawChannel, paths: list[str]) -> Iterator[Batch]:
    """Decode by mcap-ros2-support alone."""
    reference = decoding._ReferenceDecoder(channel)
    for block in channel.blocks:
        yield from reference.decode(block, paths, ())


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_definition_decodes_as_the_reference_does(data: st.DataObject) -> None:
    """Every number of every message of random definitions equals what mcap-ros2-support decodes, and in one pass."""
    outer, inner = data.draw(draw_definition())
    text = f"{write_text(outer)}\n{'=' * 80}\nMSG: test_msgs/Inner\n{write_text(inner)}\n"
    lengths: dict[str, int] = {}
    messages: list[Message] = [{name: data.draw(draw_value(kind, inner, lengths, name)) for kind, name in outer}
                               for _ in range(4)]  # fmt: skip
    channel = read_channel(Bag(Path()).add("/t", "test_msgs/msg/Outer", messages, text))
    definitions = parse_definition(channel.message_type, channel.definition)
    layout = locate_fields(definitions, channel.message_type, channel.blocks[0].payload[0].tobytes())
    assert layout.size == channel.blocks[0].payload.shape[1]  # every byte is accounted for
    paths = list(layout.leaves)
    (batch,) = decode_channel(channel, paths)
    for row, single in enumerate(decode_one_by_one(channel, paths)):
        for path in paths:
            assert np.array_equal(batch.values[path][row], single.values[path][0], equal_nan=True)


@pytest.mark.parametrize("name", [*DEFINITIONS])
def test_composed_messages_decode(name: str) -> None:
    """A message composed by the layout is one that mcap-ros2-support decodes, strings and sequences in place."""
    text = compose_definition(name)
    strings = {"header.frame_id": "abc", "name[0]": "left", "name[1]": ""}
    message, layout = compose_message(parse_definition(name, text), name, strings, {"name": 2, "effort": 2})
    decode = DecoderFactory().decoder_for("cdr", Schema(1, text.encode(), "ros2msg", name))
    assert decode is not None
    decoded = decode(bytes(message))
    assert layout.size == len(message)
    if name == "sensor_msgs/JointState":
        assert (decoded.header.frame_id, decoded.name, decoded.effort) == ("abc", ["left", ""], [0.0, 0.0])


@pytest.mark.parametrize("order", "<>")
def test_both_byte_orders_are_read(tmp_path: Path, order: str) -> None:
    """A pose in big-endian CDR, packed by hand, reads as the same pose in little-endian CDR."""
    payloads = []
    for k in range(5):
        # Encapsulation (1: little-endian), stamp, frame_id "map\0"; then the doubles, 16 bytes on and so aligned.
        stamp = struct.pack(f"{order}iII4s", 1_700_000_000, k * 10**7, 4, b"map\0")
        body = struct.pack(f"{order}7d", 0.5, 0.0, 1.0 + k, 0.0, -np.sin(0.1), 0.0, np.cos(0.1))
        payloads.append(struct.pack("BBBB", 0, order == "<", 0, 0) + stamp + body)
    write_payloads(tmp_path / "log.mcap", payloads)
    pose = read_flight(tmp_path / "log.mcap").streams["/mocap/pose"]
    assert pose.time.tolist() == [0.0, 0.01, 0.02, 0.03, 0.04]
    assert pose["z"].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert np.allclose(pose["theta"], 0.2, atol=1e-15)


@pytest.mark.parametrize(("shapes", "most"), [(13, None), (4, 2)])
def test_frames_of_different_length_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shapes: int, most: int | None
) -> None:
    """Messages whose frame_id moves everything behind it keep their order, also if decoded one by one, as too many."""
    if most is not None:
        monkeypatch.setattr(decoding, "MAX_SHAPES", most)
    messages = [make_imu(EPOCH + k * 10**6, rate=float(k)) for k in range(60)]
    for k, message in enumerate(messages):
        message["header"]["frame_id"] = "f" * (k % shapes)  # type: ignore[index]
    imu = read_flight(Bag(tmp_path / "log.mcap").add("/imu/data", IMU, messages).write()).streams["/imu/data"]
    assert imu["rate"].tolist() == [float(k) for k in range(60)]


def test_long_logs_are_decoded_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunk by chunk, so that memory does not grow twice: the values come out in order all the same."""
    path = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(200)).write(chunk_size=2000)
    whole = read_flight(path).streams["/mocap/pose"]
    monkeypatch.setattr(decoding, "MAX_MERGED", 3000)
    parts = read_flight(path).streams["/mocap/pose"]
    np.testing.assert_array_equal(parts.time, whole.time)
    np.testing.assert_array_equal(parts["x"], whole["x"])


def test_a_wrong_fast_decoder_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the fast path disagrees with mcap-ros2-support on the first or last message, the latter decodes them all."""
    true_decode = decoding._decode_same

    def shift(block: Block, *rest: object) -> Batch:
        batch = true_decode(block, *rest)  # type: ignore[arg-type]
        batch.values["angular_velocity.y"][-1] += 1e-9
        return batch

    monkeypatch.setattr(decoding, "_decode_same", shift)
    channel = read_channel(Bag(Path()).add("/imu/data", IMU, [make_imu(EPOCH + k, rate=float(k)) for k in range(9)]))
    batches = list(decode_channel(channel, ["angular_velocity.y"]))
    assert [-batch.values["angular_velocity.y"][0] for batch in batches] == [float(k) for k in range(9)]


@pytest.mark.parametrize("topic", CHANNELS)
def test_the_fast_path_is_taken(topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a whole channel of each type of ours only the first and the last message go through the slow decoder."""
    calls: Counter[str] = Counter()
    slow = decoding._ReferenceDecoder._decode_message

    def count(self: decoding._ReferenceDecoder, payload: bytes) -> object:
        calls["slow"] += 1
        return slow(self, payload)

    monkeypatch.setattr(decoding._ReferenceDecoder, "_decode_message", count)
    kind = CHANNELS[topic].message_type
    messages: list[Message] = [{"header": stamp_header(k * 10**9)} for k in range(50)]
    if kind == IMU:
        messages = [make_imu(k * 10**9) for k in range(50)]
    if kind.startswith("vpptwin_msgs"):
        pairs = {name: [0.0, 0.0] for name in ("blade_pitch", "throttle", "speed", "current")}
        messages = [message | pairs for message in messages]
    (batch,) = decode_channel(read_channel(Bag(Path()).add(topic, kind, messages)), ["header.stamp.sec"])
    assert batch.values["header.stamp.sec"].tolist() == list(range(50))
    assert calls["slow"] == 2


@pytest.mark.parametrize("payload", [b"", b"\0\1", b"\0\1\0\0" + b"\0" * 9])
def test_short_messages_are_refused(tmp_path: Path, payload: bytes) -> None:
    """A payload that ends before its fields do is refused with topic and type."""
    log = write_payloads(tmp_path / "log.mcap", [payload])
    refuse(log, f"/mocap/pose (geometry_msgs/msg/PoseStamped) has {len(payload)} bytes that do not decode")


def test_unknown_encapsulation_is_refused() -> None:
    """XCDR2, whose alignment differs, is refused rather than misread."""
    definitions = parse_definition("a/msg/B", "float64 x")
    with pytest.raises(LayoutError, match="not plain CDR"):
        locate_fields(definitions, "a/msg/B", b"\0\7\0\0" + b"\0" * 8)


def test_an_unknown_field_is_named() -> None:
    """Asking for a field that a message lacks says which it has."""
    channel = read_channel(Bag(Path()).add("/imu/data", IMU, [make_imu(EPOCH)]))
    with pytest.raises(DecodeError, match=r"no numeric field gyro, only header\.stamp\.sec"):
        list(decode_channel(channel, ["gyro"]))


def test_services_have_no_layout() -> None:
    """Definitions of services, with their ---, are not taken for messages."""
    with pytest.raises(LayoutError, match="---"):
        parse_definition("a/srv/B_Event", "int32 a\n---\nint32 b")
