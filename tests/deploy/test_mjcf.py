"""Twins as plain MJCF: what MuJoCo holds moves as the twin does, what it doesn't is listed."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from proving import quadrotor
from vpptwin.cli.main import main
from vpptwin.deploy.hold import hold
from vpptwin.deploy.mjcf import compare_rollouts, write_mjcf
from vpptwin.twin import load_twin

CART = """<mujoco>
  <compiler angle="degree"/><option timestep="0.001"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.2"/>
      <geom type="box" size="0.1 0.05 0.05" mass="2"/>
      <body name="pole">
        <joint name="swing" type="hinge" axis="0 -1 0" stiffness="0.1" springref="20"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="slide" gear="20" ctrllimited="true" ctrlrange="-0.6 0.8"/>
    <position name="servo" joint="swing" kp="0.5" kv="0.02" forcerange="-4 4"/>
  </actuator>
</mujoco>"""
SIGNALS = """model: cart.xml
signals:
  joints: {slide: /joint_states, swing: /joint_states}
  actuators: {motor: /command, servo: /command}
effects: {%s}
provenance: {intervals_90_percent: {slide.coulomb.force: [1.4, 1.6], swing.spring.stiffness: [0.18, 0.22]}}
"""
EXACT = (
    "slide.viscous: {damping: 0.4}", "swing.inertia: {inertia: 0.004}", "swing.spring: {stiffness: 0.2, rest: 0.3}",
    "slide.bias: {force: 0.3}", "swing.offset: {angle: 0.1}",
    "motor.gain: {gain: 0.9}", "servo.gain: {gain: 0.8}", "motor.delay: {delay: 0.0063}",
    "motor.saturation: {limit: 0.2}, motor.gain: {gain: 1.4}", "servo.delay: {delay: 0.02}",
    "servo.stiffness: {stiffness: 0.7}, servo.strength: {strength: 0.5}, servo.gain: {gain: 0.9}",
    "servo.force_limit: {limit: 0.02}", "pole.mass: {mass: 0.1}", "mount.tilt: {x: 0.05, y: -0.1}",
    "pole.payload: {mass: 0.1, place_x: 0.1, place_y: 0.0, place_z: -0.5}",
)  # fmt: skip
"""Effects that MuJoCo holds as they are."""
ROUNDED = 1e-6
"""MuJoCo writes the numbers of an MJCF that nobody changes to six digits."""
TURN = 2.0 * 1.5 / (2.2 * 500.0)
"""Velocity by which its friction of 1.5 N turns late, as it brakes at 500 /s [m/s] (docs/twin.md)."""


def write_twin(folder: Path, effects: str) -> Path:
    """The cart's twin with effects."""
    (folder / "cart.xml").write_text(CART)
    (folder / "twin.yaml").write_text(SIGNALS % effects)
    return folder / "twin.yaml"


def compare(twin: Path, out: Path) -> tuple[str, np.ndarray]:
    """Text of the MJCF, and the numbers of the rollouts, (nv, 4)."""
    spec = load_twin(twin)
    held = hold(spec)
    out.write_text(write_mjcf(spec, held, out.parent))
    return out.read_text(), np.array([row[1:] for row in compare_rollouts(spec, held, out)])


@pytest.mark.parametrize("effects", EXACT)
def test_what_mujoco_holds_moves_as_the_twin(tmp_path: Path, effects: str) -> None:
    """To the digits of the file, where the MJCF before was far off."""
    text, numbers = compare(write_twin(tmp_path, effects), tmp_path / "out.xml")
    moves, from_held, from_twin, before = numbers.T
    assert (from_twin == from_held).all()
    assert (from_twin < ROUNDED * np.maximum(moves, 1.0)).all()
    assert before.max() > 1000.0 * from_twin.max()
    assert f"<!-- {effects.split(':')[0]}: " in text


@pytest.mark.parametrize(
    ("effects", "late"),
    [("slide.coulomb: {force: 1.5}", TURN), ("motor.lag: {time_constant: 0.02}", 0.5 * 0.001 * 20.0 * 0.8 / 2.2)],
    ids=["friction that turns late", "half a step of the largest acceleration"],
)
def test_what_it_holds_in_its_own_way(tmp_path: Path, effects: str, late: float) -> None:
    """Within what follows from how it does: a velocity that is off by so much for a second."""
    _, numbers = compare(write_twin(tmp_path, effects), tmp_path / "out.xml")
    assert (numbers[:, 2] < late * np.array([1.0, 5.0])).all()  # the pole, 0.25 m to its middle, swings along
    assert (numbers[:, 2] < 0.1 * numbers[:, 3]).all()


