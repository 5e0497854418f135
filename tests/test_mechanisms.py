"""The proving ground of other rigs obeys mechanics: by hand, against Pinocchio, against the MJCF that it hands out."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from proving.mechanisms.families import FAMILIES
from proving.mechanisms.hidden import Hidden, Scale, hide, list_kinds, name_effect, size_effect
from proving.mechanisms.measure import Evidence, trace_offset
from proving.mechanisms.plant import FORMS, STEP, build_drives, build_laws
from proving.mechanisms.rig import GRAVITY, JITTER, Drive, Link, Rig
from proving.mechanisms.tree import build_tree, choose_dynamics, find_tree_dynamics, run_tree
from proving.mechanisms.trial import Motion, Track, Trial, World, foresee, perform, plan_trial

SWING = (0.0, -1.0, 0.0)
CART = Rig(
    "carriage",
    (Link("slide", False, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 40.0, (0.1, 0.1, 0.1)),),
    (Drive("motor", 0, 60.0, 1.0),),
    (0.3,),
    3.0,
)
PENDULUM = Rig(
    "pendulum",
    (Link("swing", True, SWING, (0.0, 0.0, 0.0), (0.0, 0.0, -0.4), 0.5, (0.002, 0.002, 0.0002)),),
    (),
    (1.2,),
    4.0,
)
DOUBLE = Rig(
    "double pendulum",
    (
        Link("upper", True, SWING, (0.0, 0.0, 0.0), (0.0, 0.0, -0.2), 1.5, (0.01, 0.01, 0.001), 0.02),
        Link("lower", True, SWING, (0.0, 0.0, -0.35), (0.0, 0.0, -0.15), 0.8, (0.004, 0.004, 0.0004), 0.01),
    ),
    (Drive("motor_upper", 0, 1.0, 30.0), Drive("motor_lower", 1, 5.0, 3.0)),
    (0.8, 0.8),
    4.0,
)


def build_world(rig: Rig) -> World:
    """A rig in which nothing is hidden."""
    n, laws, drives = len(rig.links), build_laws(rig), build_drives(rig)
    return World(rig, laws, drives, np.zeros((n, n)), laws.copy(), drives.copy())


def drive(
    rig: Rig, world: World, kind: str = "moves", seconds: float = 8.0, seed: int = 4, step: float = STEP
) -> Track:
    """Track a reference at 200 Hz without noise, or let go."""
    motion = Motion("tracked" if rig.drives else "released", kind, seconds, seed)
    return perform(world, rig, plan_trial(rig, motion, 0.005), step=step)


def scale_of(rig: Rig, track: Track, period: float = 0.005) -> Scale:
    """What is usual along a track; forces and inertias are taken as one."""
    ones = np.ones(len(rig.links))
    q, v = track.moved[:, 0], track.moved[:, 1]
    return Scale(ones, np.sqrt(np.mean(v**2, 0)), q.std(0), np.median(q, 0), ones, track.given, period)


def find_energy(rig: Rig, track: Track) -> np.ndarray:
    """Kinetic and potential energy at every sample by Pinocchio, (T,) J."""
    model = build_tree(rig)
    data = model.createData()
    rows = zip(track.moved[:, 0].copy(), track.moved[:, 1].copy())
    return np.array(
        [
            pin.computeKineticEnergy(model, data, q, v) + 0.5 * model.armature @ v**2
            + (pin.computePotentialEnergy(model, data, q))
            for q, v in rows
        ]
    )  # fmt: skip


def test_a_pendulum_loses_what_damping_takes() -> None:
    """By hand: m g l (1 - cos) + I w²/2 falls by the integral of b w², over a free decay to a tenth of the energy."""
    world = build_world(PENDULUM)
    world.laws["viscous"] = 0.03
    moved = drive(PENDULUM, world).moved
    angle, rate = moved[:, 0, 0], moved[:, 1, 0]
    energy = 0.5 * (0.002 + 0.5 * 0.4**2) * rate**2 + 0.5 * GRAVITY * 0.4 * (1.0 - np.cos(angle))
    lost = 0.03 * np.cumsum(0.5 * (rate[1:] ** 2 + rate[:-1] ** 2)) * 0.005
    # Trapezia of 5 ms on a rate that swings at 0.8 Hz; midpoint steps of 0.25 ms are good to 1e-7.
    np.testing.assert_allclose(energy[1:] - energy[0], -lost, atol=3e-5 * energy[0])
    assert energy[-1] < 0.1 * energy[0]


def test_without_friction_a_double_pendulum_keeps_its_energy() -> None:
    """Energy by Pinocchio of motion by our own equations: constant within the integrator's error."""
    trial = plan_trial(DOUBLE, Motion("released", "", 6.0, 1), 0.005)
    trial = replace(trial, start=np.array([[2.0, -1.0], [0.5, 0.0]]))
    energy = find_energy(DOUBLE, perform(build_world(DOUBLE), DOUBLE, trial))
    hanging = find_energy(DOUBLE, Track(np.zeros((1, 3, 2)), np.zeros((1, 2)), np.zeros((1, 2))))[0]
    assert np.ptp(energy) < 2e-4 * (energy.max() - hanging)


