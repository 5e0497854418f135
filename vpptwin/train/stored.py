"""Checkpoints as files: which one a name stands for, what it must hold, and reading it without torch."""

from __future__ import annotations

import io
import pickle
import subprocess
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import vpptwin
from vpptwin.system.errors import InputError, suggest
from vpptwin.system.resources import models_dir

KIND, FORMAT = "vpptwin policy", 5
FILE_NAME, BEST_NAME = "checkpoint.pt", "best.pt"
"""Of the last state, which resuming needs, and of the best policy so far, which flies."""
RECORDED = ("vpptwin", "torch", "torchrl", "tensordict", "mujoco", "numpy")
PARTS = {"config": (dict,), "steps": (int,), "policy": (dict,), "commit": (str,), "training": (dict, type(None))}
"""What a checkpoint holds, and of which type."""
TRAIN_AGAIN = "train one with `vpptwin train task=hover`"
NUMBERS = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "LongStorage": "<i8", "IntStorage": "<i4", "ShortStorage": "<i2",
    "ByteStorage": "<u1", "CharStorage": "<i1", "BoolStorage": "?",
}  # fmt: skip
"""Numbers of torch's storages, as NumPy names them."""


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


def need_checkpoint(path: Path | str, flying: bool = True) -> Path:
    """As `find_checkpoint`; commands that load torch ask before that.

    Raises:
        InputError: if there is no such file.
    """
    file = find_checkpoint(path, flying)
    if not file.is_file():
        advice = suggest(str(path), shipped_policies(), TRAIN_AGAIN)
        raise InputError(f"no checkpoint {file}", "a checkpoint or the folder of a run", advice)
    return file


def shipped_policies() -> dict[str, Path]:
    """Policies that ship with the project, by name."""
    folder = models_dir() / "policies"
    return {file.stem: file for file in sorted(folder.glob("*.pt"))}


def load_arrays(path: Path) -> Any:  # noqa: ANN401
    """What `torch.save` wrote, tensors as NumPy arrays: nothing but plain data comes out, and no code runs.

    Raises:
        OSError: if it cannot be read.
        Exception: of half a dozen kinds if the file is another one.
    """
    with zipfile.ZipFile(path) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("/data.pkl"))
        return PlainUnpickler(archive, name).load()


class PlainUnpickler(pickle.Unpickler):
    """Unpickles dictionaries, lists, numbers, text and tensors of one of torch's archives, and refuses all else."""

    def __init__(self, archive: zipfile.ZipFile, name: str) -> None:
        super().__init__(io.BytesIO(archive.read(name)))
        self._archive, self._folder = archive, name.removesuffix("data.pkl")

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401
        """The few things that a checkpoint may call; numbers of a storage by name."""
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self._rebuild
        if module == "torch" and name in NUMBERS:
            return NUMBERS[name]
        raise pickle.UnpicklingError(f"{module}.{name} in a checkpoint")

    def persistent_load(self, pid: Any) -> np.ndarray:  # noqa: ANN401
        """The numbers of a storage, (count,)."""
        _, kind, key, *_ = pid
        return np.frombuffer(self._archive.read(f"{self._folder}data/{key}"), kind)

    @staticmethod
    def _rebuild(
        numbers: np.ndarray, offset: int, size: Sequence[int], stride: Sequence[int], *_: object
    ) -> np.ndarray:
        reach = sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if min(size, default=1) > 0 and not (min(stride, default=0) >= 0 <= offset and offset + reach < len(numbers)):
            raise pickle.UnpicklingError("a tensor beyond its numbers")
        steps = [step * numbers.itemsize for step in stride]
        return np.lib.stride_tricks.as_strided(numbers[offset:], size, steps, writeable=False)


def open_checkpoint(path: Path | str, flying: bool = True, load: Callable[[Path], Any] = load_arrays) -> dict[str, Any]:
    """Content of a checkpoint.

    Args:
        path: as `find_checkpoint`.
        flying: as `find_checkpoint`.
        load: reads the file; by default its tensors become NumPy arrays.

    Raises:
        InputError: if there is none, it is damaged, something else, or of another format.
    """
    file = need_checkpoint(path, flying)
    try:
        with zipfile.ZipFile(file) as archive:
            if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
                raise ValueError("packed, as torch never does: it may unpack to anything")
            broken = archive.testzip()
        if broken is not None:
            raise ValueError(f"its checksum says that {broken} was changed or damaged")
        content = load(file)
    except (OSError, ModuleNotFoundError):
        raise
    except Exception as error:  # pickle and torch raise half a dozen unrelated types on foreign bytes
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
