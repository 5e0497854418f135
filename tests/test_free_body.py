"""A body that flies: its pose on a manifold, read, estimated, stepped, drawn, and what is wrong with it named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from proving.logs import write_log
from proving.quadrotor import GRAVITY, INERTIA, MASS, STEP, fly, simulate, write_twin
from tests.builders import load_rig
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.evidence.runs import Track
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.replay import replay
from vpptwin.estimation.windows import cut_windows, fly_windows
from vpptwin.logs.read import read_flight
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.report.prediction import predict_flight
from vpptwin.report.twin_file import name_twin
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec, load_twin
from vpptwin.twin.robot.manifold import (
    chart,
    difference_attitudes,
    difference_poses,
    follow_sign,
    integrate_pose,
    read_angles,
    rotate,
    turn_to_world,
)
from vpptwin.twin.robot.robot import Loads
from vpptwin.twin.robot.signals import Signals
from vpptwin.viz.plots.panels import tell_flight
from vpptwin.viz.scene.show import prepare_show

ARM_ON_BASE = """<mujoco><worldbody><body name="base"><freejoint/><geom size="1"/>
<body><joint name="elbow" type="hinge"/><geom size="1"/></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The nominal quadrotor."""
    return load_twin(write_twin(tmp_path_factory.mktemp("quadrotor")))


def test_poses_of_free_bodies_move_as_mujoco_moves_them() -> None:
    """Integration and difference equal mj_integratePos and mj_differentiatePos to rounding."""
    model = mujoco.MjModel.from_xml_string(ARM_ON_BASE)
    rng = np.random.default_rng(1)
    pose = integrate_pose(model, model.qpos0, rng.standard_normal((50, model.nv)))
    step = rng.standard_normal((50, model.nv))
    moved, back = integrate_pose(model, pose, step), np.empty_like(step)
    for here, along, there, way in zip(pose, step, moved, back):
        expected = here.copy()
        mujoco.mj_integratePos(model, expected, along, 1.0)
        np.testing.assert_allclose(there, expected, atol=1e-14)
        mujoco.mj_differentiatePos(model, way, 1.0, here, there)
    np.testing.assert_allclose(difference_poses(model, pose, moved), back, atol=1e-12)
    np.testing.assert_array_equal(chart(model, pose)[:, [0, 1, 2, 6]], pose[:, [0, 1, 2, 7]])
    # As MuJoCo turns them; q and -q are one rotation, angles those of roll, pitch and yaw.
    rng = np.random.default_rng(2)
    attitude = rotate(np.array([1.0, 0.0, 0.0, 0.0]), rng.standard_normal((30, 3)))
    vector, expected = rng.standard_normal((30, 3)), np.empty((30, 3))
    for row, q, v in zip(expected, attitude, vector):
        mujoco.mju_rotVecQuat(row, v, q)
    np.testing.assert_allclose(turn_to_world(attitude, vector), expected, atol=1e-14)
    np.testing.assert_allclose(difference_attitudes(attitude, -attitude), 0.0, atol=1e-12)
    smooth = rotate(np.array([1.0, 0.0, 0.0, 0.0]), np.linspace(0.0, 9.0, 200)[:, None] * np.array([0.0, 0.6, 0.8]))
    flipped = np.where(np.arange(200)[:, None] % 3 == 0, -smooth, smooth)
    assert np.abs(np.diff(follow_sign(flipped), axis=0)).max() < 0.05
    yawed = rotate(np.array([1.0, 0.0, 0.0, 0.0]), np.array([[0.0, 0.0, 0.7]]))
    np.testing.assert_allclose(read_angles(rotate(yawed, np.array([[0.2, 0.0, 0.0]]))), [[0.2, 0.0, 0.7]], atol=1e-12)


@pytest.mark.parametrize("causal", [True, False])
def test_states_are_estimated_from_poses_and_a_gyro(spec: TwinSpec, causal: bool) -> None:
    """Within what the sensors' noise allows, on a flight that turns by 0.6 rad at up to 5 rad/s."""
    measured = read_measurements(spec, fly({}, 6.0, 3, gusts=0.0))
    times = np.arange(0.5, 5.5, 0.0437)
    pose, velocity = estimate_states(measured, times, spec.model, causal)
    quiet = fly({}, 6.0, 3, gusts=0.0, noise=0.0)
    truth = read_measurements(spec, quiet)
    exact, speeds = estimate_states(truth, times, spec.model, False)
    off = difference_poses(spec.model, exact, pose)
    assert np.sqrt((off[:, :3] ** 2).mean()) < 4e-4
    assert np.sqrt((off[:, 3:] ** 2).mean()) < 1.5e-3
    assert np.sqrt(((velocity - speeds)[:, :3] ** 2).mean()) < (0.04 if causal else 0.02)
    assert np.sqrt(((velocity - speeds)[:, 3:] ** 2).mean()) < (0.03 if causal else 0.01)


