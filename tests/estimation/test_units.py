"""Units and scales: velocities by their positions, per cents of a travel by where they end, efforts by the motion."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from benchmarks.guesses import write_model
from proving.logs import write_log
from proving.mechanisms.recording import record as record_session
from proving.mechanisms.session import draw_session
from proving.torque_arm import Truth, swing_arm, write_arm
from tests.diagnosis.rigs import CARTS, record
from tests.mapping.test_guess import write_log as write_table
from vpptwin.cli.main import main
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.checks.efforts import judge_efforts
from vpptwin.estimation.checks.units import LoggedPosition, find_ends, find_normalised, vet_joint
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Stream
from vpptwin.logs.read import read_flight
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.guess import guess_signals
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.mapping.survey import survey
from vpptwin.twin import TwinSpec, load_twin


def swing() -> Stream:
    """A joint at 500 Hz with the velocity of its position."""
    time = np.arange(0.0, 8.0, 0.002)
    rng = np.random.default_rng(3)
    position = 0.5 * np.sin(3.0 * time) + 0.2 * np.sin(7.0 * time) + 1e-4 * rng.standard_normal(len(time))
    velocity = 1.5 * np.cos(3.0 * time) + 1.4 * np.cos(7.0 * time) + 1e-2 * rng.standard_normal(len(time))
    return Stream(time, {"position": position, "velocity": velocity, "effort": 0.0 * time})


@pytest.mark.parametrize(
    ("factor", "said"),
    [(0.0, "velocity is 0 throughout"), (-1.0, "-1 times"), (57.3, "57.3 times"), (2.0, "2 times"), (0.5, "0.5 times")],
)
def test_velocities_that_are_not_of_the_positions_are_left_out(factor: float, said: str) -> None:
    """Dead, against the positions, in degrees, or of half the gear; the other columns stay."""
    stream = swing()
    vetted, (line,) = vet_joint(Stream(stream.time, {**stream.values, "velocity": factor * stream["velocity"]}), "arm")
    assert set(vetted.values) == {"position", "effort"}
    assert line.startswith("arm: velocity is ")
    assert said in line
    assert line.endswith(", left out")


@pytest.mark.parametrize("factor", [1.0, 0.8, 1.3])
def test_velocities_of_the_positions_stay(factor: float) -> None:
    """So do those that are off by what an effect may be, those of a joint that rests, and none at all."""
    stream = swing()
    scaled = Stream(stream.time, {**stream.values, "velocity": factor * stream["velocity"]})
    assert vet_joint(scaled, "arm") == (scaled, [])
    rest = Stream(stream.time, {name: 0.0 * data for name, data in stream.values.items()})
    assert vet_joint(rest, "arm") == (rest, [])
    alone = Stream(stream.time, {"position": stream["position"]})
    assert vet_joint(alone, "arm") == (alone, [])


TIME = np.arange(0.0, 12.0, 0.02)
REACH = {"pan": (-1.92, 1.92), "elbow": (-1.6, 1.6)}
"""Limits of two hinges [rad]: 110 and 91.7 degrees."""


def drive(size: float, shift: float = 0.0, late: float = 0.0) -> np.ndarray:
    """A motion in per cent of the travel that would go farther than its ends, so that it is held there."""
    return np.clip(size * np.sin(1.1 * (TIME - late) + shift), -100.0, 100.0)


def write_lerobot(folder: Path, size: float) -> Path:
    """A data set of one episode: two joints, their targets, and a gripper from 0 to 100."""
    names = ["pan.pos", "elbow.pos", "gripper.pos"]
    moved = [drive(size, 0.0, 0.06), drive(size, 1.0, 0.06), 50.0 + 0.5 * drive(size, 2.0, 0.06)]
    asked = [drive(size), drive(size, 1.0), 50.0 + 0.5 * drive(size, 2.0)]
    about = {"names": names, "dtype": "float32", "shape": [3]}
    info = {"codebase_version": "v3.0", "fps": 50, "total_episodes": 1,
            "features": {"observation.state": about, "action": about}}  # fmt: skip
    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    lists = {name: pa.array(np.stack(rows, axis=1).tolist(), pa.list_(pa.float32(), 3))
             for name, rows in (("observation.state", moved), ("action", asked))}  # fmt: skip
    zeros = [0] * len(TIME)
    parquet.write_table(pa.table({**lists, "timestamp": TIME, "episode_index": zeros, "frame_index": range(len(TIME))}),
                        folder / "data/chunk-000/file-000.parquet")  # fmt: skip
    return folder


@pytest.mark.parametrize(("size", "held"), [(130.0, True), (1.2, False), (60.0, False)])
def test_positions_of_lerobot_are_asked_about(tmp_path: Path, size: float, held: bool) -> None:
    """Whether they end at 100, or would be radians or degrees by how far they go."""
    model = mujoco.MjModel.from_xml_path(str(write_model(tmp_path / "m.xml", dict(REACH), "position")))
    guesses = guess_signals(model, survey(f"{write_lerobot(tmp_path / 'set', size)}#0")[1])
    assert not any(guess.sure for guess in guesses)
    for guess in guesses:
        assert any("the log does not state the unit" in doubt for doubt in guess.doubts), guess.target
        assert any("is held at exactly" in doubt and "100 of its travel" in doubt for doubt in guess.doubts) == held


def test_parquet_of_lerobot_without_its_folder_says_no_unit_either(tmp_path: Path) -> None:
    """Nor does what `convert` makes of it."""
    file = write_lerobot(tmp_path / "set", 1.2) / "data/chunk-000/file-000.parquet"
    transcribe(file, tmp_path / "c.mcap")
    for log in (file, tmp_path / "c.mcap"):
        units = {signal.label: signal.unit for signal in survey(log)[1]}
        assert units["action[0]"] == units["observation.state[1]"] == "unsaid"
        assert units["timestamp"] != "unsaid"


@pytest.mark.parametrize("kind", ["lerobot", "csv"])
@pytest.mark.parametrize(("unit", "limits", "code"), [
    ("unit: deg", REACH, 2), ("scale: 1", REACH, 2), ("unit: deg", {"pan": (-2.5, 2.5), "elbow": (-2.0, 2.0)}, 0),
    ("scale: 0.016", REACH, 0),
])  # fmt: skip
def test_a_mapping_as_degrees_is_not_taken_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, unit: str, limits: dict, code: int
) -> None:
    """Held beyond a limit it is refused, held within them all told; a scale that somebody gave is theirs."""
    write_model(tmp_path / "m.xml", dict(limits), "position")
    columns, signals = {"timestamp": TIME}, ""
    for group, what, column, late in (("joints", "observation.state", "position", 0.06),
                                      ("actuators", "action", "effort", 0.0)):  # fmt: skip
        columns |= {f"{what}.{name}.pos": drive(130.0, shift, late) for name, shift in (("pan", 0.0), ("elbow", 1.0))}
        entry = "{}: {{topic: episode, {}: {{path: {}.{}.pos, {}}}}}"
        signals += f"  {group}: {{{', '.join(entry.format(name, column, what, name, unit) for name in limits)}}}\n"
    log = str(write_table(tmp_path / "run.csv", columns))
    if kind == "lerobot":
        log = f"{write_lerobot(tmp_path / 'set', 130.0)}#0"
    (tmp_path / "t.yaml").write_text(f"model: m.xml\nsignals:\n{signals}")
    if code:
        assert main(["compare", log, "--twin", str(tmp_path / "t.yaml")]) == code
        shown = capsys.readouterr().err
        assert "is held at exactly" in shown
        assert "where the joint cannot be" in shown
        assert shown.count("\n") == 1
        return
    spec = load_twin(tmp_path / "t.yaml")
    warnings = read_measurements(spec, read_flight(log, None, spec.robot.signals.entries)).warnings
    assert any("is held at exactly" in line for line in warnings) == (unit != "scale: 0.016")


STEPS = np.repeat([0.0, 100.0, -100.0, 50.0], 100)
SWEEP = np.linspace(-90.0, 90.0, 400)


@pytest.mark.parametrize(
    ("values", "limits", "found"),
    [
        (drive(130.0), (-180.0, 180.0), True),
        (drive(130.0), (-95.0, 95.0), True),
        (50.0 + 0.5 * drive(130.0), (-np.inf, np.inf), True),
        (drive(130.0), (-100.0, 100.0), False),  # the joint's own limits, in degrees
        (drive(100.0), (-180.0, 180.0), False),  # a sine of 100 degrees, which is nowhere held
        (STEPS, (-180.0, 180.0), False),  # steps to 100 degrees
        (np.round(drive(130.0)), (-180.0, 180.0), False),  # whole degrees, or counts
        (drive(130.0) * 1.2, (-180.0, 180.0), False),  # held at 120
        (np.maximum(drive(60.0), 0.0), (-180.0, 180.0), False),
        (SWEEP, (-180.0, 180.0), False),
    ],
)
def test_only_what_is_held_at_its_ends_looks_like_it(
    values: np.ndarray, limits: tuple[float, float], found: bool
) -> None:
    """Nothing else that angles in degrees do."""
    assert bool(find_normalised([LoggedPosition("arm", values, limits)])) == found


def test_one_end_within_the_limits_is_not_enough() -> None:
    """A target that is held at 100 degrees may be one; two joints that are held there are not."""
    held = LoggedPosition(
        "arm", np.minimum(drive(130.0), 100.0) * np.where(drive(130.0) < 0.0, 0.5, 1.0), (-180.0, 180.0)
    )
    ends = find_ends(held)
    assert ends is not None
    assert ends.at == (100.0,)
    assert not find_normalised([held])
    assert len(find_normalised([held, held._replace(name="wrist")])) == 2


BELT = ((1.0, 0.0), (0.8, 1.0))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The nominal arm."""
    return write_arm(tmp_path_factory.mktemp("torque_arm"))


