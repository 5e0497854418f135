"""What MuJoCo holds of a twin, written into the text of the user's own MJCF: all other lines stay as they are."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco
import numpy as np

from vpptwin.deploy.hold import AFFINE, Held

Values = Mapping[str, tuple[float, ...]]
ANGLES = ("ref", "springref")
"""Attributes of a hinge that may be degrees."""
OF_ANY_ACTUATOR = ("ctrlrange", "forcerange", "delay", "nsample")
"""Attributes that every kind of actuator has."""
FOLDERS = ("meshdir", "texturedir")


@dataclass(frozen=True)
class Tag:
    """A start tag in a text."""

    path: tuple[str, ...]  # names of the elements around it and its own
    attributes: Mapping[str, str]
    begin: int  # of the text
    end: int  # one past its last character


@dataclass(frozen=True)
class Change:
    """A piece of a text that becomes another."""

    begin: int
    end: int
    text: str


def list_tags(text: str) -> list[Tag]:
    """Every start tag of a text of XML, in order."""
    parser, found, path = expat.ParserCreate(), [], []
    content = text.encode()

    def start(name: str, attributes: dict[str, str]) -> None:
        path.append(name)
        begin = len(content[: parser.CurrentByteIndex].decode())
        found.append(Tag(tuple(path), attributes, begin, begin + len(match_tag(text, begin))))

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda name: path.pop()
    parser.Parse(content, True)
    return found


def match_tag(text: str, begin: int) -> str:
    """The start tag that begins at a place."""
    found = re.compile(r"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(text, begin)
    assert found is not None
    return found[0]


def write_attributes(tag: str, values: Mapping[str, str]) -> str:
    """A start tag with attributes set; those that it has keep their places."""
    for name, value in values.items():
        wanted = f'{name}="{value}"'
        tag, count = re.subn(rf"""(?<=\s){name}\s*=\s*("[^"]*"|'[^']*')""", wanted, tag, count=1)
        if not count:
            close = "/>" if tag.endswith("/>") else ">"
            tag = f"{tag.removesuffix(close).rstrip()} {wanted}{close}"
    return tag


def write_own(
    file: Path, model: mujoco.MjModel, held: Held, flat: ElementTree.Element,
    comments: Mapping[tuple[str, str], Sequence[str]], head: Sequence[str], folder: Path,
) -> str | None:  # fmt: skip
    """The MJCF of a user with what is held, or None where its text is not to be changed in place.

    Args:
        file: the MJCF.
        model: compiled of it.
        held: of the twin.
        flat: the same, flattened by MuJoCo and changed, from which elements are taken that have to be of another kind.
        comments: lines before each element that changes, by kind and name.
        head: lines at the top.
        folder: where the text will lie, from which meshes are found.
    """
    text = file.read_text(encoding="utf-8")
    tags = list_tags(text)
    parts = {tag.path[-1] for tag in tags}
    compiler = next((tag for tag in tags if tag.path == ("mujoco", "compiler")), None)
    of_geoms = compiler is not None and compiler.attributes.get("inertiafromgeom") == "true"
    if tags[0].path != ("mujoco",) or parts & {"include", "replicate", "attach", "frame"} or of_geoms:
        return None
    degrees = compiler is None or compiler.attributes.get("angle", "degree") == "degree"
    changes = [Change(tags[0].end, tags[0].end, "".join(f"\n  <!-- {line} -->" for line in head))]
    if parts & {"mesh", "hfield", "texture", "skin"} and folder.resolve() != file.parent.resolve():
        changes.append(move_folders(text, tags[0], compiler, file.parent, folder))
    for element, name in held.list_elements():
        wanted = {a: values for (kind, who, a), values in held.values.items() if (kind, who) == (element, name)}
        if element == "joint" and degrees and model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_HINGE:
            wanted |= {a: tuple(np.rad2deg(values)) for a, values in wanted.items() if a in ANGLES}
        tag = find_tag(tags, element, name)
        if tag is None:
            return None
        gap = find_gap(text, tag.begin)
        before = "".join(f"<!-- {line} -->{gap}" for line in comments[element, name])
        own = text[tag.begin : tag.end]
        if element == "inertial" or (element == "option" and tag.path[-1] != "option"):
            changes += write_element(text, tags, tag, element, flat, name, before)
        elif element == "actuator":
            changes.append(Change(tag.begin, tag.end, before + write_actuator(tag, own, wanted, model, flat)))
        else:
            changes.append(Change(tag.begin, tag.end, before + write_attributes(own, write_values(wanted))))
    for _, change in sorted(enumerate(changes), key=lambda each: (each[1].begin, each[0]), reverse=True):
        text = text[: change.begin] + change.text + text[change.end :]
    return text


