"""The pictures of the effect table: each effect shows in its own, and the pictures in the docs are there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from vpptwin.robots.planar_drone.display.fingerprint import SIZES, draw_fingerprint, fly, take_fingerprint
from vpptwin.twin import TwinSpec, load_twin

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def spec() -> TwinSpec:
    """The nominal drone."""
    return load_twin()


def test_the_flight_moves_every_way_and_hovers_inverted(spec: TwinSpec) -> None:
    """The flight behind the pictures stays in the rig's travel, crosses most of it, and is upside-down for a second."""
    states, commands = fly(spec, ("rail_x.coulomb",))
    x, z, theta = states.qpos.T
    assert np.ptp(x) > 0.9
    assert np.ptp(z) > 0.7
    assert np.mean(np.cos(theta) < -0.9) > 1.0 / 9.0
    assert (np.abs(x) < 1.4).all()
    assert ((z > 0.3) & (z < 2.4)).all()
    assert commands.shape == (len(x), 5, 2)


def test_dry_friction_draws_its_law(spec: TwinSpec) -> None:
    """Where the slider moves fast, friction of F decelerates it by F over the moving mass, against the velocity."""
    effect = next(e for e in spec.catalogue if e.id == "rail_x.coulomb")
    taken = take_fingerprint(spec, effect)
    moving = 0.45 + 0.05 + 0.08  # kg, vehicle.yaml
    fast = np.abs(taken.cause) > 0.2
    expected = -np.sign(taken.cause) * effect.parameters[0].away(SIZES) / moving
    assert taken.trace.name == "ẍ [m/s²]"
    np.testing.assert_allclose(taken.trace.departure[fast], expected[fast], rtol=0.02)


@pytest.mark.parametrize("effect_id", ["mocap.delay", "rail_x.asymmetry", "battery.sag"])
def test_every_kind_of_effect_has_a_picture(spec: TwinSpec, effect_id: str, tmp_path: Path) -> None:
    """Sensors, effects that change another one and motors show in their own signals, well above noise."""
    taken = take_fingerprint(spec, next(e for e in spec.catalogue if e.id == effect_id))
    assert np.abs(taken.trace.departure).max() > 5 * taken.trace.noise
    (tmp_path / "picture.png").write_bytes(draw_fingerprint(taken))
    assert imread(tmp_path / "picture.png")[..., 3].max() > 0.5  # something is drawn


def test_the_docs_have_a_picture_of_every_effect(spec: TwinSpec) -> None:
    """docs/effects holds a picture of each effect that acts in flight (`vpptwin effects --pictures docs/effects`)."""
    found = {file.stem for file in (ROOT / "docs/effects").glob("*.png")}
    assert found == {effect.id for effect in spec.catalogue if not effect.touching}
