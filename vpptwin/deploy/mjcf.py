"""A twin as plain MJCF: what MuJoCo can hold of it, a comment at each change, and how far that is from the twin."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.parsers.expat import ExpatError

import mujoco
import numpy as np

from vpptwin.deploy.hold import AFFINE, Held
from vpptwin.deploy.own_text import write_numbers, write_own, write_values
from vpptwin.effects import Effect
from vpptwin.engine.callback import installed
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin
from vpptwin.twin.robot.manifold import difference_poses
from vpptwin.twin.robot.model import hold_joints, typical_forces
from vpptwin.twin.spec import TwinSpec

HELD, SEED = 0.1, 0
"""How long each command of the rollouts is held [s]; of what is random in them."""
SPEED = 0.3
"""At which their joints start [m/s, rad/s]."""
SHARE = 0.3
"""Of what a command may be, or of what typically moves a joint that it acts on, or of a radian."""
ALIKE = 1e-4
"""Difference in a second that six digits of numbers may make, as a share of the motion."""
TINY = 1e-9
"""Stands for an actuator that moves nothing."""


def describe(effect: Effect, spec: TwinSpec) -> str:
    """An effect with its values and their 90 % intervals, in a line."""
    parts = []
    for p in effect.parameters:
        ends = spec.intervals.get(f"{effect.id}.{p.name}")
        sure = f" (90 %: {ends[0]:.4g} to {ends[1]:.4g})" if ends else ""
        parts.append(f"{p.name} = {spec.value(effect, p.name):.6g} {p.unit}".rstrip() + sure)
    return f"{effect.id}: {', '.join(parts)}"


def write_mjcf(spec: TwinSpec, held: Held, folder: Path) -> str:
    """The twin's MJCF with what MuJoCo can hold: the user's own text with few lines changed where that can be.

    Where it cannot, as with includes, URDF, or the drone's numbers, it is the model as MuJoCo flattens it.

    Args:
        spec: the twin.
        held: of it.
        folder: where the file will lie, from which meshes are found.

    Raises:
        InputError: if the MJCF's text cannot be made or holds no such element, as of a replicated body.
    """
    with TemporaryDirectory() as name:
        tried = Path(name)
        own, flat = change_own(spec, held, tried), write_flat(spec, held, tried)
        if own is not None and move_alike(spec, own, flat, tried):
            return change_own(spec, held, folder) or flat
    return write_flat(spec, held, folder)


def change_own(spec: TwinSpec, held: Held, folder: Path) -> str | None:
    """The user's own text with what is held, or None where it cannot be changed in place."""
    if spec.robot.rotorcraft is not None or spec.model_file.suffix.lower() != ".xml":
        return None
    flat, comments = flatten(spec, held, folder), list_comments(spec, held)
    try:
        return write_own(spec.model_file, spec.model, held, flat, comments, list_heads(spec, held), folder)
    except (UnicodeDecodeError, ExpatError):
        return None


def move_alike(spec: TwinSpec, own: str, flat: str, folder: Path) -> bool:
    """Whether two texts of an MJCF, in a folder, move alike under random commands."""
    commands, velocity = excite(spec)
    ways: list[np.ndarray] = []
    for text in (own, flat):
        file = folder / f"{len(ways)}.xml"
        file.write_text(text, encoding="utf-8")
        try:
            with installed(None):
                model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError:
            return False
        if (model.nq, model.nu) != (spec.model.nq, spec.model.nu):
            return False
        ways.append(simulate_plain(spec, model, commands, velocity))
    missed = np.abs(difference_poses(spec.model, *ways)).max()
    return bool(missed < ALIKE * max(1.0, np.ptp(ways[1], axis=0).max(initial=0.0)))


def list_comments(spec: TwinSpec, held: Held) -> dict[tuple[str, str], list[str]]:
    """What is told of each element that changes, by its kind and name."""
    return {
        place: [without_dashes(describe(effect, spec)) for effect in effects]
        for place, effects in held.list_elements().items()
    }


