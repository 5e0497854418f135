"""Logs, twins, models and checkpoints as an accident or an enemy leaves them, drawn from a seed; nothing of vpptwin."""

from __future__ import annotations

import copy
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[1]
MODELS = ROOT / "models"
Draw = Callable[[np.random.Generator, Path], Path]
"""Writes a file into a folder and names it."""

WORDS: tuple[object, ...] = (
    None, True, -1, 0, 10**7, 10**400, 1e-300, 1e308, float("nan"), float("inf"), "", "nan", "\x1b[31mred",
    "${oc.env:HOME}",
    "<script>alert(1)</script>", "../../../etc/passwd", "/dev/zero", [], {}, [[]], {"a": {"b": None}}, "x" * 5000,
)  # fmt: skip
"""Values that belong nowhere."""


def spoil_bytes(rng: np.random.Generator, data: bytes) -> bytes:
    """Bytes cut, flipped, zeroed, repeated or swapped in a place or two."""
    content = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        begin, size = int(rng.integers(len(content))), int(rng.integers(1, 400))
        kind = rng.integers(6)
        if kind == 0:
            content[begin] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            content[begin : begin + 8] = rng.bytes(8)
        elif kind == 2:
            content[begin : begin + size] = bytes(len(content[begin : begin + size]))
        elif kind == 3:
            content[begin:begin] = content[begin : begin + size]
        elif kind == 4:
            content[begin : begin + 8] = b"\xff" * 8
        else:
            del content[max(begin, 16) :]
    return bytes(content)


def spoil_plain(rng: np.random.Generator, data: Any) -> Any:  # noqa: ANN401
    """Plain data with a key or two lost, renamed, of another type or far too large or deep."""
    content = copy.deepcopy(data)
    for _ in range(rng.integers(1, 3)):
        node: Any = content
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = keys[rng.integers(len(keys))]
            if isinstance(node[key], (dict, list)) and len(node[key]) and rng.random() < 0.75:
                node = node[key]
                continue
            kind = rng.integers(5)
            if kind == 0 and isinstance(node, dict):
                del node[key]
            elif kind == 1 and isinstance(node, dict):
                node[f"{key}_"] = node.pop(key)
            elif kind == 2:
                deep: list[Any] = []
                for _ in range(3000):
                    deep = [deep]
                node[key] = deep
            else:
                node[key] = copy.deepcopy(WORDS[rng.integers(len(WORDS))])
            break
    return content


def draw_log(rng: np.random.Generator, folder: Path) -> Path:
    """A flight that ships, spoilt."""
    path = folder / f"fuzz_{rng.integers(1 << 30)}.mcap"
    path.write_bytes(spoil_bytes(rng, (ROOT / "demo" / "flights" / "flip.mcap").read_bytes()))
    return path


TWIN = """\
model: rail_rig.xml
vehicle: vehicle.yaml
effects: &all
  rail_x.coulomb: {force: 0.30}
  servo.lag: {time_constant: 0.028}
controller: map
provenance: {command: vpptwin diagnose, intervals_90_percent: {rail_x.coulomb.force: [0.2, 0.4]}}
"""
LINES = (
    "signals: {joints: {slide: /joint_states}}", "effects_from: [own.py]", "effects: *all", "a: &a [*a]",
    "controller: adaptive",
    "effects: " + "[" * 4000, "x: " + "9" * 6000, "t: 2001-99-99", "? [1, 2]\n: 3", "<<: *all",
    "!!python/object/apply:os.abort []",
    "model: /dev/zero", "actuator: /dev/null", "vehicle: spoilt.yaml", "model: spoilt.xml",
    "signals:\n  bodies: {b: /b}",
    "a: &b0 [x, x]\n" + "\n".join(f"b{i}: &b{i} [{', '.join(9 * [f'*b{i - 1}'])}]" for i in range(1, 12)),
)  # fmt: skip
"""Lines that a twin YAML gets, some of which it takes."""


def spoil_text(rng: np.random.Generator, text: str) -> str:
    """Text with a number replaced, lines lost or repeated, or bytes spoilt."""
    kind = rng.integers(4)
    numbers = list(re.finditer(r"-?\d+(\.\d+)?", text))
    if not numbers:  # spoilt before, down to nothing
        return text
    if kind == 0:
        found = numbers[rng.integers(len(numbers))]
        word = ("-1", "0", "1e300", "nan", "1e-300", "100000", "10000000", "inf", "")[rng.integers(9)]
        return text[: found.start()] + word + text[found.end() :]
    lines = text.splitlines(keepends=True)
    at = int(rng.integers(len(lines)))
    if kind == 1:
        return "".join(lines[:at] + lines[at + 1 :])
    if kind == 2:
        return "".join(lines[: at + 1] + lines[at:])
    return spoil_bytes(rng, text.encode()).decode("utf-8", "replace")


