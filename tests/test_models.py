"""The two MJCF models: they agree with vehicle.yaml, keep the frames, and behave as a rig does.

Frames: x to the right, z up, pitch counter-clockwise seen so; thrust along the body's z.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.resources import models_dir
from vpptwin.twin.robot.losses import take_out_losses

MODELS = ("vpp_planar", "rail_rig")
JOINTS = ("rail_x", "rail_z", "pitch")
X, Z, PITCH = 0, 1, 2
SHARED_VEHICLE = Path(__file__).resolve().parents[2] / "shared" / "vehicle.yaml"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    """The nominal numbers."""
    return load_vehicle()


def load_model(name: str) -> mujoco.MjModel:
    """Compile one of the shipped models without its friction, damping and air, as a twin does; those have own tests."""
    spec = mujoco.MjSpec.from_file(str(models_dir() / f"{name}.xml"))
    take_out_losses(spec, JOINTS)
    return spec.compile()


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> mujoco.MjModel:
    """Each shipped model in turn, freshly compiled, so that a test may edit it."""
    return load_model(request.param)


@pytest.fixture
def rig() -> mujoco.MjModel:
    """The rail rig, freshly compiled."""
    return load_model("rail_rig")


def place(model: mujoco.MjModel, x: float = 0.0, z: float = 1.0, pitch: float = 0.0) -> mujoco.MjData:
    """Put the craft at rest at x, z [m] and pitch [rad]."""
    data = mujoco.MjData(model)
    data.qpos[:] = x, z, pitch
    mujoco.mj_forward(model, data)
    return data


def mass_matrix(model: mujoco.MjModel) -> np.ndarray:
    """Joint-space inertia (3, 3) [kg, kg, kg m^2 on the diagonal] of the level craft."""
    data = place(model)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def test_models_share_their_joints(model: mujoco.MjModel) -> None:
    """Both models have the joints rail_x, rail_z, pitch in this order, along x, along z, and about -y."""
    assert [model.joint(j).name for j in range(model.njnt)] == list(JOINTS)
    assert list(model.jnt_dofadr) == [X, Z, PITCH]
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    assert list(model.jnt_type) == [slide, slide, hinge]
    np.testing.assert_array_equal(model.jnt_axis, [[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def test_models_agree_with_vehicle(model: mujoco.MjModel, vehicle: Vehicle) -> None:
    """Mass, inertia, arm, gravity and time step of both models are those of vehicle.yaml."""
    craft, inertia_about_y = model.body("craft"), 1
    assert craft.mass[0] == vehicle.airframe.mass
    assert craft.inertia[inertia_about_y] == vehicle.airframe.inertia
    np.testing.assert_array_equal(craft.ipos, 0.0)  # centre of mass on the hinge
    np.testing.assert_array_equal(model.site("rotor_1").pos, [-vehicle.airframe.half_length, 0, 0])
    np.testing.assert_array_equal(model.site("rotor_2").pos, [vehicle.airframe.half_length, 0, 0])
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -vehicle.gravity])
    assert model.opt.timestep == 1.0 / vehicle.control.inner_rate


def test_nominal_model_has_no_effects(model: mujoco.MjModel) -> None:
    """Nothing that the catalogue calls an effect is hidden in the models once their losses are taken out."""
    for name in ("dof_frictionloss", "dof_damping", "dof_armature", "jnt_stiffness", "geom_fluid"):
        np.testing.assert_array_equal(getattr(model, name), 0.0, err_msg=name)
    assert model.opt.density == 0.0
    assert model.opt.viscosity == 0.0
    np.testing.assert_array_equal(model.opt.wind, 0.0)


def test_planar_and_rig_agree_with_vehicle(vehicle: Vehicle, rig: mujoco.MjModel) -> None:
    """The free craft carries no rig mass and meets neither limit nor contact."""
    planar, craft = load_model("vpp_planar"), vehicle.airframe
    np.testing.assert_allclose(mass_matrix(planar), np.diag([craft.mass, craft.mass, craft.inertia]), rtol=1e-12)
    assert not planar.jnt_limited.any()
    assert not (planar.geom_contype | planar.geom_conaffinity).any()
    # Carriage and slider add their mass to x, the slider to z; travel and rail height are those of vehicle.yaml.
    assert rig.body("carriage").mass[0] == vehicle.rig.carriage_mass
    assert rig.body("slider").mass[0] == vehicle.rig.slider_mass
    moving_z = vehicle.airframe.mass + vehicle.rig.slider_mass
    expected = np.diag([moving_z + vehicle.rig.carriage_mass, moving_z, vehicle.airframe.inertia])
    np.testing.assert_allclose(mass_matrix(rig), expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(rig.joint("rail_x").range, vehicle.rig.travel_x)
    np.testing.assert_array_equal(rig.joint("rail_z").range, vehicle.rig.travel_z)
    assert list(rig.jnt_limited) == [True, True, False]
    assert rig.geom("rail").pos[2] == vehicle.rig.rail_height


def test_positions_are_those_of_the_hinge(model: mujoco.MjModel) -> None:
    """rail_x and rail_z are the world coordinates of the hinge, and of the IMU mounted there."""
    data = place(model, x=0.3, z=0.8, pitch=0.7)
    np.testing.assert_allclose(data.joint("pitch").xanchor, [0.3, 0.0, 0.8], atol=1e-15)
    np.testing.assert_allclose(data.site("imu").xpos, [0.3, 0.0, 0.8], atol=1e-15)


@pytest.mark.parametrize("pitch", [0.4, -1.2, 2.5])
def test_positive_pitch_is_counter_clockwise(model: mujoco.MjModel, vehicle: Vehicle, pitch: float) -> None:
    """Seen with x right and z up, a positive pitch lifts the right arm: rotor_2 at l (cos, sin), rotor_1 opposite."""
    data = place(model, pitch=pitch)
    arm = vehicle.airframe.half_length * np.array([math.cos(pitch), 0.0, math.sin(pitch)])
    np.testing.assert_allclose(data.site("rotor_2").xpos - [0, 0, 1], arm, atol=1e-12)
    np.testing.assert_allclose(data.site("rotor_1").xpos - [0, 0, 1], -arm, atol=1e-12)


@pytest.mark.parametrize("pitch", [0.0, 0.4, -1.2, math.pi])
@pytest.mark.parametrize("thrusts", [(2.0, 3.0), (-1.0, 0.5), (-2.0, -2.0)])
def test_thrust_follows_the_paper(
    model: mujoco.MjModel, vehicle: Vehicle, pitch: float, thrusts: tuple[float, float]
) -> None:
    """Thrusts f1, f2 give the force f (-sin, cos) and the pitch acceleration (f2 - f1) l / I of the paper's Eq. 2."""
    data = place(model, pitch=pitch)
    data.ctrl[:] = thrusts
    mujoco.mj_forward(model, data)
    total, moment = sum(thrusts), (thrusts[1] - thrusts[0]) * vehicle.airframe.half_length
    force = [-total * math.sin(pitch), total * math.cos(pitch), moment]
    np.testing.assert_allclose(data.qfrc_actuator, force, atol=1e-12)
    assert data.qacc[PITCH] == pytest.approx(moment / vehicle.airframe.inertia, abs=1e-9)


def test_vehicle_is_the_agreed_one() -> None:
    """The vehicle.yaml that ships equals the one that the interfaces were agreed on."""
    if not SHARED_VEHICLE.is_file():
        pytest.skip(f"needs {SHARED_VEHICLE}")
    shipped = models_dir() / "vehicle.yaml"
    assert yaml.safe_load(shipped.read_text()) == yaml.safe_load(SHARED_VEHICLE.read_text())
