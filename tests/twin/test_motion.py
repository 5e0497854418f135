"""Motion that can be foretold without a computer: hover, fall, conservation, mirror symmetry, dry friction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.twin.hover import (
    BLADE_PER_NEWTON,
    MASS_X,
    PITCH,
    SPEC,
    VEHICLE,
    WEIGHT,
    X,
    Z,
    coast,
    make_twin,
    place,
    share_kernel,
)
from vpptwin.twin import Twin, TwinSpec, load_twin


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The free craft: no rig mass, no end stops."""
    path: Path = tmp_path_factory.mktemp("planar") / "twin.yaml"
    path.write_text("model: vpp_planar.xml\nvehicle: vehicle.yaml\n")
    return load_twin(path)


@pytest.mark.parametrize(("angle", "thrust"), [(0.0, WEIGHT), (np.pi, -WEIGHT)], ids=["upright", "inverted"])
def test_hover_is_an_equilibrium(angle: float, thrust: float) -> None:
    """Under its weight in thrust and no rate the craft hangs still, through the whole cascade, upright or inverted."""
    twin = Twin(SPEC, 1)
    start = place(twin, np.array([[0.2, 1.3, angle]]), thrust=thrust)
    state = start
    for _ in range(100):
        state = twin.step_policy(state, np.array([[thrust, 0.0]]), 0.01)
    np.testing.assert_allclose(state.qpos, start.qpos, rtol=0, atol=1e-9)  # m, rad: rounding, over 1000 steps
    np.testing.assert_allclose(state.rotor_speed, VEHICLE.rotor.speed, rtol=1e-9)
    assert 0.3 < state.throttle.min() <= state.throttle.max() < 0.6
    assert state.time == pytest.approx(1.0)


def test_free_fall() -> None:
    """Without thrust the rig's craft falls by g t²/2 and drifts at its speed, on the engine's steps exactly."""
    pose, velocity = np.array([[-0.2, 2.2, 0.3]]), np.array([[0.4, 0.5, -2.0]])
    twin = Twin(SPEC, 1)
    path, speed = coast(twin, place(twin, pose, velocity), 0.5)
    time = twin.dt * np.arange(1, 501)[None, :, None]
    gravity = np.array([0.0, -VEHICLE.gravity, 0.0])
    np.testing.assert_allclose(path, pose[:, None] + velocity[:, None] * time + 0.5 * gravity * time**2, atol=1e-11)
    np.testing.assert_allclose(speed, velocity[:, None] + gravity * time, atol=1e-11)


def test_free_craft_conserves_energy_and_momentum(planar: TwinSpec) -> None:
    """Tumbling freely it keeps its spin and horizontal momentum; its weight acts on the rest, energy stays."""
    rng = np.random.default_rng(1)
    with share_kernel():
        twin = Twin(planar, 20)
    velocity = rng.uniform(-3, 3, (20, 3)) * [1, 1, 4]
    path, speed = coast(twin, place(twin, rng.uniform(-1, 1, (20, 3)), velocity), 1.0)
    airframe = VEHICLE.airframe
    np.testing.assert_allclose(speed[..., X], np.broadcast_to(velocity[:, None, X], speed.shape[:2]), atol=1e-12)
    np.testing.assert_allclose(
        speed[..., PITCH], np.broadcast_to(velocity[:, None, PITCH], speed.shape[:2]), atol=1e-12
    )
    np.testing.assert_allclose(speed[:, -1, Z] - velocity[:, Z], -VEHICLE.gravity, atol=1e-11)
    energy = (
        0.5 * airframe.mass * (speed[..., X] ** 2 + speed[..., Z] ** 2 + 2 * VEHICLE.gravity * path[..., Z])
        + 0.5 * airframe.inertia * speed[..., PITCH] ** 2
    )
    np.testing.assert_allclose(energy, np.broadcast_to(energy[:, :1], energy.shape), rtol=0, atol=1e-11)  # of 5 J


def test_thrust_does_the_work_that_the_craft_gains(planar: TwinSpec) -> None:
    """Under constant blades the energy gained is the thrust's work, force times way and torque times angle."""
    rng = np.random.default_rng(2)
    with share_kernel():
        twin = Twin(planar, 10)
    pose, velocity = rng.uniform(-1, 1, (10, 3)), rng.uniform(-1, 1, (10, 3)) * [1, 1, 3]
    blades = np.array([0.10, 0.102])
    start = place(twin, pose, velocity)
    start.actuators["horn"] = start.actuators["blade"] = blades
    _, qpos, qvel, _ = twin.replay_commands(start, np.tile(blades, (10, 400, 1)))
    path = np.concatenate([pose[:, None], twin.pose_at_time(qpos, qvel)], axis=1)
    speed = np.concatenate([velocity[:, None], qvel], axis=1)
    left, right = blades / BLADE_PER_NEWTON
    airframe = VEHICLE.airframe
    middle = 0.5 * (path[:, 1:, PITCH] + path[:, :-1, PITCH])
    step = np.diff(path, axis=1)
    work = (left + right) * (-np.sin(middle) * step[..., X] + np.cos(middle) * step[..., Z])
    work += (right - left) * airframe.half_length * step[..., PITCH]
    kinetic = 0.5 * airframe.mass * (speed[..., X] ** 2 + speed[..., Z] ** 2)
    kinetic += 0.5 * airframe.inertia * speed[..., PITCH] ** 2
    gained = kinetic + airframe.mass * VEHICLE.gravity * path[..., Z]
    # The midpoint sum is off by dt²/24 times second derivatives: 1e-6/24 * 5 N * (10 m/s * 30/s²) * 0.4 s < 3e-5 J.
    np.testing.assert_allclose(gained[:, -1] - gained[:, 0], work.sum(axis=1), rtol=0, atol=3e-5)
    assert np.abs(work.sum(axis=1)).min() > 0.01