def draw_twin(rng: np.random.Generator, folder: Path) -> Path:
    """A twin YAML, spoilt, with a spoilt vehicle and a spoilt model at hand."""
    (folder / "own.py").write_text("raise SystemExit('this ran')\n")
    (folder / "spoilt.yaml").write_text(spoil_text(rng, (MODELS / "vehicle.yaml").read_text()))
    draw_model(rng, folder)
    text = TWIN
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(4)
        if kind == 0:
            text = spoil_text(rng, text)
        elif kind == 1:
            text += LINES[rng.integers(len(LINES))] + "\n"
        else:
            text = text.replace(*(("vehicle.yaml", "spoilt.yaml"), ("rail_rig.xml", "spoilt.xml"))[kind - 2])
    path = folder / f"fuzz_{rng.integers(1 << 30)}.yaml"
    path.write_bytes(text.encode())
    return path


ELEMENTS = (
    '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
    '<size memory="100G"/>',
    '<size memory="900M"/>',
    '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/></asset>',
    '<include file="spoilt.xml"/>',
    '<worldbody><replicate count="5000000" offset="1 0 0"><geom size="1"/></replicate></worldbody>',
    '<option timestep="1e-9"/>',
    '<option timestep="1e9"/>',
    '<option gravity="nan 0 0"/>',
    '<option integrator="RK4"/>',
    '<size nuserdata="2000000000"/>',
    f"<worldbody>{3000 * '<body>'}{3000 * '</body>'}</worldbody>",
    '<worldbody><body><joint type="free"/></body></worldbody>',
    '<sensor><user dim="2000000000" name="u"/></sensor>',
    '<asset><mesh name="m" file="/dev/zero"/></asset>',
    '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>',
    '<custom><numeric name="n" size="500000000" data="1"/></custom>',
)
"""What an MJCF gets."""


def draw_model(rng: np.random.Generator, folder: Path) -> Path:
    """The rig's MJCF, spoilt; a twin of no vehicle names it."""
    text = (MODELS / "rail_rig.xml").read_text()
    for _ in range(rng.integers(1, 3)):
        if rng.random() < 0.5:
            text = spoil_text(rng, text)
        else:
            text = text.replace("</mujoco>", ELEMENTS[rng.integers(len(ELEMENTS))] + "\n</mujoco>")
    (folder / "spoilt.xml").write_text(text)
    path = folder / f"fuzz_{rng.integers(1 << 30)}.yaml"
    signals = "signals: {joints: {rail_x: /joint_states, rail_z: /joint_states, pitch: /joint_states}}"
    path.write_text(f"model: spoilt.xml\n{('vehicle: vehicle.yaml', signals)[rng.integers(2)]}\n")
    return path


def draw_checkpoint(rng: np.random.Generator, folder: Path) -> Path:
    """The policy that ships, spoilt: its bytes, its configuration, its weights or its other parts."""
    source = MODELS / "policies" / "flip.pt"
    path = folder / f"fuzz_{rng.integers(1 << 30)}.pt"
    kind = rng.integers(4)
    if kind == 0:
        path.write_bytes(spoil_bytes(rng, source.read_bytes()))
        return path
    content = torch.load(io.BytesIO(source.read_bytes()), weights_only=True)
    if kind == 1:
        content["config"] = spoil_plain(rng, content["config"])
    elif kind == 2:
        name = list(content["policy"])[rng.integers(len(content["policy"]))]
        values = content["policy"][name]
        ways = (
            values * float("nan"),
            values[:1],
            values.double(),
            values * 1e30,
            values.to(torch.int8),
            3,
            values.expand(5, *values.shape),
        )
        content["policy"][name] = ways[rng.integers(len(ways))]
    else:
        parts = spoil_plain(rng, {name: part for name, part in content.items() if name != "policy"})
        content = {**parts, "policy": content["policy"]}
    try:
        torch.save(content, path)
    except RecursionError:  # torch itself writes nothing so deep
        path.write_bytes(b"too deep")
    return path


DRAW: dict[str, Draw] = {"log": draw_log, "twin": draw_twin, "model": draw_model, "checkpoint": draw_checkpoint}
