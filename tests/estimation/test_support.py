"""Where a log is cut as its body stands; free bodies that a floor, a hand or motors without commands move: said."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.checks.support import CLEARANCE, find_flown, find_held
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.series import Series
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.report.compare import score_twin
from vpptwin.system.errors import InputError
from vpptwin.twin import TwinSpec, load_twin

FREE = '<body><freejoint/><geom size="0.1"{}/></body>'
SLIDE = '<body><joint type="slide" axis="0 0 1"{}/><geom size="0.1" contype="0" conaffinity="0"/></body>'
BARE = ' contype="0" conaffinity="0"'
CLOCK = np.linspace(0.0, 10.0, 1001)
CLIMB = np.interp(CLOCK, [0.0, 3.0, 5.0, 7.0, 8.0], [0.05, 0.05, 1.05, 1.05, 0.05])
"""Stands for 3 s, climbs by 0.5 m/s, sinks by 1 m/s, stands for 2 s."""


def find(body: str, height: np.ndarray) -> tuple[float, float, list[str]]:
    """The span of such a log."""
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    noise = 1e-4 * np.random.default_rng(1).standard_normal((3, len(CLOCK)))
    values = noise + [[0.0], [0.0], [1.0]] * height
    series = [Series(axis, "m", CLOCK, value, 1e-4) for axis, value in zip("xyz", values)]
    return find_flown(model, dict(enumerate(series if model.nv == 6 else series[2:])), 0.0, 10.0)


@pytest.mark.parametrize("body", [FREE.format(BARE), SLIDE.format("")], ids=["free", "slide"])
def test_standing_is_left_out(body: str) -> None:
    """From when it is `CLEARANCE` above where it stood to when it is that near again, and a line says so."""
    start, end, told = find(body, CLIMB)
    assert start == pytest.approx(3.0 + CLEARANCE / 0.5, abs=0.02)
    assert end == pytest.approx(8.0 - CLEARANCE / 1.0, abs=0.02)
    span = f"the first {start:.1f} s and the last {10.0 - end:.1f} s"
    assert told == [f"{span} are left out: it is still there, and the MJCF has nothing to stand on"]


@pytest.mark.parametrize(
    ("body", "height"),
    [
        (FREE.format(""), CLIMB),
        (SLIDE.format(' frictionloss="1"'), CLIMB),
        (SLIDE.format("").replace("0 0 1", "1 0 0"), CLIMB),
        (FREE.format(BARE), 1.0 + 0.2 * np.sin(CLOCK)),
        (FREE.format(BARE), np.full(len(CLOCK), 0.05)),
    ],
    ids=["it may touch something", "friction holds it", "it does not fall", "it starts in flight", "it never flies"],
)
def test_all_else_is_left_alone(body: str, height: np.ndarray) -> None:
    """Whatever may stand by its model's own means, or never stands, keeps its log."""
    assert find(body, height) == (0.0, 10.0, [])


def test_who_comes_by_where_it_started_flies_on() -> None:
    """Still for a second in a hover, then up and down by it for the rest: no more than the first climb is left out."""
    swing = 1.0 + np.where(CLOCK > 1.0, 0.3 * np.sin(1.5 * (CLOCK - 1.0)), 0.0)
    start, end, _ = find(FREE.format(BARE), swing)
    assert start == pytest.approx(1.0 + np.arcsin(CLEARANCE / 0.3) / 1.5, abs=0.03)
    assert end == 10.0


def test_a_hop_is_no_flight() -> None:
    """0.2 s in the air a second before it climbs, and bouncing once as it lands."""
    hops = [CLIMB + 0.1 * (np.abs(CLOCK - middle) < 0.1) for middle in (2.0, 9.0)]
    assert find(FREE.format(BARE), hops[0])[0] == find(FREE.format(BARE), CLIMB)[0]
    assert find(FREE.format(BARE), hops[1])[1] == find(FREE.format(BARE), CLIMB)[1]


