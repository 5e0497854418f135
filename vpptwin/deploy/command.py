"""`vpptwin export`: a policy as C99 source or ONNX, a twin as MJCF or as events of mjlab."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vpptwin.deploy.c_source import FILES, write_c
from vpptwin.deploy.content import collect_content
from vpptwin.system.errors import InputError
from vpptwin.system.files import check_own, is_same, write_whole
from vpptwin.twin.spec import load_twin

TWINS = {"mjcf": ("{}.xml", ".xml"), "mjlab": ("{}_mjlab.py", ".py")}
"""Formats of twins: what a file is called by default, and how its name ends."""


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
    if checkpoint.suffix.lower() in (".yaml", ".yml"):
        raise InputError(f"{checkpoint} as {kind}", "a policy; twins go as mjcf or mjlab", "choose another --format")
    content = collect_content(checkpoint, twin)
    name = checkpoint.resolve().stem if checkpoint.stem else "policy"
    if kind == "c":
        folder = out or Path(f"{name}_c")
        if not force:
            check_own(folder / file for file in FILES)
        return write_c(content, folder)
    target = out or Path(f"{name}.onnx")
    if target.suffix.lower() != ".onnx":
        raise InputError(f"--out {target}", "a name that ends in .onnx", f"e.g. --out {name}.onnx")
    if not force:
        check_own([target])
    from vpptwin.deploy.onnx_model import write_onnx  # torch loads

    return [write_onnx(content, target)]


def export_twin(
    name: str, kind: str, out: Path | None, effect_files: Sequence[Path] = (), force: bool = False
) -> tuple[Path, list[str]]:
    """Export a twin.

    Args:
        name: as of `load_twin`.
        kind: `mjcf` or `mjlab`.
        out: file to write; by default `<name>.xml` or `<name>_mjlab.py` in the current folder.
        effect_files: as of `load_twin`.
        force: overwrite a file that vpptwin did not write, too.

    Returns:
        The file, and lines that say what is held, what is not, and how far plain MuJoCo goes from the twin.

    Raises:
        InputError: if the twin is not what it should be, no effect is on, or the file cannot be written.
    """
    from vpptwin.deploy.hold import hold
    from vpptwin.deploy.mjcf import describe, describe_rollouts, write_mjcf
    from vpptwin.deploy.mjlab import write_mjlab

    spec = load_twin(name, effect_files)
    default, suffix = TWINS[kind]
    target = out or Path(default.format(Path(name).stem))
    if target.suffix.lower() != suffix:
        raise InputError(f"--out {target}", f"a name that ends in {suffix}", f"e.g. --out {default.format('twin')}")
    if is_same(target, [spec.model_file]):
        raise InputError(f"--out {target} is the twin's own MJCF", "another file", "choose another name")
    if not force:
        check_own([target])
    held = hold(spec)
    if not held.reasons and not held.lost:
        raise InputError(f"twin {name} has no effect switched on", "one that a diagnosis wrote", "give twin.yaml")
    lines = [f"held: {describe(e, spec)}" for e in held.effects]
    lines += [f"not held: {describe(e, spec)} ({why})" for e, why in held.lost]
    if kind == "mjlab":
        text, fixed = write_mjlab(spec)
        return write_whole(target, text), [*lines, *(f"not drawn: {line}" for line in fixed)]
    write_whole(target, write_mjcf(spec, held, target.parent))
    return target, [*lines, *describe_rollouts(spec, held, target)]
