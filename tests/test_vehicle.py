"""Vehicle files: the shipped one loads, and a bad one is refused in one line that names the key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.system.resources import models_dir

Numbers = dict[str, dict[str, object]]


@pytest.fixture
def numbers() -> Numbers:
    """The shipped numbers as plain data, to be spoilt by a test."""
    return yaml.safe_load((models_dir() / "vehicle.yaml").read_text())


def refusal(path: Path) -> str:
    """The message that `path` is refused with; it is one line and names the file."""
    with pytest.raises(InputError) as refused:
        load_vehicle(path)
    message = str(refused.value)
    assert len(message.splitlines()) == 1
    assert len(message) - len(str(path)) < 300  # a line to be read, not a dump of the file
    assert message.startswith(str(path))
    return message


def test_shipped_vehicle_loads() -> None:
    """Without a path the nominal vehicle is read; the paper's numbers are in it."""
    vehicle = load_vehicle()
    assert vehicle.gravity == 9.81
    assert vehicle.control.policy_rate == 100
    assert vehicle.control.inner_rate == 1000


def test_own_vehicle_loads(tmp_path: Path, numbers: Numbers) -> None:
    """A file of the user's own is read, and only what it changes is changed."""
    numbers["airframe"]["mass"] = 0.6
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(numbers))
    vehicle = load_vehicle(path)
    assert vehicle.airframe.mass == 0.6
    assert vehicle.rotor == load_vehicle().rotor


def remove(section: str, key: str) -> Callable[[Numbers], object]:
    """An edit that drops a key."""
    return lambda numbers: numbers[section].pop(key)


def assign(section: str, key: str, value: object) -> Callable[[Numbers], object]:
    """An edit that sets a key."""
    return lambda numbers: numbers[section].update({key: value})


@pytest.mark.parametrize(
    ("spoil", "key"),
    [
        pytest.param(assign("airframe", "mass", -0.45), "airframe.mass", id="negative mass"),
        pytest.param(assign("airframe", "inertia", 0.0), "airframe.inertia", id="no inertia"),
        pytest.param(assign("rotor", "speed", float("nan")), "rotor.speed", id="not a number"),
        pytest.param(assign("airframe", "mass", float("inf")), "airframe.mass", id="infinite"),
        pytest.param(assign("rig", "rail_height", float("nan")), "rig.rail_height", id="no height"),
        pytest.param(assign("rig", "travel_z", [2.5, 0.15]), "rig.travel_z", id="travel reversed"),
        pytest.param(assign("motor", "battery", "full"), "motor.battery", id="a word"),
        pytest.param(assign("control", "gyro_filter", 1.5), "control.gyro_filter", id="beyond its bound"),
        pytest.param(assign("rig", "travel_x", [1.5]), "rig.travel_x", id="half a pair"),
        pytest.param(assign("rotor", "blades", 3), "rotor.blades", id="unknown key"),
        pytest.param(lambda numbers: numbers.update(colour={}), "colour", id="unknown section"),
        pytest.param(remove("servo", "time_constant"), "servo.time_constant", id="missing key"),
        pytest.param(lambda numbers: numbers.pop("motor"), "motor", id="missing section"),
    ],
)
def test_bad_number_is_named(tmp_path: Path, numbers: Numbers, spoil: Callable[[Numbers], object], key: str) -> None:
    """A number that is absent, unknown or out of range is refused, naming section and key."""
    spoil(numbers)
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(numbers))
    assert f"{path}: {key}" in refusal(path)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b"- 1\n- 2\n", id="a list"),
        pytest.param(b"airframe: {mass: 1\n  inertia: [", id="not YAML"),
        pytest.param(b"airframe:\n\tmass: 1\n", id="a tab"),
        pytest.param(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\xff", id="a picture"),
        pytest.param(bytes(256), id="zeros"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    """What is no vehicle file at all is refused, pointing to one that is."""
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    assert "models/vehicle.yaml" in refusal(path)


def test_missing_file_and_folder_are_refused(tmp_path: Path) -> None:
    """Neither an absent file nor a folder is a vehicle file."""
    assert "No such file" in refusal(tmp_path / "absent.yaml")
    assert "directory" in refusal(tmp_path)
