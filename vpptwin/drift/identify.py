"""`vpptwin identify --parameters`: from flights to parameters of a twin."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import yaml
from rich.table import Table

from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.drift.free_flight import FlightFit, fit_flights, parse_parameters
from vpptwin.effects import SIGMAS_90
from vpptwin.report.provenance import Provenance, trace_origin
from vpptwin.report.sources import open_flights
from vpptwin.report.twin_file import extend_effects, name_twin, round_digits
from vpptwin.system.errors import InputError
from vpptwin.system.files import write_files
from vpptwin.system.progress import open_bar, tell_stage
from vpptwin.system.terminal import open_console, print_dropped, print_warnings
from vpptwin.twin.spec import TwinSpec, load_twin


def check_out(out: Path) -> None:
    """Refuse a name that is no YAML file's, or a folder that is not there."""
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"--out {out}", "a .yaml file", "e.g. --out actuator.yaml")
    if not out.parent.is_dir() or out.is_dir():
        raise InputError(f"--out {out} cannot be written", "a file in an existing folder", "choose another")


def identify_flights(
    logs: Sequence[Path], parameters: str, twin: str, out: Path, topic_map: Path | None = None,
    effects: Sequence[Path] = (),
) -> None:  # fmt: skip
    """Fit chosen effects of a twin to flights, write the twin with their values to `out`, and print what was found.

    Args:
        logs: flights.
        parameters: effect ids, separated by commas.
        twin: `nominal` or a twin YAML.
        out: twin YAML to write.
        topic_map: as of every command that reads logs.
        effects: Python files with effects of the user's own.

    Raises:
        InputError: if a log, the twin or an id is not what it should be, or `out` cannot be written.
    """
    check_out(out)
    spec = load_twin(twin, effects)
    chosen = parse_parameters(spec, parameters)
    flights = open_flights(logs, topic_map, spec.robot.signals.entries, apart=True)
    origin = trace_origin(sys.argv[1:], spec.name, [flight.path for flight in flights])
    with open_bar(desc="identify") as bar:
        found = fit_flights(spec, flights, chosen, partial(tell_stage, bar), bar.update)
    print_dropped({flight.name: flight.dropped for flight in flights})
    print_warnings(found.warnings)
    write_files({out: yaml.safe_dump(compose_twin_file(spec, found, origin, out), sort_keys=False, allow_unicode=True)})
    print_flight_fit(found, out)


def compose_twin_file(spec: TwinSpec, found: FlightFit, origin: Provenance, out: Path) -> dict[str, object]:
    """The twin with the fitted values, as YAML's plain data."""
    content = name_twin(spec, out.parent)
    content["effects"] = extend_effects(spec, {key: e.value for key, e in found.values.items()})
    intervals = {".".join(key): [round_digits(end) for end in e.interval] for key, e in found.values.items()}
    content["provenance"] = {
        "command": origin.command, "date": origin.date, "versions": origin.versions, "logs": origin.logs,
        "intervals_90_percent": intervals,
    }  # fmt: skip
    return content


def print_flight_fit(found: FlightFit, out: Path) -> None:
    """Print values, what can't be told apart, held-out errors, and where the twin lies."""
    console = open_console(110)
    table = Table("parameter", "value", "90 % interval", "in the twin", "unit", box=None)
    for key, e in found.values.items():
        low, high = e.interval
        table.add_row(".".join(key), f"{e.value:.4g}", f"{low:.4g} to {high:.4g}", f"{e.nominal:.4g}", e.unit)
    console.print(table)
    for first, second, likeness in found.alike:
        pair = f"{'.'.join(first)} and {'.'.join(second)}"
        console.print(f"not separable: {pair}, errors correlate by {likeness:+.2f}", soft_wrap=True)
    for key in found.vague:
        console.print(f"hardly identifiable from these logs: {'.'.join(key)}", soft_wrap=True)
    if found.drag is not None:
        low, high = found.drag.k_d - SIGMAS_90 * found.drag.std, found.drag.k_d + SIGMAS_90 * found.drag.std
        console.print(
            f"air drag by least squares on accelerations, as the paper has it: {found.drag.k_d:.4g} N s²/m² "
            f"({low:.4g} to {high:.4g}, {found.drag.samples} samples)",
            soft_wrap=True,
        )
    fitted, held_out = found.windows
    chi2 = f"chi² {found.before.chi2:.2f} -> {found.after.chi2:.2f}"
    console.print(f"{fitted} windows fitted; on {held_out} held out {chi2}")
    if found.before.position_rmse_m is not None and found.after.position_rmse_m is not None:
        errors = (
            f"{1000 * before:.1f} -> {1000 * after:.1f} mm after {horizon:g} s"
            for horizon, before, after in zip(HORIZONS_S, found.before.position_rmse_m, found.after.position_rmse_m)
        )
        console.print(f"position error there: {', '.join(errors)}", soft_wrap=True)
    console.print(f"twin: {out}", soft_wrap=True)
