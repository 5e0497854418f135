"""Joints and actuators of a log, by name, order and kind: right or asked; what contradicts physics is never taken."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from benchmarks.guesses import RIGS, score_rig, write_model
from tests.logs.bags import EPOCH, JOINTS, Bag, stamp_header
from vpptwin.logs import read_flight
from vpptwin.logs.messages import compose_definition
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.guess import Guess, guess_signals
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[2]
HEADER = "".join(
    "=" * 80 + part.rstrip() + "\n" for part in compose_definition("sensor_msgs/msg/JointState").split("=" * 80)[1:]
)
TIME = np.arange(0.0, 20.0, 0.01)
SWING, RATE = 0.8 * np.sin(2.0 * TIME), 1.6 * np.cos(2.0 * TIME)
DELAYED = np.interp(TIME - 0.08, TIME, SWING)
LIMITS = (-1.5, 1.5)


def write_log(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A CSV."""
    rows = np.column_stack(list(columns.values()))
    path.write_text("\n".join([",".join(columns), *(",".join(f"{v:.6f}" for v in row) for row in rows)]) + "\n")
    return path


def guess(
    folder: Path, log: Path | dict[str, np.ndarray], kind: str = "motor", motors: dict[str, str] | None = None,
    **limits: tuple[float, float] | None,
) -> dict[str, Guess]:  # fmt: skip
    """What a log has of hinges with these limits, and under `NAME!` of the actuator of each, of this kind and name."""
    path = write_model(folder / "m.xml", limits, kind)
    for name, motor in (motors or {}).items():
        path.write_text(path.read_text().replace(f"<{kind} name='{name}'", f"<{kind} name='{motor}'"))
    log = log if isinstance(log, Path) else write_log(folder / "log.csv", {"time": TIME, **log})
    guesses = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(log)[1])
    return {each.target + "!" * (each.group == "actuators"): each for each in guesses}


def say(each: Guess) -> str:
    """Everything that speaks for a guess and against it."""
    return "; ".join([*each.reasons, *each.doubts])


@pytest.mark.parametrize("name", RIGS)
def test_guesses_of_real_rigs_are_never_wrong(shared_data: Path, tmp_path: Path, name: str) -> None:
    """Joints and servos, or attitude, position, angles, gyro, accelerometer: right or asked, as docs/logs.md says."""
    text = (ROOT / "docs/logs.md").read_text()
    rows = re.findall(r"^\| (\w+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", text, flags=re.MULTILINE)
    table = {rig: tuple(map(int, numbers)) for rig, *numbers in rows}
    found = score_rig(shared_data, name, tmp_path)
    assert found[-1] == 0
    assert found == table[name]


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
    arm = guess(tmp_path, columns, arm=LIMITS)["arm"]
    assert arm.sure == sure, (arm.reasons, arm.doubts)
    assert all(part in say(arm) for part in parts), say(arm)


NAMES = [
    # A joint's name is no part of another: q is not in torque, nor wrist in wrist_roll where that is a joint too.
    ("motor", {"q": "q", "wrist": "wrist", "wrist_roll": "wrist_roll"},
     {"wrist_roll_pos": SWING, "wrist_pos": RATE, "squeezed_position": SWING},
     {"q": "", "wrist": "wrist_pos", "wrist_roll": "wrist_roll_pos"}, ""),
    # A column that is called like an actuator, and nothing more, drives it; a position of that name stays one.
    ("motor", {"swing": "drive"}, {"swing": SWING, "drive": np.sign(RATE)}, {"swing": "swing", "drive!": "drive"}, ""),
    # A target is called as the joint that its servo moves.
    ("position", {"arm": "servo_arm_1", "wrist": "servo_wrist_1"},
     {"arm_pos": DELAYED, "arm_target": SWING, "wrist_pos": -DELAYED, "wrist_target": -SWING},
     {"servo_arm_1!": "arm_target", "servo_wrist_1!": "wrist_target"}, "arm_target: the name of the joint that it"),
    # What says that a joint is one is no part of its name; its target is no torque of its motor.
    ("motor", {"FL_hip_joint": "hip", "FL_calf_joint": "calf"},
     {f"FL_{part} {what}": SWING for part in ("hip", "calf") for what in ("position", "target")},
     {"FL_calf_joint": "FL_calf position"}, "FL_calf target: the model's actuator takes a force or moment"),
    # Of two alike columns what leads is the target of the servo, in whatever order they stand.
    ("position", {"arm": "arm"}, {"arm": SWING, "arm_2": DELAYED}, {"arm": "arm_2", "arm!": "arm"}, "follows arm by"),
    ("position", {"arm": "arm"}, {"arm": DELAYED, "arm_2": SWING}, {"arm": "arm", "arm!": "arm_2"}, "follows arm_2 by"),
    # Nothing tells what was asked for from what was measured where both are one column, logged twice.
    ("position", {"arm": "arm"}, {"arm_pos": SWING, "arm_action_pos": SWING}, {"arm": "arm_pos"}, "are identical"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "motors", "columns", "labels", "said"), NAMES)
