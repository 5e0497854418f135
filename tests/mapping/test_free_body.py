"""Signals of a free body and its IMU: places, attitudes, their order and sense, frames of rates, what holds a body."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.io import savemat

from proving.quadrotor import MJCF, fly
from tests.mapping.test_guess import RATE as SWING_RATE
from tests.mapping.test_guess import SWING, TIME, write_log
from vpptwin.estimation.checks.orientation import QUATERNIONS, Convention
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import interpolate
from vpptwin.logs import read_flight
from vpptwin.mapping.free_body import guess_bodies
from vpptwin.mapping.guess import Guess, guess_signals
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry
from vpptwin.twin import load_twin
from vpptwin.twin.robot.manifold import turn_to_world

FREE = "<body name='quad'><freejoint/><geom size='0.1' mass='1'/><site name='imu'/>{}</body>"
TURN = np.stack([np.cos(SWING / 2), np.sin(SWING / 2) * 0.6, np.sin(SWING / 2) * 0.8, 0.0 * TIME])
"""Attitude w, x, y, z; it turns about an axis of its own, so that the gyro shows the rate along that."""
GYRO = np.stack([0.6 * SWING_RATE, 0.8 * SWING_RATE, 0.0 * TIME])
WOBBLE = np.stack([0.3 * np.sin(1.3 * TIME + k) for k in range(3)])
PLACE = np.stack([SWING, np.cos(TIME), 0.5 * np.sin(0.7 * TIME)])
SPEED = np.gradient(PLACE, TIME, axis=1)


def free_model(rotors: int = 0) -> mujoco.MjModel:
    """A free body with an IMU, and rotors that lift it."""
    sites = "".join(f"<site name='r{i}'/>" for i in range(1, rotors + 1))
    drive = "".join(f"<motor name='rotor{i}' site='r{i}' gear='0 0 1 0 0 0'/>" for i in range(1, rotors + 1))
    text = f"<worldbody>{FREE.format(sites)}</worldbody><actuator>{drive}</actuator>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>")


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
    log = write_log(tmp_path / "log.csv", {"time": TIME, "motor_temperature": SWING, column: SWING_RATE})
    (guess,) = guess_signals(free_model(1), survey(log)[1])
    assert guess.fields["effort"].label == re.sub(r" [\[(].*", "", column)
    assert guess.units == ({"effort": unit} if unit else {})
    assert len(guess.doubts) == doubts, guess.doubts


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


def test_an_angle_that_is_missing_is_named(tmp_path: Path) -> None:
    """Roll and yaw alone are no attitude."""
    place = {f"stateEstimate.{axis}": column for axis, column in zip("xyz", PLACE)}
    angles = {"stateEstimate.roll": SWING, "stateEstimate.yaw": SWING}
    body = guess_bodies(free_model(), survey(write_log(tmp_path / "l.csv", {"t": TIME, **place, **angles}))[1])[0]
    assert any("roll and yaw without pitch" in doubt for doubt in body.doubts)


FLOWN = fly({}, 10.0, 3)
POSE, IMU = FLOWN.spatial["/pose"], FLOWN.spatial["/imu"]
RATE = interpolate(POSE.time, IMU.time, IMU["rate"])
MOTORS = {name: stream["effort"][::5] for name, stream in FLOWN.joints["/motors"].items()}


def look(
    folder: Path,
    turned: Mapping[str, np.ndarray],
    rates: Mapping[str, np.ndarray],
    site: bool = True,
    motors: bool = True,
) -> dict[str, Guess]:
    """What inspect makes of a table, by the name of the target; its twin lies beside."""
    columns = {"time": POSE.time, **dict(zip(("quad_x", "quad_y", "quad_z"), POSE["position"].T)), **turned, **rates}
    columns |= MOTORS if motors else {}
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    (folder / "quad.xml").write_text(MJCF if site else MJCF.replace('<site name="imu"/>', ""))
    (folder / "twin.yaml").unlink(missing_ok=True)
    guesses = inspect_logs([folder / "log.csv"], str(folder / "quad.xml"), folder / "twin.yaml")
    return {guess.target: guess for guess in guesses}


def check_twin(folder: Path) -> None:
    """The twin that was written reads attitudes and rates as they were."""
    spec = load_twin(folder / "twin.yaml")
    read = read_measurements(spec, read_flight(folder / "log.csv", signals=spec.robot.signals.entries))
    assert np.abs((read.attitudes[3].value * POSE["attitude"]).sum(axis=1)).min() > 1.0 - 1e-9
    for dof in (3, 4, 5):
        assert np.sqrt(np.mean((read.velocities[dof].value - RATE[:, dof - 3]) ** 2)) < 0.03


def name_numbers(values: np.ndarray, *names: str) -> dict[str, np.ndarray]:
    """Columns."""
    return dict(zip(names, values.T, strict=True))


@pytest.mark.parametrize("reading", [QUATERNIONS[i] for i in (0, 2, 3)], ids=["last", "back", "first"])
def test_names_that_contradict_the_gyro_are_asked_about(tmp_path: Path, reading: Convention) -> None:
    """The twin has the order and sense in which it turns as the gyro, and says so in a doubt."""
    logged = np.empty_like(POSE["attitude"])
    logged[:, reading.order] = POSE["attitude"] * reading.signs
    gyro = name_numbers(RATE, "gyro_x", "gyro_y", "gyro_z")
    found = look(tmp_path, name_numbers(logged, "quad_qw", "quad_qx", "quad_qy", "quad_qz"), gyro)
    assert not found["quad"].sure
    assert any("as its rates turn (100% of the turning" in doubt for doubt in found["quad"].doubts)
    check_twin(tmp_path)


@pytest.mark.parametrize("site", [True, False])
@pytest.mark.parametrize("names", [("wx_vicon", "wy_vicon", "wz_vicon"), ("gyro_x", "gyro_y", "gyro_z")])
def test_rates_about_the_worlds_axes_are_mapped(tmp_path: Path, site: bool, names: tuple[str, ...]) -> None:
    """Of an IMU, or of the body where the model has none."""
    rates = name_numbers(turn_to_world(POSE["attitude"], RATE), *names)
    found = look(tmp_path, name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz"), rates, site)
    told = found["imu" if site else "quad"]
    assert told.sure
    assert told.more["rate"] == {"frame": "world"}
    assert any("about the world's axes" in reason for reason in told.reasons)
    check_twin(tmp_path)


def test_right_logs_are_not_asked_about(tmp_path: Path) -> None:
    """Attitude and rates as they should be, whichever way the gyro is mounted."""
    turned = RATE @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    for rate in (RATE, turned):
        gyro = name_numbers(rate, "gyro_x", "gyro_y", "gyro_z")
        found = look(tmp_path, name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz"), gyro)
        assert found["quad"].sure, found["quad"].doubts
        assert not found["quad"].more
        assert not found["imu"].more


def test_what_holds_it_is_told(tmp_path: Path) -> None:
    """Without a column of a motor: that its commands are not there, beside what its signals are."""
    turned = name_numbers(POSE["attitude"], "quad_qw", "quad_qx", "quad_qy", "quad_qz")
    gyro = name_numbers(RATE, "gyro_x", "gyro_y", "gyro_z")
    (line,) = [text for text in look(tmp_path, turned, gyro, motors=False)["quad"].reasons if "does not fall" in text]
    assert "no commands of what drives it are mapped" in line
    assert not [text for text in look(tmp_path, turned, gyro)["quad"].reasons if "does not fall" in text]


def test_latitude_is_no_metre(tmp_path: Path) -> None:
    """Inspect says that it is degrees, and a twin that takes it for a position is refused."""
    turned = name_numbers(POSE["attitude"], "qw", "qx", "qy", "qz")
    place = {"Lat": 47.4 + 1e-5 * POSE["position"][:, 0], "Lng": 8.5 + 1e-5 * POSE["position"][:, 1]}
    columns = {"time": POSE.time, **turned, **place, "Alt": 400.0 + POSE["position"][:, 2]}
    np.savetxt(tmp_path / "log.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns),
               comments="")  # fmt: skip
    (tmp_path / "quad.xml").write_text(MJCF)
    (quad,) = [g for g in inspect_logs([tmp_path / "log.csv"], str(tmp_path / "quad.xml"), tmp_path / "t.yaml")
               if g.target == "quad"]  # fmt: skip
    assert any("Lat and Lng are degrees on the globe" in doubt for doubt in quad.doubts)
    entry = "{topic: log, position: %s, attitude: [qw, qx, qy, qz]}"
    for position, refused in (("[Lat, Lng, Alt]", True), ("{path: [Lng, Lat, Alt], scale: [75000, 111000, 1]}", False)):
        text = f"model: quad.xml\nsignals: {{bodies: {{quad: {entry % position}}}}}\n"
        (tmp_path / "t.yaml").write_text(text)
        spec = load_twin(tmp_path / "t.yaml")
        if refused:
            with pytest.raises(InputError, match="degrees on the globe; expected x, y, z in metres"):
                read_flight(tmp_path / "log.csv", signals=spec.robot.signals.entries)
        else:
            assert read_flight(tmp_path / "log.csv", signals=spec.robot.signals.entries).spatial
