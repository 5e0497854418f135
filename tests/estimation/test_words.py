"""What names and values tell `vpptwin inspect`: joint, source, unit; what they leave open is asked."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from benchmarks.guesses import write_model
from tests.estimation.test_guess import DELAYED, RATE, SWING, TIME, write_log
from tests.logs.bags import EPOCH, Bag, stamp_header
from vpptwin.logs import read_flight
from vpptwin.logs.messages import compose_definition
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.free_body import guess_bodies
from vpptwin.mapping.guess import Guess, guess_signals
from vpptwin.mapping.survey import Signal, survey
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry

HEADER = "".join(
    "=" * 80 + part.rstrip() + "\n" for part in compose_definition("sensor_msgs/msg/JointState").split("=" * 80)[1:]
)
FREE = "<body name='quad'><freejoint/><geom size='0.1' mass='1'/><site name='imu'/>{}</body>"


def free_model(rotors: int = 0) -> mujoco.MjModel:
    """A free body with an IMU, and rotors that lift it."""
    sites = "".join(f"<site name='r{i}'/>" for i in range(1, rotors + 1))
    drive = "".join(f"<motor name='rotor{i}' site='r{i}' gear='0 0 1 0 0 0'/>" for i in range(1, rotors + 1))
    text = f"<worldbody>{FREE.format(sites)}</worldbody><actuator>{drive}</actuator>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>")


def guess_joints(folder: Path, log: Path, kind: str = "motor", *names: str) -> dict[str, Guess]:
    """What a log has of hinges called so, each with an actuator; those of actuators under `NAME!`."""
    model = mujoco.MjModel.from_xml_path(str(write_model(folder / "m.xml", dict.fromkeys(names), kind)))
    guesses = guess_signals(model, survey(log)[1])
    return {guess.target + "!" * (guess.group == "actuators"): guess for guess in guesses}


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
    found = guess_joints(tmp_path, log, "motor", "shoulder", "elbow")
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
    found = guess_joints(tmp_path, log, "motor", "shoulder", "elbow")
    assert {name: found[name].fields["position"].label for name in ("shoulder", "elbow")} == {
        "shoulder": "position[1]", "elbow": "position[0]",
    }  # fmt: skip


def test_what_says_that_a_joint_is_one_is_no_part_of_its_name(tmp_path: Path) -> None:
    """`FL_hip position` of FL_hip_joint; its target is no torque of its motor, which is told."""
    columns = {f"FL_{part} {what}": SWING for part in ("hip", "calf") for what in ("position", "target")}
    log = write_log(tmp_path / "log.csv", {"time": TIME, **columns})
    found = guess_joints(tmp_path, log, "motor", "FL_hip_joint", "FL_calf_joint")
    assert found["FL_calf_joint"].fields["position"].label == "FL_calf position"
    assert "FL_calf target: the model's actuator takes a force or moment" in found["FL_calf_joint!"].doubts


def test_an_angle_that_is_missing_is_named(tmp_path: Path) -> None:
    """Roll and yaw alone are no attitude."""
    place = {f"stateEstimate.{axis}": column for axis, column in zip("xyz", PLACE)}
    angles = {"stateEstimate.roll": SWING, "stateEstimate.yaw": SWING}
    body = guess_bodies(free_model(), survey(write_log(tmp_path / "l.csv", {"t": TIME, **place, **angles}))[1])[0]
    assert any("roll and yaw without pitch" in doubt for doubt in body.doubts)


def test_names_that_change_or_do_not_fit_name_nothing(tmp_path: Path) -> None:
    """Joints in another order in some rows are no columns of one joint each; the order is asked then."""
    log = write_echo(tmp_path / "echo.csv", "field.", ("0", "1"))
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:50], lines[50].replace("elbow,shoulder", "shoulder,elbow"), *lines[51:]]) + "\n")
    found = guess_joints(tmp_path, log, "motor", "shoulder", "elbow")
    assert found["shoulder"].fields["position"].label == "field.position0"
    assert "only the order says that field.position0 is shoulder" in found["shoulder"].doubts


TURN = np.stack([np.cos(SWING / 2), np.sin(SWING / 2) * 0.6, np.sin(SWING / 2) * 0.8, 0.0 * TIME])
"""Attitude w, x, y, z; it turns about an axis of its own, so that the gyro shows the rate along that."""
GYRO = np.stack([0.6 * RATE, 0.8 * RATE, 0.0 * TIME])
WOBBLE = np.stack([0.3 * np.sin(1.3 * TIME + k) for k in range(3)])
PLACE = np.stack([SWING, np.cos(TIME), 0.5 * np.sin(0.7 * TIME)])
SPEED = np.gradient(PLACE, TIME, axis=1)


def spin(rates: np.ndarray) -> np.ndarray:
    """Attitudes (4, n) of a body that turns so about its axes, (3, n) rad/s."""
    q, found = np.array([1.0, 0.0, 0.0, 0.0]), []
    for rate in rates.T:
        found.append(q)
        step = np.zeros(4)
        mujoco.mju_mulQuat(step, q, np.concatenate([[1.0], 0.5 * rate * 0.01]))
        q = step / np.linalg.norm(step)
    return np.array(found).T


def number(stem: str, values: np.ndarray, form: str = "{}[{}]", first: int = 0) -> dict[str, np.ndarray]:
    """Columns STEM[0], STEM[1] and so on."""
    return {form.format(stem, first + i): column for i, column in enumerate(values)}


@pytest.mark.parametrize(("gyro", "last"), [(True, False), (True, True), (False, False)])
@pytest.mark.parametrize(("form", "first"), [("{}[{}]", 0), ("{}{}", 1)])
def test_numbered_columns_are_an_attitude_and_a_place(
    tmp_path: Path, gyro: bool, last: bool, form: str, first: int
) -> None:
    """`q[0..3]` and `p[0..2]`, as PX4's ulog2csv writes them; the gyro says where w is, else it is asked."""
    turn = spin(3.0 * WOBBLE)
    columns = {"timestamp": 1e6 * TIME, **number("q", np.roll(turn, -1 if last else 0, axis=0), form, first)}
    columns |= number("p", PLACE, form, first) | number("v", SPEED, form, first)
    columns |= number("gyro_rad", 3.0 * WOBBLE) if gyro else {}
    body, *imu = guess_bodies(free_model(), survey(write_log(tmp_path / "log.csv", columns))[1])
    order = [3, 0, 1, 2] if last else [0, 1, 2, 3]
    assert [s.label for s in body.vectors["attitude"]] == [form.format("q", first + i) for i in order]
    assert [s.label for s in body.vectors["position"]] == [form.format("p", first + i) for i in range(3)]
    assert body.sure == gyro, body.doubts
    assert len(imu) == gyro
    assert gyro or any("w, x, y, z, or x, y, z, w?" in doubt for doubt in body.doubts)


