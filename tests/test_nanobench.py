"""A real quadrotor, measured, with examples/nanobench: thrust by hand, and what is cut of its logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vpptwin
from examples.nanobench.by_hand import look
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
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
        told = [float(cell) for cell in row.split("|")[2:9]]
        numbers = [found.thrust, found.thrust / 0.15, found.first, found.last, *found.shares]
        np.testing.assert_allclose(told, numbers, atol=0.0051, rtol=0.01)
        assert 0.6 < found.thrust / 0.15 < 0.75
        assert found.last < found.first
        assert max(found.shares) < 0.4


@pytest.mark.parametrize("twin", ["crazyflie.yaml", "thrust.yaml"])
def test_logs_are_cut_to_the_flight(flights: list[Path], twin: str) -> None:
    """Motors stand for the first seconds and the last; what is left begins and ends in the air."""
    spec = load_twin(EXAMPLE / twin)
    for path in flights[:2]:
        flight = read_flight(path, signals=spec.robot.signals.entries)
        measured = read_measurements(spec, flight)
        assert 2.5 < measured.start < 3.5
        assert any("it stands there" in line for line in measured.warnings)
        height = measured.positions[int(spec.model.nv > 3) * 2]
        inside = (height.time > measured.start) & (height.time < measured.end)
        assert height.value[inside].min() > height.value[0] + 0.02


@pytest.mark.slow
def test_weight_and_thrust_are_not_told_apart(flights: list[Path]) -> None:
    """Going up and down, a third less thrust is half as much weight more: each is told with the other as its rival."""
    verdict = vpptwin.diagnose(flights[0], twin=EXAMPLE / "thrust.yaml").verdict
    heavy = {"quad.payload", "quad.mass", "m1+m2+m3+m4.gain"}
    (cause,) = [cause for cause in verdict.causes if cause.effect in heavy]
    assert heavy <= {cause.effect, *(rival.effect for rival in cause.also_explained_by)}
    assert cause.confidence < 0.5
    mass = cause.parameters["mass"].value if cause.effect != "m1+m2+m3+m4.gain" else 0.0
    assert 0.03 / (0.03 + mass) == pytest.approx(0.66, abs=0.03)