def find_tag(tags: Sequence[Tag], element: str, name: str) -> Tag | None:
    """The tag that a change is of: of a body for its inertia, of the root for options that are not there."""
    if element == "option":
        return next((tag for tag in tags if tag.path == ("mujoco", "option")), tags[0])
    kinds = {"joint": ("worldbody", "joint"), "actuator": ("actuator", ""), "inertial": ("worldbody", "body")}
    room, kind = kinds[element]
    fits = (tag for tag in tags if tag.path[1:2] == (room,) and (tag.path[-1] == kind or not kind))
    return next((tag for tag in fits if tag.attributes.get("name") == name and len(tag.path) > 2), None)


def find_gap(text: str, place: int) -> str:
    """What goes between a comment and a tag: where that begins a line, the line's end and its indent."""
    line = text[text.rfind("\n", 0, place) + 1 : place]
    return f"\n{line}" if not line.strip() else " "


def find_indent(text: str, place: int) -> str:
    """What stands before a place on its line, if that is nothing but spaces."""
    line = text[text.rfind("\n", 0, place) + 1 : place]
    return line if not line.strip() else ""


def write_element(
    text: str, tags: Sequence[Tag], around: Tag, element: str, flat: ElementTree.Element, name: str, before: str
) -> list[Change]:
    """An element that is written anew, first in the one around it: a body's inertia, options."""
    if element == "option":
        node = flat.find("option")
        assert node is not None
        gravity = {"gravity": node.get("gravity", "")}
        return [Change(around.end, around.end, f"\n  {before.strip()}\n  {write_attributes('<option/>', gravity)}")]
    body = next(each for each in flat.iter("body") if each.get("name") == name)
    node = body.find("inertial")
    assert node is not None
    written = write_attributes("<inertial/>", node.attrib)
    inside = tags[tags.index(around) + 1 :]
    known = next(
        (t for t in inside if t.path == (*around.path, "inertial") and t.begin < find_end(text, tags, around)), None
    )
    indent = find_indent(text, around.begin) + "  "
    if known is None:
        return [Change(around.end, around.end, f"\n{indent}{before.strip()}\n{indent}{written}")]
    if not text[known.begin : known.end].endswith("/>"):
        written = written.removesuffix("/>") + ">"
    own = find_indent(text, known.begin)
    return [Change(known.begin, known.end, f"{before.strip()}\n{own}{written}")]


def find_end(text: str, tags: Sequence[Tag], around: Tag) -> int:
    """Where the next element begins that is not within one."""
    later = tags[tags.index(around) + 1 :]
    return next((tag.begin for tag in later if len(tag.path) <= len(around.path)), len(text))


def write_actuator(tag: Tag, own: str, wanted: Values, model: mujoco.MjModel, flat: ElementTree.Element) -> str:
    """The tag of an actuator: of its kind where that has the attributes, a `<general>` where not."""
    kind, values, known = tag.path[-1], dict(wanted), model.actuator(tag.attributes["name"])
    others = set(values) & {"gainprm", "biasprm", "dynprm", "forcerange"}
    if kind == "motor" and others == {"gainprm"} and not model.actuator_forcelimited[known.id]:
        # a motor's own gain is one; a limit of its force would move with the gear
        values["gear"] = tuple(values.pop("gainprm")[0] * np.trim_zeros(known.gear, "b"))
    if kind == "general" or set(values) <= {*OF_ANY_ACTUATOR, "gear"}:
        return write_attributes(own, write_values(values))
    node = next(e for e in flat.findall("./actuator/*") if e.get("name") == tag.attributes["name"])
    written = write_attributes(f"<{node.tag}/>", node.attrib)
    return written if own.endswith("/>") else written.removesuffix("/>") + ">"


def write_values(values: Values) -> dict[str, str]:
    """Attributes as text, with what has to go with them."""
    written: dict[str, str] = {}
    for name, numbers in values.items():
        if name == "biastype":
            written[name] = "affine" if numbers[0] == AFFINE else "none"
        elif name == "nsample":
            written |= {name: str(int(numbers[0])), "interp": "linear"}
        else:
            written[name] = write_numbers(numbers)
        if name == "ctrlrange":
            written["ctrllimited"] = "true"
        if name == "dynprm":
            written |= {"dyntype": "filterexact", "actearly": "true"}
    return written


def write_numbers(numbers: Sequence[float]) -> str:
    """Numbers as MJCF has them, to the last bit."""
    return " ".join(repr(float(number)) for number in numbers)


def move_folders(text: str, root: Tag, compiler: Tag | None, here: Path, folder: Path) -> Change:
    """The compiler's folders as seen from another one."""
    known = {} if compiler is None else compiler.attributes
    wanted = {
        name: os.path.relpath((here / known.get(name, known.get("assetdir", "."))).resolve(), folder.resolve())
        for name in FOLDERS
    }
    if compiler is None:
        return Change(root.end, root.end, f"\n  {write_attributes('<compiler/>', wanted)}")
    return Change(compiler.begin, compiler.end, write_attributes(text[compiler.begin : compiler.end], wanted))