def test_the_twin_follows_an_independent_simulation(spec: TwinSpec) -> None:
    """From true states, without gusts, half a second of open loop ends within half a millimetre and 2 mrad."""
    truth = simulate({}, 6.0, 4, 0.0)
    measured = read_measurements(spec, fly({}, 6.0, 4, gusts=0.0, noise=0.0))
    starts = np.arange(0.5, 5.0, 0.25)
    first, last = (np.rint((starts + late) / STEP).astype(int) for late in (0.0, 0.5))
    windows = cut_windows(spec, measured, starts, 0.5, causal=False)
    windows = replace(windows, pose=truth[first, :7], velocity=truth[first, 7:13])
    motion = fly_windows(Twin(spec, len(windows)), windows)
    off = difference_poses(spec.model, truth[last, :7], motion.pose[:, -1])
    assert np.abs(off[:, :3]).max() < 5e-4
    assert np.abs(off[:, 3:]).max() < 2e-3
    assert np.median(np.abs(off[:, 3:])) < 2e-4  # where commands jump, a step of 2 ms is coarser


@pytest.mark.parametrize(
    ("effect", "acceleration"),
    [
        ({"quad.wind": {"x": 0.01, "y": -0.02, "z": 0.03}}, lambda m: np.array([0.01, -0.02, 0.03]) / m),
        ({"quad.drag": {"across": 0.02, "along": 0.05}}, lambda m: -np.array([0.02, 0.02, 0.05]) * [1.0, 2.0, 3.0] / m),
        ({"quad.mass": {"mass": 0.01}}, lambda m: np.zeros(3)),
    ],
)
def test_effects_on_a_free_body_push_as_they_say(spec: TwinSpec, effect: dict, acceleration: object) -> None:
    """One step of free fall, upright: what is added to gravity, by hand; a heavier body falls as fast."""
    twin = Twin(spec.with_effects({**spec.effects, **effect}), 1)
    velocity = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0]])
    state = twin.initial_state(qpos=np.array([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]]), qvel=velocity)
    after = twin.replay_commands(state, np.zeros((1, 1, 4)))
    gained = (after.qvel[0, -1, :3] - velocity[0, :3]) / twin.dt + [0.0, 0.0, GRAVITY]
    mass = MASS + effect.get("quad.mass", {}).get("mass", 0.0)
    np.testing.assert_allclose(gained, acceleration(mass), atol=1e-9)  # type: ignore[operator]


MISREAD = [
    ("quad.delay", {"delay": 0.012}), ("quad.drift", {"drift": 2e-3}), ("quad.misalignment", {"x": 0.03, "z": -0.05}),
    ("quad.scale", {"scale": 1.04}), ("imu.bias", {"y": 0.08}), ("imu.scale", {"scale": 0.9}),
    ("imu.misalignment", {"x": 0.03, "z": -0.09}),
]  # fmt: skip


