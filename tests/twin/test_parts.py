"""Models in parts: those that attach themselves, name pipes or crash MuJoCo end in a line; honest ones are attached."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from tests.measured import run_measured
from vpptwin.system.errors import InputError
from vpptwin.twin.robot import parts, trial
from vpptwin.twin.robot.model import compile_model

BODY = '<worldbody><body name="{}"><joint name="{}" axis="0 1 0"/><geom size=".1" mass="1"/></body>{}</worldbody>'
ATTACH = '<asset><model name="m" content_type="text/xml" file="{0}"/></asset>'
PLACE = '<frame pos="1 0 0"><attach model="m" body="{0}" prefix="{0}_"/></frame>'
TWIN = "model: arm.xml\nsignals: {joints: {arm: /joint_states}}\n"


def write(path: Path, more: str = "", place: str = "") -> Path:
    """An MJCF of a body and a joint called as the file, with more in it."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<mujoco>{more}{BODY.format(path.stem, path.stem, place)}</mujoco>")
    return path


def refuse(path: Path) -> str:
    """The line that refuses a model."""
    with pytest.raises(InputError) as caught:
        compile_model(path)
    return str(caught.value)


def test_circles_are_told(tmp_path: Path) -> None:
    """A model in itself, directly, by another one, or by what it includes; MuJoCo crashes on each."""
    write(tmp_path / "arm.xml", ATTACH.format("arm.xml"))
    write(tmp_path / "left.xml", ATTACH.format("right.xml"))
    write(tmp_path / "right.xml", ATTACH.format("left.xml"))
    write(tmp_path / "whole.xml", ATTACH.format("piece.xml"))
    (tmp_path / "piece.xml").write_text('<mujoco><include file="assets.xml"/></mujoco>')
    (tmp_path / "assets.xml").write_text(f"<mujocoinclude>{ATTACH.format('whole.xml')}</mujocoinclude>")
    (tmp_path / "link.xml").symlink_to("arm.xml")
    for name in ("arm", "left", "right", "whole", "link"):
        assert "attaches itself; expected another" in refuse(tmp_path / f"{name}.xml")


def test_parts_that_are_none_of_themselves_are_attached(tmp_path: Path) -> None:
    """One model twice, in folders of their own, and files that are included from two."""
    write(tmp_path / "hand.xml")
    write(
        tmp_path / "sub" / "leg.xml", ATTACH.format("foot.xml") + '<include file="shared.xml"/>', PLACE.format("foot")
    )
    write(tmp_path / "sub" / "foot.xml", '<include file="shared.xml"/>')
    (tmp_path / "sub" / "shared.xml").write_text("<mujocoinclude><compiler angle='radian'/></mujocoinclude>")
    two = ATTACH.format("hand.xml") + ATTACH.format("sub/leg.xml").replace('"m"', '"n"')
    model = compile_model(
        write(tmp_path / "arm.xml", two, PLACE.format("hand") + PLACE.format("leg").replace('"m"', '"n"'))
    )
    assert [model.joint(i).name for i in range(model.njnt)] == ["arm", "hand_hand", "leg_leg"]


def write_doubling(folder: Path, depth: int) -> Path:
    """Two of the next in each: so many files make 2^depth of the last."""
    for k in range(depth):
        twice = "".join(ATTACH.format(f"m{k + 1}.xml").replace('"m"', f'"{n}"') for n in "ab")
        write(folder / f"m{k}.xml", twice)
    write(folder / f"m{depth}.xml")
    return folder / "m0.xml"


def test_models_that_double_in_models_are_refused(tmp_path: Path) -> None:
    """Before MuJoCo reads any."""
    assert "more than 1000 files" in refuse(write_doubling(tmp_path, 40))


NAMING = {
    "include": '<include file="{}"/>', "hidden": '<script><include file="{}"/></script>',
    "model": '<asset><model name="m" file="{}"/></asset>', "mesh": '<asset><mesh name="m" file="{}"/></asset>',
    "texture": '<asset><texture name="t" type="skybox" fileup="{}"/></asset>',
    "height": '<asset><hfield name="h" file="{}" size="1 1 1 1"/></asset>',
    "skin": '<asset><skin name="s" file="{}"/></asset>',
    "entity": '<asset><mesh name="m" file="&#{code};{rest}"/></asset>',
    "folder": '<compiler meshdir="pipes"/><asset><mesh name="m" file="{}"/></asset>',
    "asset folder": '<asset><mesh name="m" file="{}"/></asset><compiler assetdir="pipes"/>',
    "flex": '<worldbody><body name="b"><flexcomp name="f" type="mesh" file="{}"/></body></worldbody>',
}  # fmt: skip


