"""Twins, vehicles and models that ask for anything: one line, no gigabytes, no hang."""

from __future__ import annotations

from pathlib import Path

import pytest

from proving.fuzzers import ELEMENTS, MODELS
from tests.measured import run_measured
from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml
from vpptwin.twin import load_twin

RIG = "model: rail_rig.xml\nvehicle: vehicle.yaml\n"
LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join(9 * [f'*a{i - 1}'])}]\n" for i in range(1, 12))
YAML = {
    "deep": (f"effects: {'[' * 5000}{']' * 5000}\n", "nested too deeply"),
    "laughs": (f"{LAUGHS}{RIG}", "aliases make more than 50000 values"),
    "endless": (f"{RIG}effects: &a {{b: *a}}\n", "nested too deeply, or in itself"),
    "long": (f"{RIG}# {'x' * (1 << 18)}\n", "longer than 262144 bytes"),
    "digits": (f"{RIG}x: {'9' * 6000}\n", "Exceeds the limit"),
    "date": (f"{RIG}x: 2001-99-99\n", "month must be in 1..12"),
    "object": (f"{RIG}x: !!python/object/apply:os.abort []\n", "could not determine a constructor"),
}


@pytest.mark.parametrize("name", YAML)
@pytest.mark.parametrize("role", ["twin", "vehicle", "actuator", "map"])
def test_yaml_that_grows_is_refused_wherever_it_is_read(tmp_path: Path, name: str, role: str) -> None:
    """In a line under 2 s of work, whatever the file is for; metadata of a bag that cannot be read is passed over."""
    text, part = YAML[name]
    (tmp_path / "odd.yaml").write_text(text)
    (tmp_path / "vehicle.twin").write_text("model: rail_rig.xml\nvehicle: odd.yaml\n")
    (tmp_path / "actuator.twin").write_text(f"{RIG}actuator: odd.yaml\n")
    from vpptwin.logs.topic_map import load_topic_map

    read = {"twin": "odd.yaml", "vehicle": "vehicle.twin", "actuator": "actuator.twin"}
    with pytest.raises(InputError, match=part) as caught:
        load_topic_map(tmp_path / "odd.yaml") if role == "map" else load_twin(tmp_path / read[role])
    assert "odd.yaml" in str(caught.value)


def test_aliases_are_taken_where_they_are_few(tmp_path: Path) -> None:
    """Anchors, aliases and merges are good YAML."""
    (tmp_path / "good.yaml").write_text("a: &a {b: 1}\nc: *a\nd: {<<: *a, e: 2}\n")
    assert read_yaml(tmp_path / "good.yaml") == {"a": {"b": 1}, "c": {"b": 1}, "d": {"b": 1, "e": 2}}


ABSURD = {
    0: "<hfield", 1: "Could not allocate memory", 2: "a model of 944 MB", 3: "<texture", 5: "<replicate",
    11: "nesting is too deep", 13: "allocate", 14: "no regular file", 15: "plugin", 16: "exceeds maximum",
}  # fmt: skip


@pytest.mark.parametrize("index", ABSURD)
def test_models_that_ask_for_gigabytes_are_refused(tmp_path: Path, index: int) -> None:
    """Height fields, textures, copies, arenas, sensors and numbers of any size."""
    text = (MODELS / "rail_rig.xml").read_text().replace("</mujoco>", f"{ELEMENTS[index]}\n</mujoco>")
    (tmp_path / "rig.xml").write_text(text)
    (tmp_path / "twin.yaml").write_text("model: rig.xml\nvehicle: vehicle.yaml\n")
    with pytest.raises(InputError, match=ABSURD[index]):
        load_twin(tmp_path / "twin.yaml")


@pytest.mark.parametrize("way", ["bytes", "dashes", "included"])
def test_models_are_refused_before_mujoco_hangs(tmp_path: Path, way: str) -> None:
    """What no parser of XML reads and MuJoCo does, whose next model would wait for this one's lock; and includes."""
    comment = {"bytes": b"<!-- \xff\x08 -->", "dashes": b"<!-- a -- b & c -->", "included": b""}[way]
    text = comment + ELEMENTS[0].encode()
    if way == "included":
        (tmp_path / "huge.xml").write_bytes(b"<mujoco>" + text + b"</mujoco>")
        text = b'<include file="huge.xml"/><include file="rig.xml"/><include file="nowhere.xml"/>'
    rig = (MODELS / "rail_rig.xml").read_bytes()
    (tmp_path / "rig.xml").write_bytes(rig.replace(b"</mujoco>", text + b"</mujoco>"))
    (tmp_path / "twin.yaml").write_text(RIG.replace("rail_rig", "rig"))
    with pytest.raises(InputError, match="<hfield"):
        load_twin(tmp_path / "twin.yaml")


def test_a_refused_model_costs_a_command_nothing(tmp_path: Path) -> None:
    """The line, and less than a gigabyte."""
    text = (MODELS / "rail_rig.xml").read_text().replace("</mujoco>", f"{ELEMENTS[0]}\n</mujoco>")
    (tmp_path / "rig.xml").write_text(text)
    (tmp_path / "twin.yaml").write_text("model: rig.xml\nvehicle: vehicle.yaml\n")
    cost = run_measured("effects", "--twin", "twin.yaml", folder=tmp_path)
    cost.check_refused("rig.xml: <hfield")
    assert cost.megabytes < 1000