def list_heads(spec: TwinSpec, held: Held) -> list[str]:
    """What is told at the top: by what it was written, and what is not held."""
    lost = [f"Not held: {describe(effect, spec)} - {why}" for effect, why in held.lost]
    return [without_dashes(line) for line in (f"Written by vpptwin export from {spec.name}.", *lost)]


def write_flat(spec: TwinSpec, held: Held, folder: Path) -> str:
    """The MJCF as MuJoCo flattens it, with what is held."""
    root = flatten(spec, held, folder)
    for line in reversed(list_heads(spec, held)):
        root.insert(0, ET.Comment(f" {line} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def flatten(spec: TwinSpec, held: Held, folder: Path) -> ET.Element:
    """The MJCF's elements once flattened, with what is held, and a comment at each change."""
    given = mujoco.MjSpec.from_file(str(spec.model_file))
    spec.robot.adapt(given, spec.model_file)
    if given.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        given.compiler.saveinertial = True  # of all bodies, as those of geoms would win
    given.compile()
    root = ET.fromstring(given.to_xml())
    compiler = root.find("compiler")
    if compiler is not None and root.find(".//asset") is not None:  # where they lie as seen from the folder
        for attribute, own in (("meshdir", given.compiler.meshdir), ("texturedir", given.compiler.texturedir)):
            compiler.set(attribute, os.path.relpath((spec.model_file.parent / own).resolve(), folder.resolve()))
    for (element, name), lines in list_comments(spec, held).items():
        node = find_element(root, element, name, spec.model)
        if node is None:
            raise InputError(f"{spec.model_file}: no {element} {name} once flattened", "one", "name it in the MJCF")
        wanted = {a: values for (kind, who, a), values in held.values.items() if (kind, who) == (element, name)}
        node.attrib.update(write_values(wanted))
        parent = next(around for around in root.iter() if node in list(around))
        for line in lines:
            parent.insert(list(parent).index(node), ET.Comment(f" {line} "))
    return root


def without_dashes(text: str) -> str:
    """Text for a comment of XML, which no two dashes may be in."""
    return text.replace("--", "- -").rstrip("-")


def find_element(root: ET.Element, element: str, name: str, model: mujoco.MjModel) -> ET.Element | None:
    """An element by its kind and name; one for inertia, or options, is made where it lacks."""
    if element == "option":
        node = root.find("option")
        return node if node is not None else ET.SubElement(root, "option")
    if element == "joint":
        return root.find(f".//worldbody//joint[@name='{name}']")
    if element == "actuator":
        return next((e for e in root.findall("./actuator/*") if e.get("name") == name), None)
    body = next((e for e in root.iter("body") if e.get("name") == name), None)
    if body is None:
        return None
    inertial = body.find("inertial")
    if inertial is None:
        inertial = ET.Element("inertial")
        body.insert(0, inertial)
    inertial.attrib.clear()
    of = model.body(name)
    for attribute, numbers in (("pos", of.ipos), ("quat", of.iquat), ("mass", of.mass), ("diaginertia", of.inertia)):
        inertial.set(attribute, write_numbers(tuple(numbers)))
    compiler = root.find("compiler")
    if compiler is not None:
        compiler.set("inertiafromgeom", "auto")
    return inertial


def describe_rollouts(spec: TwinSpec, held: Held, path: Path) -> list[str]:
    """What `compare_rollouts` found, in lines of a table."""
    rows = compare_rollouts(spec, held, path)
    lines = [f"{spec.robot.window:g} s of random commands in plain MuJoCo, largest difference of a position [m, rad]:"]
    heads = ("", "moves by", "from what is held", "from the twin", "of the MJCF before")
    wide = max(len(name) for name, *_ in rows)
    lines.append("  ".join([heads[0].ljust(wide), *heads[1:]]))
    for name, *numbers in rows:
        lines.append("  ".join([name.ljust(wide), *(f"{x:.3g}".rjust(len(h)) for x, h in zip(numbers, heads[1:]))]))
    return lines


def compare_rollouts(spec: TwinSpec, held: Held, path: Path) -> list[tuple[str, float, float, float, float]]:
    """How far plain MuJoCo goes from the twin under random commands.

    Args:
        spec: the twin.
        held: of it.
        path: the MJCF that was written.

    Returns:
        Of each degree of freedom: what it is called; how far it gets in the twin; the largest difference between the
        MJCF and the twin with what is held alone; the MJCF and the whole twin; the twin's own MJCF and the whole twin
        [m, rad].
    """
    with installed(None):
        written = mujoco.MjModel.from_xml_path(str(path))
    kept = {effect.id for effect in held.effects}
    partly = replace(spec, effects={name: values for name, values in spec.effects.items() if name in kept})
    commands, velocity = excite(spec)
    twins = [Twin(each, 1) for each in (spec, partly)]
    whole, part = (t.replay_commands(t.initial_state(qvel=velocity), commands[None]).qpos[0] for t in twins)
    new, old = (simulate_plain(spec, model, commands, velocity) for model in (written, spec.model))
    pairs = ((whole[:1], whole), (part, new), (whole, new), (whole, old))
    way, *missed = (np.abs(difference_poses(spec.model, *pair)).max(axis=0) for pair in pairs)
    return [
        (spec.robot.name_dof(i), float(a), float(b), float(c), float(d))
        for i, (a, b, c, d) in enumerate(zip(way, *missed))
    ]


def excite(spec: TwinSpec) -> tuple[np.ndarray, np.ndarray]:
    """Random commands (steps, nu), each held for a while, and start velocities (nv,).

    The drone's commands stay zero: those of the twin are blade pitches, those of its MJCF thrusts.
    """
    model, rng = spec.model, np.random.default_rng(SEED)
    steps, each = round(spec.robot.window / model.opt.timestep), max(round(HELD / model.opt.timestep), 1)
    drawn = rng.uniform(-1.0, 1.0, (steps // each + 1, model.nu))
    velocity = SPEED * rng.uniform(-1.0, 1.0, model.nv)
    velocity[spec.robot.driven] = 0.0
    data, moved, typical = mujoco.MjData(model), np.zeros((model.nu, model.nv)), typical_forces(model)
    data.qpos[:] = spec.robot.start_pose
    with installed(None):
        mujoco.mj_forward(model, data)
    if model.nu:  # force on each degree of freedom for one of each actuator, where the rig starts
        mujoco.mju_sparse2dense(moved, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    middle, half = np.zeros(model.nu), np.full(model.nu, SHARE)
    for i in range(model.nu):
        if model.actuator_ctrllimited[i]:
            middle[i], half[i] = model.actuator_ctrlrange[i].mean(), SHARE * np.ptp(model.actuator_ctrlrange[i]) / 2.0
        elif model.actuator_biastype[i] != AFFINE:
            half[i] *= 1.0 / max(np.max(np.abs(moved[i]) * abs(model.actuator_gainprm[i, 0]) / typical), TINY)
    half *= spec.robot.rotorcraft is None
    return np.repeat(middle + half * drawn, each, axis=0)[:steps], velocity


def simulate_plain(
    spec: TwinSpec, model: mujoco.MjModel, commands: np.ndarray, velocity: np.ndarray
) -> np.ndarray:  # fmt: skip
    """Positions of MuJoCo alone after every step, (steps, nq); joints that follow a log stay where they are."""
    with installed(None):
        model = hold_joints(model, spec.robot.driven) if spec.robot.driven.size else model
        data, way = mujoco.MjData(model), np.zeros((len(commands), model.nq))
        data.qpos[:], data.qvel[:] = spec.robot.start_pose, velocity
        for step, command in enumerate(commands):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            way[step] = data.qpos
    return way
