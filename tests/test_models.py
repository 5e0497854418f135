"""The two MJCF models: they agree with vehicle.yaml, keep the frames of SPEC 1, and behave as a rig does."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from vpptwin.resources import models_dir
from vpptwin.twin.losses import take_out_losses
from vpptwin.vehicle import Vehicle, load_vehicle

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


def test_planar_moves_only_the_craft(vehicle: Vehicle) -> None:
    """The free craft carries no rig mass and meets neither limit nor contact."""
    planar, craft = load_model("vpp_planar"), vehicle.airframe
    np.testing.assert_allclose(mass_matrix(planar), np.diag([craft.mass, craft.mass, craft.inertia]), rtol=1e-12)
    assert not planar.jnt_limited.any()
    assert not (planar.geom_contype | planar.geom_conaffinity).any()


def test_rig_agrees_with_vehicle(rig: mujoco.MjModel, vehicle: Vehicle) -> None:
    """Carriage and slider add their mass to x, the slider to z; travel and rail height are those of vehicle.yaml."""
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


def test_free_craft_falls_freely(vehicle: Vehicle) -> None:
    """Without thrust the free craft falls by g t^2 / 2 and drifts at its speed."""
    planar = load_model("vpp_planar")
    data = place(planar)
    data.qvel[:] = 0.5, 0.0, 3.0
    steps, dt = 500, planar.opt.timestep
    mujoco.mj_step(planar, data, steps)
    fall = 0.5 * vehicle.gravity * dt**2 * steps * (steps + 1)  # semi-implicit Euler's sum, g t^2 / 2 + O(dt)
    np.testing.assert_allclose(data.qpos, [0.5 * steps * dt, 1.0 - fall, 3.0 * steps * dt], atol=1e-12)
    np.testing.assert_allclose(data.qvel, [0.5, -vehicle.gravity * steps * dt, 3.0], atol=1e-12)


def simulate(model: mujoco.MjModel, data: mujoco.MjData, duration: float) -> np.ndarray:
    """Step for `duration` [s]; returns qpos (n, 3) after each step."""
    path = np.empty((round(duration / model.opt.timestep), model.nq))
    for row in path:
        mujoco.mj_step(model, data)
        row[:] = data.qpos
    assert np.isfinite(path).all()
    return path


def hull_radius(model: mujoco.MjModel) -> float:
    """Radius [m] of the capsule that collides."""
    return float(model.geom("hull").size[0])


@pytest.mark.parametrize(
    ("z", "pitch"),
    [
        pytest.param(0.30, 0.0, id="level, onto the end stop"),
        pytest.param(0.515, math.pi / 2, id="on its right tip, 0.3 m above the floor"),
        pytest.param(0.515, -math.pi / 2, id="on its left tip, 0.3 m above the floor"),
    ],
)
def test_dropped_craft_rebounds(rig: mujoco.MjModel, z: float, pitch: float) -> None:
    """A drop rebounds, lower than it fell from, and comes to rest."""
    height = simulate(rig, place(rig, z=z, pitch=pitch), duration=3.0)[:, Z]
    lowest = int(height.argmin())
    fallen, risen = z - height[lowest], height[lowest:].max() - height[lowest]
    assert 0.1 * fallen < risen < 0.5 * fallen  # the shipped stiffness gives a restitution of about 0.4
    assert np.ptp(height[-500:]) < 0.005  # m; a tip is a rocking point, it settles slowly


@pytest.mark.parametrize("pitch", [0.0, 0.5, 1.0, math.pi / 2, 2.0, math.pi])
def test_nothing_passes_the_floor(rig: mujoco.MjModel, vehicle: Vehicle, pitch: float) -> None:
    """At 6 m/s downwards the axis of the hull stays above the floor."""
    data = place(rig, z=0.6, pitch=pitch)
    data.qvel[Z] = -6.0
    path = simulate(rig, data, duration=1.0)
    lower_tip = path[:, Z] - vehicle.airframe.half_length * np.abs(np.sin(path[:, PITCH]))
    assert lower_tip.min() > 0.0  # the hull (radius 15 mm) sinks in by 13 mm
    assert path[:, Z].min() > vehicle.rig.travel_z[0] - hull_radius(rig)


@pytest.mark.parametrize("pitch", [0.0, 0.3, -0.5, 1.0, math.pi / 2])
@pytest.mark.parametrize("z", [0.4, 1.5])
def test_nothing_passes_the_wall(rig: mujoco.MjModel, vehicle: Vehicle, pitch: float, z: float) -> None:
    """At 6 m/s to the right the axis of the hull stays before the wall, the carriage at its end stop."""
    wall = rig.geom("wall")
    face = wall.pos[0] - wall.size[0]
    data = place(rig, x=1.0, z=z, pitch=pitch)
    data.qvel[X] = 6.0
    path = simulate(rig, data, duration=0.5)
    right_tip = path[:, X] + vehicle.airframe.half_length * np.abs(np.cos(path[:, PITCH]))
    assert right_tip.max() < face
    assert path[:, X].max() < vehicle.rig.travel_x[1] + hull_radius(rig)


@pytest.mark.parametrize("pitch", [0.0, 0.3, 1.0, math.pi / 2])
@pytest.mark.parametrize("velocity", [(0.0, -6.0, 0.0), (6.0, 0.0, 0.0), (4.0, -4.0, 10.0)])
def test_contact_takes_energy(rig: mujoco.MjModel, pitch: float, velocity: tuple[float, float, float]) -> None:
    """Hitting floor, wall and end stops (velocity [m/s, m/s, rad/s]) leaves less energy than before."""
    rig.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = place(rig, x=1.0, z=0.6, pitch=pitch)
    data.qvel[:] = velocity
    mujoco.mj_forward(rig, data)
    before = data.energy.sum()
    simulate(rig, data, duration=1.0)
    mujoco.mj_forward(rig, data)
    assert data.energy.sum() < before - 1.0  # J, of about 10


@pytest.mark.parametrize("joint", [X, Z], ids=JOINTS[:2])
@pytest.mark.parametrize("friction", [0.05, 0.3, 2.0])
@pytest.mark.parametrize("support", ["thrust", "hand"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_pushed_slider_stands_still(
    model: mujoco.MjModel, joint: int, friction: float, support: str, direction: float
) -> None:
    """Pushed with 80 % of its breakaway force [N], a slider carried by thrust or hand creeps below 0.1 mm in 10 s."""
    model.dof_frictionloss[joint] = friction
    data = place(model)
    weight = data.qfrc_bias[Z]
    if support == "thrust":
        data.ctrl[:] = weight / 2.0
    else:
        data.qfrc_applied[Z] = weight
    data.qfrc_applied[joint] += 0.8 * direction * friction
    mujoco.mj_step(model, data, round(10.0 / model.opt.timestep))
    assert abs(data.qpos[joint] - place(model).qpos[joint]) < 1e-4


@pytest.mark.parametrize("joint", [X, Z], ids=JOINTS[:2])
def test_slider_gives_way_beyond_breakaway(model: mujoco.MjModel, joint: int) -> None:
    """Pushed with 120 % of its breakaway force a slider accelerates with the surplus: it is not merely stuck."""
    friction, duration = 0.3, 1.0
    model.dof_frictionloss[joint] = friction
    data = place(model)
    data.ctrl[:] = data.qfrc_bias[Z] / 2.0
    data.qfrc_applied[joint] = 1.2 * friction
    mujoco.mj_step(model, data, round(duration / model.opt.timestep))
    expected = 0.2 * friction * duration / mass_matrix(model)[joint, joint]
    assert data.qvel[joint] == pytest.approx(expected, rel=0.01)


def test_vehicle_is_the_agreed_one() -> None:
    """The vehicle.yaml that ships equals the one that the interfaces were agreed on."""
    if not SHARED_VEHICLE.is_file():
        pytest.skip(f"needs {SHARED_VEHICLE}")
    shipped = models_dir() / "vehicle.yaml"
    assert yaml.safe_load(shipped.read_text()) == yaml.safe_load(SHARED_VEHICLE.read_text())
