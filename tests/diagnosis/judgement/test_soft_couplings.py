"""Equalities of an MJCF that give, which is told where a twin is far off."""

from __future__ import annotations

import mujoco
import pytest

from vpptwin.diagnosis.judgement.conclusion import describe_soft_couplings

FINGERS = """<mujoco><worldbody><body><joint name="left" type="slide"/><geom size="0.01" mass="0.2"/></body>
<body><joint name="right" type="slide"/><geom size="0.01" mass="0.2"/></body></worldbody>
<equality><joint joint1="right" joint2="left" %s/></equality></mujoco>"""


@pytest.mark.parametrize(
    ("setting", "told"),
    [("", "equality 0 of the MJCF gives (solimp up to 0.95)"),
     ('name="mimic" solimp="0.5 0.6 0.001"', "equality mimic of the MJCF gives (solimp up to 0.6)"),
     ('solimp="0.9999 0.9999 0.001"', None), ('active="false"', None)],
)  # fmt: skip
def test_soft_couplings_are_told(setting: str, told: str | None) -> None:
    """With MuJoCo's own softness or more; not where it is rigid, or does nothing."""
    lines = describe_soft_couplings(mujoco.MjModel.from_xml_string(FINGERS % setting))
    assert [line.split(":")[0] for line in lines] == ([] if told is None else [told])
