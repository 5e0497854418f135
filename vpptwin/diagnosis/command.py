"""`vpptwin diagnose`: read, diagnose, write the folder, print what was found."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

import yaml
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm

from vpptwin import __version__
from vpptwin.diagnosis.diagnose import Diagnosis, diagnose
from vpptwin.diagnosis.report import render_report
from vpptwin.diagnosis.summary import describe_cause, describe_leftover, describe_rivals, headline, tabulate_errors
from vpptwin.diagnosis.verdict import Verdict, write_json, write_text
from vpptwin.effects import find_effect
from vpptwin.errors import InputError
from vpptwin.logs.read import read_flight
from vpptwin.resources import models_dir
from vpptwin.twin.spec import TwinSpec, load_twin


def diagnose_logs(logs: Sequence[Path], twin: str, out: Path, topic_map: Path | None = None) -> Verdict:
    """Diagnose logs and write verdict.json, report.html and twin.yaml into `out`.

    Raises:
        InputError: on bad logs, a bad twin, or a folder that cannot be written; nothing is left behind then.
    """
    spec = load_twin(twin)
    flights = [read_flight(log, topic_map) for log in logs]
    made = open_folder(out)
    try:
        # The delay draws nothing before the first step, so that logs that are refused leave one line and no bar.
        with tqdm(unit=" steps", unit_scale=True, desc="diagnose", dynamic_ncols=True, delay=1e-6) as bar:
            diagnosis = diagnose(spec, flights, bar.set_postfix_str, bar.update)
        # Everything is rendered before anything is written: the three files always belong together.
        extended, report = write_twin(spec, diagnosis, logs, out), render_report(diagnosis)
        write_json(diagnosis.verdict.as_dict(), out / "verdict.json")
        write_text(extended, out / "twin.yaml")
        write_text(report, out / "report.html")
    except BaseException:
        for folder in made:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        raise
    print_verdict(diagnosis.verdict, out)
    return diagnosis.verdict


def open_folder(out: Path) -> list[Path]:
    """Make sure that a folder exists and can be written; return the folders made for it, innermost first."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".write-test.{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot write to {out} ({reason})", "a folder to write to", "choose another --out") from error
    return made


def write_twin(spec: TwinSpec, diagnosis: Diagnosis, logs: Sequence[Path], out: Path) -> str:
    """The extended twin as YAML, with where it comes from."""
    effects = {effect: dict(values) for effect, values in spec.effects.items()}
    for (effect, parameter), value in diagnosis.values.items():
        bounds, rounded = find_effect(spec.catalogue, effect).parameter(parameter), float(f"{value:.6g}")
        # Rounding may not carry a value at its bound over it: the file would be refused.
        effects.setdefault(effect, {})[parameter] = rounded if bounds.low <= rounded <= bounds.high else float(value)
    content: dict[str, object] = {"model": name_file(spec.model_file, out)}
    if spec.vehicle_file is not None:
        content["vehicle"] = name_file(spec.vehicle_file, out)
    content["effects"] = effects
    if spec.signals is not None:
        content["signals"] = spec.signals.model_dump()
    intervals = {
        f"{cause.effect}.{name}": [float(f"{e.value - 1.645 * e.std:.6g}"), float(f"{e.value + 1.645 * e.std:.6g}")]
        for cause in diagnosis.verdict.causes
        for name, e in cause.parameters.items()
    }
    content["provenance"] = {
        "vpptwin": __version__,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "diagnosed_twin": spec.name,
        "logs": {str(log): sha256(log.read_bytes()).hexdigest() for log in logs if log.is_file()},
        "intervals_90_percent": intervals,
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def name_file(file: Path, out: Path) -> str:
    """How a twin in `out` names a file: shipped ones by name, others by a path relative to it."""
    return file.name if file.parent == models_dir().resolve() else os.path.relpath(file, out.resolve())


def print_verdict(verdict: Verdict, out: Path) -> None:
    """Print the verdict and where to look."""
    console = Console(highlight=False)
    console.print()
    console.print(headline(verdict), style="bold", markup=False)
    for cause in verdict.causes[1:]:
        console.print(describe_cause(cause), markup=False)
    for cause in verdict.causes:
        console.print(describe_rivals(cause) + ".", markup=False)
    console.print(describe_leftover(verdict), markup=False)
    table = Table(title=f"held-out error, {verdict.held_out_windows} windows", title_justify="left", show_edge=False)
    tables = tabulate_errors(verdict.before, verdict.after)
    table.add_column("horizon")
    for entry in tables:
        table.add_column(escape(f"{entry.title}\nbefore"), justify="right")
        table.add_column("\nafter", justify="right")
    for i, (horizon, _, _) in enumerate(tables[0].rows):
        table.add_row(horizon, *[cell for entry in tables for cell in entry.rows[i][1:]])
    console.print(table)
    console.print(f"chi² {verdict.before.chi2:.3g} → {verdict.after.chi2:.3g} (1 = noise floor)")
    for name, text in (("report.html", "report"), ("verdict.json", "verdict"), ("twin.yaml", "extended twin")):
        console.print(f"{text}: {out / name}", markup=False, soft_wrap=True)
