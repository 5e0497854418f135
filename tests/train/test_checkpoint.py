"""Checkpoints: round trip, which file a name stands for, and files that are something else."""

from __future__ import annotations

import io
import os
import shutil
import zipfile
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._pytree import tree_flatten

from vpptwin.cli.main import main
from vpptwin.system.errors import InputError
from vpptwin.train.config import to_config
from vpptwin.train.env.observe import ObservationTerms
from vpptwin.train.evaluate.evaluate import load_policy
from vpptwin.train.learn.actor import build_actor
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint, write_checkpoint
from vpptwin.train.learn.networks import Policy
from vpptwin.train.stored import FORMAT, PlainUnpickler, find_checkpoint, open_checkpoint, shipped_policies


def test_round_trip(tiny_run: Path, tmp_path: Path) -> None:
    """A policy written and read acts bit-equal; a file without training state is small enough to ship."""
    policy, content = load_policy(tiny_run), read_checkpoint(tiny_run)
    path = tmp_path / "policy.pt"
    write_checkpoint(path, to_config(content["config"]), policy, content["steps"])
    observation = torch.randn(7, 11)
    assert torch.equal(load_policy(path)(observation), policy(observation))
    assert path.stat().st_size < 200_000
    assert [p.name for p in tmp_path.iterdir()] == ["policy.pt"]


def test_a_folder_flies_its_best_and_resumes_its_last(tiny_run: Path, tmp_path: Path) -> None:
    """best.pt if there is one, else checkpoint.pt; a file stands for itself."""
    assert find_checkpoint(tiny_run) == tiny_run / "best.pt"
    assert find_checkpoint(tiny_run, flying=False) == tiny_run / "checkpoint.pt"
    assert find_checkpoint(tiny_run / "checkpoint.pt") == tiny_run / "checkpoint.pt"
    shutil.copy(tiny_run / "checkpoint.pt", tmp_path)
    assert find_checkpoint(str(tmp_path)) == tmp_path / "checkpoint.pt"


