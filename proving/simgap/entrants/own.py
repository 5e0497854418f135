"""vpptwin as its users run it: `vpptwin diagnose` in a process of its own, on the MCAP files, with its defaults."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from proving.simgap.entrants.corrections import Correction
from proving.simgap.entrants.fits import draw_sizes
from proving.simgap.scores import UNKNOWN
from proving.simgap.session import Session

LIMIT = "8m"
"""After so long it says what it has found so far."""
SILENT = 3e-4
"""Confidence of a cause of which a verdict says nothing; of public sessions."""
SECOND = ("rest", "velocity")
"""Second parameters that the common simulator knows."""


def write_twin(session: Session) -> str:
    """The twin YAML of a session: what its columns are, and what is known beside the model."""
    signals: dict[str, dict[str, Any]] = {}
    for column in session.columns.values():
        if column.role in ("position", "velocity"):
            signals.setdefault("joints", {})[column.of] = column.topic
        elif column.role == "command":
            signals.setdefault("actuators", {})[column.of] = column.topic
        elif column.role == "x":
            signals["bodies"] = {body_of(session): column.topic}
        elif column.role == "wx":
            signals["sites"] = {column.of: column.topic}
    content: dict[str, Any] = {"model": "rig.xml", "signals": signals}
    if session.known:
        content["effects"] = {cause: {session.causes[cause].parameter: size} for cause, size in session.known.items()}
    return yaml.safe_dump(content)


def write_files(session: Session, folder: Path) -> Path:
    """Write the twin YAML and its model; returns the former."""
    (folder / "rig.xml").write_text(session.model)
    (folder / "twin.yaml").write_text(write_twin(session))
    return folder / "twin.yaml"


def body_of(session: Session) -> str:
    """The one free body."""
    return next(name.split(".")[0] for name in session.causes if name.endswith(".mass"))


def diagnose(session: Session, home: Path) -> tuple[dict[str, float], dict[str, list[float]], list[Correction], str]:
    """Log confidences of causes and rivals, their sizes, the corrections of those with half or more, and a note.

    Raises:
        RuntimeError: where it ends with an error, whose last line is told.
    """
    with TemporaryDirectory() as folder:
        twin, out = write_files(session, Path(folder)), Path(folder) / "out"
        logs = sorted(map(str, home.glob("run_*.mcap")))
        command = [sys.executable, "-m", "vpptwin", "diagnose", *logs, "--twin", str(twin), "--out", str(out)]
        ran = subprocess.run([*command, "--limit", LIMIT, "-y"], capture_output=True, text=True, check=False)
        if not (out / "verdict.json").exists():
            raise RuntimeError(" | ".join(ran.stderr.strip().splitlines()[-2:]) or f"ended with {ran.returncode}")
        verdict = json.loads((out / "verdict.json").read_text())
    shares: dict[str, float] = {}
    sizes: dict[str, list[float]] = {}
    corrections, rng, lost = [], np.random.default_rng(0), 0.0
    for cause in verdict["causes"]:
        for told in (cause, *cause["also_explained_by"]):
            name, value, std, other = read_size(told, session)
            if name not in session.causes:
                lost = max(lost, told["confidence"])
                continue
            shares[name] = max(shares.get(name, 0.0), told["confidence"])
            if value is not None and name not in sizes:
                sizes[name] = draw_sizes(rng, value, std)
            if told is cause and value is not None and cause["confidence"] >= 0.3:
                corrections.append(Correction(name, value, other))
    misfit = verdict["misfit"] or {}
    for name in misfit.get("within", []):  # what makes most of an error without leaving its build tolerance
        shares.setdefault(name, 0.5 * misfit["explained"] / len(misfit["within"]))
    evidence = {name: float(np.log(max(shares.get(name, 0.0), SILENT))) for name in session.causes}
    if verdict["unexplained"]["significant"] or lost:
        evidence[UNKNOWN] = float(np.log(max(lost, 0.5)))
    return evidence, sizes, corrections, str(verdict.get("stopped") or "")


def read_size(told: dict[str, Any], session: Session) -> tuple[str, float | None, float, float]:
    """Id in this session, size, its standard deviation and second number of a cause or rival."""
    name, parameters = told["effect"], told.get("parameters") or {}
    axes = [axis for axis in parameters if f"{name}:{axis}" in session.causes]
    if axes:
        axis = max(axes, key=lambda a: abs(parameters[a]["value"]) / max(parameters[a].get("std") or 1e-9, 1e-9))
        return f"{name}:{axis}", parameters[axis]["value"], parameters[axis].get("std") or 0.0, 0.0
    if not parameters:
        return name, None, 0.0, 0.0
    first = parameters.get(session.causes[name].parameter if name in session.causes else "") or next(
        iter(parameters.values())
    )
    other = next((parameters[p]["value"] for p in SECOND if p in parameters), 0.0)
    return name, first["value"], first.get("std") or 0.0, other
