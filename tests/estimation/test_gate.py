"""Wrong inputs that the gate refuses with the line to change, and correct logs that pass it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml

from examples.double_pendulum.convert import convert as convert_double
from examples.simple_pendulum.convert import convert as convert_simple
from examples.so101.convert import convert as convert_arm
from proving import leg, quadrotor, servo_arm
from proving.kinds import KINDS, write_kind
from proving.logs import write_log
from tests.conftest import SHARED
from vpptwin import compare
from vpptwin.cli.main import main
from vpptwin.diagnosis.evidence.logged_inputs import read_session
from vpptwin.estimation.checks.gate import check_columns
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.system.doubt import list_overruled, take_as_is
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec, load_twin

FOLDER = TemporaryDirectory(prefix="vpptwin-gate-")
EXAMPLES, DATA = Path(__file__).resolve().parents[2] / "examples", SHARED / "data"
DEGREES = 180.0 / np.pi
Edit = Callable[[TwinSpec, Flight], Flight]

WORLDS = {"servo": (servo_arm, servo_arm.move), "quad": (quadrotor, quadrotor.fly), "leg": (leg, leg.move)}
MEASURED = {
    "antx": ("antx/free.yaml", "antx/rail_velocity_doublets_1.mcap", None),
    "simple": ("simple_pendulum/pendulum.yaml", "simple_pendulum/pd_system_identification.csv", convert_simple),
    "double": ("double_pendulum/both.yaml", "double_pendulum/design_A_04.csv", convert_double),
    "so101": ("so101/so101.yaml", "so101/multisine", convert_arm),
}
"""Twin of ../examples, a log of ../shared, and what converts it."""


def find_case(rig: str) -> tuple[Path, list[Path]]:
    """Twin and logs of a rig by name: a kind of log and seed, a world, or a measured example."""
    folder = Path(FOLDER.name) / rig
    folder.mkdir(exist_ok=True)
    if rig in WORLDS:
        world, move = WORLDS[rig]
        twin = world.write_twin(folder)
        return twin, [write_log(move({}, 15.0, 1), folder / "log.mcap")]
    if rig in MEASURED:
        if not DATA.is_dir():
            pytest.skip(f"needs the measured data in {DATA}")
        twin, log, convert = MEASURED[rig]
        if convert is None:
            return EXAMPLES / twin, [DATA / log]
        convert(DATA / log, folder / "log.mcap")
        return EXAMPLES / twin, [folder / "log.mcap"]
    kind, seed = rig.rsplit("_", 1)
    case = write_kind(kind, int(seed), folder)
    if case.twin is None:  # columns are called as joints
        names = "\n".join(f"    {name}: {{topic: run_1, position: {name}}}" for name in ["hinge"])
        (folder / "twin.yaml").write_text(f"model: rig.xml\nsignals:\n  joints:\n{names}\n")
    return folder / "twin.yaml", case.logs


@cache
def load_case(rig: str) -> tuple[TwinSpec, Flight]:
    """The twin and its first log."""
    twin, logs = find_case(rig)
    spec = load_twin(twin)
    return spec, read_flight(logs[0], signals=spec.robot.signals.entries)


def alter(flight: Flight, topic: str, name: str, **columns: Callable[[np.ndarray], np.ndarray]) -> Flight:
    """A flight with some columns of a joint, actuator or body written otherwise."""
    joints, spatial = {t: dict(names) for t, names in flight.joints.items()}, dict(flight.spatial)
    names, key = (spatial, topic) if topic in spatial else (joints[topic], name)
    stream = names[key]
    written = {column: write(stream[column]) for column, write in columns.items() if column in stream.values}
    assert written
    names[key] = Stream(stream.time, {**stream.values, **written})
    return replace(flight, joints=joints, spatial=spatial)


def scale(group: str, factor: float, *columns: str, only: int | None = None, rotary: bool | None = None) -> Edit:
    """Columns of all in a group, or of one, times a factor."""

    def edit(spec: TwinSpec, flight: Flight) -> Flight:
        named = list(getattr(spec.robot.signals, group).items())
        for name, topic in named if only is None else [named[only]]:
            if rotary is not None and bool(spec.robot.rotary[spec.model.joint(name).dofadr[0]]) != rotary:
                continue
            held = flight.spatial.get(topic) or flight.joints[topic][name]
            known = [column for column in columns if column in held.values]
            if not known:
                continue
            flight = alter(flight, topic, name, **dict.fromkeys(known, lambda values: factor * values))
        return flight

    return edit


def swap(group: str, *columns: str) -> Edit:
    """The columns of the first two in a group, each written as the other's."""

    def edit(spec: TwinSpec, flight: Flight) -> Flight:
        (one, first), (other, second) = list(getattr(spec.robot.signals, group).items())[:2]
        streams = flight.joints[first][one], flight.joints[second][other]
        for column in columns:
            if column in streams[0].values:
                flight = alter(flight, first, one, **{column: lambda _, c=column: streams[1][c]})
                flight = alter(flight, second, other, **{column: lambda _, c=column: streams[0][c]})
        return flight

    return edit


