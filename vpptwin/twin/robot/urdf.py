"""URDF as ROS has it: xacro, packages, meshes and <mimic> become what MuJoCo can read."""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import redirect_stderr
from functools import cache
from io import StringIO
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.plain import open_regular
from vpptwin.system.resources import find_package

MAX_TEXT = 1 << 26
"""Bytes of a URDF."""
SHAPES = (".stl", ".obj", ".msh")
"""Kinds of meshes that MuJoCo reads."""
RIGID = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance (`solimp`) of what <mimic> couples: the largest that MuJoCo has."""

_ROBOT = re.compile(rb"(?:\xef\xbb\xbf)?(?:\s|<\?.*?\?>|<!--.*?-->)*<robot[\s>]", re.DOTALL)
_MISSING = re.compile(r"Error opening file '([^']*)'")
_LIGHT = re.compile(r"mass and inertia of moving bodies.*Element name '([^']*)'", re.DOTALL)
_SCHEME = re.compile(r"(package|model|file)://([^/]*)/?(.*)")
_MOVING = ("revolute", "continuous", "prismatic")


def read_urdf(path: Path) -> ET.Element | None:
    """The <robot> of a URDF or xacro as MuJoCo is to read it; None for a model of another kind, or no file.

    Visual shapes are left out. Meshes are named by their whole path. A robot that stands on its base touches nothing
    but itself, so that a collision mesh that is not found is left out there.

    Raises:
        InputError: if it is no XML, or xacro cannot expand it.
    """
    try:
        with open_regular(path) as content:
            raw = content.read(MAX_TEXT)
    except OSError:  # MuJoCo says so
        return None
    if path.suffix.lower() not in (".urdf", ".xacro") and not _ROBOT.match(raw):
        return None
    text = expand_xacro(path) if path.suffix.lower() == ".xacro" or b"<xacro:" in raw else raw
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: {error}", "a URDF, which is XML", "correct it") from None
    if root.tag != "robot":
        raise InputError(f"{path}: <{root.tag}>", "a URDF, whose first element is <robot>", "call an MJCF .xml")
    ours = root.find("mujoco")
    ours = ET.SubElement(root, "mujoco") if ours is None else ours
    compiler = ours.find("compiler")
    compiler = ET.SubElement(ours, "compiler") if compiler is None else compiler
    compiler.attrib = {"strippath": "false", "inertiafromgeom": "false"} | compiler.attrib
    folders = [path.parent, path.parent / compiler.get("meshdir", "")]
    unseen = compiler.get("discardvisual", "true") == "true"
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            file = None if mesh is None else find_mesh(mesh.get("filename", ""), path, folders)
            if mesh is not None and file is not None:
                mesh.set("filename", str(file))
            elif mesh is not None and (shape.tag == "visual" or not is_loose(root)):
                link.remove(shape)
            if shape.tag == "visual" and unseen and shape in list(link):
                link.remove(shape)
    return root


def expand_xacro(path: Path) -> str:
    """The XML that a file of xacro stands for.

    Raises:
        InputError: with what xacro says.
    """
    xacro = load_extra("xacro", path)
    from xacro import substitution_args

    def find(name: str) -> str:
        """The folder of $(find NAME)."""
        folder = find_package(name, path)
        if folder is None:
            raise ValueError(f"no package {name}: say --package {name}=FOLDER")
        return str(folder)

    def evaluate(expression: str, *scopes: object) -> object:
        """An expression's value; names with two underscores reach what runs code, in inner functions too."""
        if "__" in expression:
            raise ValueError(f"{expression}: two underscores")
        return safe_eval(expression, *scopes)

    safe_eval, known = xacro.safe_eval, substitution_args._eval_find
    xacro.safe_eval, substitution_args._eval_find = evaluate, find
    substitution_args._eval_dict["find"] = find
    try:
        with redirect_stderr(StringIO()):
            text: str = xacro.process_file(str(path)).toxml()
    except (Exception, RecursionError) as error:
        plain = path.name.partition(".")[0]
        said = " ".join(str(error).split()) or type(error).__name__
        action = f"correct it, or expand it where its packages are: `xacro {path.name} > {plain}_plain.urdf`"
        raise InputError(f"{path}: xacro says {said}", "a file that it expands", action) from None
    finally:
        xacro.safe_eval, substitution_args._eval_find = safe_eval, known
        substitution_args._eval_dict["find"] = known
    return text