OWN = """<?xml version="1.0"?>
<!-- Ours, since 2019. -->
<mujoco   model='cart'>
  <compiler angle="degree"/>
  <default><default class="drive"><motor gear="20"/></default></default>
  <worldbody>
    <body name="cart">   <!-- on a rail -->
      <joint name="slide" type="slide"
             axis="1 0 0" damping='0.2'/>
      <geom type="box" size="0.1 0.05 0.05" mass="2"/>
      <body name="pole">
        <inertial pos="0 0 -0.25" mass="0.2" fullinertia="0.005 0.005 0.001 0 0 0"></inertial>
        <joint name="swing" type="hinge" axis="0 -1 0" stiffness="0.1" springref="20"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor class="drive" name="motor" joint="slide"/> <motor name="servo" joint="swing" forcerange="-4 4"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("effects", "old", "new"),
    [
        ("slide.viscous: {damping: 0.3}", "damping='0.2'/>", 'damping="0.5"/>'),
        ("swing.spring: {stiffness: 0.1, rest: 0.0}", 'stiffness="0.1" springref="20"',
         'stiffness="0.2" springref="10.0"'),
        ("motor.gain: {gain: 0.9}", 'name="motor" joint="slide"/>', 'name="motor" joint="slide" gear="18.0"/>'),
        ("motor.delay: {delay: 0.006}", 'joint="slide"/> ',
         'joint="slide" delay="0.006" nsample="5" interp="linear"/> '),
        ("servo.gain: {gain: 0.5}", '<motor name="servo" joint="swing" forcerange="-4 4"/>',
         '<general name="servo" joint="swing" forcerange="-4 4" gainprm="0.5 0.0 0.0"/>'),
        ("pole.mass: {mass: 0.2}",
         '<inertial pos="0 0 -0.25" mass="0.2" fullinertia="0.005 0.005 0.001 0 0 0"></inertial>',
         '<inertial pos="0.0 0.0 -0.25" quat="1.0 0.0 0.0 0.0" mass="0.4" diaginertia="0.01 0.01 0.002"></inertial>'),
    ],
)  # fmt: skip
def test_the_users_text_stays_as_it_is(tmp_path: Path, effects: str, old: str, new: str) -> None:
    """But for comments and what changes; a `<motor>` stays one unless no motor has that attribute."""
    twin = write_twin(tmp_path, effects)
    (tmp_path / "cart.xml").write_text(OWN)
    text, _ = compare(twin, tmp_path / "out.xml")
    text = re.sub(r"\s*<!-- Written by .*? -->", "", text)
    assert re.sub(rf"<!-- {effects.split(':')[0]}: .*? -->\s*", "", text) == OWN.replace(old, new)


def test_a_text_in_pieces_is_flattened(tmp_path: Path) -> None:
    """Elements of an included file are in none of ours."""
    twin = write_twin(tmp_path, "slide.viscous: {damping: 0.3}")
    (tmp_path / "part.xml").write_text(
        f"<mujoco>{OWN[OWN.index('<worldbody>') : OWN.index('</worldbody>')]}</worldbody></mujoco>"
    )
    (tmp_path / "cart.xml").write_text('<mujoco><include file="part.xml"/><actuator><motor name="motor" joint="slide"/>'
                                       '<motor name="servo" joint="swing"/></actuator></mujoco>')  # fmt: skip
    text, numbers = compare(twin, tmp_path / "out.xml")
    assert "<include" not in text
    assert (numbers[:, 2] < ROUNDED * np.maximum(numbers[:, 0], 1.0)).all()


@pytest.mark.parametrize(
    "effects", ["quad.mass: {mass: 0.004}", "quad.com: {x: 0.002, y: -0.001}", "quad.inertia: {x: 1.2, y: 0.9}"]
)
def test_a_body_that_flies(tmp_path: Path, effects: str) -> None:
    """Its mass, centre of mass and inertia."""
    (tmp_path / "quadrotor.xml").write_text(quadrotor.MJCF)
    (tmp_path / "twin.yaml").write_text(f"{quadrotor.TWIN}effects: {{{effects}}}\n")
    _, numbers = compare(tmp_path / "twin.yaml", tmp_path / "out.xml")
    assert (numbers[:, 2] < ROUNDED).all()
    assert numbers[:, 3].max() > 1e-4


def test_export_says_what_it_held_and_missed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A comment with the interval at each change, a list of the rest in file and output, the rollouts in numbers."""
    twin = write_twin(tmp_path, "slide.coulomb: {force: 1.5}, slide.stiction: {force: 0.3}, motor.backlash: {gap: 0.1}")
    out = tmp_path / "sub" / "out.xml"
    assert main(["export", str(twin), "--format", "mjcf", "--out", str(out)]) == 0
    said, text = capsys.readouterr().out, out.read_text()
    assert '<!-- slide.coulomb: force = 1.5 N (90 %: 1.4 to 1.6) -->\n      <joint name="slide"' in text
    assert "held: slide.coulomb: force = 1.5 N (90 %: 1.4 to 1.6)\n" in said
    for lost in ("slide.stiction: force = 0.3 N", "motor.backlash: gap = 0.1 ctrl"):
        assert f"not held: {lost}" in said
        assert f"<!-- Not held: {lost}" in text
    assert "moves by  from what is held  from the twin  of the MJCF before\nslide" in said
    assert mujoco.MjModel.from_xml_path(str(out)).dof_frictionloss[0] == 1.5


