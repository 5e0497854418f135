"""`vpptwin inspect`: what it says of real logs, scored; what contradicts physics is told, never taken."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.guesses import RIGS, score_rig, write_model
from tests.logs.bags import EPOCH, JOINTS, Bag, stamp_header
from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.mapping.free_body import guess_bodies
from vpptwin.mapping.guess import guess_signals
from vpptwin.mapping.inspect import ask, inspect_logs
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[2]


def read_table() -> dict[str, tuple[int, ...]]:
    """Rig → logs, right, asked, wrong, as docs/logs.md says."""
    text = (ROOT / "docs/logs.md").read_text()
    rows = re.findall(r"^\| (\w+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", text, flags=re.MULTILINE)
    return {name: tuple(map(int, numbers)) for name, *numbers in rows}


@pytest.mark.parametrize("name", RIGS)
def test_guesses_of_real_rigs_are_never_wrong(shared_data: Path, tmp_path: Path, name: str) -> None:
    """Joints and servos, or attitude, position, angles, gyro, accelerometer: right or asked, as docs/logs.md says."""
    found = score_rig(shared_data, name, tmp_path)
    assert found[-1] == 0
    assert found == read_table()[name]


def write_log(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A CSV."""
    rows = np.column_stack(list(columns.values()))
    path.write_text("\n".join([",".join(columns), *(",".join(f"{v:.6f}" for v in row) for row in rows)]) + "\n")
    return path


TIME = np.arange(0.0, 20.0, 0.01)
SWING, RATE = 0.8 * np.sin(2.0 * TIME), 1.6 * np.cos(2.0 * TIME)
DELAYED = np.interp(TIME - 0.08, TIME, SWING)


@pytest.mark.parametrize(
    ("columns", "sure", "parts"),
    [
        ({"arm_pos": SWING, "arm_vel": RATE}, True, ["arm_vel is 1.00 of the slope of arm_pos (r 1.00)"]),
        ({"arm_pos": SWING, "arm_vel [deg/s]": np.rad2deg(RATE)}, True, ["arm_vel is in deg/s", "is 1.00 of"]),
        ({"arm_pos [deg]": np.rad2deg(SWING), "arm_vel": RATE}, True, ["arm_pos is in deg", "is 1.00 of the slope"]),
        ({"arm_pos": SWING, "arm_vel": np.rad2deg(RATE)}, False, ["left out: arm_vel is 57.29 of the slope"]),
        ({"arm_pos": SWING, "arm_vel": SWING}, False, ["left out: arm_vel is"]),
        ({"arm_pos": np.rad2deg(SWING)}, False, ["lie outside -1.5 to 1.5: in deg?"]),
        ({"arm_pos": SWING + 2.0, "arm_vel": RATE}, False, ["another sign or zero?"]),
        ({"arm_pos": np.round(2048 + 652 * SWING)}, False, ["counts of an encoder, of which 4096 a turn have scale"]),
        ({"arm_pos": SWING, "arm_pos_2": SWING}, False, ["or /log arm_pos_2"]),
        ({"arm_pos_error": SWING}, False, ["may be made of another signal"]),
        ({"angle": SWING}, False, ["no velocity tests it"]),
        ({"arm_pos": np.zeros_like(SWING)}, False, ["constant"]),
        ({"arm_pos": SWING, "arm_vel": np.full_like(SWING, np.nan)}, False, ["constant", "too little motion"]),
        ({"arm_deg": np.rad2deg(SWING)}, True, ["arm_deg: its name", "arm_deg is in deg"]),
        ({"arm_deg": np.rad2deg(SWING), "arm_dps": np.rad2deg(RATE)}, True, ["arm_dps is 1.00 of the slope"]),
        ({"arm": SWING, "arm_dot": RATE}, True, ["arm_dot is 1.00 of the slope of arm (r 1.00)"]),
        ({"theta": SWING, "dtheta": RATE}, True, ["dtheta is 1.00 of the slope of theta"]),
        ({"theta_deg": np.rad2deg(SWING), "theta_dot_rad_s": RATE}, True, ["theta_dot_rad_s is 1.00 of the slope"]),
        ({"arm": SWING, "darm": RATE}, True, ["arm: its name"]),
        ({"arm_temperature": SWING}, False, ["no position in the log looks like it"]),
        ({"arm_rpm": 10.0 * RATE}, False, ["no position in the log", "its velocity is integrated, which does for a"]),
    ],
)
def test_joints_are_tested_against_physics(
    tmp_path: Path, columns: dict[str, np.ndarray], sure: bool, parts: list[str]
) -> None:
    """What agrees is said with numbers, and what contradicts leaves a doubt."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", {"arm": (-1.5, 1.5)}, "motor")))
    signals = survey(write_log(tmp_path / "log.csv", {"time": TIME, **columns}))[1]
    guess = guess_signals(model, signals)[0]
    assert guess.sure == sure, (guess.reasons, guess.doubts)
    for part in parts:
        assert part in "; ".join([*guess.reasons, *guess.doubts])


@pytest.mark.parametrize("extra", [{}, {"y": SWING}])
def test_slides_and_hinges_are_told_by_kind(tmp_path: Path, extra: dict[str, np.ndarray]) -> None:
    """A crane logged as x, theta, u: one slide and one length, one hinge and one angle; with two lengths none is it."""
    (tmp_path / "m.xml").write_text(
        '<mujoco><worldbody><body><joint name="trolley" type="slide"/><geom size="0.1"/><body><joint name="rope"/>'
        '<geom size="0.1"/></body></body></worldbody><actuator><motor name="belt" joint="trolley"/></actuator></mujoco>'
    )
    columns = {"t": TIME, "x": SWING, "xdot": RATE, "theta": SWING**2, "dtheta": 2 * SWING * RATE, "u": RATE, **extra}
    signals = survey(write_log(tmp_path / "log.csv", columns))[1]
    guesses = guess_signals(mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml")), signals)
    found = {guess.target: {name: signal.label for name, signal in guess.fields.items()} for guess in guesses}
    slide = {} if extra else {"position": "x", "velocity": "xdot"}
    assert found == {"trolley": slide, "rope": {"position": "theta", "velocity": "dtheta"}, "belt": {"effort": "u"}}
    assert not any(guess.sure for guess in guesses)
    assert "only that says that theta is rope" in guesses[1].doubts


def test_an_angle_of_one_turn_is_tested_as_it_goes_on(tmp_path: Path) -> None:
    """Its velocity is the slope of what turns on; a voltage drives it, by how much nobody says."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", {"arm": (-99.0, 99.0)}, "motor")))
    turns = np.rad2deg(8.0 * SWING)
    logged = np.where(np.arange(len(TIME)) == 30, np.nan, (turns + 180.0) % 360.0 - 180.0)
    columns = {"stamp": TIME, "arm_deg": logged, "arm_rad_s": 8.0 * RATE, "voltage": RATE}
    arm, motor = guess_signals(model, survey(write_log(tmp_path / "log.csv", columns))[1])
    assert arm.sure
    assert arm.units == {"position": "deg"}
    assert any("arm_rad_s is 1.00 of the slope of arm_deg" in reason for reason in arm.reasons)
    assert motor.fields["effort"].label == "voltage"
    assert not motor.sure


