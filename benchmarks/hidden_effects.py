"""How often the diagnosis is right: sessions of the independent simulation with effects hidden in them, diagnosed.

    python benchmarks/hidden_effects.py --cases 40 --seed 1 [--effects rail_x.stiction,servo.lag] [--json out.json]

Each session is three 16 s flights of one rig, closed loop: gusts, noise, dropouts, stamp jitter, the rig off nominal
within its tolerance (tests/reality, which shares no physics with vpptwin). A tenth of the sessions hide nothing, a
fifth two effects, a tenth one that the catalogue lacks, the rest one of the catalogue. About 40 s of a core each.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.reality import ALIEN, CORE, EXTENDED, draw_effect, fly_many, write_mcap  # noqa: E402
from vpptwin.diagnosis.diagnose import diagnose  # noqa: E402
from vpptwin.logs.read import read_flight  # noqa: E402
from vpptwin.twin import load_twin  # noqa: E402

MANOEUVRES = ("x_steps", "aggressive", "mixed")
DURATION = 16.0
CONFIDENT = 0.9
"""A wrong cause named with more than this is confidently wrong."""
SHARES = {"none": 0.1, "two": 0.2, "alien": 0.1, "single": 0.6}


@dataclass(frozen=True)
class Case:
    """One session and what became of it.

    Attributes:
        kind: `none`, `single`, `two` or `alien`.
        hidden: effect → parameter → value.
        rig: seed of the rig's tolerances.
        named: causes, strongest first, with their confidence.
        groups: for each cause, the effects that the verdict says it cannot be told from.
        unexplained: whether something is said to be left.
        seconds: time of the diagnosis.
    """

    kind: str
    hidden: dict[str, dict[str, float]]
    rig: int
    named: dict[str, float]
    groups: dict[str, list[str]]
    unexplained: bool
    seconds: float

    @property
    def first(self) -> str:
        """The strongest cause, "" for none."""
        return next(iter(self.named), "")

    @property
    def top(self) -> bool:
        """Every hidden effect of the catalogue is named, the strongest cause among them."""
        known = set(self.hidden) - set(ALIEN)
        return bool(known) and self.first in known and known <= set(self.named)

    @property
    def grouped(self) -> bool:
        """Every hidden effect is named or in the group of a cause."""
        return set(self.hidden) - set(ALIEN) <= set(self.named).union(*self.groups.values(), ())

    @property
    def wrong(self) -> list[str]:
        """Effects named with confidence that are not there."""
        return [
            cause
            for cause, confidence in self.named.items()
            if confidence > CONFIDENT and not {cause, *self.groups[cause]} & set(self.hidden)
        ]


def draw_case(rng: np.random.Generator, effects: Sequence[str]) -> tuple[str, dict[str, dict[str, float]]]:
    """What is hidden in a session."""
    kind = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    match kind:
        case "none":
            return kind, {}
        case "alien":
            return kind, draw_effect(rng, tuple(ALIEN))
        case "two":
            first, second = rng.choice(len(effects), 2, replace=False)
            return kind, draw_effect(rng, (effects[first],)) | draw_effect(rng, (effects[second],))
        case _:
            return kind, draw_effect(rng, tuple(effects))


def run_case(kind: str, hidden: Mapping[str, Mapping[str, float]], rig: int) -> Case:
    """Fly a session and diagnose it."""
    plans = [
        {"effects": hidden, "manoeuvre": name, "duration": DURATION, "seed": rig + 1 + i, "session": rig}
        for i, name in enumerate(MANOEUVRES)
    ]
    with tempfile.TemporaryDirectory() as folder:
        logs = [write_mcap(flight, Path(folder) / f"{flight.manoeuvre}.mcap") for flight in fly_many(plans)]
        flights = [read_flight(log) for log in logs]
        began = time.perf_counter()
        verdict = diagnose(load_twin(), flights).verdict
        seconds = time.perf_counter() - began
    named = {cause.effect: round(cause.confidence, 3) for cause in verdict.causes}
    groups = {cause.effect: [rival.effect for rival in cause.also_explained_by] for cause in verdict.causes}
    copied = {effect: dict(values) for effect, values in hidden.items()}
    return Case(kind, copied, rig, named, groups, verdict.unexplained.significant, round(seconds, 1))


def summarise(cases: Sequence[Case]) -> dict[str, str]:
    """The rates that count, as `n of m`."""

    def rate(kind: str, good: Sequence[bool]) -> str:
        return f"{sum(good)} of {len(good)}"

    single, two = ([c for c in cases if c.kind == kind] for kind in ("single", "two"))
    none, alien = ([c for c in cases if c.kind == kind] for kind in ("none", "alien"))
    return {
        "one effect: named first": rate("single", [c.top for c in single]),
        "one effect: named or in a group": rate("single", [c.grouped for c in single]),
        "two effects: both named": rate("two", [c.top for c in two]),
        "two effects: both named or in a group": rate("two", [c.grouped for c in two]),
        "no effect: something named": rate("none", [bool(c.named) for c in none]),
        "effect outside the catalogue: flagged unexplained": rate("alien", [c.unexplained for c in alien]),
        "effect outside the catalogue: misnamed with confidence": rate("alien", [bool(c.wrong) for c in alien]),
        "confidently wrong, all sessions": rate("", [bool(c.wrong) for c in cases]),
        "time of a diagnosis": f"{np.median([c.seconds for c in cases]):.0f} s (median)",
    }


def main() -> None:
    """Run the sessions, print each and the rates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", help="ids to draw from, separated by commas; by default all that fly")
    parser.add_argument("--kind", choices=list(SHARES), help="only sessions of this kind")
    parser.add_argument("--json", type=Path, help="write every session and the rates")
    options = parser.parse_args()
    effects = options.effects.split(",") if options.effects else [*CORE, *EXTENDED]
    rng = np.random.default_rng(options.seed)
    cases: list[Case] = []
    while len(cases) < options.cases:
        kind, hidden = draw_case(rng, effects)
        rig = int(rng.integers(2**31))
        if options.kind and kind != options.kind:
            continue
        cases.append(run_case(kind, hidden, rig))
        last = cases[-1]
        mark = "ok" if (last.grouped and not last.wrong) or (not last.hidden and not last.named) else "MISS"
        print(f"{len(cases):4d} {mark:4s} {kind:6s} {hidden} -> {last.named} {last.groups}", flush=True)
    rates = summarise(cases)
    for name, value in rates.items():
        print(f"{name}: {value}")
    if options.json:
        content = {
            "seed": options.seed,
            "machine": platform.processor() or platform.machine(),
            "rates": rates,
            "cases": [asdict(case) for case in cases],
        }
        options.json.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
