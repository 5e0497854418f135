"""What of a URDF MuJoCo cannot use, told by its tag or link: it names neither, or says nothing at all."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.twin.robot.parts import Element

_MISSING = re.compile(r"Error opening file '([^']*)'")
_LIGHT = re.compile(r"mass and inertia of moving bodies.*Element name '([^']*)'", re.DOTALL)
_MOVING = ("revolute", "continuous", "prismatic")
_NOTHING = re.compile(r"\s*[-+]?(0+\.?0*|\.0+)([eE][-+]?\d+)?\s*")


def is_urdf(elements: Sequence[Element]) -> bool:
    """Whether a model is a URDF, whatever its file is called."""
    return bool(elements) and elements[0].tag == "robot"


def check_urdf(path: Path, elements: Sequence[Element]) -> None:
    """Refuse macros of xacro, which MuJoCo passes over.

    Raises:
        InputError: naming the first.
    """
    macro = next((element.tag for element in elements if element.tag.startswith("xacro:")), "")
    if macro or path.suffix.lower() == ".xacro":
        found = f"{path}: <{macro}> of xacro" if macro else f"{path} is a file of xacro"
        plain = path.name.removesuffix(".xacro").removesuffix(".urdf")
        raise InputError(found, "a plain URDF", f"expand it: `xacro {path.name} > {plain}_plain.urdf`")


def explain_urdf(path: Path, elements: Sequence[Element], reason: str) -> InputError | None:
    """What MuJoCo's reason to refuse a URDF means there: a mesh that is missing, or a link without mass."""
    link = ""
    missing, light = _MISSING.search(reason), _LIGHT.search(reason)
    if light:
        action = "add it, or make its joint fixed"
        return InputError(
            f"{path}: link {light[1]} moves and has no mass", "<inertial> with a mass and an inertia", action
        )
    for element in elements if missing else ():
        link = element.given.get("name", "") if element.tag == "link" else link
        name = element.given.get("filename", "")
        if missing and element.tag == "mesh" and name.rpartition("/")[2] == missing[1].rpartition("/")[2]:
            expected, action = "meshes by their path from the URDF's own folder", "copy it there, or correct the path"
            if package := re.match(r"[a-z]+://[^/]*", name):
                action = f"write the folder that {package[0]} stands for in its place"
            return InputError(f"{path}: <mesh> of link {link} names {name}, which is not found", expected, action)
    return None


def tell_drives(path: Path, elements: Sequence[Element]) -> None:
    """Say on standard error what a URDF leaves open about what drives its joints."""
    joint, idle, led = "", list[str](), list[str]()
    for element in elements:
        if element.tag == "joint" and "type" in element.given:
            joint = element.given.get("name", "") if element.given["type"] in _MOVING else ""
        elif joint and element.tag == "limit" and _NOTHING.fullmatch(element.given.get("effort", "")):
            idle.append(joint)
        elif element.tag == "mimic":
            led.append(f"{joint} (as {element.given.get('joint', '')})")
    if idle:
        none = f'no motor drives {", ".join(idle)}, by <limit effort="0">'
        say(f"{path}: {none}; write what one can exert, if there is one")
    if led:
        say(f"{path}: <mimic> of {', '.join(led)} is held by MuJoCo's soft equality; an MJCF can say how stiff it is")


@cache
def say(text: str) -> None:
    """A line, once in a process, however often a model is compiled."""
    print(text, file=sys.stderr)


def drive_joints(spec: mujoco.MjSpec) -> None:
    """Give every joint of a URDF that may exert an effort a motor of its name: it says no more of what drives it."""
    for joint in spec.joints if not spec.actuators else ():
        if np.ptp(joint.actfrcrange) > 0.0:
            motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gainprm[0] = 1.0