def test_torques_and_friction_account_for_a_double_pendulums_energy() -> None:
    """Work of the motors, less dry friction's, is the change of energy, armature included."""
    world = build_world(DOUBLE)
    world.laws["coulomb"] = 0.2, 0.1
    track = drive(DOUBLE, world, "sines")
    moved, gears = np.diff(track.moved[:, 0], axis=0), np.array([1.0, 5.0])
    work = np.cumsum((gears * track.given[:-1] * moved).sum(1) - (np.array([0.2, 0.1]) * np.abs(moved)).sum(1))
    energy = find_energy(DOUBLE, track)
    # Turning back between two samples is counted too short: friction times some 1e-4 rad, a few times a second.
    np.testing.assert_allclose(energy[1:] - energy[0], work, atol=0.01 * np.ptp(energy))


def test_dry_friction_holds_exactly_up_to_its_level() -> None:
    """A carriage at rest: velocity is 0.0, position does not move a bit, and what pushes is within breakaway."""
    world = build_world(CART)
    world.laws["coulomb"], world.laws["stiction"], world.laws["stribeck"] = 20.0, 10.0, 0.01
    track = drive(CART, world, seconds=20.0)
    position, rate, friction = (track.moved[:, i, 0] for i in range(3))
    resting = (rate[:-1] == 0.0) & (rate[1:] == 0.0)
    push = 60.0 * track.given[:-1, 0]
    assert 0.05 < resting.mean() < 0.95
    assert (np.diff(position)[resting] == 0.0).all()
    assert np.abs(push[resting]).max() <= 30.0
    np.testing.assert_allclose(friction[1:][resting], -push[resting])
    sliding = np.abs(rate) > 0.05
    np.testing.assert_allclose(friction[sliding], -20.0 * np.sign(rate[sliding]), atol=1e-6)


def test_a_push_beyond_breakaway_moves_a_carriage_as_newton_says() -> None:
    """By hand: 50 N on 40 kg with 20 N of friction is 0.75 m/s², 0.375 m after a second."""
    world = build_world(CART)
    world.laws["coulomb"] = 20.0
    zeros, feed = np.zeros((1, 1)), np.full((201, 1), 50.0 / 60.0)
    trial = Trial(0.005, np.zeros((2, 1)), feed, zeros, zeros, np.zeros((201, 2, 1)), np.ones(1))
    track = perform(world, CART, trial)
    np.testing.assert_allclose(track.moved[-1, :2, 0], [0.375, 0.75], rtol=1e-3)
    np.testing.assert_allclose(track.lacking[1:-1, 0], -20.0, rtol=1e-9)


def test_one_joint_sticks_while_the_other_swings() -> None:
    """Where the lower joint's friction is strong it stays put exactly, and both links swing as one body."""
    world = build_world(DOUBLE)
    world.laws["coulomb"] = 0.0, 50.0
    trial = plan_trial(DOUBLE, Motion("released", "", 4.0, 1), 0.005)
    moved = perform(world, DOUBLE, replace(trial, start=np.array([[1.0, 0.6], [0.0, 0.0]]))).moved
    assert (moved[:, 0, 1] == 0.6).all()
    assert np.ptp(moved[:, 0, 0]) > 1.0
    # By hand (parallel axes): what turns about the shoulder with the elbow stuck at 0.6 rad, and gravity's torque.
    com = np.array([0.0, -0.35]) + 0.15 * np.array([np.sin(0.6), -np.cos(0.6)])
    about = 0.01 + 1.5 * 0.2**2 + 0.004 + 0.8 * com @ com + 0.02
    down = np.array([0.0, -1.5 * 0.2]) + 0.8 * com
    torque = GRAVITY * (down[1] * np.sin(moved[:, 0, 0]) - down[0] * np.cos(moved[:, 0, 0]))
    spun = np.cumsum(0.5 * (torque[1:] + torque[:-1])) * 0.005
    np.testing.assert_allclose(about * moved[1:, 1, 0], spun, atol=1e-3 * np.abs(spun).max())


