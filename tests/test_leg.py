"""A leg on a base that follows its log, its foot on a ball joint: read, estimated, stepped, shown, what it may have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from proving.leg import STEP, move, simulate, write_twin
from proving.logs import write_log
from tests.builders import load_rig
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.joints import smooth_series
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.replay import replay
from vpptwin.estimation.series import Series
from vpptwin.estimation.windows import cut_windows, fly_windows
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec, load_twin
from vpptwin.twin.robot.manifold import difference_attitudes, difference_poses, follow_sign, rotate
from vpptwin.twin.robot.robot import Loads
from vpptwin.viz.plots.panels import tell_flight
from vpptwin.viz.scene.show import prepare_show

BOB = """<mujoco><option timestep="0.001"/><worldbody><body euler="0 0 90"><body name="bob" euler="180 0 0">
<joint name="hook" type="ball"/><geom type="sphere" size="0.03" pos="0.05 0 0.3" mass="0.2"/><site name="imu"/></body>
</body></worldbody></mujoco>"""
HUNG = "{bodies: {bob: /pose}, sites: {imu: /imu}}"
"""Signals of a spherical pendulum."""
UP = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The nominal leg."""
    return load_twin(write_twin(tmp_path_factory.mktemp("leg")))


def test_the_twin_follows_an_independent_simulation(spec: TwinSpec) -> None:
    """From true states, trunk led along its log: half a second of open loop ends within what steps of 2 ms cost."""
    poses, rates, _ = simulate({}, 6.0, 1)
    order = [0, 1, 2, 6, 3, 4, 5, 7, 8, 12, 9, 10, 11]
    measured, truth = read_measurements(spec, move({}, 6.0, 1, noise=0.0)), poses[:, order]
    starts = np.arange(0.5, 5.0, 0.25)
    first, last = (np.rint((starts + late) / STEP).astype(int) for late in (0.0, 0.5))
    windows = cut_windows(spec, measured, starts, 0.5, causal=False)
    assert windows.free_dofs == 5
    windows.velocity[:, 6:] = rates[first]
    windows = replace(windows, pose=truth[first])
    off = difference_poses(spec.model, truth[last], fly_windows(Twin(spec, len(windows)), windows).pose[:, -1])
    assert np.abs(off[:, :6]).max() < 1e-4
    assert np.sqrt((off[:, 6:8] ** 2).mean()) < 1.5e-3
    assert np.sqrt((off[:, 8:] ** 2).mean()) < 4e-3


def test_states_are_estimated_and_a_body_that_leads_is_smoothed(spec: TwinSpec) -> None:
    """Noise of 0.3 mm and 1 mrad at 100 Hz leaves the trunk's rates good to a fifth of their differences' noise."""
    noisy, quiet = (read_measurements(spec, move({}, 5.0, 2, noise=noise)) for noise in (1.0, 0.0))
    times = np.arange(0.5, 4.5, 0.0437)
    (pose, velocity), (exact, speeds) = (estimate_states(log, times, spec.model, False) for log in (noisy, quiet))
    off = np.sqrt((difference_poses(spec.model, exact, pose) ** 2).mean(axis=0))
    assert off[:3].max() < 3e-4
    assert max(off[3:6].max(), off[8:].max()) < 1e-3
    assert np.sqrt(((velocity - speeds) ** 2).mean(axis=0))[3:6].max() < 0.2 * np.sqrt(2.0) * 1e-3 / 0.01
    time = np.linspace(0.0, 3.0, 301)
    still = Series("x", "m", time, np.sin(3.0 * time), 1e-3)
    np.testing.assert_allclose(smooth_series(still).value, still.value, atol=3e-5)  # third differences of a sine


def test_a_log_of_the_leg_reads_back_and_is_shown(spec: TwinSpec, tmp_path: Path) -> None:
    """As MCAP; plot and page have the trunk, both joints and the foot's angles from the shank."""
    flight = read_flight(write_log(move({}, 4.0, 3), tmp_path / "motion.mcap"))
    story = tell_flight(flight, replay(spec, flight), spec)
    labels = [panel.label for panel in story.panels]
    wanted = ["hip position [rad]", "ankle roll [rad]", "trunk z [m]", "trunk yaw [rad]", "hip_motor, input"]
    assert set(wanted) <= set(labels)
    assert all(len(panel.lines) == 2 for panel in story.panels if not panel.label.endswith("input"))
    show = prepare_show(flight, None, spec)
    assert np.ptp(show.log.qpos[:, 0]) > 0.02
    turned = difference_attitudes(flight.spatial["/ankle"]["attitude"][0], show.log.qpos[0, 9:13])
    assert np.abs(turned).max() < 0.05


def test_what_a_leg_may_have(spec: TwinSpec) -> None:
    """Nothing of the trunk, which follows its log; masses of links, friction and a payload of the foot."""
    kinds = {effect.id for effect in spec.catalogue}
    assert {"shank.mass", "foot.payload", "foot.com", "ankle.coulomb", "ankle.viscous", "knee.load"} <= kinds
    assert not [name for name in kinds if name.startswith(("trunk", "ankle.offset", "ankle.spring"))]