@pytest.mark.parametrize(("effect", "values"), MISREAD)
def test_what_signals_get_wrong_is_predicted(spec: TwinSpec, effect: str, values: dict[str, float]) -> None:
    """With the error of an independent log's sensors in the twin a window is missed no more than without any error."""

    def miss(hidden: dict, told: dict) -> float:
        measured = [read_measurements(spec, fly(hidden, 6.0, 4, gusts=0.0))]
        bench = build_bench(spec, measured, [np.arange(0.5, 5.0, 0.3)], 0.3, causal=False)
        missed = bench.residual({(effect, name): value for name, value in told.items()}) / bench.std
        return float((missed[bench.valid] ** 2).mean())

    clean, wrong, right = miss({}, {}), miss({effect: values}, {}), miss({effect: values}, values)
    assert right < 1.1 * clean
    assert wrong > 1.5 * clean


def test_a_log_of_poses_and_an_imu_reads_back(spec: TwinSpec, tmp_path: Path) -> None:
    """PoseStamped and Imu as MCAP give the streams that were written; the twin's replay, plot and page show them."""
    flown = fly({}, 4.0, 5)
    flight = read_flight(write_log(flown, tmp_path / "flight.mcap"))
    assert set(flight.spatial) == {"/pose", "/imu"}
    for topic, stream in flown.spatial.items():
        assert set(flight.spatial[topic].values) == set(stream.values)
        for name, values in stream.values.items():
            np.testing.assert_allclose(flight.spatial[topic][name], values, atol=1e-12)
    story = tell_flight(flight, replay(spec, flight), spec)
    assert [panel.label for panel in story.panels][:6] == [
        "quad x [m]", "quad y [m]", "quad z [m]", "quad roll [rad]", "quad pitch [rad]", "quad yaw [rad]",
    ]  # fmt: skip
    assert all(len(panel.lines) == 2 for panel in story.panels[:6])
    show = prepare_show(flight, None, spec)
    turns = difference_attitudes(show.log.qpos[0, 3:7], show.log.qpos[:, 3:7])
    assert 0.2 < np.abs(turns).max() < 3.0


def test_an_imu_may_be_on_the_topic_of_the_drone(spec: TwinSpec, tmp_path: Path) -> None:
    """/imu/data and /mocap/pose, which a twin's signals name, are an IMU's and a body's as any other topics."""
    flown = fly({}, 2.0, 5)
    renamed = {"/mocap/pose": flown.spatial["/pose"], "/imu/data": flown.spatial["/imu"]}
    log = write_log(replace(flown, spatial=renamed), tmp_path / "flight.mcap")
    signals = Signals(bodies={"quad": "/mocap/pose"}, sites={"imu": "/imu/data"})
    assert signals.as_dict() == {"joints": {}, "bodies": {"quad": "/mocap/pose"}, "sites": {"imu": "/imu/data"},
                                 "actuators": {}, "driven": {}}  # fmt: skip
    flight = read_flight(log, signals=signals.entries)
    assert set(flight.spatial) == set(renamed)
    assert set(flight.spatial["/imu/data"].values) >= {"rate"}


def test_inspect_knows_messages_of_poses_and_of_an_imu(tmp_path: Path) -> None:
    """Their topics alone, without a doubt; an orientation that never changes is none."""
    known, log = load_twin(write_twin(tmp_path)), write_log(fly({}, 6.0, 5), tmp_path / "flight.mcap")
    guesses = inspect_logs([log], str(tmp_path / "quadrotor.xml"), tmp_path / "found.yaml")
    assert all(guess.sure for guess in guesses)
    assert load_twin(tmp_path / "found.yaml").robot.signals == known.robot.signals


TABLE = """model: quadrotor.xml
signals:
  bodies: {quad: {topic: flight, position: {path: [px, py, pz], unit: mm}, attitude: [qw, qx, qy, qz]}}
  sites: {imu: {topic: flight, rate: {path: [gx, gy, gz], unit: deg/s}}}
  actuators:
"""
MAP = "{topic: flight, effort: {path: pwm%d, polynomial: [0.0, 2.0e-6], voltage: {path: volts, nominal: 4.0}}}"