def swap_targets(spec: TwinSpec, flight: Flight) -> Flight:
    """Target and position of every servo, each written as the other."""
    for name, topic in spec.robot.signals.actuators.items():
        joint = spec.model.joint(int(spec.model.actuator(name).trnid[0])).name
        place = spec.robot.signals.joints[joint]
        seen, asked = flight.joints[place][joint], flight.joints[topic][name]
        was, wanted = (
            np.interp(a.time, b.time, b[c]) for a, b, c in ((asked, seen, "position"), (seen, asked, "effort"))
        )
        flight = alter(flight, place, joint, position=lambda _, w=wanted: w)
        flight = alter(flight, topic, name, effort=lambda _, w=was: w)
    return flight


def swap_slopes(spec: TwinSpec, flight: Flight) -> Flight:
    """Position and velocity of every joint, each written as the other."""
    for name, topic in spec.robot.signals.joints.items():
        held = flight.joints.get(topic, {}).get(name)
        if held is None:  # a ball joint
            continue
        flight = alter(
            flight, topic, name, position=lambda _, s=held: s["velocity"], velocity=lambda _, s=held: s["position"]
        )
    return flight


def turn_axes(column: str, order: list[int], signs: list[float]) -> Edit:
    """A body's vector or quaternion in another order, with other signs."""

    def edit(spec: TwinSpec, flight: Flight) -> Flight:
        ((name, topic),) = spec.robot.signals.bodies.items()
        return alter(flight, topic, name, **{column: lambda values: values[:, order] * signs})

    return edit