def tell(spec: TwinSpec, truth: Truth, seed: int = 1) -> dict[str, float]:
    """Actuator → factor that is told."""
    return {
        each.actuator: each.factor
        for each in judge_efforts(spec, [read_measurements(spec, swing_arm(truth, 10.0, seed))])
    }


@pytest.mark.parametrize(
    "truth",
    [
        Truth(gain=(12.1, 9.3)), Truth(gain=(14.0, -6.0), coulomb=(0.6, 0.3), viscous=(0.3, 0.2)),
        Truth(gain=(1e-3, 1e-3)), Truth(gain=(0.0981, 0.0981)), Truth(gain=(8.0, 5.0), slow=4.0),
        Truth(gain=(10.0, 10.0), load=0.3),
    ],
)  # fmt: skip
def test_currents_and_other_units_are_told(arm: TwinSpec, truth: Truth) -> None:
    """Each with its factor: to what friction, filters and a load leave of it."""
    told = tell(arm, truth)
    for name, gain in zip(("m_shoulder", "m_elbow"), truth.gain, strict=True):
        assert told[name] == pytest.approx(gain, rel=0.4 if truth.load else 0.05)


@pytest.mark.parametrize(
    "truth",
    [
        Truth(), Truth(gain=(0.7, 1.3)), Truth(gain=(-1.0, 1.0)), Truth(gain=(2.5, 0.5)), Truth(load=2.4),
        Truth(load=0.8), Truth(heavier=(1.5, 2.0)), Truth(rotor=0.3), Truth(coulomb=(2.0, 0.6)),
        Truth(drive=((1.0, 1.0), (1.0, -1.0))), Truth(drive=BELT),
    ],
)  # fmt: skip
def test_gains_loads_rotors_and_other_drives_are_no_units(arm: TwinSpec, truth: Truth) -> None:
    """A diagnosis names those; a load may be three times what it hangs on."""
    assert tell(arm, truth) == {}