def test_axes_that_never_change_are_believed_no_more_than_others(spec: TwinSpec) -> None:
    """Odometry of what rolls on a floor has z = 0 and no roll or pitch: nobody measured them to the nanometre."""
    flown = fly({}, 6.0, 3, gusts=0.0)
    pose, yaw = flown.spatial["/pose"], 0.5 * np.sin(flown.spatial["/pose"].time)
    pose["position"][:, 2] = 0.1
    pose["attitude"][:] = np.stack([np.cos(0.5 * yaw), 0.0 * yaw, 0.0 * yaw, np.sin(0.5 * yaw)], axis=1)
    measured = read_measurements(spec, flown)
    moving = [measured.positions[dof].std for dof in (0, 1)]
    assert measured.positions[2].std == max(moving) > 1e-5
    assert measured.attitudes[3].std == measured.positions[5].std


def test_a_table_of_columns_is_a_flight_too(tmp_path: Path) -> None:
    """Poses, rates, PWM at a battery that sags, in a lone CSV; where columns lie an extended twin says too."""
    write_twin(tmp_path)
    (tmp_path / "twin.yaml").write_text(TABLE + "".join(f"    m{i}: {MAP % i}\n" for i in range(1, 5)))
    spec, flown = load_twin(tmp_path / "twin.yaml"), fly({}, 2.0, 5)
    pose, imu, motors = flown.spatial["/pose"], flown.spatial["/imu"], flown.joints["/motors"]
    volts = 4.2 - 0.1 * pose.time
    columns = {"time": pose.time, "volts": volts}
    columns |= dict(zip(("px", "py", "pz"), 1e3 * pose["position"].T)) | dict(
        zip(("qw", "qx", "qy", "qz"), pose["attitude"].T)
    )
    columns |= dict(zip(("gx", "gy", "gz"), np.rad2deg(imu["rate"][::5]).T))
    columns |= {f"pwm{i}": motors[f"m{i}"]["effort"][::5] / 2e-6 * 4.0 / volts for i in range(1, 5)}
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(tmp_path / "today.csv", rows, delimiter=",", header=",".join(columns), comments="")
    flight = read_flight(tmp_path / "today.csv", signals=spec.robot.signals.entries)
    np.testing.assert_allclose(flight.spatial["/bodies/quad"]["position"], pose["position"], atol=1e-9)
    np.testing.assert_allclose(flight.spatial["/bodies/quad"]["attitude"], pose["attitude"], atol=1e-9)
    np.testing.assert_allclose(flight.spatial["/sites/imu"]["rate"], imu["rate"][::5], atol=1e-9)
    for name, stream in flight.joints["/actuator_command"].items():
        np.testing.assert_allclose(stream["effort"], motors[name]["effort"][::5], atol=1e-9)
    measured = read_measurements(spec, flight)
    assert set(measured.attitudes) == {3}
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(name_twin(spec, tmp_path)))
    assert load_twin(tmp_path / "again.yaml").robot.signals == spec.robot.signals


@pytest.mark.parametrize(("names", "size"), [("roll,pitch,yaw", 1.0), ("roll_deg,pitch_deg,yaw_deg", 180.0 / np.pi)])
def test_an_attitude_may_be_roll_pitch_and_yaw(tmp_path: Path, names: str, size: float) -> None:
    """As inspect finds it, in degrees if a name says so: it yaws about z, pitches about y, rolls about x."""
    write_twin(tmp_path)
    pose = fly({}, 4.0, 5).spatial["/pose"]
    yaw, pitch, roll = size * Rotation.from_quat(np.roll(pose["attitude"], -1, axis=1)).as_euler("ZYX").T
    rows = np.column_stack([pose.time, pose["position"], roll, pitch, yaw])
    np.savetxt(tmp_path / "today.csv", rows, delimiter=",", header=f"t,quad_x,quad_y,quad_z,{names}", comments="")
    inspect_logs([tmp_path / "today.csv"], str(tmp_path / "quadrotor.xml"), tmp_path / "found.yaml")
    signals = load_twin(tmp_path / "found.yaml").robot.signals
    found = read_flight(tmp_path / "today.csv", signals=signals.entries).spatial[signals.bodies["quad"]]["attitude"]
    np.testing.assert_allclose(np.abs((found * pose["attitude"]).sum(axis=1)), 1.0, atol=1e-12)