@pytest.mark.parametrize(
    ("asked", "sure", "part"),
    [(SWING, True, "follows arm_target_pos by 80 ms"), (-SWING, False, "r "),
     (np.interp(TIME + 0.1, TIME, DELAYED), True, "by 100 ms"),
     (np.interp(TIME - 0.2, TIME, SWING), False, "by -120 ms")],
)  # fmt: skip
def test_targets_lead_positions(tmp_path: Path, asked: np.ndarray, sure: bool, part: str) -> None:
    """A target that comes after what it should move is none."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", {"arm": (-1.5, 1.5)}, "position")))
    log = write_log(tmp_path / "log.csv", {"time": TIME, "arm_pos": DELAYED, "arm_target_pos": asked})
    servo = guess_signals(model, survey(log)[1])[1]
    assert servo.sure == sure, (servo.reasons, servo.doubts)
    assert part in "; ".join([*servo.reasons, *servo.doubts])


@pytest.mark.parametrize(("sign", "sure"), [(1.0, True), (-1.0, False)])
def test_targets_of_speeds_are_held_against_slopes(tmp_path: Path, sign: float, sure: bool) -> None:
    """`arm_target` is what a velocity servo called as its joint is asked for."""
    path = write_model(tmp_path / "m.xml", {"arm": (-1.5, 1.5)}, "velocity")
    log = write_log(tmp_path / "log.csv", {"time": TIME, "arm": SWING, "arm_target": sign * RATE})
    _, servo = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(log)[1])
    assert (servo.fields["effort"].label, servo.sure) == ("arm_target", sure)
    assert "arm_target is " in "; ".join([*servo.reasons, *servo.doubts])


@pytest.mark.parametrize("stem", ["cart_", "vicon_", ""])
def test_a_body_on_wheels_is_known_by_its_name(tmp_path: Path, stem: str) -> None:
    """Its height does not change; x, y and z that nothing names, nor its attitude, are no more than likely."""
    body = "<body name='cart'><freejoint/><geom size='0.1' mass='1'/></body>"
    (tmp_path / "m.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    turn = {
        f"{stem}qw": np.cos(SWING / 2),
        f"{stem}qx": 0.0 * TIME,
        f"{stem}qy": 0.0 * TIME,
        f"{stem}qz": np.sin(SWING / 2),
    }
    place = {f"{stem}x": SWING, f"{stem}y": np.cos(TIME), f"{stem}z": 0.0 * TIME + 0.1}
    log = write_log(tmp_path / "log.csv", {"time": TIME, **place, **turn})
    (cart,) = guess_bodies(mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml")), survey(log)[1])
    assert [signal.field for signal in cart.vectors["position"]] == list(place)
    assert [signal.field for signal in cart.vectors["attitude"]] == list(turn)
    assert cart.sure == bool(stem), cart.doubts


def test_a_target_says_its_unit(tmp_path: Path) -> None:
    """An angle asked for in degrees is held against the range in radians, and written so."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", {"arm": (-1.5, 1.5)}, "position")))
    columns = {"time": TIME, "arm_deg": np.rad2deg(DELAYED), "arm_cmd_deg": np.rad2deg(SWING)}
    servo = guess_signals(model, survey(write_log(tmp_path / "log.csv", columns))[1])[1]
    assert servo.sure, servo.doubts
    assert servo.units == {"effort": "deg"}


