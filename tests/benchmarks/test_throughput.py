"""The throughput benchmark: its results file, and that what it times is one and the same hover."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import throughput_rigs as rigs

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
NAMES = (
    "raw", "raw, clock stopped", "raw, no friction", "twin", "twin, all effects", "environment", "environment, kalman",
)  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Results file of a quick run in a process of its own."""
    out = tmp_path_factory.mktemp("throughput") / "out.json"
    command = [sys.executable, str(BENCHMARKS / "throughput.py"), "--quick", "--threads", "1", "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| environments | what |" in done.stdout
    return json.loads(out.read_text())


@pytest.mark.slow
def test_the_results_file(result: dict) -> None:
    """Each is timed in every round and set against the engine in the same round; the engine's own ratio is one."""
    assert [row["name"] for row in result["rows"]] == list(NAMES)
    for row in result["rows"]:
        assert len(row["rounds"]) == result["rounds"] == 2
        assert min(row["rounds"]) <= row["control_steps_per_s"] <= max(row["rounds"])
        assert row["processor_us_per_physics_step"] > 0.0
    assert result["rows"][0]["ratio"] == result["rows"][0]["processor_ratio"] == 1.0
    # Machine, versions, seed and threads stand in the file, with speed of one rig and memory.
    assert result["versions"]["mujoco"]
    assert (result["seed"], result["threads"], result["friction_n"]) == (0, 1, 0.3)
    assert [alone["name"] for alone in result["alone"]] == ["twin, all effects", "environment"]
    for memory in result["memory"]:
        assert 0.0 < memory["single_mib"] <= memory["peak_mib"]


@pytest.mark.parametrize("name", NAMES)
def test_contenders_hover(name: str) -> None:
    """What is timed is a flight: within 5 s every rig began anew once, at its own time, and hardly one failed."""
    flown = rigs.CONTENDERS[name][1](16, 1, 3)
    spent = flown.fly(500)
    assert (spent.steps, spent.wall > 0.0) == (8000, True)
    assert spent.ended - spent.failed == pytest.approx(16, abs=1)
    assert spent.failed <= 1
    first = flown.fly(100)
    assert 0 < first.ended < 16
    pose, velocity = flown.motion()
    # The pilot has no integral: friction and a tilted rail leave it some 10 cm off, drawn effects twice that.
    assert np.median(np.hypot(*(flown.target - pose)[:, :2].T)) < 0.4
    assert np.abs(velocity).max() < 8.0


def test_pilot_by_hand() -> None:
    """At rest on the target it carries craft and slider; to the left of it, it turns to the right, clockwise."""
    vehicle, target = rigs.load_vehicle(), np.array([[0.0, 1.2, 0.0]])
    ((thrust, rate),) = rigs.steer(vehicle, target, np.zeros((1, 3)), target)
    assert thrust == pytest.approx(0.5 * 9.81)  # 0.450 and 0.050 kg
    assert rate == 0.0
    ((_, rate),) = rigs.steer(vehicle, target - np.array([0.5, 0.0, 0.0]), np.zeros((1, 3)), target)
    assert rate < 0.0


@pytest.mark.slow
def test_a_device_flies_beside(tmp_path: Path) -> None:
    """On Warp's processor device: the kernel, and the environment around it, next to the processor's own."""
    pytest.importorskip("warp")
    out = tmp_path / "device.json"
    command = [sys.executable, str(BENCHMARKS / "throughput.py"), "--quick", "--device", "cpu", "--json", str(out)]
    subprocess.run(command, capture_output=True, text=True, check=True)
    rows = {row["name"]: row for row in json.loads(out.read_text())["rows"]}
    assert {"raw", "twin, all effects", "environment", "twin on cpu", "environment on cpu"} <= rows.keys()
    assert all(row["control_steps_per_s"] > 0.0 for row in rows.values())