@pytest.mark.parametrize(
    ("entry", "line"),
    [
        ("{topic: flight, position: [px, py, pz], attitude: [a, b]}", "2 fields, 1 factors; expected 4 fields, or"),
        ("{topic: flight, position: [px, py, pz]}", "with position; expected position and attitude"),
        ("{topic: flight, position: px, attitude: [a, b, c, d]}", "position: 1 fields, 1 factors; expected 3 fields"),
        ("{topic: flight, position: [x, y, z], attitude: [a, b, c, d], effort: u}", "expected position and attitude"),
    ],
)  # fmt: skip
def test_a_body_of_columns_needs_its_pose(tmp_path: Path, entry: str, line: str) -> None:
    """All of it, a field for every component, and nothing else."""
    write_twin(tmp_path)
    (tmp_path / "twin.yaml").write_text(f"model: quadrotor.xml\nsignals:\n  bodies: {{quad: {entry}}}\n")
    (tmp_path / "today.csv").write_text("time,x\n0.0,1.0\n0.1,2.0\n")
    signals = load_twin(tmp_path / "twin.yaml").robot.signals
    with pytest.raises(InputError, match=line):
        read_flight(tmp_path / "today.csv", signals=signals.entries)


def test_predictions_and_the_extended_twin_know_the_body(spec: TwinSpec, tmp_path: Path) -> None:
    """Angles of a prediction stay near those measured where it was restarted; its YAML has the signals it came with."""
    prediction = predict_flight([spec], fly({}, 4.0, 7))
    tracks = {track.name: track for track in prediction.tracks if track.kind == "position"}
    assert set(tracks) == {f"quad {way}" for way in ("x", "y", "z", "roll", "pitch", "yaw")}
    for name, track in tracks.items():
        known = np.isfinite(track.residual[0])
        assert known.mean() > 0.8
        assert np.sqrt(np.mean(track.residual[0][known] ** 2)) < (0.02 if name[-1] in "xyz" else 0.08)
    content = name_twin(spec, tmp_path)
    assert content["signals"] == spec.robot.signals.model_dump(exclude={"turned"})
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(content))
    assert load_twin(tmp_path / "again.yaml").robot.signals == spec.robot.signals


def test_a_craft_that_has_less_of_everything_flies_the_same_about_a_track(spec: TwinSpec) -> None:
    """A tenth less mass, inertia and thrust: what is missed is the same, pulses that turn it included."""
    bench = build_bench(spec, [read_measurements(spec, fly({}, 6.0, 4))], [np.arange(0.5, 5.0, 0.5)], 0.3, False)
    rng, count = np.random.default_rng(0), len(bench.windows)
    push = rng.standard_normal((count, bench.segments, 6)) * [0.0, 0.0, 0.0, 2e-5, 2e-5, 2e-5]
    pushed = bench.about(Track(np.zeros((count, 6)), rng.standard_normal((count, 6)), push))
    less = {("quad.mass", "mass"): -0.1 * MASS, ("m1+m2+m3+m4.gain", "gain"): 0.9}
    less |= {("quad.inertia", axis): 0.9 for axis in "xyz"}
    nominal, moved = pushed.residual({}), pushed.residual(less)
    assert np.abs((nominal - bench.residual({})) / bench.std)[bench.valid].max() > 30.0
    np.testing.assert_allclose(moved / bench.std, nominal / bench.std, atol=1e-6)