def test_names_tell_what_is_what(
    tmp_path: Path, kind: str, motors: dict[str, str], columns: dict[str, np.ndarray], labels: dict[str, str], said: str
) -> None:
    """Of joints, and of actuators by their own name or that of the joint that they move."""
    found = guess(tmp_path, columns, kind, motors, **dict.fromkeys(motors))
    for name, label in labels.items():
        (signal,) = found[name].fields.values() or [None]
        assert (signal.label if signal else "") == label
    assert said in "; ".join(map(say, found.values()))


def test_a_filtered_copy_is_asked_about(tmp_path: Path) -> None:
    """What comes first and is rougher may be the raw signal of the other."""
    noise = np.random.default_rng(3).normal(0.0, 0.02, len(TIME))
    smooth = np.interp(TIME - 0.05, TIME, np.convolve(SWING + noise, np.ones(15) / 15.0, "same"))
    found = guess(tmp_path, {"arm": SWING + noise, "arm_2": smooth}, "position", arm=None)
    assert any("is arm_2 a filtered arm?" in doubt for doubt in found["arm"].doubts)
    assert "effort" not in found["arm!"].fields


@pytest.mark.parametrize("asked", [False, True])
def test_efforts_are_called_as_the_joints_that_motors_move(tmp_path: Path, asked: bool) -> None:
    """By columns in another order than motors; what was asked for comes before what was measured, which is asked."""
    columns = {"wrist_pos": -SWING, "arm_pos": SWING, "wrist_effort": -RATE, "arm_effort": RATE}
    columns |= {"wrist_torque_cmd": 1.1 * -RATE, "arm_torque_cmd": 1.1 * RATE} if asked else {}
    found = guess(tmp_path, columns, "motor", {"arm": "m1", "wrist": "m2"}, arm=None, wrist=None)
    ending = "torque_cmd" if asked else "effort"
    for motor, name in (("m1!", "arm"), ("m2!", "wrist")):
        assert (found[motor].fields["effort"].label, found[motor].sure) == (f"{name}_{ending}", asked)


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
    found = {each.target: {name: signal.label for name, signal in each.fields.items()} for each in guesses}
    slide = {} if extra else {"position": "x", "velocity": "xdot"}
    assert found == {"trolley": slide, "rope": {"position": "theta", "velocity": "dtheta"}, "belt": {"effort": "u"}}
    assert not any(each.sure for each in guesses)
    assert "only that says that theta is rope" in guesses[1].doubts


def test_an_angle_of_one_turn_is_tested_as_it_goes_on(tmp_path: Path) -> None:
    """Its velocity is the slope of what turns on; a voltage drives it, by how much nobody says."""
    turns = np.rad2deg(8.0 * SWING)
    logged = np.where(np.arange(len(TIME)) == 30, np.nan, (turns + 180.0) % 360.0 - 180.0)
    found = guess(tmp_path, {"arm_deg": logged, "arm_rad_s": 8.0 * RATE, "voltage": RATE}, arm=(-99.0, 99.0))
    assert (found["arm"].sure, found["arm"].units) == (True, {"position": "deg"})
    assert "arm_rad_s is 1.00 of the slope of arm_deg" in say(found["arm"])
    assert (found["arm!"].fields["effort"].label, found["arm!"].sure) == ("voltage", False)


