"""The paper's thrust-tracking figure: the fitted map alone against the adaptive actuator controller.

    python benchmarks/thrust_tracking.py
    python benchmarks/thrust_tracking.py --stands 32 --seed 1 --json tracking.json --picture docs/pictures

On the thrust stand of the independent simulation (proving/drone, no physics shared with vpptwin): 0.02 rad of play in
every linkage, its zero up to 0.02 rad off, a map of drag that is 20 % off, sensor noise, tolerances. The controllers
are told nothing. Last, what the adaptive one costs inside the twin, as a ratio.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from same_rig.report import describe_machine  # noqa: E402
from tqdm import tqdm  # noqa: E402

from proving.thrust_tracking import COMMANDS, NOMINAL, Track, draw_stands, track_thrust  # noqa: E402
from vpptwin.twin import Twin, load_twin  # noqa: E402
from vpptwin.viz.plots.figure import INK, name_axes, open_figure, write_svg  # noqa: E402
from vpptwin.viz.plots.palette import BLUE, VERMILION  # noqa: E402

DURATION, LEARNED, HOLD = 12.0, 2.0, 5.0
"""Of each run; of learning; until the command of "held" has settled [s]."""
METHODS = {"map alone": False, "adaptive": True}


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stands", type=int, default=16, help="with two rotors each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=15, help="of the measurement of cost")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--picture", type=Path, help="folder for thrust_tracking.svg")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the stands, print the table."""
    options = parse(argv)
    if min(options.stands, options.rounds) < 1 or options.seed < 0:
        print("--stands, --rounds from 1, --seed from 0", file=sys.stderr)
        return 2
    stands = draw_stands(options.stands, options.seed)
    pairs = [(command, method) for command in COMMANDS for method in METHODS]
    tracks = {
        (command, method): track_thrust(stands, command, DURATION, adaptive=METHODS[method], seed=options.seed)
        for command, method in tqdm(pairs, unit="run")
    }
    rows = [judge(command, method, tracks[command, method]) for command, method in pairs]
    for row in rows:
        by_map = tracks[row["command"], "map alone"]
        row["times_lower"] = spread(by_map.error(LEARNED) / tracks[row["command"], row["method"]].error(LEARNED))
    cost = measure_cost(options.rounds)
    print(format_table(rows))
    print(f"\nin the twin a step of the adaptive controller's takes {cost:.3f} times one of the map's")
    if options.json:
        about = {"date": datetime.now(UTC).isoformat(timespec="seconds"), "seed": options.seed, "stands": stands}
        options.json.write_text(json.dumps(about | describe_machine() | {"rows": rows, "cost": cost}, indent=1) + "\n")
    if options.picture:
        draw(tracks, options.picture / "thrust_tracking.svg")
    return 0


def judge(command: str, method: str, track: Track) -> dict:
    """The figures of one command and method over all rotors, plain data: each a median and a worst."""
    row: dict = {"command": command, "method": method}
    if command != "full steps":  # from stop to stop: no controller can command more there
        row["from_start_n"] = spread(track.error(), worst=np.max)
        row["error_n"] = spread(track.error(LEARNED), worst=np.max)
    late = track.time >= LEARNED
    row["speed_off"] = spread(np.abs(track.speed[late] / NOMINAL.rotor.speed - 1.0).max(axis=0), worst=np.max)
    if command == "steps":
        row["settling_s"] = spread(track.settling(LEARNED), worst=np.max)
    if command == "held":
        row["swing_n"] = spread(np.ptp(track.thrust[track.time >= HOLD], axis=0), worst=np.max)
    return row


def spread(values: np.ndarray, worst: np.ufunc | object = np.min) -> tuple[float, float]:
    """Median and worst."""
    assert callable(worst)
    return float(np.median(values)), float(worst(values))


def measure_cost(rounds: int) -> float:
    """Time of a step of the twin with the adaptive controller over that with the map: median ratio over rounds."""
    twins = [Twin(load_twin("nominal").with_controller(name), 1024, num_threads=1) for name in ("map", "adaptive")]
    states = [twin.initial_state() for twin in twins]
    command = np.column_stack([np.random.default_rng(0).uniform(2.0, 6.0, 1024), np.zeros(1024)])
    ratios = []
    for _ in range(rounds):
        times = []
        for twin, state in zip(twins, states):
            fresh, began = state.copy(), perf_counter()
            for _ in range(5):
                twin.advance_policy(fresh, command)
            times.append(perf_counter() - began)
        ratios.append(times[1] / times[0])
    return float(np.median(ratios))


def format_table(rows: list[dict]) -> str:
    """Markdown."""
    names = ("command", "method", "RMS error [N]", "times lower", "from the start [N]", "settling [ms]", "speed off",
             "swing [N]")  # fmt: skip
    lines = [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
    for row in rows:

        def show(name: str, form: str, factor: float = 1.0, row: dict = row) -> str:
            if name not in row:
                return ""
            return " / ".join(format(factor * value, form) for value in row[name])

        times = "" if row["method"] == "map alone" or "error_n" not in row else show("times_lower", ".1f")
        cells = [
            row["command"], row["method"], show("error_n", ".3f"), times, show("from_start_n", ".3f"),
            show("settling_s", ".0f", 1000.0), show("speed_off", ".2%"), show("swing_n", ".3f"),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    lines.append(f"\nmedian / worst over all rotors, from {LEARNED:g} s on; swing from {HOLD:g} s on")
    return "\n".join(lines)


def draw(tracks: dict[tuple[str, str], Track], path: Path) -> None:
    """Command and thrust of one rotor, the map above, the adaptive controller below, from switching on."""
    with open_figure(9.0, 6.0) as figure:
        panels = figure.subplots(2, 2, sharex="col", sharey=True)
        for column, command in zip(panels.T, ("steps", "sine, 1 Hz")):
            for axes, method in zip(column, METHODS):
                track = tracks[command, method]
                shown = track.time < 6.0
                axes.plot(track.time[shown], track.thrust[shown, 1, 0], color=BLUE, label="thrust")
                axes.plot(
                    track.time[shown], track.command[shown], "--", color=VERMILION, label="command", linewidth=1.0
                )
                rms = track.error(LEARNED)[1, 0]
                name_axes(axes, "", "thrust [N]", f"{method}, {command}: {rms:.2f} N RMS after {LEARNED:g} s")
                axes.axvspan(0.0, LEARNED, color=INK, alpha=0.06, linewidth=0.0)
            column[-1].set_xlabel("time [s]")
        panels[0, 0].legend(loc="upper right", ncols=2)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(write_svg(figure, "Thrust tracking") + "\n")


if __name__ == "__main__":
    sys.exit(main())
