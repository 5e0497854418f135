"""A real hobby arm with position servos, measured, with examples/so101."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.so101.by_hand import INERTIA, LIMITS, MAKERS, WEIGHT, fit_joint, miss, prepare, weigh
from examples.so101.convert import JOINTS, convert, read_motion
from vpptwin.cli.demo import MOTIONS
from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/so101"


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    """The motions."""
    return shared_data / "so101"


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_that_ship_are_what_was_measured(folder: Path, tmp_path: Path, name: str) -> None:
    """Their first 24 s, and their licence."""
    convert(folder / name, tmp_path / "log.mcap", last=24.0)
    shipped, made = (read_flight(path) for path in (EXAMPLE / f"motions/{name}.mcap", tmp_path / "log.mcap"))
    for topic, streams in made.joints.items():
        for joint, stream in streams.items():
            for column, values in stream.values.items():
                np.testing.assert_array_equal(shipped.joints[topic][joint][column], values)
    assert (EXAMPLE / "motions/LICENSE").read_bytes() == (folder / "LICENSE").read_bytes()


def test_the_fit_weighs_as_the_model_does() -> None:
    """Gravity by hand is that of the MJCF, at poses all over the range."""
    import mujoco

    model = load_twin(EXAMPLE / "so101.yaml").model
    data, poses = mujoco.MjData(model), np.random.default_rng(1).uniform(-1.0, 1.0, (20, 5))
    poses[:, 4] = 0.0  # the gripper's centre is 2 mm off the axis of its roll
    held = []
    for pose in poses:
        data.qpos[:], data.qvel[:] = pose, 0.0
        mujoco.mj_forward(model, data)
        held.append(-data.qfrc_bias.copy())
    for joint in WEIGHT:
        weight = np.array(held)[:, JOINTS.index(joint)]
        np.testing.assert_allclose(weigh(joint, poses), weight, atol=2e-3)
    inertia = np.zeros((5, 5))
    mujoco.mj_fullM(model, data, inertia)
    assert all(0.5 < INERTIA[joint] / inertia[i, i] < 1.5 for i, joint in enumerate(JOINTS))


def test_converting_loses_nothing(folder: Path, tmp_path: Path) -> None:
    """Targets and positions come back as in the CSVs."""
    convert(folder / "pick_place", tmp_path / "log.mcap", last=20.0)
    time, target, position = read_motion(folder / "pick_place")
    flight = read_flight(tmp_path / "log.mcap")
    for i, joint in enumerate(JOINTS):
        motion, servo = flight.joints["/joint_states"][joint], flight.joints["/actuator_command"][f"{joint}_servo"]
        rows = len(motion.time)
        assert 950 < rows < 1010
        np.testing.assert_allclose(np.diff(motion.time), np.diff(time[:rows]), atol=1e-8)
        np.testing.assert_array_equal(motion["position"], position[:rows, i])
        np.testing.assert_array_equal(servo["effort"], target[:rows, i])


def test_servos_by_hand(folder: Path) -> None:
    """README's numbers of the turntable; what its makers say is further off, on unseen motions too."""
    fit = fit_joint([folder / "prbs_excitation"], "Rotation")
    (row,) = [
        line for line in (EXAMPLE / "README.md").read_text("utf-8").splitlines() if line.startswith("| Rotation |")
    ]
    told = [float(number) for number in re.findall(r"-?[\d.]+", row)]
    found = [fit["kp"], fit["b"], fit["F"]]
    np.testing.assert_allclose(found, told[:3], rtol=0.03)
    assert fit["late"] < 0.01
    assert all(each.low <= each.value <= each.high for each in fit.estimates.values())
    values = {name: fit[name] for name in LIMITS}
    for motion, share in (("prbs_excitation", 0.3), ("random_waypoints", 0.9), ("multisine", 0.8)):
        assert miss(folder / motion, "Rotation", values) < share * miss(folder / motion, "Rotation", MAKERS)


def test_a_target_is_followed_within_three_samples(folder: Path) -> None:
    """Whatever lags is the servo's damping: steps of the target move the joint 20 to 40 ms later."""
    target, seen, _, _ = prepare(folder / "prbs_excitation", "Rotation")
    steps = np.flatnonzero(np.abs(np.diff(target)) > 0.2)
    moved = [np.argmax(np.abs(seen[i : i + 20] - seen[i]) > 0.02) for i in steps]
    assert 1 <= np.median(moved) <= 3


def diagnose_steps(folder: Path, out: Path, twin: str) -> dict[str, Any]:
    """The verdict on 24 s of random steps."""
    convert(folder / "prbs_excitation", out / "log.mcap", last=24.0)
    assert main(["diagnose", str(out / "log.mcap"), "--twin", str(EXAMPLE / twin), "--out", str(out / "out")]) == 0
    found: dict[str, Any] = json.loads((out / "out/verdict.json").read_text())
    return found


@pytest.fixture(scope="module")
def verdict(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of the turntable."""
    return diagnose_steps(folder, tmp_path_factory.mktemp("turntable"), "rotation.yaml")


@pytest.mark.slow
def test_the_verdict_on_the_turntable(verdict: dict[str, Any]) -> None:
    """Friction, of which its makers have a tenth, and damping or its like; nothing for sure."""
    causes = {cause["effect"]: cause for cause in verdict["causes"]}
    assert {"Rotation.coulomb", "Rotation.stiction"} & set(causes)
    alike = {rival["effect"] for cause in causes.values() for rival in cause["also_explained_by"]}
    assert "Rotation.viscous" in alike | set(causes)
    before, after = (verdict[key]["angle_rmse_rad"][-1] for key in ("before", "after"))
    assert after < before / 3.0
    assert verdict["gap"]
    assert all(cause["confidence"] < 0.9 for cause in causes.values())
    # Of held-out chi².
    assert verdict["after"]["chi2"] < 0.1 * verdict["before"]["chi2"]


@pytest.mark.slow
def test_the_verdict_on_five_joints_at_once(folder: Path, tmp_path: Path) -> None:
    """Damping and dry friction of all of them, as by hand, and nothing for sure; three and a half minutes."""
    verdict = diagnose_steps(folder, tmp_path, "so101.yaml")
    causes = {cause["effect"]: cause for cause in verdict["causes"]}
    for effect in ("joints.viscous", "joints.coulomb"):
        (parameter,) = causes[effect]["parameters"].values()
        assert parameter["value"] > 3.0 * parameter["std"]
    assert all(cause["confidence"] < 0.9 for cause in causes.values())
    assert verdict["after"]["chi2"] < 0.2 * verdict["before"]["chi2"]