TARGETS = [
    ("position", {"arm_pos": DELAYED, "arm_target_pos": SWING}, True, "follows arm_target_pos by 80 ms"),
    ("position", {"arm_pos": DELAYED, "arm_target_pos": -SWING}, False, "r "),
    ("position", {"arm_pos": DELAYED, "arm_target_pos": np.interp(TIME + 0.1, TIME, DELAYED)}, True, "by 100 ms"),
    ("position", {"arm_pos": DELAYED, "arm_target_pos": np.interp(TIME - 0.2, TIME, SWING)}, False, "by -120 ms"),
    ("position", {"arm_deg": np.rad2deg(DELAYED), "arm_cmd_deg": np.rad2deg(SWING)}, True, "is in deg"),
    ("position", {"arm_pos": DELAYED, "arm_cmd": np.rad2deg(SWING)}, True, "so in deg"),
    ("velocity", {"arm": SWING, "arm_target": RATE}, True, "arm_target is "),
    ("velocity", {"arm": SWING, "arm_target": -RATE}, False, "arm_target is "),
]


@pytest.mark.parametrize(("kind", "columns", "sure", "part"), TARGETS)
def test_targets_are_held_against_what_follows_them(
    tmp_path: Path, kind: str, columns: dict[str, np.ndarray], sure: bool, part: str
) -> None:
    """A target that comes after what it should move is none; one of a speed is its slope; degrees are held so."""
    servo = guess(tmp_path, columns, kind, arm=LIMITS)["arm!"]
    assert (servo.fields["effort"].label, servo.sure) == (list(columns)[1], sure), (servo.reasons, servo.doubts)
    assert part in say(servo)
    assert servo.units == ({"effort": "deg"} if "deg" in part else {})


def test_commands_are_held_against_ranges_in_their_unit(tmp_path: Path) -> None:
    """1000 gf are within 10 N."""
    path = write_model(tmp_path / "m.xml", {"arm": None}, "motor", slide=True)
    path.write_text(path.read_text().replace("<motor ", "<motor ctrllimited='true' ctrlrange='-12 12' "))
    columns = {"time": TIME, "arm_pos": SWING, "arm_thrust_cmd_gf": 1000.0 * RATE / np.abs(RATE).max()}
    motor = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(write_log(tmp_path / "l.csv", columns))[1])[1]
    assert (motor.units, motor.doubts) == ({"effort": "gf"}, [])


@pytest.mark.parametrize(("gear", "sure"), [(50.0, True), (1.0, False)])
def test_a_motor_with_a_pulley_is_logged_as_torque(tmp_path: Path, gear: float, sure: bool) -> None:
    """Or by a screw: its gear makes a force of it; without a gear a torque on a slide is a doubt."""
    path = write_model(tmp_path / "m.xml", {"arm": None}, "motor", slide=True)
    path.write_text(path.read_text().replace("<motor ", f"<motor gear='{gear}' "))
    columns = {"time": TIME, "arm_pos_mm": SWING, "arm_torque_cmd_Nm": RATE}
    motor = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(write_log(tmp_path / "l.csv", columns))[1])[1]
    assert (motor.sure, motor.units) == (sure, {}), motor.doubts


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


def write_echo(path: Path, prefix: str, ends: tuple[str, str], swap: bool = False) -> Path:
    """What `rostopic echo -p` makes of a JointState of an elbow and a shoulder, or one like it."""
    a, b = ends
    names = ["shoulder", "elbow"] if swap else ["elbow", "shoulder"]
    head = f"%time,{prefix}header.seq,{prefix}name{a},{prefix}name{b},{prefix}position{a},{prefix}position{b},"
    head += f"{prefix}velocity{a},{prefix}velocity{b},{prefix}effort{a},{prefix}effort{b}"
    rows = [f"{round(t * 1e9) + 10**18},{i},{names[0]},{names[1]},{q},{-q},{v},{-v},{np.sign(v)},{-np.sign(v)}"
            for i, (t, q, v) in enumerate(zip(TIME, SWING, RATE))]  # fmt: skip
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize("convert", [False, True])
@pytest.mark.parametrize(("prefix", "ends", "swap"), [
    ("field.", ("0", "1"), False), ("field.", ("0", "1"), True), ("", ("_0", "_1"), False),
    ("state.joint_", ("[0]", "[1]"), True),
])  # fmt: skip
def test_columns_of_names_say_which_joint_is_which(
    tmp_path: Path, convert: bool, prefix: str, ends: tuple[str, str], swap: bool
) -> None:
    """Not the order of columns; in the MCAP that `convert` makes of it, too."""
    log = write_echo(tmp_path / "echo.csv", prefix, ends, swap)
    if convert:
        transcribe(log, log := tmp_path / "echo.mcap")
    found = guess(tmp_path, log, shoulder=None, elbow=None)
    first, second = ("shoulder", "elbow") if swap else ("elbow", "shoulder")
    for name, end in ((first, ends[0]), (second, ends[1])):
        assert {q: s.label for q, s in found[name].fields.items()} == {
            "position": f"{prefix}position{end}", "velocity": f"{prefix}velocity{end}",
        }  # fmt: skip
        assert found[name].sure, found[name].doubts
        assert found[f"{name}!"].fields["effort"].label == f"{prefix}effort{end}"


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
def test_lists_of_names_say_which_joint_is_which(tmp_path: Path, kind: str) -> None:
    """Beside lists of numbers: rows of a JointState in Parquet, messages of a controller's state in a bag."""
    names, moved = ["elbow_joint", "shoulder_joint"], [[q, -q] for q in SWING]
    if kind == "parquet":
        table = pa.table({"time": TIME, "name": [names] * len(TIME), "position": moved})
        parquet.write_table(table, log := tmp_path / "log.parquet")
    else:
        text = f"std_msgs/Header header\nstring[] joint_names\nfloat64[] position\n{HEADER}"
        messages = [{"header": stamp_header(EPOCH + 10**7 * i), "joint_names": names, "position": row}
                    for i, row in enumerate(moved)]  # fmt: skip
        log = Bag(tmp_path / "log.mcap").add("/state", "lab_msgs/msg/State", messages, text).write()
    found = guess(tmp_path, log, shoulder=None, elbow=None)
    assert {name: found[name].fields["position"].label for name in ("shoulder", "elbow")} == {
        "shoulder": "position[1]", "elbow": "position[0]",
    }  # fmt: skip