def test_a_short_name_is_no_part_of_another(tmp_path: Path) -> None:
    """Joint q is not found in torque, nor wrist in wrist_roll where that is a joint too."""
    limits = {"q": None, "wrist": None, "wrist_roll": None}
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", limits, "motor")))
    columns = {"time": TIME, "wrist_roll_pos": SWING, "wrist_pos": RATE, "squeezed_position": SWING}
    guesses = guess_signals(model, survey(write_log(tmp_path / "l.csv", columns))[1])
    found = {guess.target: guess.fields.get("position") for guess in guesses if guess.group == "joints"}
    assert {name: signal and signal.field for name, signal in found.items()} == {
        "q": None, "wrist": "wrist_pos", "wrist_roll": "wrist_roll_pos",
    }  # fmt: skip


def test_the_order_is_asked_once(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who says yes has no more to look at; who says no keeps the doubts."""
    model = load_twin(ROOT / "examples/double_pendulum/both.yaml").model
    for answer, sure in (("n", 0), ("y", 2)):
        guesses = guess_signals(model, survey(shared_data / "double_pendulum/design_A_02.csv")[1])
        questions: list[str] = []
        monkeypatch.setattr("builtins.input", lambda text, a=answer, q=questions: q.append(text) or a)
        assert sum(guess.sure for guess in ask(guesses)) == sure
        assert questions == ["Is this the order of the columns: pos_meas1 = shoulder, pos_meas2 = elbow? [y/n] "]


def test_the_twin_that_is_written_works(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A CSV and an MJCF become a twin that `compare` takes, every doubt stands in it."""
    monkeypatch.setenv("COLUMNS", "200")
    log, out = shared_data / "double_pendulum/design_A_02.csv", tmp_path / "twin.yaml"
    model = ROOT / "examples/double_pendulum/double_pendulum.xml"
    assert main(["inspect", str(log), "--model", str(model), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"/design_A_02 tau_fric1 +│ float64 │ +500 Hz │ 0 +│ +│ constant", shown)
    assert "DOUBT: only the order says that pos_meas1 is shoulder" in out.read_text()
    spec = load_twin(out)
    assert spec.robot.signals.entries["/joint_states"]["elbow"].position.path == "pos_meas2"
    assert main(["compare", str(log), "--twin", str(out)]) == 0


@pytest.mark.parametrize(
    ("arguments", "part"),
    [(["--out", "twin.yaml"], "without --model"), (["--model", "none.xml"], "none.xml"), ([], "no file")],
)
def test_bad_inspections_are_refused(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], part: str
) -> None:
    """In one line, with exit code 2."""
    log = shared_data / "simple_pendulum/ilqr.csv" if arguments else tmp_path / "missing.csv"
    assert main(["inspect", str(log), *arguments]) == 2
    error = capsys.readouterr().err
    assert part in error
    assert error.count("\n") == 1


def test_a_column_that_is_called_like_an_actuator_drives_it(tmp_path: Path) -> None:
    """And nothing more, as of joints; a position of that name stays one."""
    path = write_model(tmp_path / "m.xml", {"swing": None}, "motor")
    path.write_text(path.read_text().replace("<motor name='swing'", "<motor name='drive'"))
    model = mujoco.MjModel.from_xml_path(str(path))
    columns = {"time": TIME, "swing": SWING, "drive": np.sign(RATE)}
    joint, motor = guess_signals(model, survey(write_log(tmp_path / "l.csv", columns))[1])
    assert [motor.target, joint.fields["position"].field, motor.fields["effort"].field] == ["drive", "swing", "drive"]


def test_a_target_is_called_as_the_joint_that_its_servo_moves(tmp_path: Path) -> None:
    """`arm_target` of a servo called otherwise."""
    path = write_model(tmp_path / "m.xml", {"arm": None, "wrist": None}, "position")
    path.write_text(re.sub("<position name='(arm|wrist)'", r"<position name='servo_\1_1'", path.read_text()))
    columns = {"time": TIME, "arm_pos": DELAYED, "arm_target": SWING, "wrist_pos": -DELAYED, "wrist_target": -SWING}
    log = write_log(tmp_path / "log.csv", columns)
    servos = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(log)[1])[2:]
    assert [servo.fields["effort"].label for servo in servos] == ["arm_target", "wrist_target"]
    assert "arm_target: the name of the joint that it moves" in servos[0].reasons


