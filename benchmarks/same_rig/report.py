"""What a benchmark ran on, and its table."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("mujoco", "numpy", "numba", "torch", "torchrl", "tensordict", "gymnasium", "mujoco-mjx", "jax", "vpptwin")


def describe_machine() -> dict:
    """Processor, cores, system, processes that wanted a core in the last minute, versions."""
    cpu = [
        line.split(":")[1].strip() for line in read_text("/proc/cpuinfo").splitlines() if line.startswith("model name")
    ]
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = None
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    ).stdout.strip()
    machine = {
        "cpu": cpu[0] if cpu else platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "load_average": os.getloadavg()[0],
    }
    return {"machine": machine, "versions": versions, "commit": commit or None}


def read_text(path: str) -> str:
    """Text of a file, empty where there is none."""
    return Path(path).read_text() if Path(path).is_file() else ""


def format_table(rows: Sequence[dict]) -> str:
    """The table and its notes, in Markdown."""
    lines = [
        "| implementation | environments | worker processes | control steps/s | µs per physics step | ratio to raw |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    notes = []
    for row in rows:
        if "control_steps_per_s" in row:
            ratio = f"{row['ratio_to_raw']:.3f}" if "ratio_to_raw" in row else "-"
            lines.append(
                f"| {row['title']} | {row['environments']} | {row['workers'] or 'none'} "
                f"| {row['control_steps_per_s']:,.0f} | {row['us_per_physics_step']:.2f} | {ratio} |"
            )
            off = f"; {1e3 * row['position_error_m']:.2g} mm from the twin" if row["agrees"] else ""
            notes.append(f"- {row['title']}: {row['leaves_out']}{off}")
        else:
            notes.append(f"- {row['title']}: not timed, {row['skipped']}")
    return "\n".join([*lines, "", *notes])
