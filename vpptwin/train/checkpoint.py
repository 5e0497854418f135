"""Checkpoints: one torch file of tensors and plain data that `weights_only` loading accepts, written atomically."""

from __future__ import annotations

import io
import subprocess
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

import vpptwin
from vpptwin.errors import InputError
from vpptwin.files import write_whole
from vpptwin.resources import models_dir
from vpptwin.train.config import TrainConfig, to_config, to_plain
from vpptwin.train.env import VppEnv
from vpptwin.train.hook import Hook
from vpptwin.train.networks import Policy
from vpptwin.train.snapshot import take_snapshot

KIND, FORMAT = "vpptwin policy", 5
FILE_NAME, BEST_NAME = "checkpoint.pt", "best.pt"
"""Of the last state, which resuming needs, and of the best policy so far, which flies."""
RECORDED = ("vpptwin", "torch", "torchrl", "tensordict", "mujoco", "numpy")
PARTS = {"config": (dict,), "steps": (int,), "policy": (dict,), "commit": (str,), "training": (dict, type(None))}
"""What a checkpoint holds, and of which type."""
TRAIN_AGAIN = "train one with `vpptwin train task=hover`"


def find_commit() -> str:
    """Commit of the checkout this package runs from; "unknown" for an installed one."""
    folder = Path(vpptwin.__file__).resolve().parent.parent
    if not (folder / ".git").exists():
        return "unknown"
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def find_versions() -> dict[str, str]:
    """Versions of the packages that a run depends on."""
    versions = {}
    for name in RECORDED:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


def write_checkpoint(
    path: Path, config: TrainConfig, policy: Policy, steps: int, training: dict[str, Any] | None = None
) -> None:
    """Write a policy and, for resuming, the state of its training; the old file stays until the new one is complete."""
    content = {
        "kind": KIND, "format": FORMAT, "commit": find_commit(), "versions": find_versions(),
        "config": to_plain(config), "steps": steps, "policy": policy.state_dict(), "training": training,
    }  # fmt: skip
    data = io.BytesIO()
    torch.save(content, data)
    write_whole(path, data.getvalue())


def find_checkpoint(path: Path | str, flying: bool = True) -> Path:
    """The file that a name stands for: itself, one of a run's folder, or a policy that ships with the project.

    Args:
        path: file, folder of a run, or name such as `flip`.
        flying: the best policy of a folder is wanted, not the last state of training.
    """
    given = Path(path)
    if given.is_dir():
        best = given / BEST_NAME
        return best if flying and best.is_file() else given / FILE_NAME
    if not given.exists() and given.name == str(path) and not given.suffix:
        return shipped_policies().get(given.name, given)
    return given


def shipped_policies() -> dict[str, Path]:
    """Policies that ship with the project, by name."""
    folder = models_dir() / "policies"
    return {file.stem: file for file in sorted(folder.glob("*.pt"))}


def read_checkpoint(path: Path | str, flying: bool = True) -> dict[str, Any]:
    """Content of a checkpoint.

    Args:
        path: as `find_checkpoint`.
        flying: as `find_checkpoint`.

    Raises:
        InputError: if there is none, it is damaged, something else, or of another format.
    """
    file = find_checkpoint(path, flying)
    if not file.is_file():
        raise InputError(f"no checkpoint {file}", "a checkpoint or the folder of a run", TRAIN_AGAIN)
    try:
        with zipfile.ZipFile(file) as archive:
            if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
                raise ValueError("packed, as torch never does: it may unpack to anything")
            broken = archive.testzip()
        if broken is not None:
            raise ValueError(f"its checksum says that {broken} was changed or damaged")
        content = torch.load(file, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:  # torch raises half a dozen unrelated types on foreign bytes
        reason = f" ({error})" if type(error) is ValueError else ""
        found = f"{file} is not a checkpoint{reason}"
        raise InputError(found, "a file that `vpptwin train` wrote", TRAIN_AGAIN) from error
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise InputError(f"{file} is another kind of torch file", "a file that `vpptwin train` wrote", TRAIN_AGAIN)
    if content.get("format") != FORMAT:
        by = dict(content["versions"]).get("vpptwin") if isinstance(content.get("versions"), dict) else "unknown"
        found = f"{file} has checkpoint format {content.get('format')!r:.20} of vpptwin {by!s:.20}"
        raise InputError(found, f"format {FORMAT}", f"use that version, or {TRAIN_AGAIN}")
    for name, kind in PARTS.items():
        if not isinstance(content.get(name), kind):
            found = f"{file}: {name} is {type(content.get(name)).__name__}"
            raise InputError(found, " or ".join(str(part.__name__) for part in kind), TRAIN_AGAIN)
    return content


def build_policy(content: dict[str, Any], source: object) -> tuple[Policy, TrainConfig]:
    """The policy in a checkpoint's content and the configuration it was trained with.

    Raises:
        InputError: if the weights do not fit the network that the configuration describes, or are no numbers.
    """
    try:
        config = to_config(content["config"])
    except InputError as error:
        raise InputError(f"{source}: {error.found}", error.expected, error.action) from error
    policy = make_policy(config)
    try:
        policy.load_state_dict(content["policy"])
    except (RuntimeError, TypeError, AttributeError) as error:
        found = f"{source}: weights of another architecture than hidden={config.hidden}"
        raise InputError(found, "the network that its configuration describes", TRAIN_AGAIN) from error
    wrong = [name for name, values in policy.state_dict().items() if not bool(torch.isfinite(values).all())]
    if wrong:
        raise InputError(f"{source}: NaN or infinity in weights {wrong[0]}", "finite numbers", TRAIN_AGAIN)
    return policy.eval(), config


def make_policy(config: TrainConfig) -> Policy:
    """An untrained policy of the configured size."""
    return Policy(config.sight, (config.hidden[0], config.hidden[1]))


class SaveCheckpoint(Hook):
    """Writes a checkpoint every so many steps and after the last one.

    Args:
        path: of the file.
        config: of the run.
        policy: what flies, the average of what is trained.
        env: whose simulations are saved too, so that a resumed run continues as if never interrupted; None if they
            are elsewhere, and new episodes begin.
    """

    place, name = "post_steps_log", "save_checkpoint"  # the last of them that is registered

    def __init__(self, path: Path, config: TrainConfig, policy: Policy, env: VppEnv | None) -> None:
        self.path, self.config, self.policy, self.env = path, config, policy, env
        self.saved = 0

    def __call__(self, batch: object = None) -> None:
        """Save if it is time."""
        steps = self.trainer.collected_frames
        if steps - self.saved < self.config.checkpoint_every and steps < self.trainer.total_frames:
            return
        self.saved = steps
        env = None if self.env is None else take_snapshot(self.env)
        training = {"trainer": self.trainer.state_dict(), "env": env, "torch_random": torch.get_rng_state()}
        write_checkpoint(self.path, self.config, self.policy, steps, training)

    def state_dict(self) -> dict[str, Any]:
        """When it last saved."""
        return {"saved": self.saved}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue counting from a saved run."""
        self.saved = state_dict["saved"]
