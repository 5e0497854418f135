"""Logs, twins, models and checkpoints as an accident or an enemy leaves them, drawn from a seed; nothing of vpptwin."""

from __future__ import annotations

import copy
import io
import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import scipy.io
import torch
import yaml
from pyarrow import parquet

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


TEMPLATES = (
    "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "data/{chunk_index:0999999999d}.parquet", "data/{chunk_index.__class__.__mro__}.parquet", "{x}", "{", "}{", "{}",
    "{chunk_index!r}", "{chunk_index:>{file_index}}", "/etc/passwd", "../../{chunk_index}", "data/../../x.parquet",
    "/dev/zero", "pipe.parquet", "data", "data/\0.parquet", "{chunk_index}" * 500, "meta/info.json", "loop.parquet",
)  # fmt: skip
"""Where a LeRobot data set may say that its rows lie."""
INFO: dict[str, object] = {
    "codebase_version": "v3.0", "fps": 50, "total_episodes": 2, "chunks_size": 1000,
    "features": {"observation.state": {"dtype": "float32", "shape": [2], "names": ["a.pos", "b.pos"]},
                 "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["a", "b"]}}},
    "data_path": TEMPLATES[0],
}  # fmt: skip
PLACES: tuple[object, ...] = (0, 1, -1, 10**6, 2**62, None, "0", "../..", 0.5, float("nan"), True, [0], {"a": 0})
"""What may stand in the place of a chunk's number."""


def spoil_file(rng: np.random.Generator, path: Path) -> None:
    """A file lost, cut, or replaced by a pipe, a folder, a device, or a link to itself or to somebody's file."""
    content = path.read_bytes()
    path.unlink()
    kind = rng.integers(7)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.mkdir()
    elif kind < 5:
        path.symlink_to((path.name, "/etc/passwd", "/dev/zero")[kind - 2])
    elif kind == 5:
        path.write_bytes(spoil_bytes(rng, content))


def clear_folder(path: Path) -> Path:
    """A folder without what was there."""
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    os.mkfifo(path / "pipe.parquet")
    (path / "loop.parquet").symlink_to("loop.parquet")
    return path


def draw_set(rng: np.random.Generator, folder: Path) -> Path:
    """A LeRobot data set of version 2 or 3 with two episodes, spoilt."""
    path = clear_folder(folder / f"fuzz_{rng.integers(1 << 30)}")
    old = rng.random() < 0.3
    place = [PLACES[rng.integers(len(PLACES))] if rng.random() < 0.2 else 0 for _ in range(3)]
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (path / part).mkdir(parents=True)
    frames = 2 * list(range(60))
    rows: dict[str, Any] = {
        "observation.state": [[0.01 * k, -0.5] for k in frames], "action": [[0.01 * k, -0.4] for k in frames],
        "timestamp": [k / 50 for k in frames], "episode_index": [k // 60 for k in range(120)],
    }  # fmt: skip
    if rng.random() < 0.2:
        name = list(rows)[rng.integers(len(rows))]
        rows[name] = [(None, "x", [1.0], {"a": 1.0}, True)[rng.integers(5)]] * 120
    names = ["episode_000000", "episode_000001"] if old else ["file-000"]
    files = [path / f"data/chunk-000/{name}.parquet" for name in names]
    for file in files:
        parquet.write_table(pa.table(rows), file)
    if not old:
        index = {"episode_index": [0, 1], "data/chunk_index": 2 * [place[0]], "data/file_index": 2 * [place[1]]}
        files.append(path / "meta/episodes/chunk-000/file-000.parquet")
        parquet.write_table(pa.table(index), files[-1])
    info = dict(INFO)
    if rng.random() < 0.5:
        info["data_path"] = TEMPLATES[rng.integers(len(TEMPLATES))]
    if rng.random() < 0.3:
        info["total_episodes"] = (3 * 10**6, 10**18, 0, -1, True, "2", 2.0, None, [2])[rng.integers(9)]
    if rng.random() < 0.4:
        info = spoil_plain(rng, info)
    text = write_plain(json.dumps, info)
    if rng.random() < 0.1:
        text = ("[" * 100_000, '{"features": ' * 100_000, "[]", "nul", '{"total_episodes": ' + "9" * 5000)[
            rng.integers(5)
        ]
    (path / "meta/info.json").write_text(text)
    files.append(path / "meta/info.json")
    if rng.random() < 0.25:
        spoil_file(rng, files[rng.integers(len(files))])
    return path


def write_plain(dump: Callable[[Any], str], content: Any) -> str:  # noqa: ANN401
    """Plain data as text; what is nested too deeply to be written is brackets."""
    try:
        return dump(content)
    except RecursionError:
        return "[" * 3000


def draw_bag(rng: np.random.Generator, folder: Path) -> Path:
    """A folder of rosbag2 whose metadata names files that it should not."""
    path = clear_folder(folder / f"fuzz_{rng.integers(1 << 30)}")
    shutil.copy(ROOT / "demo" / "flights" / "flip.mcap", path / "bag_0.mcap")
    names: list[object] = ["bag_0.mcap"]
    odd = ("/etc/passwd", "../../etc/passwd", "../outside.csv", "/dev/zero", "/dev/stdin", "pipe.parquet", ".", "",
           "loop.parquet", "bag_0.mcap/", "a" * 5000, "\0", "metadata.yaml", f"{path.name}/bag_0.mcap", "x#0",
           "bag_0.mcap@0-2", "bag_0.mcap+/etc/passwd", "*", None, 3, ["bag_0.mcap"], {"a": "b"})  # fmt: skip
    for _ in range(rng.integers(0, 3)):
        names.insert(int(rng.integers(len(names) + 1)), odd[rng.integers(len(odd))])
    (folder / "outside.csv").write_text("time,q\n" + "".join(f"{k / 50},{k}\n" for k in range(500)))
    about: Any = {"rosbag2_bagfile_information": {"version": 5, "relative_file_paths": names, "files": []}}
    if rng.random() < 0.3:
        about = spoil_plain(rng, about)
    text = write_plain(yaml.safe_dump, about)
    (path / "metadata.yaml").write_text(spoil_text(rng, text) if rng.random() < 0.2 else text)
    if rng.random() < 0.25:
        spoil_file(rng, path / ("bag_0.mcap", "metadata.yaml")[rng.integers(2)])
    return path


NAMED = (
    "fuzz_pipe", "/etc/passwd", "/dev/zero", "/dev/stdin", "../../../etc/passwd", "spoilt.xml", "part.xml", "other.xml",
    "nowhere.xml", ".", "", "cube.obj", "part.stl", "a" * 5000, "loop.xml", "file:///etc/passwd",
)  # fmt: skip
"""Files that an MJCF may name."""
NAMING = (
    '<include file="{}"/>', '<worldbody><include file="{}"/></worldbody>',
    '<asset><model name="m{n}" file="{}"/></asset>',
    '<asset><model name="m{n}" content_type="text/xml" file="{}"/></asset>'
    '<worldbody><frame pos="0 0 1"><attach model="m{n}" body="part" prefix="p{n}"/></frame></worldbody>',
    '<asset><mesh name="h{n}" file="{}"/></asset>', '<asset><texture name="t{n}" type="2d" file="{}"/></asset>',
    '<asset><mesh name="h{n}" file="{}" content_type="model/obj"/></asset>',
    '<asset><texture name="t{n}" type="skybox" fileup="{}" filedown="{}"/></asset>',
    '<asset><hfield name="f{n}" file="{}" size="1 1 1 1"/></asset>', '<asset><skin name="s{n}" file="{}"/></asset>',
    '<worldbody><body><flexcomp name="x{n}" type="mesh" file="{}"/></body></worldbody>', '<compiler meshdir="{}"/>',
    '<compiler assetdir="{}"/>', '<asset><material name="a{n}"><layer role="rgb" texture="{}"/></material></asset>',
)  # fmt: skip
"""How an MJCF names files."""


def name_file(rng: np.random.Generator) -> str:
    """An element that names a file."""
    name = NAMED[rng.integers(len(NAMED))]
    return NAMING[rng.integers(len(NAMING))].replace("{n}", str(rng.integers(1000))).replace("{}", name)


def draw_parts(rng: np.random.Generator, folder: Path) -> Path:
    """An MJCF or URDF that names files: its own parts, itself, pipes, devices, somebody's."""
    for name in ("fuzz_pipe", "part.stl"):
        if not (folder / name).exists():
            os.mkfifo(folder / name)
    if not (folder / "loop.xml").is_symlink():
        (folder / "loop.xml").symlink_to("loop.xml")
    (folder / "cube.obj").write_text("".join(f"v {i & 1} {i >> 1 & 1} {i >> 2}\n" for i in range(8)) + "f 1 2 3\n")
    body = '<worldbody><body name="part"><joint name="{0}" axis="0 1 0"/><geom size=".1" mass="1"/></body></worldbody>'
    for name in ("part", "other"):
        inside = name_file(rng) if rng.random() < 0.6 else ""
        (folder / f"{name}.xml").write_text(f"<mujoco>{body.format(name)}{inside}</mujoco>")
    inside = "".join(name_file(rng) for _ in range(rng.integers(1, 3)))
    text = f"<mujoco>{body.format('slide')}{inside}</mujoco>"
    (folder / "spoilt.xml").write_text(spoil_text(rng, text) if rng.random() < 0.1 else text)
    path = folder / f"fuzz_{rng.integers(1 << 30)}.yaml"
    path.write_text("model: spoilt.xml\nsignals: {joints: {slide: /joint_states}}\n")
    return path


CELLS = (
    "", '"', '"' + "y" * 200_000, "z" * 300_000, "[1, 2", '"[1, 2]"', '"[0.1 0.2\n 0.3]"', "()", "1.000", "1,000",
    "1e400", "-", "\0", "\r", "é", "\U0001f600", "#REF!", "0x1F", "nan", "inf", "2026-01-31 12:00:00",
    "2026-99-99 12:00:00", "9" * 400, "1'000", "=1+1", ";;;;", "\t", "true", "sep=;", "\ufeff", "1 000,5", "12:00:00",
)  # fmt: skip
"""What a cell of a CSV may hold."""
HEADS = (
    "{'descr': [", "{'descr': '<f8', 'fortran_order': False, 'shape': (",
    "{'descr': '|O', 'fortran_order': False, 'shape': (9,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }",
    "{'descr': [('t', '<f8'), ('q', '<f8')], 'fortran_order': False, 'shape': (4,), }",
    "'" * 3, "(" * 5000, "1_", "\\", "\0", "{}", "é",
)  # fmt: skip
"""What the head of a NumPy array may say."""


def draw_table(rng: np.random.Generator, folder: Path) -> Path:
    """A CSV, NumPy, MATLAB or Parquet file of a clock and a few columns, some of several tests, spoilt."""
    time = 0.01 * np.arange(60)
    columns: dict[str, Any] = {"t": time, "q": np.sin(time), "n": np.arange(60)}
    tests = np.array([(time, time), (time[:9], time), ([], "x")], dtype=[("t", "O"), ("q", "O")])
    path = folder / f"fuzz_{rng.integers(1 << 30)}{('.csv', '.npz', '.mat', '.parquet')[rng.integers(4)]}"
    if path.suffix == ".csv":
        marks = ",;\t |"
        rows = [list(columns), *([f"{value:.3f}" for value in row] for row in zip(*columns.values()))]
        for _ in range(rng.integers(0, 4)):
            rows[rng.integers(len(rows))][rng.integers(3)] = CELLS[rng.integers(len(CELLS))]
        mark = marks[rng.integers(len(marks))]
        text = "\n" * int(rng.integers(2)) + "\n".join(mark.join(row) for row in rows) + "\n"
        path.write_bytes(text.encode(("utf-8", "utf-16", "utf-16-le", "cp1252")[rng.integers(4)], "replace"))
    elif path.suffix == ".npz":
        np.savez(path, **columns, log=np.rec.fromarrays([time, time], names="t,q"))
        if rng.random() < 0.5:
            head = HEADS[rng.integers(len(HEADS))].encode()
            with zipfile.ZipFile(path, "a") as archive:
                archive.writestr("u.npy", b"\x93NUMPY\1\0" + len(head).to_bytes(2, "little") + head + bytes(80))
    elif path.suffix == ".mat":
        content: dict[str, Any] = {"tests": tests} if rng.random() < 0.5 else {**columns, "who": np.array(["ab", "c"])}
        scipy.io.savemat(path, content, do_compression=True)
    else:
        columns |= {"episode_index": [k // 30 for k in range(60)], "l": [[1.0] * int(rng.integers(2, 4)) for _ in time]}
        parquet.write_table(pa.table(columns), path)
    if rng.random() < 0.5:
        path.write_bytes(spoil_bytes(rng, path.read_bytes()))
    return path


DRAW: dict[str, Draw] = {
    "log": draw_log, "twin": draw_twin, "model": draw_model, "checkpoint": draw_checkpoint,
    "set": draw_set, "bag": draw_bag, "parts": draw_parts, "table": draw_table,
}  # fmt: skip
