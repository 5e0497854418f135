"""`vpptwin identify` on thrust-stand runs of the independent simulation: what was hidden comes back."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from proving.thrust_stand_logs import write_bench
from tests.viz.browser import Browser
from vpptwin.actuators.blade import compute_thrust, max_thrust, pitch_for_thrust
from vpptwin.actuators.file import equip, load_actuator
from vpptwin.cli.main import main
from vpptwin.robots.planar_drone.thrust_stand.actuator import Actuator, identify
from vpptwin.robots.planar_drone.thrust_stand.bench import find_levels, read_bench
from vpptwin.robots.planar_drone.vehicle import Propeller, load_vehicle, strengthen_rotor
from vpptwin.twin import Twin, load_twin

NOMINAL = load_vehicle()
HIDDEN = {"servo.lag": {"time_constant": 0.028}, "command.delay": {"delay": 0.006}, "rotor.drag": {"gain": 1.1}}
TRUE = {
    "motor.k_v": 115.0, "motor.resistance": 0.12, "motor.k_q": 115.0, "motor.no_load_current": 0.4,
    "rotor.k_d1": 9.9e-8, "rotor.k_d2": 5.5e-6, "rotor.k_d3": 1.1e-4, "rotor.inertia": 4e-5,
    "servo.time_constant": 0.028, "servo.delay": 0.006,
}  # fmt: skip
"""What the stand has: nominal but for what is hidden."""
FEW = (0.0, 0.1, -0.1, 0.2, -0.2, 0.05, -0.05, 0.15, -0.15)
"""Fewer pitches, for shorter runs [rad]."""


@cache
def fit(path: Path) -> Actuator:
    """What one run tells."""
    run = read_bench(path, NOMINAL)
    return identify([run], find_levels([run]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For logs."""
    return tmp_path_factory.mktemp("bench")


@pytest.fixture(scope="module")
def plain(folder: Path) -> Path:
    """A run of a straight rotor without a torque channel."""
    return write_bench(folder / "plain.mcap", HIDDEN, 1, pitches=FEW)


@pytest.fixture(scope="module")
def bent(folder: Path) -> Path:
    """A run of a rotor whose thrust is bent as of blade elements with inflow, with a torque channel."""
    return write_bench(folder / "bent.mcap", HIDDEN, 2, pitches=FEW, curve=bend_thrust, torque=True)


def bend_thrust(pitch: np.ndarray) -> np.ndarray:
    """Equivalent pitch of a rotor with inflow: a good deal less at small pitch, a little more at large."""
    x = 0.5 * (-0.35 + np.sqrt(0.35**2 + 4.0 * 1.9 * np.abs(pitch)))
    return np.sign(pitch) * x * x


@pytest.mark.parametrize("run", ["plain", "bent"])
def test_every_constant_comes_back(run: str, request: pytest.FixtureRequest) -> None:
    """Within 2 % or four standard deviations, whichever is more; with the torque channel or without."""
    found = fit(request.getfixturevalue(run))
    for name, true in TRUE.items():
        constant = found.constant(name)
        assert constant.std < 0.05 * abs(true), name
        assert constant.value == pytest.approx(true, abs=max(0.02 * abs(true), 4.0 * constant.std)), name
    assert ("ideal motor" in found.constant("motor.k_q").note) == (run == "plain")


def test_a_straight_rotor_gets_a_line(plain: Path) -> None:
    """The paper's map where that is the truth, k_T within 0.2 %, off by less than the load cell's noise."""
    found = fit(plain)
    assert found.thrust.candidate.name == "linear, T ∝ ω"
    assert found.thrust.values[0] == pytest.approx(NOMINAL.rotor.k_t, rel=2e-3)
    assert abs(found.thrust.offset) < 4.0 * found.thrust.offset_std + 1e-5
    assert found.thrust.held_out < 0.02


def test_a_bent_rotor_gets_a_bent_map(bent: Path) -> None:
    """Held-out error chooses a map that is bent, and is a tenth of the line's."""
    found = fit(bent)
    assert found.thrust.candidate.name == "blade elements with inflow, T ∝ ω"
    line = next(m for m in found.maps if m.candidate.name == "linear, T ∝ ω")
    assert line.held_out > 10.0 * found.thrust.held_out
    assert line.held_out > 0.03 * np.abs(found.levels.thrust).max()


def test_errors_are_of_what_was_left_out(bent: Path) -> None:
    """Held-out errors are small beside what they are of, and never below those on the data of the fit."""
    found = fit(bent)
    for held in found.held_out[:4]:
        assert held.error < 0.05 * held.scale, held.what
    for fitted in found.maps:
        assert fitted.held_out >= fitted.residual


