"""The extended twin on disk: the diagnosed one with the named effects switched on, and where they come from."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import yaml

from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.effects import find_effect
from vpptwin.report.provenance import Provenance
from vpptwin.report.summary import describe_partial
from vpptwin.system.installed import list_installed
from vpptwin.system.resources import models_dir
from vpptwin.twin.robot.signals import NO_SIGNALS
from vpptwin.twin.spec import EffectValues, TwinSpec


def extend_effects(spec: TwinSpec, values: Mapping[Key, float]) -> EffectValues:
    """Effects of the extended twin: those of the diagnosed one, and the fitted values to six digits."""
    effects = {effect: dict(parameters) for effect, parameters in spec.effects.items()}
    for (effect, parameter), value in values.items():
        bounds, rounded = find_effect(spec.catalogue, effect).parameter(parameter), round_digits(value)
        # Rounding may not carry a value at its bound over it: the file would be refused.
        effects.setdefault(effect, {})[parameter] = rounded if bounds.low <= rounded <= bounds.high else float(value)
    return effects


def compose_twin(spec: TwinSpec, effects: EffectValues, verdict: Verdict, origin: Provenance, folder: Path) -> str:
    """The diagnosed twin with the effects of the extended one as YAML, which names its files from `folder`."""
    content = name_twin(spec, folder) | {"effects": effects}
    intervals = {
        f"{cause.effect}.{name}": [round_digits(end) for end in e.interval]
        for cause in verdict.causes
        if cause.effect in effects
        for name, e in cause.parameters.items()
    }
    partial = describe_partial(verdict)
    content["provenance"] = ({"partial": partial} if partial else {}) | {
        "command": origin.command, "date": origin.date, "diagnosed_twin": origin.twin, "versions": origin.versions,
        "logs": origin.logs, "intervals_90_percent": intervals,
    }  # fmt: skip
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120)


def name_twin(spec: TwinSpec, folder: Path) -> dict[str, object]:
    """The keys of a twin YAML in a folder, with the effects of `spec`."""
    content: dict[str, object] = {"model": name_file(spec.model_file, folder)}
    if spec.vehicle_file is not None:
        content["vehicle"] = name_file(spec.vehicle_file, folder)
    content["effects"] = spec.effects
    if spec.effect_files:
        names = {file.resolve(): name for name, file in list_installed().items()}
        files = [file.resolve() for file in spec.effect_files]
        content["effects_from"] = [names.get(file) or os.path.relpath(file, folder.resolve()) for file in files]
    if spec.thrust_to_weight is not None:
        content["thrust_to_weight"] = spec.thrust_to_weight
    if spec.actuator_file is not None:
        content["actuator"] = os.path.relpath(spec.actuator_file.resolve(), folder.resolve())
    if spec.controller != "map":
        content["controller"] = spec.controller
    if spec.robot.signals != NO_SIGNALS:
        content["signals"] = spec.robot.signals.as_dict()
    return content


def round_digits(value: float) -> float:
    """A number to six digits."""
    return float(f"{value:.6g}")


def name_file(file: Path, folder: Path) -> str:
    """How a twin in a folder names a file: shipped ones by name, others by a path relative to it."""
    return file.name if file.parent == models_dir().resolve() else os.path.relpath(file, folder.resolve())
