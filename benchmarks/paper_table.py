"""The paper's table and training curves, its four setups side by side, and what each of its ingredients is worth.

    python benchmarks/paper_table.py --seeds 5 --json benchmarks/results/paper_table.json --pictures docs/pictures
    python benchmarks/paper_table.py --variants All "no curriculum" --seeds 3 --json ablations.json
    python benchmarks/paper_table.py --options preset=paper --variants All --seeds 5 --jobs 1 --json paper.json
    python benchmarks/paper_table.py --report benchmarks/results/paper_table.json            (the table again)

Every run is `vpptwin train task=flip` and `vpptwin evaluate` over 1000 tracks with sensor noise, wide random initial
states and twins drawn from the catalogue's priors; the flights that choose a run's checkpoint are others. Runs are kept
in --folder and, once they are evaluated, in --json: an interrupted campaign goes on where it was, and one of the same
options takes what that file has and adds what it lacks.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from same_rig.report import describe_machine  # noqa: E402
from training.campaign import SETUPS, VARIANTS, Run, run_campaign  # noqa: E402

from vpptwin.system.errors import InputError  # noqa: E402
from vpptwin.system.files import write_whole  # noqa: E402
from vpptwin.viz.plots.curves import draw_curves  # noqa: E402
from vpptwin.viz.plots.plot import write_story  # noqa: E402

PAPER = {
    "VA": (0.035, 0.082, 0.08),
    "TA": (0.038, 0.073, 0.08),
    "PI": (0.022, 0.034, 0.06),
    "All": (0.017, 0.023, 0.02),
}
"""The paper's row of each setup: position error, inverted position error [m], fail rate."""


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(SETUPS))
    parser.add_argument("--seeds", type=int, default=5, help="seeds 0, 1, ... of every variant")
    parser.add_argument("--tracks", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side; more than one makes times meaningless")
    parser.add_argument("--options", nargs="*", default=[], help="overrides for every run, e.g. preset=paper")
    parser.add_argument("--folder", type=Path, default=Path("runs/paper_table"), help="where runs are kept")
    parser.add_argument("--json", type=Path, help="write results here")
    parser.add_argument("--pictures", type=Path, help="folder for training_curves.svg of --variants")
    parser.add_argument("--report", type=Path, nargs="+", help="print tables of earlier results, train nothing")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign, or report on an earlier one."""
    args = parse(argv)
    if args.report:
        results = [result for file in args.report for result in json.loads(file.read_text())["runs"]]
    else:
        args.folder.mkdir(parents=True, exist_ok=True)
        threads = [f"sim_threads={max(2 // args.jobs, 1)}"]
        options = ("task=flip", *threads, *args.options)
        folder = args.folder.resolve()
        runs = [Run(variant, seed, folder, options) for seed in range(args.seeds) for variant in args.variants]
        try:
            known = read_known(args.json, args.options, args.tracks)
        except InputError as error:
            print(error, file=sys.stderr)
            return 2
        about = {"options": args.options, "jobs": args.jobs} | describe_machine()

        def keep(results: list[dict]) -> None:
            if args.json:
                date = {"date": datetime.now(UTC).isoformat(timespec="seconds")}
                write_whole(args.json, json.dumps(date | about | {"runs": results}) + "\n")

        results = run_campaign(runs, args.jobs, args.tracks, known, keep)
    print(format_table(results))
    if args.pictures:
        curves = {name: [r["curve"] for r in results if r["variant"] == name] for name in args.variants}
        curves = {name: runs for name, runs in curves.items() if runs}
        write_story(draw_curves(curves, "Training curves"), args.pictures / "training_curves.svg")
    return 0


def read_known(file: Path | None, options: list[str], tracks: int) -> list[dict]:
    """Runs that a results file has; none without such a file.

    Raises:
        InputError: if it is of other options or evaluations.
    """
    if file is None or not file.exists():
        return []
    content = json.loads(file.read_text())
    found = {run["tracks"] for run in content["runs"]} - {tracks}
    if content["options"] != options or found:
        other = f"--options {' '.join(content['options'])}" if content["options"] != options else f"--tracks {found}"
        raise InputError(f"{file} is of {other}", "results of this campaign", "name another --json")
    return content["runs"]


def format_table(results: list[dict]) -> str:
    """Median and worst over seeds of every variant, the paper's figure beside it, as Markdown."""
    head = "| | seeds | position error [m] | inverted [m] | fail rate | success (5 cm) | full turns | paper |"
    lines = [head, "|" + "---|" * 8]
    for variant in dict.fromkeys(result["variant"] for result in results):
        rows = [result for result in results if result["variant"] == variant]
        upright, inverted = ([r[f"{k}_error_m"]["mean"] for r in rows] for k in ("upright", "inverted"))
        turns = [r["full_turns"]["made"] / max(r["full_turns"]["asked"], 1) for r in rows]
        paper = PAPER.get(variant)
        cells = [
            variant, str(len(rows)), show(upright, ".4f"), show(inverted, ".4f"),
            show([r["fail_rate"] for r in rows], ".1%"), show([r["success_share"] for r in rows], ".1%", worst=min),
            show(turns, ".0%", worst=min), "" if paper is None else f"{paper[0]} / {paper[1]} / {paper[2]:.0%}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def show(values: list[float | None], form: str, worst: object = max) -> str:
    """Median and, in brackets, the worst; flights that all failed have no error."""
    known = [value for value in values if value is not None]
    if not known:
        return "none left"
    assert callable(worst)
    return f"{statistics.median(known):{form}} ({worst(known):{form}})"


if __name__ == "__main__":
    sys.exit(main())
