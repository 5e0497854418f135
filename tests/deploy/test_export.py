"""`vpptwin export` and `vpptwin fly --policy`: ONNX agrees with torch, flights are those of the checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from tests.deploy.conftest import compile_library, make_random
from vpptwin.cli.main import main
from vpptwin.deploy.content import STATES, TOLERANCE, Content, draw_observations
from vpptwin.deploy.load import CompiledController, OnnxController, load_exported
from vpptwin.deploy.onnx_model import write_onnx
from vpptwin.logs import read_flight
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import accumulate_error, observe
from vpptwin.train.evaluate.evaluate import load_policy


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy as ONNX, by the command."""
    path = tmp_path_factory.mktemp("onnx") / "flip.onnx"
    assert main(["export", "flip", "--format", "onnx", "--out", str(path)]) == 0
    return path


def draw_states(count: int) -> tuple[np.ndarray, ...]:
    """Poses, velocities, targets and integrals of a flight, turned a few times."""
    rng = np.random.default_rng(8)
    scales = ([0.5, 0.5, 4.0], [1.0, 1.0, 5.0], [0.5, 0.5, 3.0], [1.0, 1.0])
    return tuple(rng.normal(size=(count, len(scale))) * scale for scale in scales)


def test_onnx_gives_the_actions_of_torch(shipped: Content, model: Path) -> None:
    """Ten thousand states through onnxruntime: observation, integral and action within 1e-5 of torch on the same."""
    session = onnxruntime.InferenceSession(model.read_bytes(), providers=["CPUExecutionProvider"])
    given = [values.astype(np.float32) for values in draw_states(10_000)]
    action, grown, seen = session.run(None, dict(zip(STATES, given)))
    with torch.no_grad():
        wanted = load_policy("flip")(torch.from_numpy(seen)).numpy()
    assert np.abs(action - wanted).max() < TOLERANCE
    pose, velocity, target, before = (values.astype(float) for values in given)
    integral = accumulate_error(before, (target - pose)[:, :2])
    np.testing.assert_allclose(grown, integral, atol=1e-6)
    np.testing.assert_allclose(seen, observe(pose, velocity, target, integral, shipped.trained.observation), atol=3e-6)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(("setup=VA",), marks=pytest.mark.slow),
        pytest.param(("setup=PI",), marks=pytest.mark.slow),
        ("setup=TA", "paper_inputs=true"),
    ],
)
def test_other_setups_as_onnx(options: tuple[str, ...], tmp_path: Path) -> None:
    """Written, loaded, their test vectors pass."""
    loaded = load_exported(write_onnx(make_random(*options), tmp_path / "policy.onnx"))
    assert isinstance(loaded, OnnxController)
    assert loaded.trained.setup == options[0].removeprefix("setup=")


def test_exports_say_where_they_come_from(shipped: Content, library: Path, model: Path) -> None:
    """Commit, twin with its hash, versions and observation stand in both, and there are 64 test vectors."""
    for loaded in (load_exported(library), load_exported(model)):
        about = loaded.metadata
        assert about["checkpoint"] == "flip"
        assert about["observation"] == list(shipped.trained.observation.names)
        assert len(about["twin_sha256"]) == 64
        assert about["steps"] > 1e6
        assert len(about["trained_at"]) == 40
        assert loaded.trained.task.name == "flip"
    assert shipped.inputs.shape == (64, 11)
    assert np.abs(shipped.inputs - draw_observations(shipped.trained, 64, seed=1)).max() == 0.0


def test_a_changed_model_is_refused(model: Path, tmp_path: Path) -> None:
    """Weights that are not those of the test vectors, a model of somebody else, no model: a line each."""
    changed = onnx.load(model)
    weight = next(t for t in changed.graph.initializer if len(t.dims) == 2)
    values = onnx.numpy_helper.to_array(weight).copy()
    values[0] += 1.0
    weight.CopyFrom(onnx.numpy_helper.from_array(values, weight.name))
    onnx.save(changed, tmp_path / "changed.onnx")
    foreign = onnx.load(model)
    del foreign.metadata_props[:]
    onnx.save(foreign, tmp_path / "foreign.onnx")
    (tmp_path / "none.onnx").write_text("nothing")
    for name, hint in (
        ("changed", "of its test vectors fail"),
        ("foreign", "no controller"),
        ("none", "no ONNX model"),
    ):
        with pytest.raises(InputError, match=hint) as caught:
            load_exported(tmp_path / f"{name}.onnx")
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_exported_controllers_fly_as_the_checkpoint(library: Path, model: Path, tmp_path: Path) -> None:
    """The same flip by checkpoint, C and ONNX: float32 apart, and the flip takes place."""
    logs = {}
    for name, pilot in (
        ("checkpoint", ["flip"]),
        ("c", ["--policy", str(library)]),
        ("onnx", ["--policy", str(model)]),
    ):
        out = tmp_path / f"{name}.mcap"
        assert main(["fly", *pilot, "--seed", "3", "--out", str(out)]) == 0
        logs[name] = read_flight(out).streams
    pose = logs["checkpoint"]["/mocap/pose"]
    assert np.ptp(pose["theta"]) > 3.0
    for name in ("c", "onnx"):
        for column in ("x", "z", "theta"):
            np.testing.assert_allclose(logs[name]["/mocap/pose"][column], pose[column], atol=2e-4)
        found, wanted = (logs[n]["/cmd/rate_thrust"]["rate"] for n in (name, "checkpoint"))
        np.testing.assert_allclose(found, wanted, atol=2e-2)


def test_c_by_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Two files in a folder named like the policy; a twin's own vehicle goes into the cascade."""
    monkeypatch.chdir(tmp_path)
    assert main(["export", "flip", "--format", "c"]) == 0
    assert capsys.readouterr().out.split() == ["flip_c/vpptwin.h", "flip_c/vpptwin.c"]
    (tmp_path / "adaptive.yaml").write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\ncontroller: adaptive\n")
    assert main(["export", "flip", "--format", "c", "--twin", "adaptive.yaml", "--out", "other"]) == 0
    assert load_exported(compile_library(tmp_path / "other")).metadata["controller"] == "adaptive"


def test_bad_exports(tmp_path: Path, capsys: pytest.CaptureFixture[str], library: Path) -> None:
    """No such policy, a name that does not fit, no place to write, two policies at once: one line and code 2."""
    for arguments, hint in (
        (["export", "flop", "--format", "c"], "flop"),
        (["export", "flip", "--format", "onnx", "--out", str(tmp_path / "policy.pb")], ".onnx"),
        (["export", "flip", "--format", "c", "--out", "/proc/vpptwin"], "cannot write"),
        (["fly", "flip", "--policy", str(library), "--out", str(tmp_path / "a.mcap")], "leave one out"),
        (["fly", "--policy", str(tmp_path / "none.so"), "--out", str(tmp_path / "a.mcap")], "none.so"),
        (["fly", "--policy", str(library), "--task", "flap", "--out", str(tmp_path / "a.mcap")], "flap"),
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err.strip()
        assert hint in said
        assert "\n" not in said
    assert not list(tmp_path.iterdir())


def test_a_library_is_one_of_ours(library: Path) -> None:
    """Loaded by its kind."""
    assert isinstance(load_exported(library), CompiledController)