def test_meshes_are_found_from_elsewhere(tmp_path: Path) -> None:
    """An MJCF with meshes beside it, exported into another folder; a body's mass that geoms gave becomes its own."""
    (tmp_path / "meshes").mkdir()
    corners = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    (tmp_path / "meshes" / "box.obj").write_text(f"{corners}\nf 1 2 3\nf 2 4 3\nf 5 7 6\nf 6 7 8\nf 1 3 5\nf 3 7 5\n"
                                                 "f 2 6 4\nf 4 6 8\nf 1 5 2\nf 2 5 6\nf 3 4 7\nf 4 8 7\n")  # fmt: skip
    (tmp_path / "m.xml").write_text(
        '<mujoco><compiler meshdir="meshes" inertiafromgeom="true"/><asset><mesh name="box" file="box.obj"/></asset>'
        '<worldbody><body name="b"><freejoint/><geom type="mesh" mesh="box"/></body></worldbody></mujoco>'
    )
    (tmp_path / "t.yaml").write_text("model: m.xml\nsignals: {bodies: {b: /pose}}\neffects: {b.mass: {mass: 100.0}}\n")
    (tmp_path / "sub").mkdir()
    spec, out = load_twin(tmp_path / "t.yaml"), tmp_path / "sub" / "out.xml"
    out.write_text(write_mjcf(spec, hold(spec), out.parent))
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.body("b").mass[0] == pytest.approx(1100.0, rel=1e-6)
    np.testing.assert_allclose(model.body("b").ipos, spec.model.body("b").ipos, rtol=1e-6)
    np.testing.assert_allclose(model.body("b").inertia, spec.model.body("b").inertia, rtol=1e-6)


def test_the_drone(tmp_path: Path) -> None:
    """What its rig and airframe have is held, rotors and sensors are not; it falls and slides as the twin."""
    (tmp_path / "t.yaml").write_text(
        "model: rail_rig.xml\nvehicle: vehicle.yaml\neffects:\n  rail_x.viscous: {damping: 0.4}\n"
        "  airframe.com: {offset: 0.004}\n  airframe.mass: {mass: 0.02}\n  rail.tilt: {angle: 0.02}\n"
        "  carriage.mass: {mass: 0.03}\n  servo.lag: {time_constant: 0.03}\n  gyro.bias: {bias: 0.02}\n"
    )
    spec = load_twin(tmp_path / "t.yaml")
    assert {effect.id for effect, _ in hold(spec).lost} == {"servo.lag", "gyro.bias"}
    _, numbers = compare(tmp_path / "t.yaml", tmp_path / "out.xml")
    assert (numbers[:, 1] < ROUNDED).all()
    assert (numbers[:, 3] > 100.0 * numbers[:, 2]).all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nominal", "--format", "mjcf"], "no effect switched on"),
        (["twin.yaml", "--format", "c"], "choose another --format"),
        (["twin.yaml", "--format", "mjcf", "--out", "cart.xml"], "is the twin's own MJCF"),
        (["twin.yaml", "--format", "mjlab", "--out", "cart.xml"], "a name that ends in .py"),
        (["twin.yaml", "--format", "mjcf", "--twin", "typical"], "leave it out"),
        (["flip", "--format", "mjcf"], "no readable twin flip"),
    ],
)
def test_mistakes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    """One line, exit code 2."""
    write_twin(tmp_path, "slide.coulomb: {force: 1.5}")
    monkeypatch.chdir(tmp_path)
    assert main(["export", *arguments]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1


def test_events_of_mjlab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ranges from the intervals, single numbers from the rest; functions and arguments are those of mjlab 1.6."""
    effects = "slide.coulomb: {force: 1.5}, swing.spring: {stiffness: 0.2, rest: 0.3}, motor.delay: {delay: 0.006}"
    out = tmp_path / "events.py"
    assert main(["export", str(write_twin(tmp_path, effects)), "--format", "mjlab", "--out", str(out)]) == 0
    assert "not drawn: actuator motor delay: (0.006, 0.006)" in capsys.readouterr().out
    source = out.read_text()
    body = source[source.index("def randomize") :]
    drawn = {name: name for name in ("joint_friction", "joint_damping", "joint_armature", "joint_stiffness")}
    made = {"dr": type("dr", (), drawn), "EventTermCfg": dict, "SceneEntityCfg": lambda name, **which: (name, which)}
    exec(compile(body, str(out), "exec"), made)
    events = made["randomize"]("cart")  # type: ignore[operator]
    assert events["slide_joint_friction"] == {
        "mode": "startup", "func": "joint_friction",
        "params": {"asset_cfg": ("cart", {"joint_names": ("slide",)}), "operation": "abs", "ranges": (1.4, 1.6)},
    }  # fmt: skip
    low, high = events["swing_joint_stiffness"]["params"]["ranges"]
    assert (low, high) == pytest.approx((0.28, 0.32))  # beside the 0.1 of the MJCF
