"""A real quadrotor, measured, with examples/nanobench: thrust by hand, and what is cut of its logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vpptwin
from examples.nanobench.by_hand import look
from vpptwin.diagnosis.evidence.logged_inputs import read_session
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/nanobench"


@pytest.fixture(scope="module")
def flights(shared_data: Path) -> list[Path]:
    """The logs."""
    return sorted((shared_data / "nanobench").glob("*.csv.gz"))


def test_thrust_by_hand(flights: list[Path]) -> None:
    """README's numbers: two thirds of the published map, fading in each flight, and little of what turns the craft."""
    text = (EXAMPLE / "README.md").read_text("utf-8")
    for path in flights:
        found = look(path)
        (row,) = [line for line in text.splitlines() if line.startswith(f"| {path.name.split('_rep')[0]} |")]
        told = [float(cell) for cell in row.split("|")[2:11]]
        numbers = [found.thrust, found.thrust / 0.15, found.first, found.last, *found.shares, *found.drag]
        np.testing.assert_allclose(told, numbers, atol=0.0051, rtol=0.01)
        assert 0.6 < found.thrust / 0.15 < 0.75
        assert found.last < found.first
        assert max(found.shares) < 0.4
        assert all(0.011 < drag < 0.013 for drag in found.drag)


def test_logs_are_cut_to_the_flight(flights: list[Path]) -> None:
    """Motors stand for the first seconds and the last; what is left begins and ends in the air."""
    spec = load_twin(EXAMPLE / "crazyflie.yaml")
    for path in flights[:2]:
        flight = read_flight(path, signals=spec.robot.signals.entries)
        measured = read_measurements(spec, flight)
        assert 2.5 < measured.start < 3.5
        assert any("it is still there" in line for line in measured.warnings)
        height = measured.positions[2]
        inside = (height.time > measured.start) & (height.time < measured.end)
        assert height.value[inside].min() > height.value[0] + 0.02


@pytest.mark.parametrize("number", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 5))])
def test_inputs_do_not_tell_what_turned_it(flights: list[Path], number: int) -> None:
    """Every flight turns as logged: PWM explains a tenth to a third of what turned it."""
    spec, path = load_twin(EXAMPLE / "crazyflie.yaml"), flights[number]
    assert read_session(spec, [read_flight(path, signals=spec.robot.signals.entries)])[0].robot.signals.turned


def test_a_gyro_in_another_unit_is_refused(flights: list[Path], tmp_path: Path) -> None:
    """Taken for degrees a second, its rates turn a sixtieth as fast as the attitudes."""
    text = (EXAMPLE / "crazyflie.yaml").read_text("utf-8").replace("imu_gyro_z]}", "imu_gyro_z], unit: deg/s}")
    (tmp_path / "degrees.yaml").write_text(text.replace("crazyflie.xml", str(EXAMPLE / "crazyflie.xml")))
    spec = load_twin(tmp_path / "degrees.yaml")
    with pytest.raises(
        InputError, match=r"rates of quad are 0.01\d* times the turning of the attitudes.*`unit: rad/s`"
    ):
        read_measurements(spec, read_flight(flights[0], signals=spec.robot.signals.entries))


@pytest.mark.parametrize(
    "attitude", ["[qx, qy, qz, qw]", "{path: [qw, qx, qy, qz], scale: [1, -1, -1, -1]}"], ids=["last", "back"]
)
def test_attitudes_read_in_another_order_or_sense_are_refused(
    flights: list[Path], tmp_path: Path, attitude: str
) -> None:
    """The line in the message is the example's own."""
    text = (EXAMPLE / "crazyflie.yaml").read_text("utf-8").replace("[qw, qx, qy, qz]", attitude)
    (tmp_path / "wrong.yaml").write_text(text.replace("crazyflie.xml", str(EXAMPLE / "crazyflie.xml")))
    spec = load_twin(tmp_path / "wrong.yaml")
    for path in flights[:2]:
        with pytest.raises(InputError, match=r"attitudes of quad .* write `attitude: \[qw, qx, qy, qz\]` for quad"):
            read_measurements(spec, read_flight(path, signals=spec.robot.signals.entries))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(2))
def test_weak_rotors_and_drag_are_named_as_by_hand(flights: list[Path], number: int) -> None:
    """It turns as logged; a third less thrust, or half as much weight more, which are one, and the drag beside it.

    By hand both come from the accelerometer, at which no diagnosis looks, and thrust is a mean over the flight: where
    it fades, it is that of the middle. With more weight there is more drag.
    """
    verdict, hand = vpptwin.diagnose(flights[number], twin=EXAMPLE / "crazyflie.yaml").verdict, look(flights[number])
    spec = load_twin(EXAMPLE / "crazyflie.yaml")
    flown = read_measurements(spec, read_flight(flights[number], signals=spec.robot.signals.entries))
    causes = {cause.effect: cause for cause in verdict.causes}
    (first,) = {"m1+m2+m3+m4.gain", "quad.mass"} & set(causes)
    named = {first, *(rival.effect for rival in causes[first].also_explained_by)}
    assert named >= {"m1+m2+m3+m4.gain", "quad.mass"}
    (strength,) = (parameter.value for parameter in causes[first].parameters.values())
    weight = 1.0 + strength / 0.03 if first == "quad.mass" else 1.0
    thrust = 1.0 if first == "quad.mass" else strength
    sag = causes["m1+m2+m3+m4.sag"].parameters["rate"].value if "m1+m2+m3+m4.sag" in causes else 0.0
    thrust *= 1.0 - 0.5 * (flown.start + flown.end) * sag
    assert thrust / weight == pytest.approx(hand.thrust / 0.15, abs=0.03)
    drag = causes["quad.drag"].parameters["across"].value / weight
    assert drag == pytest.approx(np.mean(hand.drag), rel=0.15)
    assert verdict.after.chi2 < verdict.before.chi2 / 50.0
    assert all(cause.confidence < 0.9 for cause in verdict.causes)
