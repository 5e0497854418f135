"""`vpptwin diagnose`: read, diagnose, write the folder, print what was found."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from json import loads
from pathlib import Path

from vpptwin.diagnosis.evidence.noise import find_noise_floor
from vpptwin.diagnosis.judgement.diagnose import Diagnosis, diagnose
from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.diagnosis.report.export import name_files, write_prediction
from vpptwin.diagnosis.report.output import STDOUT, check_target, give_json, stage_results
from vpptwin.diagnosis.report.page import render_report
from vpptwin.diagnosis.report.pictures import draw_pictures
from vpptwin.diagnosis.report.prediction import predict_flight
from vpptwin.diagnosis.report.provenance import Provenance, trace_origin
from vpptwin.diagnosis.report.ranking import rank_suspects
from vpptwin.diagnosis.report.summary import Summary, summarise
from vpptwin.diagnosis.report.terminal import print_summary
from vpptwin.diagnosis.report.twin_file import compose_twin, extend_effects
from vpptwin.estimation.measurements import read_measurements
from vpptwin.files import write_json, write_whole
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flights
from vpptwin.progress import open_bar, tell_stage
from vpptwin.twin.spec import TwinSpec, load_twin

VERDICT, REPORT, TWIN = "verdict.json", "report.html", "twin.yaml"


def diagnose_logs(
    logs: Sequence[Path], twin: str, out: Path, topic_map: Path | None = None, json: Path | None = None,
    effects: Sequence[Path] = (),
) -> Verdict:  # fmt: skip
    """Diagnose logs; write verdict, report, extended twin and the twins' predictions into `out`; print a summary.

    Args:
        logs: flight logs.
        twin: `nominal` or a twin YAML.
        out: folder of results.
        topic_map: YAML that renames topics of other people's bags.
        json: another place for the verdict; `-` prints it to standard output instead of the summary.
        effects: Python files with effects of the user's own.

    Raises:
        InputError: on bad logs, a bad twin, or a folder that cannot be written; old results are left as they were.
    """
    arguments = ["diagnose", *map(str, logs), "--twin", twin, "--out", str(out)]
    arguments += ["--topic-map", str(topic_map)] if topic_map is not None else []
    arguments += [part for file in effects for part in ("--effects", str(file))]
    spec = load_twin(twin, effects)
    flights = read_flights(logs, topic_map, spec.robot.signals.entries)
    if json is not None:
        check_target(json)
    files = [VERDICT, REPORT, TWIN, *name_files(logs)]
    with stage_results(out, files, list_stale(out)) as folder, open_bar(desc="diagnose") as bar:
        diagnosis = diagnose(spec, flights, partial(tell_stage, bar), bar.update)
        tell_stage(bar, "writing the report")
        origin = trace_origin(arguments, spec.name, logs)
        summary = write_results(folder, out, spec, flights, diagnosis, origin)
    if json is not None:
        give_json(diagnosis.verdict.as_dict(), json)
    if json != STDOUT:
        print_summary(diagnosis.verdict, summary, out, files)
    return diagnosis.verdict


def write_results(
    folder: Path, out: Path, spec: TwinSpec, flights: Sequence[Flight], diagnosis: Diagnosis, origin: Provenance
) -> Summary:
    """Write all results of a diagnosis into `folder`, to lie in `out` in the end; returns the verdict in sentences."""
    verdict = diagnosis.verdict
    effects = extend_effects(spec, diagnosis.values)
    twins = [spec, spec.with_effects(effects)] if verdict.causes else [spec]
    predictions = [predict_flight(twins, flight) for flight in flights]
    traced = {"command": origin.command, "date": origin.date, "twin": origin.twin}
    for prediction, name in zip(predictions, name_files([f.path for f in flights]), strict=True):
        write_prediction(folder / name, spec, prediction, {"log": str(prediction.flight.path)} | traced)
    noise = find_noise_floor([read_measurements(spec, flight) for flight in flights])
    meanings = {effect.id: effect.summary for effect in spec.catalogue}
    summary = summarise(verdict, noise, meanings)
    ranking = rank_suspects(diagnosis.ranking, verdict)
    pictures = draw_pictures(diagnosis, predictions, noise)
    preflight = [flight.describe() for flight in diagnosis.preflight]
    write_json(verdict.as_dict(), folder / VERDICT)
    write_whole(folder / TWIN, compose_twin(spec, effects, verdict, origin, out))
    write_whole(folder / REPORT, render_report(verdict, summary, ranking, pictures, preflight, origin, meanings))
    return summary


def list_stale(out: Path) -> list[str]:
    """Predictions that an earlier diagnosis in the same folder wrote, by the logs that its verdict names."""
    try:
        verdict = loads((out / VERDICT).read_text(encoding="utf-8"))
        return name_files([Path(log) for log in verdict["logs"]])
    except (OSError, ValueError, KeyError, TypeError):
        return []
