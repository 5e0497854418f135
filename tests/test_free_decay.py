"""The commonest log of all: a pendulum let go, without actuator and commands, and only some seconds long."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest
import yaml

from tests.diagnosis.rigs import DAMPING, DECAYS, let_swing, record
from vpptwin.cli.main import main
from vpptwin.diagnosis.evidence.flights import list_starts
from vpptwin.diagnosis.judgement.material import open_held_out
from vpptwin.diagnosis.judgement.wrench import plot_wrench
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.twin.spec import load_twin


@dataclass(frozen=True)
class Decay:
    """Log, twin without friction, and folder with results."""

    log: Path
    twin: Path
    out: Path

    @property
    def verdict(self) -> dict:
        """verdict.json."""
        return json.loads((self.out / "verdict.json").read_text())


def diagnose_decay(folder: Path, duration: float) -> Decay:
    """So many seconds of a damped pendulum, diagnosed as a user does."""
    log, twin = record(replace(DECAYS, move=partial(let_swing, duration=duration)), DAMPING, folder, seed=1)
    assert main(["diagnose", str(log), "--twin", str(twin), "--out", str(folder / "out")]) == 0
    return Decay(log, twin, folder / "out")


@pytest.fixture(scope="module")
def decay(tmp_path_factory: pytest.TempPathFactory) -> Decay:
    """4.1 s."""
    return diagnose_decay(tmp_path_factory.mktemp("decay"), 4.1)


def check_damping(decay: Decay) -> None:
    """Viscous, alone, of the right size; nothing is left."""
    (cause,) = decay.verdict["causes"]
    assert cause["effect"] == "swing.viscous"
    assert cause["parameters"]["damping"]["value"] == pytest.approx(DAMPING, rel=0.1)
    assert not decay.verdict["unexplained"]["significant"]


def check_short(decay: Decay) -> None:
    """Windows are short enough, the verdict says what a short log can't show."""
    assert decay.verdict["samples"]["held_out_windows"] >= 3
    assert any("so short that windows have 0." in warning for warning in decay.verdict["warnings"])
    assert "short: in windows of 0." in (decay.out / "report.html").read_text()


def test_damping_of_a_free_decay_is_named(decay: Decay) -> None:
    """In a few seconds; the report's line on the log speaks of no commands."""
    check_damping(decay)
    check_short(decay)
    page = (decay.out / "report.html").read_text()
    assert "swing rate 200 Hz;" in page
    assert "control" not in page
    assert yaml.safe_load((decay.out / "twin.yaml").read_text())["signals"]["actuators"] == {}
    assert (decay.out / "prediction.mcap").stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize("duration", [6.0, 9.0, 12.0])
def test_damping_of_longer_decays_is_named(duration: float, tmp_path: Path) -> None:
    """From windows as long as the log allows."""
    found = diagnose_decay(tmp_path, duration)
    check_damping(found)
    if duration < 10.0:
        check_short(found)


def test_a_free_decay_can_be_compared_and_looked_at(decay: Decay, tmp_path: Path) -> None:
    """compare, play and plot take the rig without actuators, and the extended twin predicts it better."""
    chi2 = []
    for twin in (decay.twin, decay.out / "twin.yaml"):
        assert main(["compare", str(decay.log), "--twin", str(twin), "--json", str(tmp_path / "c.json")]) == 0
        chi2.append(json.loads((tmp_path / "c.json").read_text())["error"]["chi2"])
    assert chi2[1] < 0.1 * chi2[0]
    for command in (["play", "--html", "o.html"], ["plot", "--out", "o.png"], ["plot", "--free", "--out", "free.png"]):
        command[-1] = str(tmp_path / command[-1])
        assert main([command[0], str(decay.log), "--twin", str(decay.twin), *command[1:]]) == 0
        assert Path(command[-1]).stat().st_size > 10_000


def test_every_cause_of_a_free_decay_has_something_to_plot_against(decay: Decay) -> None:
    """A force that follows the command elsewhere is shown against the position where there are no commands."""
    spec = load_twin(decay.twin)
    measurements = [read_measurements(spec, read_flight(decay.log))]
    held_out = open_held_out(spec, measurements, list_starts(measurements, spec.robot.window), None)
    plot = plot_wrench(held_out, {}, find_effect(spec.catalogue, "swing.inertia"))
    assert plot.x_label == "swing position [rad]"


def test_three_seconds_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What holds no nine windows of 0.4 s tells too little."""
    log, twin = record(replace(DECAYS, move=partial(let_swing, duration=3.5)), DAMPING, tmp_path, seed=1)
    assert main(["diagnose", str(log), "--twin", str(twin), "--out", str(tmp_path / "out")]) == 2
    assert "at least 4 s" in capsys.readouterr().err