@pytest.mark.parametrize(
    ("weak", "named"), [((2,), "m2.gain"), pytest.param((1, 2, 3, 4), "m1+m2+m3+m4.gain", marks=pytest.mark.slow)]
)
def test_weak_motors_are_named(spec: TwinSpec, weak: tuple[int, ...], named: str) -> None:
    """7 % less thrust of one motor or of all of them on 10 s of flight: first, with its size."""
    hidden = {f"m{i}.gain": {"gain": 0.93} for i in weak}
    verdict = diagnose(spec, [fly(hidden, 10.0, 100)]).verdict
    assert verdict.causes[0].effect == named
    gain = verdict.causes[0].parameters["gain"]
    assert abs(gain.value - 0.93) < max(3.0 * gain.std, 0.01)
    assert verdict.after.chi2 - 1.0 < (verdict.before.chi2 - 1.0) / 3.0


@pytest.mark.slow
def test_what_tolerances_hide_is_told(spec: TwinSpec) -> None:
    """Motors up to 1.5 % apart, which any may be: none is accused, and those that explain the error are told."""
    hidden = {f"m{i}.gain": {"gain": gain} for i, gain in ((1, 0.985), (2, 0.99), (3, 1.012), (4, 1.015))}
    verdict = diagnose(spec, [fly(hidden, 12.0, 300 + i) for i in range(2)]).verdict
    assert not verdict.causes
    assert verdict.misfit is not None
    assert set(verdict.misfit.within) == {"m1.gain", "m4.gain"}


@pytest.mark.parametrize(
    ("xml", "signals", "line"),
    [
        (ARM_ON_BASE, "{joints: {elbow: /joint_states}}",
         r"leave out free body 'base'.*every free body under `bodies`"),
        (ARM_ON_BASE, "{bodies: {base: /pose}}", "leave out joint 'elbow'"),
        (ARM_ON_BASE, "{bodies: {arm: /pose}}", "free body 'arm'; expected one of base"),
        (ARM_ON_BASE, "{bodies: {base: /pose}, driven: {base: /pose, elbow: /joint_states}}",
         "body 'base' under bodies and driven; expected it under one"),
        (ARM_ON_BASE, "{driven: {base: /pose, elbow: /joint_states}}",
         "every joint follows its log; expected something to simulate"),
        (ARM_ON_BASE.replace('name="elbow" type="hinge"', 'name="hip" type="ball"'), "{bodies: {base: /pose}}",
         "leave out joint 'hip'"),
    ],
)  # fmt: skip
def test_what_signals_leave_out_is_refused(xml: str, signals: str, line: str) -> None:
    """A body that nobody names, a name that is no body's, and what a twin of a free body can't do: a line each."""
    with pytest.raises(InputError, match=line):
        load_rig(xml, signals)


def test_a_log_without_the_pose_is_refused(spec: TwinSpec) -> None:
    """The line says which topics of poses there are."""
    flight = fly({}, 2.0, 6)
    assert "/pose" in flight.spatial
    del flight.spatial["/pose"]  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="no topic /pose; expected it in the log, which has /imu"):
        read_measurements(spec, flight)


def test_pushes_on_turns_are_measured_by_the_weights_moment(spec: TwinSpec) -> None:
    """What turns a craft that hovers is next to nothing; a gust of a share of its weight pushes off its centre."""
    ones, weight = np.ones(6), MASS * GRAVITY
    loads = Loads(np.repeat([weight, 1e-6], 3), ones, ones, ones, ones, np.ones(4))
    gyration = np.sqrt(INERTIA.max() / MASS)
    np.testing.assert_allclose(spec.robot.scale(loads).exposure, np.repeat([weight, weight * gyration], 3))
    strong = replace(loads, force=np.full(6, weight))
    np.testing.assert_array_equal(spec.robot.scale(strong).exposure, strong.force)
