"""Every line by which an MJCF, its signals or a log of it are refused, as docs/refusals.md lists them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vpptwin.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
BODY = '<geom type="sphere" size="0.05" pos="0 0 -0.3" mass="1"/><site name="tip" pos="0 0 -0.3"/>'
SWING, BALL, FREE = '<joint name="swing" axis="0 1 0"/>', '<joint name="hook" type="ball"/>', "<freejoint/>"
BOB = f'<body name="bob" pos="0 0 -0.3">{BALL}<geom size="0.05" mass="1"/></body>'
JOINTS, MOTORS = "joints: {swing: /joint_states}", "actuators: {m: /motors}"


def rig(joint: str = SWING, inner: str = "", rest: str = "", pre: str = "", world: str = "") -> str:
    """The MJCF of an arm."""
    body = f'<body name="arm">{joint}{BODY}{inner}</body>'
    return f"<mujoco>{pre}<worldbody>{world}{body}</worldbody>{rest}</mujoco>"


def driven(what: str) -> str:
    """The MJCF of an arm with this actuator."""
    return rig(rest=f"<actuator>{what}</actuator>")


MOTOR = '<actuator><motor joint="swing"/></actuator>'
HAND = '<body name="hand" mocap="true"/>'
TENDON = '<tendon><fixed name="t" actuatorfrcrange="-1 1"><joint joint="swing" coef="1"/></fixed></tendon>'
CASES = (
    (driven('<muscle name="m" joint="swing" lengthrange="0 1"/>'), JOINTS),
    (driven('<general name="m" joint="swing" dyntype="integrator"/>'), JOINTS),
    (driven('<dcmotor name="m" joint="swing" motorconst="0.05" resistance="1" inductance="0.001"/>'), JOINTS),
    (driven('<pid name="m" joint="swing" kp="1"/>'), JOINTS),
    (rig(pre='<extension><plugin plugin="mujoco.pid"/></extension>',
         rest='<actuator><plugin name="m" joint="swing" plugin="mujoco.pid"/></actuator>'), JOINTS),
    (driven('<position name="m" joint="swing" kp="5" timeconst="1"/>'), JOINTS),
    (rig(rest=f'{TENDON}<actuator><motor name="m" tendon="t"/></actuator>'), JOINTS),
    (rig(pre='<option actuatorgroupdisable="0"/>', rest=MOTOR), JOINTS),
    (rig(pre='<option><flag actuation="disable"/></option>', rest=MOTOR), JOINTS),
    (rig(pre='<option><flag clampctrl="disable"/></option>', rest=MOTOR), JOINTS),
    (rig(pre='<option integrator="RK4"/>'), JOINTS),
    (rig(pre='<option integrator="discrete"/>'), JOINTS),
    (rig(pre='<option><flag sleep="enable"/></option>'), JOINTS),
    (rig(pre='<size memory="600M"/>'), JOINTS),
    (rig(joint=""), JOINTS),
    (rig(joint='<joint name="swing" axis="0 0 0"/>'), JOINTS),
    (rig(joint='<joint name="swing" type="slide" axis="1e300 0 1"/>'), JOINTS),
    (rig(), ""),
    (rig(), "driven: {swing: /joint_states}"),
    (rig(inner=BOB), JOINTS),
    (rig(inner=BOB), f"{JOINTS}, bodies: {{bob: /pose}}"),
    (rig(joint=FREE), "bodies: {leg: /pose}"),
    (rig(world=HAND), f"{JOINTS}, driven: {{hand: /pose}}"),
    (rig(), "joints: {swung: /joint_states}"),
    (rig(), f"{JOINTS}, driven: {{swing: /joint_states}}"),
    (rig(), f"{JOINTS}, turned: [swing]"),
    (rig(), f"{JOINTS}, {MOTORS}"),
    (rig(), f"{JOINTS}, sites: {{tip: /imu}}"),
    (rig(joint=FREE), "bodies: {arm: /pose}, sites: {tip: {topic: log, acceleration: [ax, ay, az]}}"),
    (rig(), "joints: {swing: {topic: log, position: {path: a, unit: furlong}}}"),
    (rig(), f"{JOINTS}, tendons: {{t: /tendon}}"),
)  # fmt: skip
"""An MJCF, and the signals of its twin."""
LOGGED = (
    (rig(), JOINTS),
    (rig(), "joints: {swing: {topic: log, velocity: v}}"),
    (rig(joint=BALL), "joints: {hook: {topic: log, position: v}}"),
    (rig(joint=BALL), "joints: {hook: {topic: log, attitude: [v, v]}}"),
    (rig(joint=FREE), "bodies: {arm: {topic: log, position: [v, v, v]}}"),
    (driven('<motor name="m" joint="swing"/>'),
     "joints: {swing: {topic: log, position: v}}, actuators: {m: {topic: log, position: v, velocity: v}}"),
    (rig(), "joints: {swing: {topic: log, position: w}}"),
    (rig(), "joints: {swing: {topic: log, position: v}}"),
)  # fmt: skip
"""The same, of a log of 2 s with one column."""
PROVOKED: set[str] = set()
"""Lines that the cases of this run ended in."""


def list_shown() -> list[str]:
    """The lines of docs/refusals.md."""
    page = (ROOT / "docs/refusals.md").read_text(encoding="utf-8")
    return [line for block in re.findall(r"```text\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]


@pytest.mark.parametrize("number", range(len(CASES) + len(LOGGED)))
def test_every_refusal_is_one_line_of_the_list(
    number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was found, what was expected, what to do; exit code 2."""
    monkeypatch.chdir(tmp_path)
    xml, signals = (*CASES, *LOGGED)[number]
    Path("rig.xml").write_text(xml)
    Path("rig.yaml").write_text("model: rig.xml\n" + (f"signals: {{{signals}}}\n" if signals else ""))
    rows = "".join(f"{0.01 * i:.2f},{(0.1 * i) % 1.7:.3f}\n" for i in range(200))
    Path("log.csv").write_text(f"time,v\n{rows}")
    command = (
        ["effects", "--twin", "rig.yaml"]
        if number < len(CASES)
        else ["diagnose", "log.csv", "--twin", "rig.yaml", "--out", "out"]
    )
    assert main(command) == 2
    said = capsys.readouterr().err.replace(f"{tmp_path}/", "").splitlines()[-1]
    assert said in list_shown()
    PROVOKED.add(said)


def test_the_list_has_nothing_else() -> None:
    """Every line is provoked, and stands there once."""
    assert len(set(list_shown())) == len(list_shown())
    if len(PROVOKED) > 1:  # not where this test runs alone
        assert set(list_shown()) == PROVOKED
