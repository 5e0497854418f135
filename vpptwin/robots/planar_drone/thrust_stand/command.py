"""`vpptwin identify`: from thrust-stand runs to actuator.yaml and a page, or from flights to parameters of a twin."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import yaml
from rich.table import Table

from vpptwin.actuators.file import ActuatorFile
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.drift.free_flight import FlightFit, fit_flights, parse_parameters
from vpptwin.effects import SIGMAS_90
from vpptwin.logs.read import expand_logs
from vpptwin.report.output import Pieces
from vpptwin.report.provenance import Provenance, trace_origin
from vpptwin.report.sources import open_flights
from vpptwin.report.twin_file import extend_effects, name_twin, round_digits
from vpptwin.robots.planar_drone.thrust_stand.actuator import Actuator, identify
from vpptwin.robots.planar_drone.thrust_stand.bench import find_levels, read_bench
from vpptwin.robots.planar_drone.thrust_stand.report import render_page
from vpptwin.robots.planar_drone.thrust_stand.thrust_map import ThrustMap, inflow
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.system.files import check_own, check_target, write_files
from vpptwin.system.progress import open_bar, tell_stage
from vpptwin.system.terminal import open_console, print_warnings
from vpptwin.twin.spec import TwinSpec, load_twin


def identify_bench(
    logs: Sequence[Path], out: Path, topic_map: Path | None = None, vehicle: Path | None = None, force: bool = False
) -> None:
    """Identify an actuator, write `out` and a page beside it, and print what was found.

    Args:
        logs: thrust-stand runs.
        out: YAML to write; the page is named like it, with .html.
        topic_map: as of every command that reads logs.
        vehicle: whose governed speed and inner rate hold; the shipped one by default.
        force: overwrite a page that vpptwin did not write, too.

    Raises:
        InputError: if a log lacks something, or a file cannot be written; nothing is left behind then.
    """
    check_out(out)
    page = out.with_suffix(".html")
    check_target(page)
    if not force:
        check_own([page])
    believed = load_vehicle(vehicle)
    stands = expand_logs(logs)
    origin = trace_origin(sys.argv[1:], "", stands)
    runs = [read_bench(log, believed, topic_map) for log in stands]
    found = identify(runs, find_levels(runs))
    print_warnings(warning for run in runs for warning in run.warnings)
    content = compose_file(found, believed, origin)
    ActuatorFile.model_validate(content)
    pieces = Pieces()
    told = pieces.attempt(page.name, partial(render_page, found, runs, origin), "")
    actuator = {out: yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120)}
    write_files({**actuator, page: told} if told else actuator)
    if not told:
        page.unlink(missing_ok=True)  # it is of another actuator
    print_warnings(pieces.lost)
    print_found(found, out, page if told else None)


def check_out(out: Path) -> None:
    """Refuse a name that is no YAML file's, or a folder that is not there."""
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"--out {out}", "a .yaml file", "e.g. --out actuator.yaml")
    if not out.parent.is_dir() or out.is_dir():
        raise InputError(f"--out {out} cannot be written", "a file in an existing folder", "choose another")


def name_coefficients(thrust: ThrustMap, speed: float) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of a vehicle's keys for a map, at a governed speed [rad/s]."""
    scale = (speed / thrust.reference) ** (thrust.candidate.power - 1)
    if thrust.candidate.shape is inflow:
        p, q = abs(thrust.values)
        return {"k_t": (p * scale, thrust.std[0] * scale), "inflow": (q * scale**0.5, thrust.std[1] * scale**0.5)}
    names = ("k_t", "k_t2", "k_t3")
    return {name: (v * scale, s * scale) for name, v, s in zip(names, thrust.values, thrust.std)}


def compose_file(found: Actuator, vehicle: Vehicle, origin: Provenance) -> dict[str, object]:
    """The content of actuator.yaml."""
    parts: dict[str, dict[str, float]] = {"rotor": {}, "motor": {}, "servo": {}}
    intervals: dict[str, list[float]] = {}

    def add(name: str, value: float, std: float) -> None:
        section, key = name.split(".")
        parts[section][key] = round_digits(value)
        intervals[name] = [round_digits(value + side * SIGMAS_90 * std) for side in (-1.0, 1.0)]

    for name, (value, std) in name_coefficients(found.thrust, vehicle.rotor.speed).items():
        add(f"rotor.{name}", value, std)
    if found.thrust.candidate.power == 2:
        parts["rotor"]["thrust_power"] = 2.0
    for constant in found.constants:
        add(constant.name, max(constant.value, 0.0), constant.std)
    offset, std = found.thrust.offset, found.thrust.offset_std
    return {
        **parts,
        "intervals_90": intervals,
        "thrust_map": {
            "form": found.thrust.candidate.name,
            "pitch_of_no_thrust_rad": round_digits(offset),
            "pitch_of_no_thrust_90": [round_digits(offset + side * SIGMAS_90 * std) for side in (-1.0, 1.0)],
            "held_out_error_n": {m.candidate.name: round_digits(m.held_out) for m in found.maps},
        },
        "held_out": {
            h.what: {"rms": round_digits(h.error), "of": round_digits(h.scale), "unit": h.unit} for h in found.held_out
        },
        "notes": [f"{c.name}: {c.note}" for c in found.constants if c.note],
        "provenance": {
            "command": origin.command, "date": origin.date, "versions": origin.versions, "logs": origin.logs,
        },
    }  # fmt: skip


def print_found(found: Actuator, out: Path, page: Path | None) -> None:
    """Print constants with their intervals, the thrust maps, and where the files lie."""
    console = open_console(110)
    table = Table("constant", "value", "90 % interval", "unit", box=None)
    rows = [(f"rotor.{n}", v, s, "") for n, (v, s) in name_coefficients(found.thrust, found.thrust.reference).items()]
    for name, value, std, unit in [*rows, *((c.name, c.value, c.std, c.unit) for c in found.constants)]:
        ends = [value + side * SIGMAS_90 * std for side in (-1.0, 1.0)]
        table.add_row(name, f"{value:.5g}", f"{ends[0]:.5g} to {ends[1]:.5g}", unit)
    console.print(table)
    console.print(f"thrust map: {found.thrust.candidate.name}; held-out errors:")
    for fitted in sorted(found.maps, key=lambda m: m.held_out):
        console.print(f"  {fitted.candidate.name}: {1000.0 * fitted.held_out:.1f} mN")
    for held in found.held_out:
        console.print(f"{held.what}: {held.error:.3g} {held.unit} RMS, of {held.scale:.3g}")
    for constant in found.constants:
        if constant.note:
            console.print(f"{constant.name} {constant.note}")
    console.print(f"{out} (a twin YAML refers to it by `actuator:`){f', {page}' if page else ''}", soft_wrap=True)


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
        console.print(f"can't be told apart: {pair}, whose errors correlate by {likeness:+.2f}", soft_wrap=True)
    for key in found.vague:
        console.print(f"hardly seen in these flights: {'.'.join(key)}", soft_wrap=True)
    if found.drag is not None:
        low, high = (found.drag.k_d + side * SIGMAS_90 * found.drag.std for side in (-1.0, 1.0))
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