def test_pinocchios_arm_is_the_two_link_arm_of_the_textbook() -> None:
    """By hand: M11 = I1 + I2 + m1 c1² + m2 (l1² + c2² + 2 l1 c2 cos q2) and so on, with armature, at one state."""
    q, v = np.array([0.7, -1.1]), np.array([1.3, -0.4])
    M, h = find_tree_dynamics(DOUBLE)(q, v)
    m1, m2, l1, c1, c2, i1, i2 = 1.5, 0.8, 0.35, 0.2, 0.15, 0.01, 0.004
    k = m2 * l1 * c2
    coupled = i2 + m2 * c2**2 + k * np.cos(q[1])
    first = i1 + i2 + m1 * c1**2 + m2 * (l1**2 + c2**2) + 2.0 * k * np.cos(q[1])
    np.testing.assert_allclose(M, [[first + 0.02, coupled], [coupled, i2 + m2 * c2**2 + 0.01]])
    hanging = GRAVITY * m2 * c2 * np.sin(q[0] + q[1])
    turning = -k * np.sin(q[1]) * (2.0 * v[0] * v[1] + v[1] ** 2)
    np.testing.assert_allclose(h[0], turning + GRAVITY * (m1 * c1 + m2 * l1) * np.sin(q[0]) + hanging)
    np.testing.assert_allclose(h[1], k * np.sin(q[1]) * v[0] ** 2 + hanging)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_mjcf_is_the_rig(family: str) -> None:
    """Mass matrix and bias forces: MuJoCo's of the MJCF, Pinocchio's and our own agree at random states."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        rig = FAMILIES[family](rng)
        model = mujoco.MjModel.from_xml_string(rig.write_mjcf())
        data = mujoco.MjData(model)
        q, v = rng.uniform(-2.0, 2.0, (2, len(rig.links)))
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        dense = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, dense)
        for find in (find_tree_dynamics(rig), choose_dynamics(rig)):
            M, h = find(q, v)
            np.testing.assert_allclose(M, dense, rtol=1e-6, atol=1e-8 * np.abs(dense).max())
            np.testing.assert_allclose(h, data.qfrc_bias, rtol=1e-6, atol=1e-7 * np.abs(data.qfrc_bias).max())
        assert [model.joint(i).name for i in range(model.njnt)] == rig.joints
        np.testing.assert_allclose(model.actuator_gear[:, 0], [d.gear for d in rig.drives])
        np.testing.assert_allclose(model.dof_damping, [link.damping for link in rig.links], rtol=1e-6)


def test_the_tree_moves_as_the_closed_form_does() -> None:
    """A double pendulum with friction, lag and delay through both loops, of Pinocchio and of our own."""
    world = build_world(DOUBLE)
    for laws in (world.laws, world.later):
        laws["coulomb"], laws["viscous"], laws["hysteresis"] = (0.3, 0.1), 0.05, 0.1
    world.drives["lag"], world.drives["delay"] = 0.02, (40, 0)
    trial = plan_trial(DOUBLE, Motion("tracked", "steps", 3.0, 2), 0.005)
    own = perform(world, DOUBLE, trial)
    track = Track(np.zeros_like(own.moved), np.zeros_like(own.given), np.zeros_like(own.lacking))
    samples, n = own.lacking.shape
    run_tree(
        DOUBLE, world.laws, world.later, samples, world.drives, world.drives, world.cross, np.array([1.0, 5.0]),
        trial.start, trial.feed, trial.stiff, trial.damp, trial.reference, np.zeros((samples, 2, n)),
        np.zeros((samples, n)), trial.limit, 0.005, 20, track.moved, track.given, track.lacking,
    )  # fmt: skip
    for one, other in ((own.moved[:, :2], track.moved[:, :2]), (own.given, track.given), (own.lacking, track.lacking)):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(one).max())


def test_half_the_step_gives_the_same_motion() -> None:
    """Steps of 0.125 ms differ from those of 0.25 ms by less than a hundredth of any encoder's noise."""
    moved = [drive(DOUBLE, build_world(DOUBLE), "sines", step=step).moved[:, 0] for step in (STEP, STEP / 2.0)]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-6)