@pytest.mark.parametrize(("truth", "factors"), [(Truth(gain=(12.0, 7.0)), 2), (Truth(rotor=1.0), 0), (Truth(), 0)])
def test_an_arm_on_its_side_has_inertia_alone(tmp_path: Path, truth: Truth, factors: int) -> None:
    """Which a rotor adds to, but nothing takes from: more torque than logged is a unit, less is not."""
    assert len(tell(write_arm(tmp_path, 0.0), replace(truth, gravity=0.0))) == factors


def test_one_joint_of_two_in_another_unit(arm: TwinSpec) -> None:
    """The other one is none of it."""
    told = tell(arm, Truth(gain=(1.0, 15.0)))
    assert list(told) == ["m_elbow"]


def test_every_command_says_it_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`diagnose` and `compare` in their only line, with the scale that mends it; with that they run."""
    spec = write_arm(tmp_path)
    log = write_log(swing_arm(Truth(gain=(11.0, 8.0)), 8.0, 2), tmp_path / "run.mcap")
    for command in (["compare"], ["diagnose", "--out", str(tmp_path / "out")]):
        assert main([*command, str(log), "--twin", str(tmp_path / "twin.yaml")]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("vpptwin: ")]
        assert line.startswith(
            "vpptwin: run.mcap: the effort of m_shoulder looks like current, or like torque before a gear: "
            "torque is 11 times it (r = 0.99"
        )
        assert re.search(r"the effort of m_elbow looks like current, .*: torque is (8|7\.9\d) times it", line)
        assert "`scale: 1" in line
    assert not (tmp_path / "out").exists()
    twin = (tmp_path / "twin.yaml").read_text()
    for name, scale in (("m_shoulder", 11.0), ("m_elbow", 8.0)):
        entry = f"{name}: {{topic: /efforts, effort: {{path: effort, scale: {scale}}}}}"
        twin = twin.replace(f"{name}: /efforts", entry)
    (tmp_path / "scaled.yaml").write_text(twin)
    scaled = load_twin(tmp_path / "scaled.yaml")
    flight = read_flight(log, None, scaled.robot.signals.entries)
    assert judge_efforts(scaled, [read_measurements(scaled, flight)]) == []
    found = judge_efforts(spec, [read_measurements(spec, read_flight(log))])
    np.testing.assert_allclose([each.scale for each in found], [11.0, 8.0], rtol=0.01)


def test_a_scale_that_is_given_counts(tmp_path: Path) -> None:
    """What is to be written is the scale in all, and forces of a slide are forces."""
    log, _ = record(CARTS, 0.5, tmp_path, 3, part=0.5)
    path = tmp_path / "rig.yaml"
    entry = "motor: {topic: /actuator_command, effort: {path: effort, scale: 0.05}}"
    path.write_text(path.read_text().replace("motor: /actuator_command", entry))
    spec = load_twin(path)
    flight = read_flight(log, None, spec.robot.signals.entries)
    (far,) = judge_efforts(spec, [read_measurements(spec, flight)])
    assert far.scale == pytest.approx(1.0, rel=0.05)
    assert far.factor == pytest.approx(20.0, rel=0.05)
    assert str(far).startswith("the effort of motor looks like current, ")


def test_inspect_doubts_it_with_the_scale(tmp_path: Path) -> None:
    """Of columns of a table, one in another unit; the other stays sure."""
    write_arm(tmp_path)
    flight = swing_arm(Truth(gain=(1.0, 13.0)), 8.0, 3)
    columns: dict[str, np.ndarray] = {}
    for name, stream in flight.joints["/joint_states"].items():
        columns |= {"time": stream.time, f"{name}_pos": stream["position"], f"{name}_vel": stream["velocity"]}
    columns |= {f"{name}_cmd_torque": stream["effort"] for name, stream in flight.joints["/efforts"].items()}
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True))
    (tmp_path / "run.csv").write_text(",".join(columns) + "\n" + rows + "\n")
    guesses = inspect_logs([tmp_path / "run.csv"], str(tmp_path / "torque_arm.xml"), tmp_path / "found.yaml")
    found = {guess.target: guess for guess in guesses}
    assert found["m_shoulder"].sure, found["m_shoulder"].doubts
    assert not found["m_elbow"].sure
    (doubt,) = found["m_elbow"].doubts
    assert doubt.startswith("the effort of m_elbow looks like current, ")
    assert "write scale: 1" in doubt
    assert f"DOUBT: {doubt}" in (tmp_path / "found.yaml").read_text()


@pytest.mark.parametrize(("factor", "unit"), [(12.0, ""), pytest.param(1e-3, "mN m", marks=pytest.mark.slow)])
def test_another_arm_with_hysteresis_and_gears(tmp_path: Path, factor: float, unit: str) -> None:
    """Drawn, with an effect in it that no catalogue has, and gains of its motors in the MJCF."""
    recorded = record_session(draw_session(4711, 10), tmp_path)
    spec, flight = load_twin(recorded.twin), read_flight(recorded.logs[0])
    (topic,) = set(spec.robot.signals.actuators.values())
    scaled = {name: Stream(s.time, {"effort": s["effort"] / factor}) for name, s in flight.joints[topic].items()}
    found = judge_efforts(spec, [read_measurements(spec, replace(flight, joints={**flight.joints, topic: scaled}))])
    assert [each.unit for each in found] == [unit, unit]
    np.testing.assert_allclose([each.scale for each in found], factor, rtol=0.25)
    assert judge_efforts(spec, [read_measurements(spec, flight)]) == []


@pytest.mark.slow
def test_a_gain_is_still_a_gain(arm: TwinSpec) -> None:
    """0.7 of the shoulder's torque, hidden where a unit would be refused."""
    verdict = diagnose(arm, [swing_arm(Truth(gain=(0.7, 1.0)), 12.0, seed) for seed in (5, 6)]).verdict
    assert verdict.causes[0].effect == "m_shoulder.gain"
    assert verdict.causes[0].parameters["gain"].value == pytest.approx(0.7, abs=0.03)


def test_efforts_that_say_nothing_are_not_judged(arm: TwinSpec) -> None:
    """Zeros, and noise that no motion follows."""
    flight, rng = swing_arm(Truth(), 8.0, 4), np.random.default_rng(1)
    for make in (np.zeros, lambda n: 0.01 * rng.standard_normal(n)):
        efforts = {n: Stream(s.time, {"effort": make(len(s))}) for n, s in flight.joints["/efforts"].items()}
        mute = replace(flight, joints={**flight.joints, "/efforts": efforts})
        assert judge_efforts(arm, [read_measurements(arm, mute)]) == []