MISTAKES: dict[str, tuple[Edit, str]] = {
    "degrees": (scale("joints", DEGREES, "position", rotary=True), "unit: deg"),
    "degrees and degrees/s": (scale("joints", DEGREES, "position", "velocity", rotary=True), "unit: deg/s"),
    "degrees/s": (scale("joints", DEGREES, "velocity", rotary=True), "unit: deg/s"),
    "mm": (scale("joints", 1e3, "position", rotary=False), "unit: mm"),
    "mm and mm/s": (scale("joints", 1e3, "position", "velocity", rotary=False), "unit: mm/s"),
    "mm/s": (scale("joints", 1e3, "velocity", rotary=False), "unit: mm/s"),
    "velocity of the other sign": (scale("joints", -1.0, "velocity"), "velocity: {path: [a-z_]+, scale: -1.0}"),
    "joint of the other sign": (scale("joints", -1.0, "position", "velocity", only=0), "scale: -1"),
    "effort of the other sign": (scale("actuators", -1.0, "effort"), "scale: -1"),
    "position and velocity swapped": (swap_slopes, "position: (v_[a-z]+|velocity), velocity: [a-z_]+"),
    "joints swapped": (swap("joints", "position", "velocity"), "to be exchanged"),
    "efforts swapped": (swap("actuators", "effort"), "to be exchanged"),
    "mN": (scale("actuators", 1e3, "effort"), "unit: mN"),
    "kgf": (scale("actuators", 1.0 / 9.80665, "effort"), "scale: 9.8|unit: kgf|scale: 9.7"),
    "target and position swapped": (swap_targets, "to be exchanged: .* target follows"),
    "before a gear of 50": (scale("actuators", 0.02, "effort"), "before a gear|for a gear that the MJCF lacks"),
    "targets in degrees": (scale("actuators", DEGREES, "effort"), "unit: deg"),
    "body in mm": (scale("bodies", 1e3, "position"), "unit: mm"),
    "y and z swapped": (turn_axes("position", [0, 2, 1], [1.0, 1.0, 1.0]), "position"),
    "z down": (turn_axes("position", [0, 1, 2], [1.0, 1.0, -1.0]), "scale: .1.0, 1.0, -1.0"),
    "x, y, z, w": (turn_axes("attitude", [1, 2, 3, 0], [1.0, 1.0, 1.0, 1.0]), "in another order"),
    "the inverse": (turn_axes("attitude", [0, 1, 2, 3], [1.0, -1.0, -1.0, -1.0]), "of the other sign"),
}
"""What somebody does wrong, and what the refusal says."""
SLIDE = ["mm", "joint of the other sign", "effort of the other sign", "mN", "kgf"]
FAST = ["mm", "mm and mm/s", "mm/s", "velocity of the other sign", "position and velocity swapped"]
CHAIN = ["degrees", "joint of the other sign", "joints swapped", "effort of the other sign", "efforts swapped", "mN"]
RATED = ["degrees", "degrees and degrees/s", "degrees/s", "velocity of the other sign", "position and velocity swapped"]
SERVO = [
    "target and position swapped",
    "joint of the other sign",
    "effort of the other sign",
    "targets in degrees",
    "joints swapped",
]
WRONG = [
    *[("step_1", mistake) for mistake in [*FAST, *SLIDE[1:]]],
    *[("sweep_1", mistake) for mistake in SLIDE], *[("relay_1", mistake) for mistake in SLIDE],
    *[(rig, "degrees") for rig in ("decay_1", "quiet_2", "nothing_2", "noisy_2")],
    *[("two_zeros_1", mistake) for mistake in CHAIN],
    *[("wrist_1", mistake) for mistake in [*RATED, "effort of the other sign", "mN"]],
    *[("servo", mistake) for mistake in SERVO],
    *[("quad", m) for m in ("body in mm", "y and z swapped", "z down", "x, y, z, w", "the inverse",
                            "effort of the other sign", "before a gear of 50")],
    *[(rig, "before a gear of 50")
      for rig in ("step_1", "sweep_1", "two_zeros_1", "wrist_1", "leg", "simple", "double")],
    *[("so101", mistake) for mistake in SERVO[:-1]],
    *[("leg", mistake) for mistake in ["effort of the other sign", *RATED, "efforts swapped", "mN"]],
    *[("simple", mistake) for mistake in RATED],
    *[("double", mistake) for mistake in [*RATED, "joints swapped", "mN"]],
    *[("antx", m) for m in ("degrees", "degrees/s", "mm", "mm/s", "velocity of the other sign",
                            "position and velocity swapped")],
]  # fmt: skip
"""Rigs with what is wrong with their logs."""

FIRST = {next(case for case in WRONG if case[i] == each) for i in (0, 1) for each in {case[i] for case in WRONG}}
"""One case of each rig and one of each mistake, which every run tries; the others are `slow`."""


def vet(spec: TwinSpec, *flights: Flight) -> None:
    """The gate, and the checks of reading."""
    check_columns(spec, flights, [read_measurements(spec, flight) for flight in flights])


@pytest.mark.parametrize(
    ("rig", "mistake"),
    [case if case in FIRST else pytest.param(*case, marks=pytest.mark.slow) for case in WRONG],
)
def test_wrong_columns_are_refused_with_the_line_to_change(rig: str, mistake: str) -> None:
    """And the refusal names what was found, and how the twin's line must be."""
    spec, flight = load_case(rig)
    edit, said = MISTAKES[mistake]
    with pytest.raises(InputError, match=said) as refused:
        read_session(spec, [edit(spec, flight)])
    text = str(refused.value)
    assert "\n" not in text
    assert "--as-is" in text


def test_there_are_sixty_wrong_inputs() -> None:
    """At least, each of them different."""
    assert len(set(WRONG)) >= 60


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "current"])
@pytest.mark.parametrize("seed", [3, 4])
def test_correct_logs_of_kinds_pass(kind: str, seed: int) -> None:
    """Whatever is hidden in them; but `current`, whose efforts are no forces."""
    vet(*load_case(f"{kind}_{seed}"))


@pytest.mark.parametrize("rig", [*WORLDS, *MEASURED])
def test_correct_logs_of_other_rigs_pass(rig: str) -> None:
    """Of independent simulations, and measured ones."""
    vet(*load_case(rig))


