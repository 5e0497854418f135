"""Sessions of other rigs: recorded and diagnosed in worker processes, counted (hidden_effects.py --rigs other)."""

from __future__ import annotations

import resource
import shutil
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from itertools import count as count_up
from pathlib import Path

from proving.mechanisms import Session, draw_session
from proving.runner.campaign import open_pool
from proving.runner.case import Case
from proving.runner.crafts import GROUNDS, CraftSession
from proving.runner.mechanisms import MechanismPlan
from proving.runner.rates import Figure, Rate, count, is_flagged, measure_parameters, measure_time
from proving.runner.session import read_verdict
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.logs.read import read_flight
from vpptwin.twin import load_twin

SECONDS, MEMORY = 1200, 10 * 2**30
"""That no diagnosis may take more of [s], [bytes]; one that does has failed."""
UNRECORDED = "unrecorded"
"""Kind of a session that could not be recorded."""

AnySession = Session | CraftSession
DRAWS: dict[str, Callable[[int, int], AnySession]] = {
    "other": draw_session, **{family: partial(CraftSession, family=family) for family in GROUNDS},
}  # fmt: skip
"""Rigs that are not ours → what draws a session of them."""


def choose_sessions(
    rigs: str, seed: int, cases: int, kinds: Sequence[str], numbers: str | None, shard: str
) -> list[AnySession]:
    """The sessions that a command line asks for."""
    draw = DRAWS[rigs]
    if numbers:
        return [draw(seed, int(number)) for number in numbers.split(",")]
    first, shards = map(int, shard.split("/"))
    drawn = (draw(seed, number) for number in count_up())
    wanted = (session for session in drawn if not kinds or session.kind in kinds)
    return list(islice(wanted, cases))[first - 1 :: shards]


def run_sessions(rigs: str, sessions: Sequence[AnySession], folder: Path, jobs: int, keep: bool) -> Iterator[Case]:
    """Record and diagnose sessions; yields each as it is done, in no order."""
    with open_pool(jobs) as pool:
        homes = [folder / f"case_{session.number:04d}" for session in sessions]
        running = {pool.submit(run_session, rigs, s.seed, s.number, home): home for s, home in zip(sessions, homes)}
        for future in as_completed(running):
            if not keep:
                shutil.rmtree(running[future], ignore_errors=True)
            yield future.result()


def run_session(rigs: str, seed: int, number: int, folder: Path) -> Case:
    """Record a session and diagnose its logs; a diagnosis that fails is a result too."""
    session: AnySession = DRAWS[rigs](seed, number)
    try:
        recorded = session.record(folder)
    except Exception as error:  # a fault of the proving ground, not of what is tried on it
        return Case(MechanismPlan(number, UNRECORDED, session.family), None, error=f"not recorded: {tell_error(error)}")
    plan = recorded.plan if isinstance(session, CraftSession) else MechanismPlan.from_record(session, recorded)
    watch_memory()
    began = time.perf_counter()
    try:
        with limited():
            verdict = diagnose(load_twin(recorded.twin), [read_flight(log) for log in recorded.logs]).verdict
    except Exception as error:
        return Case(plan, None, error=tell_error(error))
    found = read_verdict(verdict, time.perf_counter() - began)
    return Case(plan, replace(found, memory=read_memory()))


def tell_error(error: Exception) -> str:
    """An exception and where it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"


@contextmanager
def limited(seconds: int = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Raise a TimeoutError or MemoryError in whatever takes more than that; bytes are of address space."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"took more than {seconds} s")

    before, usual = resource.getrlimit(resource.RLIMIT_AS), signal.signal(signal.SIGALRM, stop)
    resource.setrlimit(resource.RLIMIT_AS, (memory, before[1]))
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, usual)
        resource.setrlimit(resource.RLIMIT_AS, before)


def watch_memory() -> None:
    """Count the most memory that this process holds from now on, where Linux allows it."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def read_memory() -> float:
    """The most memory that this process held [MB]."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return next(float(line.split()[1]) / 1024.0 for line in status.splitlines() if line.startswith("VmHWM"))


def is_silent(case: Case) -> bool:
    """Whether a verdict names nothing but what is too small to ask for, and leaves nothing unexplained."""
    return case.found is not None and not case.first and not case.found.unexplained


def summarise(cases: Sequence[Case]) -> list[Rate | Figure]:
    """Every measure of how often verdicts are right; rates are over all sessions where nothing else is said."""
    single, two, alien, none = ([c for c in cases if c.plan.kind == k] for k in ("single", "two", "alien", "none"))
    clear, clear_two, apart = ([c for c in some if c.plan.separable] for some in (single, two, alien))
    shown = [c for c in single if c.plan.detectable]
    memory = [c.found.memory for c in cases if c.found and c.found.memory]
    held = f"{max(memory):.0f} MB at most" if memory else "-"
    return [
        count("one effect, identifiable: named first", (c.all_named for c in clear), ">= 0.90"),
        count("one effect, identifiable: named or in the group", (c.all_suspected for c in clear), ">= 0.95"),
        count("one effect that shows: named or in the group", (c.all_suspected for c in shown), ">= 0.95"),
        count("one effect: named first", (c.all_named for c in single)),
        count("one effect: named or in the group", (c.all_suspected for c in single)),
        count("two effects, identifiable: both named", (c.all_named for c in clear_two), ">= 0.80"),
        count("two effects, identifiable: named or in groups", (c.all_suspected for c in clear_two)),
        count("two effects: both named", (c.all_named for c in two)),
        count("missed effects: said not to be identifiable", chain(*(c.owned for c in cases))),
        count("confidently wrong", (bool(c.wrong) for c in cases if c.plan.kind != "alien"), "<= 0.02"),
        count(
            "nothing hidden, build tolerance does not show: silent",
            (is_silent(c) for c in none if c.plan.quiet),
            ">= 0.98",
        ),
        count("nothing hidden: silent", map(is_silent, none)),
        count("nothing hidden: nothing named with confidence", (c.found is not None and not c.wrong for c in none)),
        count("outside the catalogue, like nothing in it: flagged", map(is_flagged, apart), ">= 0.85"),
        count("outside the catalogue: flagged", map(is_flagged, alien)),
        count("outside the catalogue: misnamed with confidence", (bool(c.wrong) for c in alien)),
        *measure_parameters(cases),
        replace(measure_time(cases), name="time of a diagnosis: median"),
        Figure("memory of a diagnosis", held),
        count("diagnosis failed", (c.found is None for c in cases if c.plan.kind != UNRECORDED), "<= 0"),
    ]
