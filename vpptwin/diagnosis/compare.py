"""`vpptwin compare`: how well a twin predicts flights, with nothing fitted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from errno import EISDIR
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from vpptwin.diagnosis.diagnose import check_moving, open_held_out
from vpptwin.diagnosis.flights import list_starts, window_length
from vpptwin.diagnosis.holdout import HORIZONS_S, Score
from vpptwin.diagnosis.summary import tabulate_errors
from vpptwin.diagnosis.verdict import write_json
from vpptwin.errors import InputError
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.twin.spec import load_twin


def compare_logs(logs: Sequence[Path], twin: str, json: Path | None, topic_map: Path | None = None) -> Score:
    """Score a twin on whole logs and print (and write) the errors over the horizon.

    Raises:
        InputError: on bad logs, a bad twin, or a file that cannot be written.
    """
    spec = load_twin(twin)
    flights = [read_flight(log, topic_map) for log in logs]
    if json is not None:
        check_target(json)
    measurements = [read_measurements(spec, flight) for flight in flights]
    check_moving(measurements)
    starts = list_starts(measurements, window_length(spec))
    with threadpool_limits(limits=1, user_api="blas"), tqdm(unit=" steps", unit_scale=True, desc="compare") as bar:
        held_out = open_held_out(spec, measurements, starts, bar.update)
        score = held_out.score({})
    print_score(score, twin)
    if json is not None:
        content = {
            "logs": [str(log) for log in logs],
            "twin": twin,
            "samples": {"windows": len(held_out.short.windows)},
            "horizons_s": list(HORIZONS_S),
            "error": score.as_dict(),
        }
        write_json(content, json)
    return score


def check_target(path: Path) -> None:
    """Refuse a --json that cannot be written, before the work rather than after it."""
    probe = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot write --json {path} ({reason})", "a file in an existing folder", "choose another"
        ) from error


def print_score(score: Score, twin: str) -> None:
    """Print errors over the horizon."""
    console = Console(highlight=False)
    tables = tabulate_errors(score, None)
    table = Table(title=f"prediction error of twin {twin}", title_justify="left", show_edge=False)
    table.add_column("horizon")
    for entry in tables:
        table.add_column(escape(entry.title), justify="right")
    for i, (horizon, _, _) in enumerate(tables[0].rows):
        table.add_row(horizon, *[entry.rows[i][1] for entry in tables])
    console.print(table)
    console.print(f"chi² {score.chi2:.3g} (1 = noise floor)")