FLIPPED = {
    ("rail_x.bias", "force"), ("pitch.bias", "force"), ("rail_x.asymmetry", "fraction"), ("rail_x.spring", "rest"),
    ("rail_x.tight_spot", "place"), ("rail.tilt", "angle"), ("airframe.com", "offset"), ("rotor.asymmetry", "fraction"),
    ("gyro.bias", "bias"), ("mocap.misalignment", "angle"),
}  # fmt: skip
"""Parameters that a mirror turns over; those of `servo.trim` it exchanges, all others it leaves."""


def draw_mirrored(count: int, ids: list[str]) -> dict[str, dict[str, np.ndarray]]:
    """Parameters of effects from their priors, (2 count,): the second half as a mirror shows the first."""
    rng, values = np.random.default_rng(4), {}
    for effect in SPEC.catalogue:
        if effect.id in ids:
            drawn = {p.name: p.draw(rng, count) for p in effect.parameters}
            seen = {name: -v if (effect.id, name) in FLIPPED else v for name, v in drawn.items()}
            if effect.id == "servo.trim":
                seen = {"offset_1": drawn["offset_2"], "offset_2": drawn["offset_1"]}
            values[effect.id] = {name: np.concatenate([v, seen[name]]) for name, v in drawn.items()}
    return values


@pytest.mark.parametrize(
    "ids", [[], *([e.id] for e in SPEC.catalogue), [e.id for e in SPEC.catalogue]], ids=lambda ids: ",".join(ids[:2])
)
def test_left_and_right_are_mirror_images(ids: list[str]) -> None:
    """Mirrored in x, its effects with it, the same commands fly the mirrored path: bare, with each effect, with all."""
    twin = make_twin(16, draw_mirrored(8, ids))
    rng = np.random.default_rng(3)
    pose = rng.uniform([-0.3, 1.2, -1.0], [0.3, 1.5, 1.0], (8, 3))
    velocity, flip = rng.uniform(-1, 1, (8, 3)), np.array([-1.0, 1.0, -1.0])
    state = place(twin, np.concatenate([pose, pose * flip]), np.concatenate([velocity, velocity * flip]), thrust=WEIGHT)
    for _ in range(40):
        command = rng.normal([5.0, 0.0], [2.0, 3.0], (8, 2))
        state = twin.step_policy(state, np.concatenate([command, command * [1, -1]]))
    # Rounding alone differs, amplified little in 0.4 s; m, m, rad.
    np.testing.assert_allclose(state.qpos[8:], state.qpos[:8] * flip, rtol=0, atol=1e-11)
    np.testing.assert_allclose(state.qvel[8:], state.qvel[:8] * flip, rtol=0, atol=1e-10)
    np.testing.assert_allclose(state.blade_pitch[8:], state.blade_pitch[:8, ::-1], rtol=0, atol=1e-11)
    assert np.abs(state.qpos[:8] - state.qpos[8:]).max() > 0.1


def test_horizontal_rail_carries_the_rig() -> None:
    """A tilted craft moves carriage, slider and itself in x, but not the carriage in z."""
    twin, angle, thrust = Twin(SPEC, 1), 0.3, 4.0
    pose = np.array([[0.0, 1.5, angle]])
    _, speed = coast(twin, place(twin, pose, thrust=thrust), 0.05, thrust)
    mass_z = WEIGHT / VEHICLE.gravity
    expected = [-thrust * np.sin(angle) / MASS_X, thrust * np.cos(angle) / mass_z - VEHICLE.gravity, 0.0]
    np.testing.assert_allclose(speed[0, -1], 0.05 * np.array(expected), atol=1e-9)


def test_dry_friction_stops_a_slider_where_it_should() -> None:
    """From v the slider stops after v² m/(2 F), within 1 %, and stays there."""
    speeds = np.array([0.2, 0.5, 0.8, -0.5])
    friction, twin = 0.5, Twin(SPEC, 4, active=["rail_x.coulomb"])
    twin.set_parameter("rail_x.coulomb", "force", friction)
    pose, velocity = np.tile([0.0, 1.0, 0.0], (4, 1)), np.zeros((4, 3))
    velocity[:, X] = speeds
    path, _ = coast(twin, place(twin, pose, velocity, thrust=WEIGHT), 2.0, WEIGHT)
    way = speeds * np.abs(speeds) * MASS_X / (2 * friction)
    np.testing.assert_allclose(path[:, -1, X], way, rtol=0.01)
    np.testing.assert_allclose(path[:, -500, X], path[:, -1, X], atol=1e-6)
    assert path[:, :, X].max() <= way.max() * 1.01


def test_viscous_friction_decays_exponentially() -> None:
    """Speed decays as e^(-b t/m), within the first-order error of the step, b dt/(2 m) of the exponent."""
    damping = np.array([0.1, 0.5, 2.0])
    twin = Twin(SPEC, 3, active=["rail_x.viscous"])
    twin.set_parameter("rail_x.viscous", "damping", damping)
    pose, velocity = np.tile([0.0, 1.0, 0.0], (3, 1)), np.tile([0.5, 0.0, 0.0], (3, 1))
    _, speed = coast(twin, place(twin, pose, velocity, thrust=WEIGHT), 1.0, WEIGHT)
    exponent = np.log(speed[:, -1, X] / 0.5)
    np.testing.assert_allclose(exponent, -damping / MASS_X, rtol=2.0 * twin.dt / MASS_X)
