"""`vpptwin diagnose`: diagnose, write the folder, print what was found."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from signal import Signals

from vpptwin.logs.flight import Flight
from vpptwin.report.export import name_files
from vpptwin.report.output import Pieces, give_json, stage_results
from vpptwin.report.result import (
    REPORT,
    SUGGESTED,
    TWIN,
    VERDICT,
    Result,
    judge_logs,
    list_stale,
    parse_fixed,
    read_causes,
    settle_effects,
)
from vpptwin.report.sources import list_logs, open_twin
from vpptwin.report.terminal import print_summary
from vpptwin.system.deadline import Deadline
from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.files import STDOUT
from vpptwin.system.progress import tell_wait
from vpptwin.system.signals import defer_signal, write_line


def diagnose_logs(
    logs: Sequence[Path], twin: str, out: Path, topic_map: Path | None = None, json: Path | None = None,
    effects: Sequence[Path] = (), force: bool = False, rrd: bool = False, device: str | None = None,
    only: Sequence[str] = (), deadline: Deadline | None = None, without: Sequence[str] = (), fix: Sequence[str] = (),
    revised: Path | None = None,
) -> Result:  # fmt: skip
    """Diagnose logs; write verdict, report, extended twin and the twins' predictions into `out`; print a summary.

    Args:
        logs: flight logs.
        twin: `nominal` or a twin YAML.
        out: folder of results.
        topic_map: YAML that renames topics of other people's bags.
        json: another place for the verdict; `-` prints it to standard output instead of the summary.
        effects: Python files with effects of the user's own.
        force: overwrite files in `out` that vpptwin did not write, too.
        rrd: write the predictions for Rerun as well.
        device: where simulations run, as `diagnose` has it.
        only: effects that are candidates, likewise.
        without: effects that are no candidates.
        fix: effects that are known, each `EFFECT=VALUE`.
        revised: folder of a diagnosis whose causes are taken for granted but for those `without`; logs and twin are
            its own where none are named.
        deadline: when to stop the search; the first signal that comes stops it, too.

    Raises:
        InputError: on bad logs, a bad twin or device, or a folder that cannot be written; old results are left as they
            were.
    """
    causes = None
    if revised is not None:
        before, named, causes = read_causes(revised)
        logs, twin = logs or before, named if twin == "nominal" else twin
    spec = settle_effects(open_twin(twin, effects), without, parse_fixed(fix))
    if causes is not None:
        causes = [cause for cause in causes if cause not in spec.settled]
        only = only or causes
        if not causes:
            raise InputError(f"--from {revised} without any cause", "one that is left", "leave --from out")
    flown = list_logs(logs)
    if rrd:
        load_extra("rerun", "--rrd")  # before the work
    read = [Path(log) for log in flown if not isinstance(log, Flight)]
    files = [VERDICT, REPORT, TWIN, SUGGESTED, *name_files(read), *(name_files(read, ".rrd") if rrd else ())]
    deadline = deadline or Deadline()
    with stage_results(out, files, [*list_stale(out), *files], force) as folder, defer_signal(partial(stop, deadline)):
        found = judge_logs(flown, spec, topic_map, effects, True, device, only, deadline, causes)
        kept = found.write(folder, out)
    result = complete(found, kept, out, rrd)
    for line in result.lost:
        print(f"vpptwin: {line}", file=sys.stderr)
    if json is not None:
        give_json(result.verdict.as_dict(), json)
    if json != STDOUT:
        print_summary(result.verdict, result.summary, out, [name for name in files if (out / name).exists()])
    return result


def stop(deadline: Deadline, number: int) -> bool:
    """Stop at a signal with what was found so far, and say so; whether there is anything."""
    kept = deadline.interrupt(number)
    told = "what was found so far is kept; once more ends it" if kept else "nothing was found yet; old files stay"
    write_line(f"{Signals(number).name}: {told}")
    return kept


def complete(found: Result, kept: Result, out: Path, rrd: bool) -> Result:
    """Draw what was `found`, and write all files again with that; what was `kept` stays where that cannot be."""
    with tell_wait("drawing"):
        drawn = found.draw()
    pieces = Pieces()

    def save() -> Result:
        with stage_results(out, drawn.files, force=True) as folder:
            return drawn.write(folder, out, rrd)

    return pieces.attempt("pictures and predictions", save, kept).tell(pieces.lost)