@pytest.mark.parametrize("asked", [False, True])
def test_efforts_are_called_as_the_joints_that_motors_move(tmp_path: Path, asked: bool) -> None:
    """By columns or in a message, in another order than motors; what was asked for comes before what was measured."""
    path = write_model(tmp_path / "m.xml", {"arm": None, "wrist": None}, "motor")
    path.write_text(re.sub("<motor name='(arm|wrist)'", r"<motor name='\1_drive'", path.read_text()))
    path.write_text(path.read_text().replace("arm_drive", "m1").replace("wrist_drive", "m2"))
    columns = {"time": TIME, "wrist_pos": -SWING, "arm_pos": SWING, "wrist_effort": -RATE, "arm_effort": RATE}
    columns |= {"wrist_torque_cmd": 1.1 * -RATE, "arm_torque_cmd": 1.1 * RATE} if asked else {}
    log = write_log(tmp_path / "l.csv", columns)
    motors = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(log)[1])[2:]
    found = [(motor.target, motor.fields["effort"].label, motor.sure) for motor in motors]
    ending = "torque_cmd" if asked else "effort"  # which may be measured, and is asked
    assert found == [("m1", f"arm_{ending}", asked), ("m2", f"wrist_{ending}", asked)]


def test_commands_are_held_against_ranges_in_their_unit(tmp_path: Path) -> None:
    """1000 gf are within 10 N."""
    path = write_model(tmp_path / "m.xml", {"arm": None}, "motor", slide=True)
    path.write_text(path.read_text().replace("<motor ", "<motor ctrllimited='true' ctrlrange='-12 12' "))
    columns = {"time": TIME, "arm_pos": SWING, "arm_thrust_cmd_gf": 1000.0 * RATE / np.abs(RATE).max()}
    motor = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(write_log(tmp_path / "l.csv", columns))[1])[1]
    assert (motor.units, motor.doubts) == ({"effort": "gf"}, [])


def test_the_topic_tells_what_numbers_without_names_are(tmp_path: Path) -> None:
    """Of a Float64MultiArray by its order, by the log's time, as it has no header; `diagnose` reads what is written."""
    path = write_model(tmp_path / "m.xml", {"left": None, "right": None}, "motor")
    stamps, bag = [EPOCH + 10**6 * i for i in range(len(TIME))], Bag(tmp_path / "log.mcap")
    joints = [{"header": stamp_header(now), "name": ["left", "right"], "position": [moved, -moved], "velocity": [],
               "effort": []} for now, moved in zip(stamps, SWING)]  # fmt: skip
    bag.add("/joint_states", JOINTS, joints)
    bag.add("/motor_torques", "std_msgs/msg/Float64MultiArray", [{"data": [r, -r]} for r in RATE], "float64[] data")
    bag.write()
    inspect_logs([tmp_path / "log.mcap"], str(path), tmp_path / "t.yaml")
    signals = load_twin(tmp_path / "t.yaml").robot.signals
    found = read_flight(tmp_path / "log.mcap", signals=signals.entries).joints[signals.actuators["right"]]
    np.testing.assert_allclose(found["right"]["effort"], -RATE)
    bare = tmp_path / "bare.yaml"
    bare.write_text((tmp_path / "t.yaml").read_text().replace(", stamp: log_time", ""))
    with pytest.raises(InputError, match=r"header\.stamp.*say `stamp: log_time` of it"):
        read_flight(tmp_path / "log.mcap", signals=load_twin(bare).robot.signals.entries)
