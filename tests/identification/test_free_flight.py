"""`vpptwin identify FLIGHT... --parameters`: chosen effects fitted to flights of the independent simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving.drone.flight import fly_many
from proving.drone.recording import write_mcap
from vpptwin.cli.main import main
from vpptwin.drift.free_flight import FlightFit, fit_flights, pair_up, parse_parameters
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

K_D, LAG = 0.12, 0.030  # N s²/m², s
HIDDEN = {"air.drag": {"k_d": K_D}, "servo.lag": {"time_constant": LAG}}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three flights of one rig."""
    folder = tmp_path_factory.mktemp("flights")
    plans = [
        {"effects": HIDDEN, "manoeuvre": m, "duration": 8.0, "seed": i, "session": 4}
        for i, m in enumerate(("aggressive", "z_steps", "mixed"))
    ]
    return [write_mcap(flight, folder / f"{i}.mcap") for i, flight in enumerate(fly_many(plans))]  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def fitted(logs: list[Path]) -> FlightFit:
    """Drag and lag, and a pair that flights can't tell apart."""
    spec = load_twin()
    effects = parse_parameters(spec, "air.drag, servo.lag.time_constant,mocap.misalignment,rail_x.bias")
    assert effects == ["air.drag", "servo.lag", "mocap.misalignment", "rail_x.bias"]
    return fit_flights(spec, [read_flight(log) for log in logs], effects)


def test_what_is_hidden_comes_back(fitted: FlightFit) -> None:
    """Drag and lag within three standard deviations, which are small beside them; what is not there is about zero."""
    drag, lag = fitted.values["air.drag", "k_d"], fitted.values["servo.lag", "time_constant"]
    assert drag.value == pytest.approx(K_D, abs=3.0 * drag.std)
    assert lag.value == pytest.approx(LAG, abs=3.0 * lag.std + 0.001)  # servos differ by 3 % within tolerance
    assert drag.std < 0.3 * K_D
    assert lag.std < 0.1 * LAG
    assert abs(fitted.values["mocap.misalignment", "angle"].value) < 0.02


def test_the_gain_is_measured_on_windows_not_seen(fitted: FlightFit) -> None:
    """Held-out windows fit better with the values, after half a second by a good deal."""
    assert fitted.after.chi2 < fitted.before.chi2
    assert fitted.before.position_rmse_m is not None
    assert fitted.after.position_rmse_m is not None
    assert fitted.after.position_rmse_m[3] < 0.7 * fitted.before.position_rmse_m[3]


def test_the_papers_least_squares(fitted: FlightFit) -> None:
    """Of drag it gives a figure too: the same order, with all that it leaves out in it."""
    assert fitted.drag is not None
    assert fitted.drag.samples > 100
    assert fitted.drag.k_d == pytest.approx(K_D, abs=max(4.0 * fitted.drag.std, 0.6 * K_D))


def test_the_command(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    fitted: FlightFit,
) -> None:  # fmt: skip
    """It prints values, pairs and errors, and writes a twin that has them."""
    pair = (("air.drag", "k_d"), ("servo.lag", "time_constant"), -0.95)
    shown = replace(fitted, alike=[*fitted.alike, pair])
    monkeypatch.setattr("vpptwin.drift.identify.fit_flights", lambda *given: shown)
    out = tmp_path / "twin.yaml"
    assert main(["identify", *map(str, logs), "--parameters", "air.drag,servo.lag", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "air.drag.k_d" in said
    assert "by least squares on accelerations" in said
    assert "held out chi²" in said
    spec = load_twin(out)
    assert spec.effects["air.drag"]["k_d"] == pytest.approx(fitted.values["air.drag", "k_d"].value, rel=1e-5)
    for first, second, likeness in shown.alike:
        assert f"{'.'.join(first)} and {'.'.join(second)}" in said
        assert abs(likeness) > 0.9


def test_pairs_by_hand() -> None:
    """Of three parameters the two whose errors go together are named, however small their units, with the sign."""
    keys = [("a", "x"), ("b", "y"), ("c", "z")]
    covariance = np.array([[1e-6, 0.5e-3, -0.97e-3], [0.5e-3, 1.0, 0.2], [-0.97e-3, 0.2, 1.0]])
    assert pair_up(keys, covariance) == [(keys[2], keys[0], pytest.approx(-0.97))]
    assert pair_up(keys, np.diag([1.0, 0.0, 2.0])) == []


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("air.drug", "unknown effect 'air.drug'"),
        (" , ", "names none"),
        ("air.drag.k_x", "air.drag has no parameter 'k_x'"),
        ("contact.friction", "contact.friction, which only impacts show"),
    ],
)
def test_unknown_parameters(given: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line with the nearest ids, before any log is read."""
    assert main(["identify", "no.mcap", "--parameters", given, "--out", str(tmp_path / "twin.yaml")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert told in said