def find_mesh(name: str, path: Path, folders: list[Path]) -> Path | None:
    """The file that a URDF's mesh names, None if it is not found or of a kind that MuJoCo does not read."""
    scheme = _SCHEME.match(name)
    if scheme and scheme[1] != "file":
        package = find_package(scheme[2], path)
        places = [] if package is None else [package / scheme[3]]
    else:
        name = f"/{scheme[3]}" if scheme else name
        places = [folder / part for part in (name, name.rpartition("/")[2]) for folder in folders]
    files = [place.resolve() for place in places if place.suffix.lower() in SHAPES and place.is_file()]
    return next(iter(files), None)


def is_loose(root: ET.Element) -> bool:
    """Whether a robot may move as a whole, so that it may touch what stands beside it."""
    return any(joint.get("type") in ("floating", "planar") for joint in root.findall("joint"))


def explain_urdf(path: Path, root: ET.Element, reason: str) -> InputError | None:
    """What MuJoCo's reason to refuse a URDF means there: a mesh that is missing, or a link without mass."""
    missing, light = _MISSING.search(reason), _LIGHT.search(reason)
    if light:
        found = f"{path}: link {light[1]} moves and has no mass"
        return InputError(found, "<inertial> with a mass and an inertia", "add it, or make its joint fixed")
    for link, mesh in list_meshes(root) if missing else ():
        name = mesh.get("filename", "")
        if missing and name.rpartition("/")[2] == missing[1].rpartition("/")[2]:
            found = f"{path}: <mesh> of link {link} names {name}, which is not found"
            expected, action = "meshes by their path from the URDF's own folder", "copy it there, or correct the path"
            if scheme := _SCHEME.match(name):
                package = f"{scheme[2]}=FOLDER"
                expected, action = f"its package {scheme[2]} in ROS_PACKAGE_PATH", f"say --package {package}"
            return InputError(found, expected, action)
    return None


def list_meshes(root: ET.Element) -> Iterator[tuple[str, ET.Element]]:
    """Every mesh with its link's name."""
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            yield link.get("name", ""), mesh


def tell_drives(path: Path, root: ET.Element) -> None:
    """Say on standard error which joints of a URDF nothing drives by their limit."""
    moving = [joint for joint in root.findall("joint") if joint.get("type") in _MOVING and joint.find("mimic") is None]
    limits = {joint.get("name", ""): limit for joint in moving if (limit := joint.find("limit")) is not None}
    if idle := [name for name, limit in limits.items() if is_nothing(limit.get("effort", ""))]:
        none = f'no motor drives {", ".join(idle)}, by <limit effort="0">'
        say(f"{path}: {none}; write what one can exert, if there is one")


def is_nothing(number: str) -> bool:
    """Whether a number of XML is zero."""
    try:
        return float(number) == 0.0
    except ValueError:
        return False


@cache
def say(text: str) -> None:
    """A line, once in a process, however often a model is compiled."""
    print(text, file=sys.stderr)


def specify_urdf(root: ET.Element) -> mujoco.MjSpec:
    """MuJoCo's specification of a URDF, with what that says of no model but its own.

    A joint that may exert an effort gets a motor of its name. One that follows another by <mimic> gets none, and
    follows rigidly. Meshes of a robot that stands on its base are only looked at.

    Raises:
        ValueError: if MuJoCo refuses it.
    """
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    followers = {joint.get("name") for joint in root.findall("joint") if joint.find("mimic") is not None}
    for joint in spec.joints if not spec.actuators else ():
        if np.ptp(joint.actfrcrange) > 0.0 and joint.name not in followers:
            motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gainprm[0] = 1.0
    for coupling in spec.equalities:
        coupling.solref, coupling.solimp = (2.0 * spec.option.timestep, 1.0), RIGID
    spec.compiler.discardvisual = False  # of which `read_urdf` left none, and which would take those meshes out too
    for geom in () if is_loose(root) else spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            geom.contype = geom.conaffinity = 0
    return spec
