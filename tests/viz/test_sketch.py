"""The drawing of a rig on which the accused part is lit."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from vpptwin.effects import find_effect
from vpptwin.twin.spec import load_twin
from vpptwin.viz.scene.sketch import ModelPart, find_part, sketch_rig

RIGS = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*/*.yaml"))


@pytest.mark.parametrize(
    ("effect", "part"),
    [
        ("rail_x.coulomb", ({"carriage"}, {"rail_x"}, set())),
        ("pitch.bias", ({"craft"}, {"pitch"}, set())),
        ("rotor.asymmetry", (set(), set(), {"thrust_1", "thrust_2"})),
        ("servo.lag", (set(), set(), {"thrust_1", "thrust_2"})),
        ("carriage.mass", ({"carriage"}, set(), set())),
        ("airframe.mass", ({"craft"}, set(), set())),
        ("gyro.bias", ({"craft"}, set(), set())),
    ],
)
def test_an_effect_lights_what_it_acts_on(effect: str, part: tuple[set[str], set[str], set[str]]) -> None:
    """A joint with its body, actuators, or a body."""
    spec = load_twin()
    found: ModelPart = find_part(spec.robot, find_effect(spec.catalogue, effect))
    model = spec.model
    assert {model.body(i).name for i in found.bodies} == part[0]
    assert {model.joint(i).name for i in found.joints} == part[1]
    assert {model.actuator(i).name for i in found.actuators} == part[2]


@pytest.mark.parametrize("twin", ["nominal", *map(str, RIGS)], ids=lambda twin: Path(twin).stem)
def test_every_rig_is_drawn(twin: str) -> None:
    """Well-formed, all numbers finite, nothing lit without an effect, something with each one, words in the label."""
    spec = load_twin(twin)
    plain = sketch_rig(spec.robot, [], "<b>")
    assert "var(--lit)" not in plain
    for effect in spec.catalogue:
        drawing = sketch_rig(spec.robot, [effect], "<b>")
        root = ElementTree.fromstring(drawing)
        assert root.get("aria-label") == "<b>"
        width, height = map(float, (root.get("viewBox") or "").split()[2:])
        assert max(width, height) == pytest.approx(260.0)
        assert min(width, height) >= 0.74 * 260.0
        assert not re.search("nan|inf", drawing)
        assert "var(--lit)" in drawing, effect.id