@pytest.mark.parametrize("name", ["vicon_", "mocap_", "optitrack_"])
def test_what_a_tracker_saw_comes_first(tmp_path: Path, name: str) -> None:
    """Before what an estimator made of it, in whatever order the columns are, with velocities beside or not."""
    axes = ("x", "y", "z")
    seen = {f"{name}{axis}": column for axis, column in zip(axes, PLACE)}
    made = {f"stateEstimate.{axis}": 1.01 * column for axis, column in zip(axes, PLACE)}
    made |= {f"stateEstimate.v{axis}": 1.01 * column for axis, column in zip(axes, SPEED)}
    turn = {f"stateEstimate.q{axis}": column for axis, column in zip("wxyz", TURN)}
    turn |= {f"{name}q{axis}": column for axis, column in zip("wxyz", TURN)}
    log = write_log(tmp_path / "log.csv", {"time": TIME, **made, **turn, **seen})
    body = guess_bodies(free_model(), survey(log)[1])[0]
    assert {s.label[: len(name)] for vector in body.vectors.values() for s in vector} == {name}
    assert body.sure, body.doubts


def test_a_tracker_topic_comes_first(tmp_path: Path) -> None:
    """A topic that has both place and attitude before one that lacks one; of two that have both the tracker's."""
    axes = {**dict(zip("xyz", PLACE)), **{f"q{axis}": column for axis, column in zip("wxyz", TURN)}}
    content = {
        "ekf": {"t": TIME, **axes},
        "vicon": {"t": TIME, **axes},
        "marker": {"t": TIME, **dict(zip("xyz", PLACE))},
    }
    savemat(tmp_path / "log.mat", content)
    body = guess_bodies(free_model(), survey(tmp_path / "log.mat")[1])[0]
    assert {s.topic for vector in body.vectors.values() for s in vector} == {"/vicon"}


@pytest.mark.parametrize(("stem", "form"), [("m{}_{}", "m{}"), ("{1}_{0}", "")])
def test_speeds_of_rotors_come_before_what_drives_them(tmp_path: Path, stem: str, form: str) -> None:
    """Logged rpm tell a thrust better than PWM; how much is asked, of rpm by a polynomial."""
    columns = {"time": TIME}
    for kind, scale in (("pwm", 100.0), ("rpm", 9000.0)):
        columns |= {stem.format(i, kind): scale * (1.0 + 0.1 * i * SWING) for i in range(1, 5)}
    guesses = guess_signals(free_model(4), survey(write_log(tmp_path / "log.csv", columns))[1])
    assert [guess.fields["effort"].label for guess in guesses] == [stem.format(i, "rpm") for i in range(1, 5)]
    for guess in guesses:
        assert not any("pwm" in doubt for doubt in guess.doubts)
        assert any("polynomial: [0, 0," in doubt for doubt in guess.doubts)