@pytest.mark.parametrize("way", NAMING)
def test_pipes_are_never_opened(tmp_path: Path, way: str) -> None:
    """By whichever element one is named, in whichever folder it lies."""
    folder = tmp_path / "pipes" if "folder" in way else tmp_path
    folder.mkdir(exist_ok=True)
    os.mkfifo(folder / "part.obj")
    text = NAMING[way].format("part.obj", code=ord("p"), rest="art.obj")
    line = refuse(write(tmp_path / "arm.xml", text))
    assert 'file="part.obj"> is no regular file' in line


@pytest.mark.parametrize("file", ["/dev/zero", "/dev/tty", "/dev/../dev/null"])
def test_devices_are_never_opened(tmp_path: Path, file: str) -> None:
    """Nor by a URDF."""
    assert "no regular file" in refuse(write(tmp_path / "arm.xml", NAMING["include"].format(file)))
    link = f'<collision><geometry><mesh filename="{file}"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="arm">{link}</link></robot>')
    assert "no regular file" in refuse(tmp_path / "arm.urdf")


@pytest.mark.parametrize("way", NAMING)
def test_no_line_shows_what_is_in_a_file(tmp_path: Path, way: str) -> None:
    """Of somebody's, that a model names: whether it is there is all that is told."""
    (tmp_path / "secret.obj").write_text("password hunter2\nroot:x:0:0\n" * 20)
    (tmp_path / "pipes").mkdir()
    (tmp_path / "pipes" / "secret.obj").write_text("password hunter2\nroot:x:0:0\n" * 20)
    text = NAMING[way].format("secret.obj", code=ord("s"), rest="ecret.obj")
    try:
        line = str(compile_model(write(tmp_path / "arm.xml", text)).nbody)
    except InputError as error:
        line = str(error)
    assert "hunter2" not in line
    assert "root:" not in line


def test_a_crash_is_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What no check foresees ends another process than ours: here MuJoCo itself on a circle that nobody looked for."""
    arm = write(tmp_path / "arm.xml", ATTACH.format("arm.xml"))
    with pytest.raises(InputError, match=r"MuJoCo crashes on it \(SIG(SEGV|ABRT|BUS)\)"):
        trial.try_model(arm, [], trial.MAX_BYTES)
    os.mkfifo(tmp_path / "pipe.xml")
    waiting = write(tmp_path / "waiting.xml", NAMING["include"].format("pipe.xml"))
    monkeypatch.setattr(trial, "PATIENCE", 1.0)
    with pytest.raises(InputError, match="MuJoCo waits for a file"):
        trial.try_model(waiting, [], trial.MAX_BYTES)


def test_processor_time_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what nobody looked for beforehand."""
    monkeypatch.setattr(trial, "SECONDS", 1)
    with pytest.raises(InputError, match="MuJoCo needs more than 1 s"):
        trial.try_model(write_doubling(tmp_path, 40), [], trial.MAX_BYTES)


def test_a_model_is_tried_once(tmp_path: Path) -> None:
    """In a process, and anew once it has changed; one that ships is not tried at all."""
    arm = write(tmp_path / "arm.xml")
    spent = []
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_nvcsw
        trial.try_model(arm, parts.read_parts(arm), trial.MAX_BYTES)
        trial.try_model(trial.models_dir() / "rail_rig.xml", [], trial.MAX_BYTES)
        spent.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_nvcsw - before)
    assert spent[0] > 0
    assert spent[1] == 0


def test_a_command_ends_in_a_line(tmp_path: Path) -> None:
    """Without a crash, a log of MuJoCo's, or a core."""
    write(tmp_path / "arm.xml", ATTACH.format("other.xml"))
    write(tmp_path / "other.xml", ATTACH.format("arm.xml"))
    (tmp_path / "twin.yaml").write_text(TWIN)
    run_measured("effects", "--twin", "twin.yaml", folder=tmp_path).check_refused("attaches itself")
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
