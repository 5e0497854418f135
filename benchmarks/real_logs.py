"""What the diagnosis says of measured logs of robots that are not ours, beside fits by hand.

    python benchmarks/real_logs.py DATA
    python benchmarks/real_logs.py DATA --rig antx --json antx.json

Prints the table of docs/benchmarks.md: what is known of each log without MuJoCo (the READMEs of `examples` tell how),
the causes that `vpptwin diagnose` names, and whether they are right. Every diagnosis is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from same_rig.report import describe_machine  # noqa: E402

from examples.double_pendulum.convert import convert as convert_double  # noqa: E402
from examples.simple_pendulum.convert import convert as convert_simple  # noqa: E402
from examples.so101.convert import convert as convert_so101  # noqa: E402
from proving.runner.commits import read_commit  # noqa: E402
from vpptwin.system.files import write_json  # noqa: E402

SURE = 0.9
"""Confidence from which a cause is claimed."""
FRICTION = ("coulomb", "stiction", "viscous")


def take(source: Path, out: Path) -> None:
    """A log that is read as it is."""
    out.symlink_to(source.resolve())


@dataclass(frozen=True)
class RealLog:
    """A measured log, and what fits by hand say of it.

    Attributes:
        rig: folder of `DATA` and of `examples`.
        log: file or folder in the first.
        twin: twin YAML in the second.
        by_hand: what is known, in words.
        right: endings of the ids of effects that say so, or say the same in other words.
        prepare: writes the log in a format that is read.
    """

    rig: str
    log: str
    twin: str
    by_hand: str
    right: tuple[str, ...]
    prepare: Callable[[Path, Path], None] = take


def list_logs() -> list[RealLog]:
    """Every log that a twin can be put beside."""
    rubs = tuple(f"slide.{law}" for law in FRICTION)
    zeros = ("shoulder.offset", "elbow.offset", "shoulder.bias", "elbow.bias")
    found = [
        RealLog("antx", f"rail_velocity_doublets_{i}.mcap", "rail.yaml", "viscous, 0.4 N s/m, with a little dry", rubs)
        for i in (1, 2)
    ]
    turns = ("spring", "inertia", "gain", "delay", "lag", *FRICTION)
    moment = "a restoring moment, a third of the gain, late by 34 ms, dry friction"
    found.append(RealLog("antx", "pitch_free_decay.mcap", "pitch.yaml", moment, turns))
    found.append(RealLog("antx", "pitch_attitude_steps.mcap", "pitch.yaml", "two thirds of the gain, late", turns))
    double = {
        "00": ("rotor's inertia at the elbow, zeros", ("elbow.inertia", *zeros)),
        "02": ("zeros of 40 and 136 mrad, rotor's inertia", ("elbow.inertia", *zeros)),
        "04": ("turns over: nothing fits", ()),
        "11": (
            "lower link 11 % heavier, or torque less, rotor's inertia",
            ("elbow.inertia", "lower.mass", "elbow_motor.gain"),
        ),
        "13": ("zeros, play at reversals, rotor's inertia", ("elbow.inertia", "backlash", *zeros)),
    }  # fmt: skip
    found += [
        RealLog("double_pendulum", f"design_A_{run}.csv", "both.yaml", *known, convert_double)
        for run, known in double.items()
    ]
    rubbing = ("coulomb", "stiction", "gain")
    simple = {
        "energy_shaping": ("dry friction 0.245 N m, a push", rubbing[:2]),
        "ilqr": ("dry friction 0.244 N m, a hand", rubbing[:2]),
        "pd_swingup_failure": ("dry friction 0.19 N m, a gain of 0.88 or a zero, a lift", (*rubbing, "bias", "offset")),
        "energy_shaping_1kg": ("heavier bob, or 0.6 to 0.7 of the torque", (*rubbing, "dead_band", "mass", "payload")),
    }  # fmt: skip
    found += [
        RealLog("simple_pendulum", f"{run}.csv", f"pendulum{'_1kg' * run.endswith('1kg')}.yaml", *known, convert_simple)
        for run, known in simple.items()
    ]
    servo = "dry friction tenfold, damping threefold, stiffer"
    found += [
        RealLog("so101", "prbs_excitation", twin, servo, ("coulomb", "viscous", "damping", "stiffness"),
                lambda source, out: convert_so101(source, out, last=24.0))
        for twin in ("rotation.yaml", "so101.yaml")
    ]  # fmt: skip
    flights = (
        "B2_circle_fast_rep1",
        "B3_figure8_fast_rep1",
        "B8_star_fast_rep1",
        "B8_star_medium_rep2",
        "B9_trefoil_slow_rep1",
    )
    known = "two thirds of the thrust, falling; drag of 0.012 N s/m; what turns it is not in the log"
    right = ("m1+m2+m3+m4.gain", "m1+m2+m3+m4.sag", "mass", "drag")
    found += [RealLog("nanobench", f"{flight}.csv.gz", "crazyflie.yaml", known, right) for flight in flights]
    return found


def weigh(causes: Sequence[tuple[str, float]], right: tuple[str, ...]) -> str:
    """What a verdict's causes are worth beside what fits by hand say: what is claimed and not so is wrong."""
    fits = [effect.endswith(right) if right else False for effect, _ in causes]
    if any(sure > SURE and not fit for (_, sure), fit in zip(causes, fits)):
        return "wrong"
    if not causes:
        return "nothing named"
    return "right" if all(fits) else "in part" if any(fits) else "not so by hand"


