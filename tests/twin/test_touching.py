"""Effects where bodies touch: what MuJoCo makes of them, which rigs have them, and what they leave as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.twin import Twin, TwinSpec, load_twin

BALLS = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<geom name="floor" type="plane" size="5 5 0.1" {solref}/>
<body pos="0 0 0.1"><joint name="fall" type="slide" axis="0 0 1"/><joint name="slip" type="slide" axis="1 0 0"/>
<geom name="ball" size="0.1" mass="1" {solref}/></body>
<body pos="1 0 0.1"><joint name="held" type="slide" axis="1 0 0"/>
<geom name="other" size="0.1" mass="1" contype="{other}" conaffinity="{other}"/></body>
</worldbody>{contact}</mujoco>"""
SIGNALS = "model: balls.xml\nsignals: {joints: {fall: /j, slip: /j, held: /j}}\n"
PAIR = '<contact><pair name="grip" geom1="other" geom2="floor" friction="0.5 0.5 0.01 0.01 0.01"/></contact>'


def load(folder: Path, solref: str = "", contact: str = "", other: int = 1) -> TwinSpec:
    """A ball that falls and slips on a floor, and one that slips along it."""
    text = BALLS.format(solref=solref and f'solref="{solref}"', contact=contact, other=other)
    (folder / "balls.xml").write_text(text)
    (folder / "balls.yaml").write_text(SIGNALS)
    return load_twin(folder / "balls.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("solref", ["0.01 0.3", "-120000 -200"])
def test_compliance_is_that_of_spring_and_damper(solref: str, tmp_path: Path) -> None:
    """A quarter of the stiffness swings for twice as long; times damping 2 leaves less; in both of MuJoCo's formats."""
    spec = load(tmp_path, solref)
    twin = Twin(spec, 4, ["contact.compliance"], num_threads=1)
    twin.set_parameter("contact.compliance", "stiffness", np.array([1.0, 0.25, 1.0, 0.25]))
    twin.set_parameter("contact.compliance", "damping", np.array([1.0, 1.0, 2.0, 0.5]))
    start = twin.initial_state(qvel=np.tile([-0.3, 0.0, 0.0], (4, 1)))
    speed = twin.replay_commands(start, np.zeros((4, 80, 0))).qvel[:, :, 0]
    turned = (speed < 0.0).sum(axis=1)  # steps until it moves up again
    left = speed[:, -1] / 0.3
    assert turned[3] == pytest.approx(2 * turned[0], abs=1)  # the same damping ratio, half the frequency
    assert left[3] == pytest.approx(left[0], abs=0.05)
    assert turned[0] < turned[1]
    assert left[2] < left[0] - 0.1
    assert left[1] < left[0] - 0.1


def test_rigs_have_what_they_can_touch(tmp_path: Path) -> None:
    """Nothing without geoms that meet; a named pair has a friction of its own, and only that changes."""
    spec = load(tmp_path, contact=PAIR, other=0)
    assert [e.id for e in spec.catalogue if e.touching] == ["contact.compliance", "contact.friction", "grip.friction"]
    twin = Twin(spec, 2, ["grip.friction"], num_threads=1)
    twin.set_parameter("grip.friction", "gain", np.array([1.0, 3.0]))
    start = twin.initial_state(qvel=np.tile([0.0, 0.0, 1.0], (2, 1)), qpos=np.zeros((2, 3)))
    end = twin.replay_commands(start, np.zeros((2, 1, 0)))
    assert end.qvel.shape == (2, 1, 3)
    np.testing.assert_allclose(twin.table["pair_friction"][:, 0, :3], [[0.5, 0.5, 0.01], [1.5, 1.5, 0.01]])
    (tmp_path / "free.xml").write_text(BALLS.format(solref="", contact="", other=0).replace(
        'name="ball" size', 'name="ball" contype="0" conaffinity="0" size'))  # fmt: skip
    (tmp_path / "free.yaml").write_text(SIGNALS.replace("balls", "free"))
    assert not [e for e in load_twin(tmp_path / "free.yaml").catalogue if e.touching]


def test_the_drone_is_stepped_as_without_them() -> None:
    """Stripped, and without MuJoCo where nothing touches."""
    spec = load_twin()
    twin = Twin(spec, 1, ["contact.compliance", "contact.friction"], num_threads=1)
    assert spec.stepped.ngeom < spec.model.ngeom
    assert twin.layout is not None