TIME = np.arange(0.0, 20.0, 0.02)
FLOOR = '<geom name="floor" type="plane" size="9 9 1"/>'
MODEL = """<mujoco><option timestep="0.002"{option}/><worldbody>{floor}<body name="robot"><freejoint/>
<geom type="box" size="0.2 0.15 0.05" mass="17"/><site name="imu"/>{wheel}</body></worldbody>{motors}</mujoco>"""
WHEEL = '<body pos="0 0.2 0"><joint name="wheel" axis="0 1 0"/><geom type="cylinder" size="0.05 0.01" mass="1"/></body>'
MOTOR = '<actuator><motor name="motor" joint="wheel"/></actuator>'


def make_spec(
    folder: Path, floor: str = "", option: str = "", wheel: str = "", motors: str = "", signals: str = ""
) -> TwinSpec:
    """A robot of 17 kg."""
    (folder / "robot.xml").write_text(MODEL.format(floor=floor, option=option, wheel=wheel, motors=motors))
    (folder / "twin.yaml").write_text(f"model: robot.xml\nsignals:\n  bodies: {{robot: /odom}}\n{signals}")
    return load_twin(folder / "twin.yaml")


def make_log(time: np.ndarray, place: np.ndarray, yaw: np.ndarray | None = None, noise: float = 5e-4) -> Flight:
    """Its odometry, noisy."""
    rng, yaw = np.random.default_rng(1), 0.0 * time if yaw is None else yaw
    attitude = euler_to_quaternion(np.column_stack([0.0 * yaw, 0.0 * yaw, yaw + noise * rng.standard_normal(len(yaw))]))
    pose = {"position": place + noise * rng.standard_normal(place.shape), "attitude": attitude}
    wheel = {"wheel": Stream(time, {"position": 20.0 * place[:, 0]})}
    inputs = {"motor": Stream(time, {"effort": np.sin(time)})}
    joints = {"/joint_states": wheel, "/actuator_command": inputs}
    return Flight(Path("drive.mcap"), 0, {}, joints, spatial={"/odom": Stream(time, pose)})


def drive(height: float = 0.0) -> Flight:
    """It drives about on a floor, or over hills, faster and slower."""
    yaw, speed = 0.8 * np.sin(0.5 * TIME), 0.6 + 0.5 * np.sin(1.3 * TIME)
    x, y = (np.cumsum(speed * way(yaw)) * 0.02 for way in (np.cos, np.sin))
    return make_log(TIME, np.column_stack([x, y, 0.05 + height * np.sin(x)]), yaw)


def throw(seconds: float, drag: float = 0.0, bounce: bool = False) -> Flight:
    """It is thrown up and falls, in a medium, or onto a floor from which it hops; by steps of 1 ms."""
    place, velocity, track = np.zeros(3), np.array([0.5, 0.2, 1.0]), []
    for _ in range(round(seconds / 1e-3)):
        velocity = velocity + 1e-3 * (np.array([0.0, 0.0, -9.81]) - drag * velocity)
        place = place + 1e-3 * velocity
        if bounce and place[2] < 0.0:
            velocity = velocity * [0.9, 0.9, -0.8]
            place[2] = -place[2]
        track.append(place.copy())
    return make_log(1e-2 * np.arange(len(track[::10])), np.array(track)[::10])


def carry() -> Flight:
    """Somebody walks about with it, as a sum of slow swings."""
    rng = np.random.default_rng(3)
    waves = [rng.uniform(0.05, 0.25, 3) * np.sin(rng.uniform(0.7, 4.0, 3) * TIME[:, None] + i) for i in range(6)]
    return make_log(TIME, np.sum(waves, axis=0))


def phone() -> Flight:
    """In a car, once a second, to half a metre."""
    time = np.arange(0.0, 60.0)
    return make_log(time, 200.0 * np.column_stack([np.sin(0.05 * time), np.cos(0.05 * time), 0.0 * time]), noise=0.5)


@pytest.mark.parametrize(
    "log", [drive(), pytest.param(drive(0.3), marks=pytest.mark.slow), pytest.param(carry(), marks=pytest.mark.slow),
            phone()], ids=["floor", "hills", "hand", "phone"],
)  # fmt: skip
def test_what_holds_a_body_is_not_found_as_a_force(tmp_path: Path, log: Flight) -> None:
    """Diagnose and compare say in a line that nothing holds it, and that commands lack; the log itself can be seen."""
    spec = make_spec(tmp_path)
    line = (
        r"robot does not fall: something bears its weight of 167 N .* no commands of what drives it are mapped; .*floor"
    )
    with pytest.raises(InputError, match=line):
        diagnose(spec, [log])
    with pytest.raises(InputError, match=line):
        score_twin(spec, [log], progress=False)
    assert any("such a force is not a candidate" in warning for warning in read_measurements(spec, log).warnings)