def test_names_that_change_or_do_not_fit_name_nothing(tmp_path: Path) -> None:
    """Joints in another order in some rows are no columns of one joint each; the order is asked then."""
    log = write_echo(tmp_path / "echo.csv", "field.", ("0", "1"))
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:50], lines[50].replace("elbow,shoulder", "shoulder,elbow"), *lines[51:]]) + "\n")
    found = guess(tmp_path, log, shoulder=None, elbow=None)
    assert found["shoulder"].fields["position"].label == "field.position0"
    assert "only the order says that field.position0 is shoulder" in found["shoulder"].doubts


@pytest.mark.parametrize("clock", ["t [µs]", "time_us", "time_µs", "Time (μs)", "micros", "t_usec", "timestamp_us"])
def test_a_clock_counts_what_its_name_says(tmp_path: Path, clock: str) -> None:
    """Microseconds, however they are spelled; `T` is a temperature or a thrust beside it."""
    log = write_log(tmp_path / "log.csv", {"T": 20.0 + SWING, clock: 2e6 * TIME, "arm": SWING})
    entry = SignalEntry.model_validate({"topic": "log", "position": "arm"})
    flight = read_flight(log, None, {"/joint_states": {"arm": entry}})
    np.testing.assert_allclose(flight.joints["/joint_states"]["arm"].time, 2.0 * TIME, atol=1e-6)


def test_a_joint_is_found_without_the_word_joint(tmp_path: Path) -> None:
    """`shoulder` is the position of `shoulder_joint`, and `shoulder_cmd` what its actuator is asked for."""
    columns = {"shoulder": DELAYED, "shoulder_vel": np.gradient(DELAYED, TIME), "shoulder_cmd": SWING}
    columns |= {name.replace("shoulder", "elbow"): 0.5 * values for name, values in columns.items()}
    found = guess(tmp_path, columns, "position", shoulder_joint=LIMITS, elbow_joint=LIMITS)
    assert [say(each) for each in found.values() if not each.sure] == []
    assert found["elbow_joint"].fields["position"].label == "elbow"


def test_what_follows_a_joint_is_read_from_its_column(tmp_path: Path) -> None:
    """Where it was not logged itself; an equality tells the factor."""
    path = write_model(tmp_path / "m.xml", {"grip": LIMITS, "finger": LIMITS}, "motor")
    coupled = '<equality><joint joint1="finger" joint2="grip" polycoef="0.1 -2 0 0 0"/></equality></mujoco>'
    path.write_text(path.read_text().replace("</mujoco>", coupled))
    log = write_log(tmp_path / "log.csv", {"time": TIME, "grip": SWING, "grip_vel": RATE})
    _, finger, *_ = guess_signals(mujoco.MjModel.from_xml_path(str(path)), survey(log)[1])
    assert finger.sure
    assert finger.more == {"position": {"scale": -2.0, "offset": 0.1}, "velocity": {"scale": -2.0}}