@pytest.fixture(scope="module")
def written(bent: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder with what the command writes, and what it says."""
    folder, said = tmp_path_factory.mktemp("identified"), io.StringIO()
    with redirect_stdout(said):
        assert main(["identify", str(bent), "--out", str(folder / "actuator.yaml")]) == 0
    return folder, said.getvalue()


@pytest.mark.browser
@pytest.mark.parametrize("width", [1200, 400])
def test_the_page_in_a_browser(written: tuple[Path, str], tmp_path: Path, width: int) -> None:
    """Offline, without complaint, all four pictures drawn, nothing sticks out sideways on a desk or a phone."""
    with Browser(tmp_path, size=(width, 900)) as browser:
        browser.open(written[0] / "actuator.html")
        browser.draw_frames()
        assert browser.complaints == []
        assert browser.requests == [(written[0] / "actuator.html").resolve().as_uri()]
        assert browser.evaluate("document.documentElement.scrollWidth") == width
        areas = "[...document.querySelectorAll('svg')].map(s => s.getBoundingClientRect()).map(b => b.width * b.height)"
        assert min(browser.evaluate(areas)) > 20_000
        assert len(browser.evaluate(areas)) == 4


def test_the_command_writes_file_and_page(written: tuple[Path, str], tmp_path: Path) -> None:
    """actuator.yaml holds the constants and their intervals, the page the same; a twin YAML refers to it."""
    folder, said = written
    assert "blade elements with inflow" in said
    assert sorted(p.name for p in folder.iterdir()) == ["actuator.html", "actuator.yaml"]
    content, page = yaml.safe_load((folder / "actuator.yaml").read_text()), (folder / "actuator.html").read_text()
    for name, (low, high) in content["intervals_90"].items():
        section, key = name.split(".")
        assert low <= content[section][key] <= high
        assert key in ("k_t", "inflow") or name in page
    assert page.count("<svg") == 4
    assert "http" not in page.replace("http://www.w3.org", "")

    twin = tmp_path / "twin.yaml"
    twin.write_text(f"model: rail_rig.xml\nvehicle: vehicle.yaml\nactuator: {folder / 'actuator.yaml'}\n")
    spec = load_twin(twin)
    assert spec.vehicle.servo.time_constant == content["servo"]["time_constant"]
    assert spec.effects["command.delay"]["delay"] == content["servo"]["delay"]
    assert spec.vehicle.airframe == NOMINAL.airframe
    rotor, pitch = spec.vehicle.rotor, np.linspace(-0.2, 0.2, 21)
    true = NOMINAL.rotor.k_t * 471.239 * bend_thrust(pitch)
    np.testing.assert_allclose(compute_thrust(rotor, 471.239, pitch), true, atol=0.02)
    np.testing.assert_allclose(pitch_for_thrust(rotor, compute_thrust(rotor, 471.239, pitch)), pitch, atol=1e-9)


BENT = NOMINAL.rotor.model_copy(update={"k_t": 0.04, "k_t2": 0.08, "k_t3": -0.1})
SQUARE = NOMINAL.rotor.model_copy(update={"k_t": 0.04, "k_t2": 0.05, "thrust_power": 2.0})
INFLOW = NOMINAL.rotor.model_copy(update={"k_t": 0.09, "inflow": 0.08})


@pytest.mark.parametrize("rotor", [NOMINAL.rotor, BENT, SQUARE, INFLOW], ids=["straight", "bent", "square", "inflow"])
def test_maps_are_inverted(rotor: Propeller) -> None:
    """The pitch for a thrust gives that thrust at the governed speed, both ways; beyond the stops the stop."""
    most = max_thrust(rotor)
    for thrust in np.linspace(-most, most, 31):
        pitch = pitch_for_thrust(rotor, float(thrust))
        assert float(compute_thrust(rotor, rotor.speed, pitch)) == pytest.approx(float(thrust), abs=1e-9)
    assert pitch_for_thrust(rotor, 2.0 * most) == rotor.pitch_max
    stronger, pitch = strengthen_rotor(rotor, 1.3), np.linspace(-0.2, 0.2, 9)
    expected = 1.3 * compute_thrust(rotor, 450.0, pitch)
    np.testing.assert_allclose(compute_thrust(stronger, 450.0, pitch), expected, atol=1e-12)


def test_thrust_grows_with_speed_as_its_power_says() -> None:
    """T ∝ ω or ω² at a fixed pitch, the same at the governed speed."""
    straight, square = BENT, BENT.model_copy(update={"thrust_power": 2.0})
    governed = NOMINAL.rotor.speed
    assert compute_thrust(straight, 1.1 * governed, 0.1) == pytest.approx(1.1 * compute_thrust(straight, governed, 0.1))
    assert compute_thrust(square, 1.1 * governed, 0.1) == pytest.approx(1.21 * compute_thrust(straight, governed, 0.1))


def test_the_twin_flies_a_bent_rotor(tmp_path: Path) -> None:
    """Inside the compiled step too: a craft told to carry its weight, on rotors believed in, does not accelerate."""
    (tmp_path / "actuator.yaml").write_text(
        "rotor: {k_t: 0.09, inflow: 0.08, k_d1: 9.0e-8, k_d2: 5.0e-6, k_d3: 1.0e-4, inertia: 4.0e-5}\n"
        "motor: {k_v: 115, k_q: 115, resistance: 0.12, no_load_current: 0.4}\nservo: {time_constant: 0.02}\n"
    )
    (tmp_path / "twin.yaml").write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\nactuator: actuator.yaml\n")
    weight = (NOMINAL.airframe.mass + NOMINAL.rig.slider_mass) * NOMINAL.gravity
    twin = Twin(load_twin(tmp_path / "twin.yaml"), 1, num_threads=1)
    state, speeds = twin.initial_state(), []
    for _ in range(50):
        state = twin.step_policy(state, np.array([[weight, 0.0]]))
        speeds.append(float(state.qvel[0, 1]))
    assert speeds[10] < -0.2  # it falls while its servos start
    assert speeds[-1] == pytest.approx(speeds[-21], abs=0.02)  # 1 % of its weight is 0.02 m/s in 0.2 s


def refuse(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a command says that is refused, one line."""
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_bad_runs_are_told_so(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each says what is missing for which constant, and leaves nothing behind."""
    out = tmp_path / "actuator.yaml"
    quick = {"hold": 0.45, "pitches": FEW[:6], "speeds": (450.0, 490.0)}
    cases = {
        "no_wrench": ({"leave_out": "/thrust_stand/wrench"}, "/thrust_stand/wrench, for the thrust map and the servo"),
        "no_state": ({"leave_out": "/rotor/state"}, "/rotor/state, for drag and motor constants"),
        "one_speed": ({"speeds": (470.0,)}, "for no_load_current, k_d1, k_v and resistance"),
        "few": ({"pitches": (0.0, 0.1, -0.1)}, "3 different pitches held for 0.4 s and more; expected 5 at least"),
        "short": ({"hold": 0.2}, "0 different pitches held"),
        "at_rest": ({"speeds": (0.0, 1.0)}, "no rotor turns"),
    }
    for name, (changed, expected) in cases.items():
        log = write_bench(folder / f"{name}.mcap", {}, 3, **(quick | changed))  # type: ignore[arg-type]
        assert expected in refuse(["identify", str(log), "--out", str(out)], capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_fails_does_not_cost_the_actuator(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is written, and a line says what is missing and why; no old page lies beside it."""

    def fail(*given: object) -> str:
        raise ZeroDivisionError("no runs")

    monkeypatch.setattr("vpptwin.robots.planar_drone.thrust_stand.command.render_page", fail)
    (tmp_path / "a.html").write_text("an old one, by vpptwin")
    assert main(["identify", str(plain), "--out", str(tmp_path / "a.yaml")]) == 0
    assert "a.html could not be made: ZeroDivisionError: no runs" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["a.yaml"]


def test_bad_files_are_told_so(plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An output that cannot be written, an actuator YAML that is none, one without the drone."""
    assert "a .yaml file" in refuse(["identify", str(plain), "--out", str(tmp_path / "actuator.json")], capsys)
    assert "an existing folder" in refuse(["identify", str(plain), "--out", str(tmp_path / "no" / "a.yaml")], capsys)
    twin, actuator = tmp_path / "twin.yaml", tmp_path / "actuator.yaml"
    twin.write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\nactuator: actuator.yaml\n")
    assert "No such file" in refuse(["effects", "--twin", str(twin)], capsys)
    actuator.write_text("rotor: {k_t: -1}\n")
    assert "rotor.k_t = -1" in refuse(["effects", "--twin", str(twin)], capsys)
    twin.write_text("model: rail_rig.xml\nactuator: actuator.yaml\nsignals: {joints: {rail_x: /joint_states}}\n")
    assert "actuator without vehicle" in refuse(["effects", "--twin", str(twin)], capsys)


def test_a_vehicle_keeps_what_a_stand_does_not_tell(tmp_path: Path) -> None:
    """Governed speed, pitch stops, battery and everything of the craft stay the vehicle's."""
    path = tmp_path / "actuator.yaml"
    path.write_text(
        "rotor: {k_t: 0.06, k_d1: 1.0e-7, k_d2: 4.0e-6, k_d3: 1.0e-4, inertia: 5.0e-5}\n"
        "motor: {k_v: 110, k_q: 112, resistance: 0.1, no_load_current: 0.5}\n"
        "servo: {time_constant: 0.03, delay: 0.01}\n"
    )
    vehicle = equip(NOMINAL, load_actuator(path))
    assert (vehicle.rotor.k_t, vehicle.rotor.inertia, vehicle.motor.k_q, vehicle.servo.time_constant) == (
        0.06, 5e-5, 112.0, 0.03,
    )  # fmt: skip
    assert (vehicle.rotor.speed, vehicle.rotor.pitch_max) == (NOMINAL.rotor.speed, NOMINAL.rotor.pitch_max)
    assert (vehicle.motor.battery, vehicle.airframe, vehicle.control) == (
        NOMINAL.motor.battery, NOMINAL.airframe, NOMINAL.control,
    )  # fmt: skip