def test_on_a_floor_without_commands_it_is_driven(tmp_path: Path) -> None:
    """With a floor in the MJCF, or seen from above without gravity: it gains energy again and again."""
    for given in ({"floor": FLOOR}, {"option": ' gravity="0 0 0"'}):
        spec = make_spec(tmp_path, **given)
        ((body, told),) = find_held(spec, read_measurements(spec, drive()))
        assert body == "robot"
        assert "gains energy" in told
        assert "no commands of what drives it are mapped" in told


def test_motors_on_wheels_do_not_hold_it_up(tmp_path: Path) -> None:
    """With commands on wheels, but no floor, that is what the line says; with a floor all is there."""
    signals = "  joints: {wheel: /joint_states}\n  actuators: {motor: /actuator_command}\n"
    lacking = make_spec(tmp_path, wheel=WHEEL, motors=MOTOR, signals=signals)
    ((_, told),) = find_held(lacking, read_measurements(lacking, drive()))
    assert "nothing in the MJCF does" in told
    assert "commands do not" in told
    whole = make_spec(tmp_path, FLOOR, wheel=WHEEL, motors=MOTOR, signals=signals)
    assert not find_held(whole, read_measurements(whole, drive()))


@pytest.mark.parametrize(
    ("given", "log"),
    [
        ({}, throw(1.5)),
        ({}, throw(8.0, drag=4.0)),
        ({}, throw(8.0, drag=20.0)),
        ({"floor": FLOOR}, throw(6.0, bounce=True)),
        ({"option": ' density="1000" viscosity="0.001"'}, drive()),
        ({"option": ' gravity="0 0 0"'}, make_log(TIME, 0.5 * np.exp(-TIME)[:, None] * [1.0, 2.0, 0.0])),
    ],
    ids=["falls", "sinks", "sinks slowly", "hops", "in water", "puck"],
)  # fmt: skip
def test_what_falls_sinks_or_hops_is_diagnosed(tmp_path: Path, given: dict[str, str], log: Flight) -> None:
    """Nothing is said of what its model has, or of what drag explains."""
    spec = make_spec(tmp_path, **given)
    assert not find_held(spec, read_measurements(spec, log))


def test_a_real_car_of_which_odometry_is_all_there_is(shared_data: Path, tmp_path: Path) -> None:
    """A 1:10 car on its tyres: no force holds it up."""
    spec = make_spec(tmp_path)
    for path in sorted((shared_data / "f1tenth").glob("*/odomData.csv")):
        rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(1, 2, 9, 10, 13, 14))
        second, nano, x, y, qz, qw = rows[np.unique(rows[:, 0] + 1e-9 * rows[:, 1], return_index=True)[1]].T
        time = second - second[0] + 1e-9 * nano
        log = make_log(time, np.column_stack([x, y, 0.0 * x]), 2.0 * np.unwrap(np.arctan2(qz, qw)))
        ((_, told),) = find_held(spec, read_measurements(spec, log))
        assert "does not fall" in told


def test_tosses_of_a_real_cube_are_not_held(shared_data: Path, tmp_path: Path) -> None:
    """With a table or without: they are short, and thrown."""
    (tmp_path / "robot.xml").write_text(MODEL.format(floor=FLOOR, option="", wheel="", motors=""))
    (tmp_path / "twin.yaml").write_text("model: robot.xml\nsignals: {bodies: {robot: /cube}}\n")
    spec = load_twin(tmp_path / "twin.yaml")
    for path in sorted((shared_data / "cube").glob("*.csv"))[:6]:
        rows = np.genfromtxt(path, delimiter=",", names=True)
        pose = {"position": np.column_stack([rows[c] for c in "xyz"]),
                "attitude": np.column_stack([rows[f"q{c}"] for c in "wxyz"])}  # fmt: skip
        log = Flight(path, 0, {}, {}, spatial={"/cube": Stream(rows["time"], pose)})
        assert not find_held(spec, read_measurements(spec, log))
