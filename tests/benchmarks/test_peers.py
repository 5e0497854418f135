"""The comparison with other simulators: its results file, and that it refuses to time one that flies differently."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import peers
import pytest
from same_rig.rig import draw_actions, write_rig
from same_rig.torchrl_env import SerialRigs
from same_rig.vpptwin_env import fly_twin

from vpptwin.robots.planar_drone.vehicle import load_vehicle

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SLOW_TO_START = ("torchrl-parallel", "mjx")
"""Left out here: worker processes that each import torch, and half a minute of compilation."""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Results file of a quick run in a process of its own."""
    out = tmp_path_factory.mktemp("peers") / "out.json"
    command = [sys.executable, str(BENCHMARKS / "peers.py"), "--quick", "--seed", "3", "--json", str(out)]
    done = subprocess.run([*command, "--without", *SLOW_TO_START], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| implementation |" in done.stdout
    return json.loads(out.read_text())


@pytest.mark.slow
def test_the_results_file(result: dict) -> None:
    """Machine, versions, seed and tolerance stand in the file."""
    assert result["machine"]["cores"] >= 1
    assert result["versions"]["mujoco"]
    assert result["versions"]["torchrl"]
    assert result["seed"] == 3
    assert result["tolerance"]["after_s"] == 0.2
    # A row has numbers of its rounds, or a reason; only gymnasium may be missing here.
    rows = {row["name"]: row for row in result["rows"]}
    assert set(rows) == {"raw", "raw-clockless", "vpptwin", "gymnasium", "torchrl-serial"}
    for name, row in rows.items():
        if row["skipped"]:
            assert name == "gymnasium"
            assert "control_steps_per_s" not in row
            continue
        assert min(row["rounds"]) <= row["control_steps_per_s"] <= max(row["rounds"])
        assert len(row["rounds"]) == result["rounds"]
        assert row["us_per_physics_step"] == pytest.approx(1e5 / row["control_steps_per_s"])
        assert row["ratio_to_raw"] > 0.0
        assert row["leaves_out"]
    # Every simulator with a controller was compared with the twin and is within the tolerance in the file.
    timed = [row for row in result["rows"] if not row["skipped"] and not row["name"].startswith("raw")]
    assert len(timed) >= 2
    for row in timed:
        assert row["agrees"] is True
        assert row["position_error_m"] <= result["tolerance"]["position_m"]
        assert row["angle_error_rad"] <= result["tolerance"]["angle_rad"]


@pytest.mark.parametrize(
    ("change", "servo", "agrees"),
    [({}, 1.0, True), ({"mass_factor": 1.1}, 1.0, False), ({"friction": 0.27}, 1.0, False),
     ({"friction": 0.0}, 1.0, False), ({}, 1.1, False)],
    ids=["same", "heavier", "slippery", "frictionless", "slow"],
)  # fmt: skip
def test_a_simulator_of_another_rig_is_refused(
    tmp_path: Path, change: dict[str, float], servo: float, agrees: bool
) -> None:
    """A craft 10 % heavier, rails with 10 % less friction, a servo 10 % slower fly otherwise beyond the tolerance."""
    vehicle = load_vehicle()
    slow = vehicle.servo.model_copy(update={"time_constant": servo * vehicle.servo.time_constant})
    flight = draw_actions(vehicle, 0, peers.CHECK_STEPS)
    rig = write_rig(tmp_path / "rig.xml", **change)
    errors = peers.compare_flight(
        SerialRigs(rig, vehicle.model_copy(update={"servo": slow}), 2, 0), flight, fly_twin(flight)
    )
    assert peers.agrees(*errors) is agrees


def test_a_flight_that_is_not_a_number_is_refused() -> None:
    """Differences that are NaN are no agreement."""
    assert not peers.agrees(np.nan, 0.0)
    assert not peers.agrees(0.0, np.nan)


def test_what_is_refused_gets_no_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    """With a tolerance that nothing meets the benchmark prints no speed but that of raw, and fails."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(peers, "POSITION_TOLERANCE", -1.0)
        code = peers.main(["--quick", "--without", "gymnasium", "vpptwin", *SLOW_TO_START])
    out = capsys.readouterr().out
    assert code == 1
    assert "TorchRL MujocoEnv, SerialEnv: not timed, flies differently" in out
    assert "| TorchRL" not in out
