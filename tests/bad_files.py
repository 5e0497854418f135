"""Files that cannot work: logs, twins and topic maps with one mistake each, and what must be said about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tests.logs.bags import EPOCH, POSE, ROTOR_COMMAND, Bag, Message, make_pose, stamp_header

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "demo" / "flights" / "flip.mcap"
PERIOD = 10**7  # ns
SECONDS = 12.0
RIG = "model: rail_rig.xml\nvehicle: vehicle.yaml\n"
JOINT = "signals: {joints: {slide: /joint_states}}\n"


def swing(tick: int, stamp: int | None = None) -> Message:
    """A pose that moves to and fro, stamped `stamp` ticks after the start (by default its own)."""
    return make_pose(EPOCH + (tick if stamp is None else stamp) * PERIOD, x=0.3 * np.sin(0.05 * tick))


def write_log(path: Path, poses: Sequence[Message], seconds: float = SECONDS) -> Path:
    """A log of these poses and of constant rotor commands."""
    commands = [
        {"header": stamp_header(EPOCH + k * PERIOD), "blade_pitch": [0.1, 0.1], "throttle": [0.4, 0.4]}
        for k in range(round(100 * seconds))
    ]
    bag = Bag(path).add("/mocap/pose", POSE, poses)
    return bag.add("/rotor/command", ROTOR_COMMAND, commands).write()


def damage_pose(value: float) -> list[Message]:
    """Poses of which one has this x."""
    poses = [swing(k) for k in range(round(100 * SECONDS))]
    poses[300]["pose"]["position"]["x"] = value  # type: ignore[index]
    return poses


LOGS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "empty": (lambda path: path.write_bytes(b""), ("is empty (0 bytes)", "MCAP", "record again")),
    "truncated": (lambda path: path.write_bytes(DEMO.read_bytes()[: DEMO.stat().st_size // 2]),
        ("ends inside a record", "a complete MCAP file", "mcap recover")),
    "no_pose": (lambda path: write_log(path, []), ("no messages on /mocap/pose, only on /rotor/command", "topic map")),
    "nan": (lambda path: write_log(path, damage_pose(float("nan"))),
        ("/mocap/pose", "position.x is NaN in 1 of 1200 messages", "3.000 s", "finite numbers")),
    "set_back": (lambda path: write_log(path, [swing(k, k if k < 900 else k - 300) for k in range(1200)]),
        ("time runs backwards", "message 901 of 1200", "2.990 s before an earlier one")),
    "folder_of_videos": (lambda path: (path.mkdir(), (path / "flight.mp4").write_bytes(b"x")),
        ("holds flight.mp4", "logs, or a rosbag2 folder")),
}  # fmt: skip
"""Damaged logs that no command takes, one of each kind: how to make each, and what the line must say."""

SHORT: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "one_second": (lambda path: write_log(path, [swing(k) for k in range(100)], 1.0),
        ("1.0 s", "at least 5 s", "for longer")),
    "standing": (lambda path: write_log(path, [make_pose(EPOCH + k * PERIOD) for k in range(1200)]),
        ("nothing moves", "a log with motion")),
    "few_poses": (lambda path: write_log(path, [swing(0), swing(1199)]), ("times a second", "at least", "Hz")),
    "apart": (lambda path: write_log(path, [swing(k, k + 2000) for k in range(1200)]),
        ("in which all needed topics were recorded", "at least 5 s")),
}  # fmt: skip
"""Sound logs from which nothing can be learnt."""

TWINS: dict[str, tuple[str, tuple[str, ...]]] = {
    "unknown_effect": (RIG + "effects: {rail_x.colomb: {force: 0.3}}",
        ("unknown effect 'rail_x.colomb'", "rail_x.coulomb", "did you mean rail_x.coulomb?")),
    "negative_mass": (RIG + "effects: {airframe.mass: {mass: -0.6}}",
        ("airframe.mass.mass = -0.6 kg", "-0.09 to 0.15 kg", "correct the value")),
    "not_compiling": ("model: broken.xml\n" + JOINT, ("broken.xml: MuJoCo says", "an MJCF that compiles")),
    "no_signals": ("model: rail_rig.xml", ("neither vehicle nor signals", "add `signals: {joints:")),
}  # fmt: skip
"""Twin files that no command takes, one of each kind; tests/twin/test_spec.py has the others."""

MAPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "unknown_topic": ("/mocap/pos: /vicon", ("/mocap/pos;", "one of /mocap/pose")),
    "not_in_log": ("/mocap/pose: /vicon", ("/mocap/pose (mapped to /vicon)", "only on /rotor/command")),
}


def fill_shelf(folder: Path) -> None:
    """Write a sound log and every bad log, twin and topic map."""
    write_log(folder / "sound.mcap", [swing(k) for k in range(1200)])
    for name, (make, _) in {**LOGS, **SHORT}.items():
        make(folder / f"{name}.mcap")
    for name, (text, _) in TWINS.items():
        (folder / f"{name}.twin.yaml").write_text(text)
    for name, (text, _) in MAPS.items():
        (folder / f"{name}.map.yaml").write_text(text)
    body = '<mujoco><worldbody><body><joint name="slide" type="sliding"/><geom size="1"/></body></worldbody></mujoco>'
    (folder / "broken.xml").write_text(body)