def test_policies_ship_by_name(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bare name stands for models/policies/NAME.pt, unless there is such a file here; others are refused."""
    monkeypatch.setattr("vpptwin.train.stored.models_dir", lambda: tmp_path)
    (tmp_path / "policies").mkdir()
    shutil.copy(tiny_run / "best.pt", tmp_path / "policies" / "spin.pt")
    observation = torch.randn(3, 11)
    assert torch.equal(load_policy("spin")(observation), load_policy(tiny_run)(observation))
    for name in ("loop", "policies/spin", "spin.pt"):
        with pytest.raises(InputError, match="no checkpoint"):
            load_policy(name)
    with pytest.raises(InputError, match=r"did you mean spin\?"):
        load_policy("spinn")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    shutil.copytree(tiny_run, tmp_path / "here" / "spin")
    (tmp_path / "here" / "spin" / "best.pt").unlink()
    assert find_checkpoint("spin") == Path("spin/checkpoint.pt")


def test_every_policy_that_ships_can_be_flown() -> None:
    """Whatever lies in models/policies loads, within the bound that it was trained with."""
    for name in shipped_policies():
        policy = load_policy(name)
        bound = to_config(read_checkpoint(name)["config"]).lipschitz
        assert bound is None or policy.lipschitz() <= bound * (1.0 + 1e-5)  # float32


def test_a_policy_flies_without_torch(tiny_run: Path) -> None:
    """NumPy reads the same numbers, of the file that resuming needs too, and acts as torch does within float32."""
    for flying in (True, False):
        plain, content = open_checkpoint(tiny_run, flying), read_checkpoint(tiny_run, flying)
        flat, same = tree_flatten(plain), tree_flatten(content)
        assert flat[1] == same[1]
        for value, other in zip(flat[0], same[0]):
            assert np.array_equal(value, other) if isinstance(value, np.ndarray) else value == other
        observation = torch.randn(100, 11)
        with torch.no_grad():
            wanted = build_policy(content, tiny_run)[0](observation).numpy()
        np.testing.assert_allclose(build_actor(plain, tiny_run)[0](observation.numpy()), wanted, atol=1e-6)


@pytest.mark.parametrize(("size", "stride"), [((10**9,), (1,)), ((3, 3), (-1, 1)), ((2, 3), (3, 2))])
def test_tensors_reach_no_further_than_their_numbers(size: tuple[int, ...], stride: tuple[int, ...]) -> None:
    """What a file says of a tensor's shape is checked before anything is read."""
    with pytest.raises(UnpicklingError, match="beyond"):
        PlainUnpickler._rebuild(np.zeros(6, np.float32), 0, size, stride)


def damage(content: dict[str, Any], kind: str) -> dict[str, Any]:
    """A checkpoint's content made unusable in one way."""
    if kind == "format":
        return {**content, "format": 99}
    if kind == "kind":
        return {"weights": content["policy"]}
    if kind == "architecture":
        return {**content, "policy": Policy(ObservationTerms(), (32, 32)).state_dict()}
    return {**content, "config": {**content["config"], "unknown_option": 1}}


@pytest.mark.parametrize(
    ("kind", "found"),
    [("format", "format 99"), ("kind", "another kind"), ("architecture", "architecture"), ("config", "unknown_option")],
)
def test_unusable_checkpoints(tiny_run: Path, tmp_path: Path, kind: str, found: str) -> None:
    """Another version, another kind of torch file and another architecture are told apart, in one line each."""
    path = tmp_path / "damaged.pt"
    torch.save(damage(read_checkpoint(tiny_run), kind), path)
    with pytest.raises(InputError, match=found) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"no torch file", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_files_that_are_no_checkpoint(tmp_path: Path, content: bytes) -> None:
    """Empty and foreign files are named as such."""
    path = tmp_path / "file.pt"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a checkpoint"):
        load_policy(path)


def test_truncated_checkpoint(tiny_run: Path, tmp_path: Path) -> None:
    """Half a checkpoint is refused, for evaluation as for resuming."""
    path = tmp_path / "checkpoint.pt"
    whole = (tiny_run / "checkpoint.pt").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(tmp_path)


def test_files_that_a_run_to_resume_names_do_not_run(
    tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They would with `--trust`; a line says so."""
    (tmp_path / "evil.py").write_text("open('ran', 'w').close()\n")
    content = read_checkpoint(tiny_run, flying=False)
    changed = {**content, "config": {**content["config"], "effects": [str(tmp_path / "evil.py")]}}
    (tmp_path / "run").mkdir()
    torch.save(changed, tmp_path / "run" / "checkpoint.pt")
    assert main(["train", f"resume={tmp_path / 'run'}", f"total_steps={2 * content['steps']}"]) == 2
    err = capsys.readouterr().err
    assert "evil.py, Python code that would be run" in err
    assert "--trust" in err
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("bit", range(0, 240, 60))
def test_a_flipped_bit_is_noticed(tmp_path: Path, bit: int) -> None:
    """Anywhere in a weight: the checksums in the file tell which part was changed."""
    data = bytearray(shipped_policies()["flip"].read_bytes())
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        part = max(archive.infolist(), key=lambda info: info.file_size)
    place = part.header_offset + 200 + 97 * bit
    data[place] ^= 1 << bit % 8
    (tmp_path / "flipped.pt").write_bytes(data)
    with pytest.raises(InputError, match="was changed or damaged"):
        load_policy(tmp_path / "flipped.pt")


def test_weights_that_are_no_numbers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """NaN in a policy is the policy's fault, whatever command flies it; no effect of the twin is blamed."""
    content = read_checkpoint("flip")
    name = next(name for name in content["policy"] if name.endswith("weight"))
    content["policy"][name] = content["policy"][name] * float("nan")
    torch.save(content, tmp_path / "nan.pt")
    for command in (["fly", "--out", str(tmp_path / "log.mcap")], ["evaluate"], ["export", "--format", "c"]):
        assert main([command[0], str(tmp_path / "nan.pt"), *command[1:]]) == 2
        assert f"nan.pt: NaN or infinity in weights {name}" in capsys.readouterr().err


LARGE = {
    "hidden": [10**7, 10**7], "critic_hidden": [10**7], "critic_lstm": 10**7, "gamma": float("nan"), "noise": 1e300,
    "setup": "${oc.env:HOME}", "sim_threads": 10**7, "loggers": "csv", "effects": {"a": 1},
}  # fmt: skip


@pytest.mark.parametrize("key", LARGE)
def test_absurd_configurations_are_refused(tmp_path: Path, key: str) -> None:
    """In one line, before anything of that size is made or anything is looked up."""
    content = read_checkpoint("flip")
    torch.save({**content, "config": {**content["config"], key: LARGE[key]}}, tmp_path / "large.pt")
    with pytest.raises(InputError, match=r"large\.pt: ") as caught:
        load_policy(tmp_path / "large.pt")
    assert "\n" not in str(caught.value)
    assert os.environ["HOME"] not in str(caught.value)


@pytest.mark.parametrize("name", ["config", "steps", "policy", "commit", "training"])
def test_parts_of_the_wrong_kind_are_named(tmp_path: Path, name: str) -> None:
    """Each part that a checkpoint must hold."""
    torch.save({**read_checkpoint("flip"), name: [1, 2]}, tmp_path / "odd.pt")
    with pytest.raises(InputError, match=rf"odd\.pt: {name} is list; expected"):
        read_checkpoint(tmp_path / "odd.pt")


def test_packed_checkpoints_are_refused(tmp_path: Path) -> None:
    """A zip whose parts are deflated may unpack to anything."""
    with zipfile.ZipFile(tmp_path / "bomb.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", bytes(10**8))
    with pytest.raises(InputError, match="packed, as torch never does"):
        read_checkpoint(tmp_path / "bomb.pt")


def test_code_in_a_checkpoint_does_not_run(tmp_path: Path) -> None:
    """A pickle that would execute something is refused, not executed."""

    class Payload:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (tmp_path / "ran",)  # type: ignore[return-value]

    torch.save({"kind": "vpptwin policy", "format": FORMAT, "policy": Payload()}, tmp_path / "evil.pt")
    for read in (read_checkpoint, open_checkpoint):
        with pytest.raises(InputError, match="not a checkpoint"):
            read(tmp_path / "evil.pt")
    assert not (tmp_path / "ran").exists()
