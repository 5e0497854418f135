"""`vpptwin compare`: how well a twin predicts flights, with nothing fitted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.evidence.flights import HORIZONS_S, choose_window, list_starts
from vpptwin.diagnosis.evidence.noise import find_noise_floor
from vpptwin.diagnosis.judgement.diagnose import check_moving, open_held_out
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.diagnosis.report.error_table import tabulate_errors
from vpptwin.diagnosis.report.output import STDOUT, check_target, give_json
from vpptwin.diagnosis.report.terminal import print_errors
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flights
from vpptwin.progress import open_bar
from vpptwin.terminal import open_console
from vpptwin.twin.spec import load_twin


def compare_logs(
    logs: Sequence[Path], twin: str, json: Path | None, topic_map: Path | None = None, effects: Sequence[Path] = ()
) -> Score:
    """Score a twin on whole logs and print (and write) the errors over the horizon.

    Raises:
        InputError: on bad logs, a bad twin, or a file that cannot be written.
    """
    spec = load_twin(twin, effects)
    flights = read_flights(logs, topic_map, spec.robot.signals.entries)
    if json is not None:
        check_target(json)
    measurements = [read_measurements(spec, flight) for flight in flights]
    check_moving(measurements)
    spec, measurements = choose_window(spec, measurements)
    starts = list_starts(measurements, spec.robot.window)
    with threadpool_limits(limits=1, user_api="blas"), open_bar(desc="compare") as bar:
        held_out = open_held_out(spec, measurements, starts, bar.update)
        score = held_out.score({})
    if json != STDOUT:
        console = open_console()
        tables = tabulate_errors(score, None, find_noise_floor(measurements))
        print_errors(console, f"prediction error of twin {twin}", tables)
        console.print(
            f"whole-log chi² {score.chi2:.3g} (1 = noise floor; that of `diagnose` is of held-out windows only)"
        )
    if json is not None:
        content = {
            "logs": [str(log) for log in logs], "twin": twin, "samples": {"windows": len(held_out.short.windows)},
            "horizons_s": list(HORIZONS_S), "error": score.as_dict(),
        }  # fmt: skip
        give_json(content, json)
    return score