def test_a_pendulum_is_read_from_the_pose_of_its_body() -> None:
    """Its joint's quaternion is what MuJoCo has when the body stands as logged; the gyro gives its rates."""
    spec = load_rig(BOB, HUNG)
    data, rng = mujoco.MjData(spec.model), np.random.default_rng(1)
    joint = rotate(UP, np.cumsum(0.02 * rng.standard_normal((200, 3)), axis=0))
    seen = np.empty((200, 4))
    for row, turn in zip(seen, joint):
        data.qpos[:] = turn
        mujoco.mj_kinematics(spec.model, data)
        row[:] = data.body("bob").xquat
    time, rate = 0.01 * np.arange(200), rng.standard_normal((200, 3))
    spatial = {"/pose": Stream(time, {"attitude": seen}), "/imu": Stream(time, {"rate": rate})}
    measured = read_measurements(spec, Flight(Path("log.mcap"), 0, {}, {}, spatial=spatial))
    np.testing.assert_allclose(difference_attitudes(follow_sign(joint), measured.attitudes[0].value), 0.0, atol=1e-12)
    np.testing.assert_allclose([measured.velocities[i].value for i in range(3)], rate.T, atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "torque"),
    [
        ({"hook.viscous": {"damping": 0.01}}, lambda w: -0.01 * w),
        ({"hook.coulomb": {"torque": 0.004}}, lambda w: -0.004 * np.sign(w)),
        ({"bob.twist": {"x": 0.001, "y": -0.002, "z": 0.003}}, lambda w: np.array([0.001, -0.002, 0.003])),
    ],
)
def test_effects_on_a_ball_joint_act_as_they_say(effect: dict, torque: object) -> None:
    """One step: what is gained besides what MuJoCo alone gains is the torque at its end by the inertia."""
    spec, velocity = load_rig(BOB, HUNG), np.array([[1.0, -2.0, 0.5]])
    gained = []
    for given in ({}, effect):
        twin = Twin(spec.with_effects(given), 1)
        state = twin.initial_state(qpos=rotate(UP, np.array([[0.3, 0.2, 0.1]])), qvel=velocity)
        gained.append(twin.replay_commands(state, np.zeros((1, 1, 0))).qvel[0, -1])
    inertia, data = np.zeros((3, 3)), mujoco.MjData(spec.model)
    mujoco.mj_forward(spec.model, data)
    mujoco.mj_fullM(spec.model, data, inertia)
    found = inertia @ (gained[1] - gained[0]) / 1e-3
    np.testing.assert_allclose(found, torque(gained[1]), rtol=1e-6)  # type: ignore[operator]


def test_a_ball_joint_of_columns(tmp_path: Path) -> None:
    """Its attitude from its parent, as fields; what else is no such joint's is refused."""
    entry = "{topic: flight, attitude: [qw, qx, qy, qz]}"
    spec = load_rig(BOB, f"{{joints: {{hook: {entry}}}}}")
    turn = rotate(UP, np.linspace(0.0, 1.0, 50)[:, None] * np.array([0.3, 0.5, 0.1]))
    rows = np.column_stack([np.arange(50) * 0.02, turn])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,qw,qx,qy,qz", comments="")
    flight = read_flight(tmp_path / "log.csv", signals=spec.robot.signals.entries)
    np.testing.assert_allclose(flight.spatial["/turns/hook"]["attitude"], turn, atol=1e-9)
    assert set(read_measurements(spec, flight).attitudes) == {0}
    assert spec.robot.signals.as_dict()["joints"]["hook"]["attitude"] == {"path": ["qw", "qx", "qy", "qz"]}
    wrong = load_rig(BOB, "{joints: {hook: {topic: flight, position: qw}}}")
    flight = read_flight(tmp_path / "log.csv", signals=wrong.robot.signals.entries)
    with pytest.raises(InputError, match="no topic /joint_states; expected it in the log"):
        read_measurements(wrong, flight)


@pytest.mark.slow
def test_a_knee_that_rubs_is_named(spec: TwinSpec) -> None:
    """0.1 N m of dry friction on two motions of 16 s: first, with its size."""
    verdict = diagnose(spec, [move({"knee.coulomb": {"torque": 0.1}}, 16.0, 100 + i) for i in range(2)]).verdict
    assert verdict.causes[0].effect == "knee.coulomb"
    assert verdict.causes[0].parameters["torque"].value == pytest.approx(0.1, rel=0.1)


BEARING = """<mujoco><worldbody><body name="sat"><joint name="bearing" type="ball"/><geom size="0.1" mass="5"/>
<site name="imu"/></body></worldbody></mujoco>"""


def test_a_gyro_on_a_ball_joint_may_be_off(tmp_path: Path) -> None:
    """A satellite on an air bearing, whose attitude is named under `bodies`, without a position: it has none."""
    signals = (
        "{bodies: {sat: {topic: log, attitude: [qw, qx, qy, qz]}}, sites: {imu: {topic: log, rate: [gx, gy, gz]}}}"
    )
    robot = load_rig(BEARING, signals).robot
    found = {effect.id: effect for effect in robot.list_misread()}
    kinds = {"sat": ("delay", "drift", "misalignment"), "imu": ("bias", "scale", "misalignment")}
    assert set(found) == {f"{name}.{kind}" for name, listed in kinds.items() for kind in listed}
    bearing = int(robot.model.joint("bearing").id)
    weak = replace(robot, loads=Loads(*(np.full(3, value) for value in (0.1, 1.0, 1.0, 0.0, 0.02)), np.ones(0)))
    assert weak.list_free()[bearing].shift == pytest.approx(0.02 * 0.1 / (5.0 * 9.81))
    assert found["imu.bias"].apply.places == tuple(("rate.bias", dof) for dof in range(3))  # type: ignore[attr-defined]
    rows = "".join(f"{0.01 * i},1,0,0,0,0.1,0,0\n" for i in range(9))
    (tmp_path / "log.csv").write_text("t,qw,qx,qy,qz,gx,gy,gz\n" + rows)
    flight = read_flight(tmp_path / "log.csv", signals=robot.signals.entries)
    assert flight.spatial[robot.signals.bodies["sat"]]["attitude"].shape == (9, 4)