@pytest.mark.parametrize(
    ("twin", "pattern"),
    [("antx/free.yaml", "antx/rail*1.mcap"), ("antx/rail.yaml", "antx/rail*1.mcap"),
     ("antx/pitch.yaml", "antx/pitch_free*.mcap"), ("nanobench/crazyflie.yaml", "nanobench/B2*.csv.gz"),
     *(pytest.param(*each, marks=pytest.mark.slow) for each in (
         ("antx/free.yaml", "antx/*.mcap"), ("antx/rail.yaml", "antx/rail*.mcap"),
         ("antx/pitch.yaml", "antx/pitch*.mcap"), ("nanobench/crazyflie.yaml", "nanobench/*fast*.csv.gz")))],
)  # fmt: skip
def test_shipped_examples_pass(twin: str, pattern: str, shared_data: Path) -> None:
    """Every twin with a log that it is for; the slow ones with all of them."""
    spec = load_twin(EXAMPLES / twin)
    for log in sorted(shared_data.glob(pattern)):
        vet(spec, read_flight(log, signals=spec.robot.signals.entries))


def test_a_range_in_another_unit_is_refused(tmp_path: Path) -> None:
    """MuJoCo reads degrees where nothing says radian."""
    world, _ = WORLDS["servo"]
    twin = world.write_twin(tmp_path)
    spec = load_twin(twin)
    log = find_case("servo")[1][0]
    model = next(tmp_path.glob("*.xml"))
    joint = next(iter(spec.robot.signals.joints))
    model.write_text(
        model.read_text().replace(f'name="{joint}"', f'name="{joint}" limited="true" range="-0.02 0.02"', 1)
    )
    spec = load_twin(twin)
    with pytest.raises(InputError, match=r"beyond its range of -0.02 to 0.02 rad"):
        vet(spec, read_flight(log, signals=spec.robot.signals.entries))


@pytest.mark.parametrize(("wall", "refused"), [("5 0.1 0.1", True), ("0.1 5 0.1", False)])
def test_parts_that_lie_in_each_other_are_refused(tmp_path: Path, wall: str, refused: bool) -> None:
    """A cart all along within its rail's geom is held by the solver; one that meets a wall at times is not refused."""
    case = write_kind("sweep", 1, tmp_path)
    model = tmp_path / "rig.xml"
    text = model.read_text().replace("<worldbody>", f'<worldbody><geom type="box" size="{wall}" pos="2 0 0.1"/>')
    model.write_text(text.replace("<inertial", '<geom type="box" size="0.1 0.05 0.05"/><inertial'))
    spec = load_twin(tmp_path / "twin.yaml")
    flight = read_flight(case.logs[0], signals=spec.robot.signals.entries)
    if not refused:
        vet(spec, flight)
        return
    with pytest.raises(InputError, match=r"world and body lie .* in each other .*exclude"):
        vet(spec, flight)
    with take_as_is():
        vet(spec, flight)
        assert any("in each other" in told for told in list_overruled())


def test_columns_with_one_mistake_are_named_together() -> None:
    """Both targets in degrees are one refusal with both lines."""
    spec, flight = load_case("servo")
    with pytest.raises(InputError) as refused:
        vet(spec, scale("actuators", DEGREES, "effort")(spec, flight))
    assert str(refused.value).count("unit: deg") == len(spec.robot.signals.actuators)


def test_a_unit_that_the_twin_says_too_much_is_taken_away(tmp_path: Path) -> None:
    """A twin that says mm of a log in m is told to leave that out, not to scale the velocity."""
    case = write_kind("step", 1, tmp_path)
    twin = tmp_path / "twin.yaml"
    text, count = re.subn(r"position: {path: slide}", "position: {path: slide, unit: mm}", twin.read_text())
    assert count == 1
    twin.write_text(text)
    spec = load_twin(twin)
    with pytest.raises(InputError) as refused:
        vet(spec, read_flight(case.logs[0], signals=spec.robot.signals.entries))
    assert "scale" not in str(refused.value)


def test_forces_behind_a_gear_are_told_from_what_goes_into_it(tmp_path: Path) -> None:
    """A pulley's gear in the MJCF, and a log of the force that it makes."""
    case = write_kind("sweep", 1, tmp_path)
    (tmp_path / "rig.xml").write_text((tmp_path / "rig.xml").read_text().replace('gear="1.08"', 'gear="50"'))
    spec = load_twin(tmp_path / "twin.yaml")
    with pytest.raises(InputError, match=r"behind the gear already.*scale: 0.02"):
        vet(spec, read_flight(case.logs[0], signals=spec.robot.signals.entries))