def diagnose(log: RealLog, data: Path, folder: Path) -> dict:
    """The verdict on one log, or its error, with seconds, memory and whether it is right."""
    ending = "".join(Path(log.log).suffixes) if log.prepare is take else ".mcap"
    ready, out = folder / f"log{ending}", folder / "out"
    log.prepare(data / log.rig / log.log, ready)
    twin = ROOT / "examples" / log.rig / log.twin
    command = [sys.executable, "-m", "vpptwin", "diagnose", str(ready), "--twin", str(twin), "--out", str(out)]
    begun = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    found: dict = {"rig": log.rig, "log": log.log, "twin": log.twin, "by_hand": log.by_hand,
                   "seconds": round(time.perf_counter() - begun, 1)}  # fmt: skip
    if run.returncode not in (0, 1) or not (out / "verdict.json").exists():
        said = run.stderr.strip().splitlines() or ["no verdict"]
        return found | {"error": said[-1], "marks": "refused"}
    verdict = json.loads((out / "verdict.json").read_text())
    causes = [(cause["effect"], cause["confidence"]) for cause in verdict["causes"]]
    chi2 = [verdict[when]["chi2"] for when in ("before", "after")]
    left = bool(verdict["unexplained"]["significant"]) or bool(verdict.get("misfit"))
    marks = weigh(causes, log.right)
    return found | {"causes": causes, "verdict": verdict["causes"], "chi2": chi2, "left": left, "marks": marks}


def print_table(results: Sequence[dict]) -> None:
    """As docs/benchmarks.md has it."""
    print("| rig, log (twin) | by hand | tool | held-out chi² | something left | |\n|---|---|---|---:|---|---|")
    for found in results:
        name = f"{found['rig']}, {found['log'].split('.')[0]} ({found['twin'].split('.')[0]})"
        if "error" in found:
            print(f"| {name} | {found['by_hand']} | {found['error']} | | | {found['marks']} |")
            continue
        causes = "; ".join(f"`{effect}` {100 * sure:.0f} %" for effect, sure in found["causes"]) or "-"
        before, after = found["chi2"]
        left = "yes" if found["left"] else "no"
        print(f"| {name} | {found['by_hand']} | {causes} | {before:.3g} → {after:.3g} | {left} | {found['marks']} |")
    counts = Counter(found["marks"] for found in results)
    print("\n" + ", ".join(f"{mark} {count}" for mark, count in counts.items()) + f", of {len(results)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Diagnose every log and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of measured data")
    parser.add_argument("--rig", choices=sorted({log.rig for log in list_logs()}), help="only this rig's logs")
    parser.add_argument("--json", type=Path, help="write results here, after every log")
    options = parser.parse_args(argv)
    logs = [log for log in list_logs() if options.rig in (None, log.rig)]
    if missing := [log.log for log in logs if not (options.data / log.rig / log.log).exists()]:
        parser.error(f"{options.data}: no {missing[0]}; expected the folder of measured data, DATA")
    results: list[dict] = []
    for log in logs:
        with TemporaryDirectory() as folder:
            results.append(diagnose(log, options.data, Path(folder)))
        print(f"{log.rig} {log.log} {log.twin}: {results[-1]['marks']}, {results[-1]['seconds']} s", file=sys.stderr)
        if options.json:
            memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
            about = {"commit": read_commit(), "machine": describe_machine(), "memory": round(memory)}
            write_json(about | {"logs": results}, options.json)
    print_table(results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