@pytest.mark.parametrize(
    ("column", "unit", "doubts"),
    [("thrust_cmd_gf", "gf", 0), ("thrust_sp [gf]", "gf", 0), ("T_sp", None, 0), ("F_cmd (kgf)", "kgf", 0),
     ("T_sp [N]", None, 0), ("thrust_cmd (A)", None, 1)],
)  # fmt: skip
def test_forces_are_in_the_unit_that_they_say(tmp_path: Path, column: str, unit: str | None, doubts: int) -> None:
    """`T_sp` is a thrust; a unit of something else is a doubt."""
    log = write_log(tmp_path / "log.csv", {"time": TIME, "motor_temperature": SWING, column: RATE})
    (guess,) = guess_signals(free_model(1), survey(log)[1])
    assert guess.fields["effort"].label == re.sub(r" [\[(].*", "", column)
    assert guess.units == ({"effort": unit} if unit else {})
    assert len(guess.doubts) == doubts, guess.doubts


@pytest.mark.parametrize("clock", ["t [µs]", "time_us", "time_µs", "Time (μs)", "micros", "t_usec", "timestamp_us"])
def test_a_clock_counts_what_its_name_says(tmp_path: Path, clock: str) -> None:
    """Microseconds, however they are spelled; `T` is a temperature or a thrust beside it."""
    log = write_log(tmp_path / "log.csv", {"T": 20.0 + SWING, clock: 2e6 * TIME, "arm": SWING})
    entry = SignalEntry.model_validate({"topic": "log", "position": "arm"})
    flight = read_flight(log, None, {"/joint_states": {"arm": entry}})
    np.testing.assert_allclose(flight.joints["/joint_states"]["arm"].time, 2.0 * TIME, atol=1e-6)


def test_near_misses_are_named(tmp_path: Path) -> None:
    """Roll is in ATT, not in POS, of a twin that looks for it there."""
    att = {"t": TIME, "Roll": SWING, "Pitch": SWING, "Yaw": SWING}
    savemat(tmp_path / "log.mat", {"ATT": att, "POS": {"t": TIME, **dict(zip("xyz", PLACE))}})
    entry = SignalEntry.model_validate(
        {"topic": "POS", "position": ["x", "y", "z"], "attitude": ["Roll", "Pitch", "Yaw"]}
    )
    with pytest.raises(InputError, match=r"/POS has no Roll, Pitch, Yaw, which are in /ATT; no numeric column Roll"):
        read_flight(tmp_path / "log.mat", None, {"/bodies/quad": {"quad": entry}})
    body = guess_bodies(free_model(), survey(tmp_path / "log.mat")[1])[0]
    assert any("only in /ATT: one topic has to have both" in d or "only in /POS: one topic" in d for d in body.doubts)


def test_of_two_alike_columns_the_command_comes_first(tmp_path: Path) -> None:
    """What leads is the target of the servo, what follows was measured, in whatever order they stand."""
    for columns in ({"arm": SWING, "arm_2": DELAYED}, {"arm": DELAYED, "arm_2": SWING}):
        log = write_log(tmp_path / "log.csv", {"time": TIME, **columns})
        found = guess_joints(tmp_path, log, "position", "arm")
        late = next(name for name, values in columns.items() if values is DELAYED)
        assert found["arm"].fields["position"].label == late
        assert found["arm!"].fields["effort"].label != late
        assert found["arm!"].sure, found["arm!"].doubts
        assert any(f"{late} follows arm" in reason for reason in found["arm"].reasons), found["arm"].reasons


def test_a_filtered_copy_is_asked_about(tmp_path: Path) -> None:
    """What comes first and is rougher may be the raw signal of the other."""
    noise = np.random.default_rng(3).normal(0.0, 0.02, len(TIME))
    smooth = np.interp(TIME - 0.05, TIME, np.convolve(SWING + noise, np.ones(15) / 15.0, "same"))
    log = write_log(tmp_path / "log.csv", {"time": TIME, "arm": SWING + noise, "arm_2": smooth})
    found = guess_joints(tmp_path, log, "position", "arm")
    assert any("is arm_2 a filtered arm?" in doubt for doubt in found["arm"].doubts)
    assert "effort" not in found["arm!"].fields


def test_a_state_that_is_its_action_is_asked_about(tmp_path: Path) -> None:
    """Nothing tells what was asked for from what was measured where both are one column, logged twice."""
    log = write_log(tmp_path / "log.csv", {"time": TIME, "arm_pos": SWING, "arm_action_pos": SWING})
    found = guess_joints(tmp_path, log, "position", "arm")
    assert any("one and the same" in doubt for doubt in found["arm!"].doubts)
    assert isinstance(found["arm"].fields["position"], Signal)