def test_a_position_that_never_changes_while_its_velocity_does_is_refused() -> None:
    """The twin names another column than it means."""
    spec, flight = load_case("step_1")
    (name, topic), *_ = spec.robot.signals.joints.items()
    with pytest.raises(InputError, match="position is 0 throughout"):
        vet(spec, alter(flight, topic, name, position=np.zeros_like))


def test_seconds_that_are_called_milliseconds_are_refused(tmp_path: Path) -> None:
    """No log has so many messages a second."""
    case = write_kind("step", 1, tmp_path)
    case.logs[0].write_text(case.logs[0].read_text().replace("t;", "t [ms];", 1))
    spec = load_twin(tmp_path / "twin.yaml")
    with pytest.raises(InputError, match="at most 100,000 messages a second; if its clock counts seconds"):
        read_flight(case.logs[0], signals=spec.robot.signals.entries)


@pytest.mark.parametrize(("effect", "values"), [
    ("motor.gain", {"gain": 0.4}), ("motor.gain", {"gain": 2.5}), ("slide.viscous", {"damping": 30.0}),
    ("slide.inertia", {"mass": 5.0}),
])  # fmt: skip
def test_a_wrong_gain_or_a_large_effect_is_no_misread_column(effect: str, values: dict[str, float]) -> None:
    """It is for the diagnosis: the logged cart is moved by a twin that has it."""
    spec, flight = load_case("sweep_1")
    known = next((e for e in spec.catalogue if e.id == effect), None)
    if known is None:
        pytest.skip(f"no {effect}")
    gain = values.get("gain")
    if gain is not None:  # the effort that was logged is not what acts
        flight = scale("actuators", 1.0 / gain, "effort")(spec, flight)
    vet(spec, flight)


def test_the_line_that_is_told_mends_the_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A CSV in mm is refused by `compare` and `plot`; with the line that they tell it passes; so it does as it is."""
    case = write_kind("sweep", 1, tmp_path)
    log, twin = case.logs[0], tmp_path / "twin.yaml"
    head, *rows = log.read_text().splitlines()
    mark = next(mark for mark in (",", ";", "\t") if mark in head)
    table = np.array([[float(cell) for cell in row.split(mark)] for row in rows])
    table[:, 1] *= 1e3
    np.savetxt(log, table, delimiter=mark, header=head, comments="", fmt="%.9g")
    for command in (["compare", str(log)], ["plot", str(log), "--out", str(tmp_path / "log.png")]):
        assert main([*command, "--twin", str(twin)]) == 2
        told = capsys.readouterr().err
        assert "unit: mm" in told
        assert main([*command, "--twin", str(twin), "--as-is"]) == 0
        assert "taken as it is" in capsys.readouterr().err
    (number,), (line,) = re.findall(r"change line (\d+) of", told), re.findall(r"`([^`]+)`", told)
    lines = twin.read_text().splitlines()
    lines[int(number) - 1] = f"    {line}"
    twin.write_text("\n".join(lines) + "\n")
    assert yaml.safe_load(twin.read_text())["signals"]["joints"]
    assert main(["compare", str(log), "--twin", str(twin)]) == 0
    assert compare([log], twin, progress=False).twins


def test_dropped_columns_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On standard error, once."""
    case = write_kind("sweep", 1, tmp_path)
    log = case.logs[0]
    head, *rows = log.read_text().splitlines()
    mark = next(mark for mark in (",", ";", "\t") if mark in head)
    log.write_text("\n".join([f"{head}{mark}temperature", *(f"{row}{mark}20.5" for row in rows)]) + "\n")
    assert main(["compare", str(log), "--twin", str(tmp_path / "twin.yaml")]) == 0
    told = capsys.readouterr().err
    assert told.count("columns that no signal names are dropped: temperature") == 1


def test_what_is_overruled_is_noted() -> None:
    """In the block that takes columns as they are, and nowhere else."""
    spec, flight = load_case("wrist_1")
    wrong = MISTAKES["degrees/s"][0](spec, flight)
    with take_as_is():
        _, (measured,) = read_session(spec, [wrong])
        assert list_overruled()
        assert any("taken as it is" in warning for warning in measured.warnings)
    assert not list_overruled()
