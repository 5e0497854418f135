"""`vpptwin export`: a policy as C99 source or ONNX."""

from __future__ import annotations

from pathlib import Path

from vpptwin.deploy.c_source import FILES, write_c
from vpptwin.deploy.content import collect_content
from vpptwin.errors import InputError
from vpptwin.files import check_own


def export(checkpoint: Path, kind: str, out: Path | None, twin: str | None = None, force: bool = False) -> list[Path]:
    """Export a policy.

    Args:
        checkpoint: file, folder of a run, or name of a shipped policy.
        kind: `c` or `onnx`.
        out: folder for C, file for ONNX; by default `<name>_c` and `<name>.onnx` in the current folder.
        twin: whose vehicle and actuator controller the cascade is for; None for that of training.
        force: overwrite files that vpptwin did not write, too.

    Returns:
        Files written.

    Raises:
        InputError: if the checkpoint or twin is not what it should be, or a file cannot be written.
    """
    content = collect_content(checkpoint, twin)
    name = checkpoint.resolve().stem if checkpoint.stem else "policy"
    if kind == "c":
        folder = out or Path(f"{name}_c")
        if not force:
            check_own(folder / file for file in FILES)
        return write_c(content, folder)
    target = out or Path(f"{name}.onnx")
    if target.suffix != ".onnx":
        raise InputError(f"--out {target}", "a name that ends in .onnx", f"e.g. --out {name}.onnx")
    if not force:
        check_own([target])
    from vpptwin.deploy.onnx_model import write_onnx  # torch loads

    return [write_onnx(content, target)]