def test_inverse_dynamics_track_a_path() -> None:
    """What is fed forward moves the nominal rig along its reference without any feedback to speak of."""
    trial = plan_trial(DOUBLE, Motion("tracked", "sines", 6.0, 3), 0.002)
    track = perform(build_world(DOUBLE), DOUBLE, trial)
    np.testing.assert_allclose(track.moved[:, 0], trial.reference[:, 0], atol=0.01)
    path = np.zeros((2, 3, 2))
    force, carried = foresee(DOUBLE, path)
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    assert carried[1] == pytest.approx(0.004 + 0.8 * 0.15**2 + 0.01)


@pytest.mark.parametrize("outside", [False, True])
def test_every_hidden_kind_does_something(outside: bool) -> None:
    """Each law at each joint of a double pendulum moves it otherwise, or is an error of the log of its torque."""
    rng, bare = np.random.default_rng(3), drive(DOUBLE, build_world(DOUBLE), "sines")
    scale = scale_of(DOUBLE, bare)
    for kind, joint in list_kinds(DOUBLE, outside):
        share = 0.05 if kind in ("delay", "lag") else 0.3
        hidden = Hidden(name_effect(DOUBLE, kind, joint, outside), joint, share, 1.0, int(rng.integers(99)))
        values = size_effect(hidden, DOUBLE, scale)
        if set(values) & {"sensor_dead", "quantum", "angle"}:
            continue
        track = drive(DOUBLE, hide(build_world(DOUBLE), hidden, values), "sines")
        moved = np.abs(track.moved[:, 0] - bare.moved[:, 0]).max()
        assert moved > 1e-3, (kind, joint, values)
        assert np.abs(track.lacking[:, joint]).max() > 1e-3, (kind, joint)


def test_an_encoder_that_reads_too_much_takes_weight_for_force() -> None:
    """By hand: the elbow's weight turns with its angle by m g l cos, on both joints; the rig is at rest."""
    track = drive(DOUBLE, build_world(DOUBLE), "sines")
    still = replace(track, moved=np.array([0.3, 0.5])[None, None] * np.array([1.0, 0.0, 0.0])[None, :, None])
    found = trace_offset(DOUBLE, Evidence(still, np.zeros((1, 2))), 1, scale_of(DOUBLE, track))
    np.testing.assert_allclose(found[0], 0.8 * GRAVITY * 0.15 * np.cos(0.8), rtol=1e-4)


def test_what_the_twin_lacks_is_what_is_hidden() -> None:
    """By hand: along a track with damping 0.3 and 10 % more gain the twin lacks 0.1 x torque - 0.3 x rate."""
    world = build_world(DOUBLE)
    for laws, drives in ((world.laws, world.drives), (world.later, world.drives_later)):
        laws["viscous"][0], drives["gain"][0] = 0.3, 1.1
    track = drive(DOUBLE, world, "sines")
    rate = 0.5 * (track.moved[:-1, 1, 0] + track.moved[1:, 1, 0])
    np.testing.assert_allclose(track.lacking[:-1, 0], 0.1 * track.given[:-1, 0] - 0.3 * rate, atol=3e-3)
    np.testing.assert_allclose(track.lacking[:, 1], 0.0, atol=1e-12)


def test_a_rig_is_built_within_its_jitter() -> None:
    """Every mass and gear is off by up to 0.5 %, none by more, and no two by the same."""
    real = DOUBLE.jitter(np.random.default_rng(1))
    shares = [a.mass / b.mass - 1.0 for a, b in zip(real.links, DOUBLE.links)]
    shares += [a.gear / b.gear - 1.0 for a, b in zip(real.drives, DOUBLE.drives)]
    assert 0.0 < np.abs(shares).max() <= JITTER
    assert len(set(shares)) == 4
    assert set(FORMS) < set(FAMILIES)
