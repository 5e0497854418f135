"""URDF as exporters write it: what MuJoCo cannot use is told by its tag or link, with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import compile_model

INERTIA = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
JOINT = (
    '<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>{4}'
    '<limit effort="{5}" velocity="1" lower="-1" upper="1"/></joint>'
)


def write(
    path: Path, upper: str = INERTIA.format(1), effort: str = "5", more: str = "", kind: str = "revolute"
) -> Path:
    """An arm of two links, `upper` and `fore`: what the first holds, how strong its motor is, what its joint says."""
    links = f'<link name="base"/><link name="upper">{upper}</link><link name="fore">{INERTIA.format(2)}</link>'
    joints = JOINT.format("shoulder", "base", "upper", kind, more, effort)
    joints += JOINT.format("elbow", "upper", "fore", "revolute", "", "3")
    path.write_text(f'<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">{links}{joints}</robot>')
    return path


def mesh(name: str, around: str = "collision") -> str:
    """A link's content with a mesh."""
    return f'{INERTIA.format(1)}<{around}><geometry><mesh filename="{name}"/></geometry></{around}>'


@pytest.mark.parametrize(
    ("upper", "parts"),
    [(mesh("package://arm_description/meshes/upper.stl"),
      ("<mesh> of link upper names package://arm_description/meshes/upper.stl, which is not found",
       "write the folder that package://arm_description stands for in its place")),
     (mesh("model://arm/upper.obj"), ("link upper", "the folder that model://arm stands for")),
     (mesh("meshes/upper.stl"), ("<mesh> of link upper names meshes/upper.stl", "copy it there")),
     ("", ("link upper moves and has no mass; expected <inertial>", "make its joint fixed")),
     (INERTIA.format(0), ("link upper moves and has no mass",)),
     ('<xacro:macro name="m"/>', ("<xacro:macro> of xacro; expected a plain URDF", "`xacro arm.urdf > "))],
)  # fmt: skip
def test_what_is_missing_is_named(tmp_path: Path, upper: str, parts: tuple[str, ...]) -> None:
    """The tag or the link, and what to do."""
    for name in ("arm.urdf", "arm.xml"):
        with pytest.raises(InputError) as caught:
            compile_model(write(tmp_path / name, upper))
        for part in parts:
            assert part.replace("arm.urdf", name) in str(caught.value)


def test_a_file_of_xacro_is_told(tmp_path: Path) -> None:
    """Whatever it holds."""
    with pytest.raises(InputError, match=r"is a file of xacro; .*`xacro arm.urdf.xacro > arm_plain.urdf`"):
        compile_model(write(tmp_path / "arm.urdf.xacro"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"effort": "0"}, 'no motor drives shoulder, by <limit effort="0">; write what one can exert'),
     ({"effort": "0.0", "kind": "continuous"}, "no motor drives shoulder"),
     ({"more": '<mimic joint="elbow" multiplier="2"/>'}, "<mimic> of shoulder (as elbow) is held by"),
     ({"effort": "0", "kind": "prismatic"}, "no motor drives shoulder"),
     ({}, ""), ({"effort": "0.05"}, ""), ({"effort": "0", "kind": "fixed"}, ""),
     ({"upper": mesh("package://x/y.dae", "visual")}, "")],
)  # fmt: skip
def test_what_drives_nothing_is_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, str], said: str
) -> None:
    """In a line on standard error, and the model is there; of meshes for the eye alone nothing is asked."""
    path = write(tmp_path / "arm.urdf", **changes)
    models = [compile_model(path) for _ in range(2)]
    assert models[0].njnt == 2 - (changes.get("kind") == "fixed")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == bool(said)
    assert said in "".join(lines)
