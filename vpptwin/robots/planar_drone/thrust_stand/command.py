"""`vpptwin identify` of thrust-stand runs: actuator.yaml and a page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import yaml
from rich.table import Table

from vpptwin.actuators.file import ActuatorFile
from vpptwin.drift.identify import check_out
from vpptwin.logs.read import expand_logs
from vpptwin.report.output import Pieces
from vpptwin.report.provenance import Provenance, trace_origin
from vpptwin.report.twin_file import round_digits
from vpptwin.robots.planar_drone.thrust_stand.actuator import Actuator, bound_90, identify
from vpptwin.robots.planar_drone.thrust_stand.bench import find_levels, read_bench
from vpptwin.robots.planar_drone.thrust_stand.report import render_page
from vpptwin.robots.planar_drone.thrust_stand.thrust_map import ThrustMap, inflow
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.system.files import check_own, check_target, write_files
from vpptwin.system.terminal import open_console, print_warnings


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
        intervals[name] = [*map(round_digits, bound_90(value, std))]

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
            "pitch_of_no_thrust_90": [*map(round_digits, bound_90(offset, std))],
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
        low, high = bound_90(value, std)
        table.add_row(name, f"{value:.5g}", f"{low:.5g} to {high:.5g}", unit)
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
