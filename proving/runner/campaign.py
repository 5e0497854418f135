"""Many sessions on many cores: flown in batches, diagnosed in worker processes, every result kept at once."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from proving.runner.case import Case
from proving.runner.draw import Plan
from proving.runner.session import fly_sessions, run_session

BATCH = 16
"""Sessions flown together: 48 flights take 40 s of a core, one alone 9 s."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def open_pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes, each on a core of its own, so that neither engine nor algebra of one takes another's."""
    context = multiprocessing.get_context("spawn")
    cores = context.Queue()
    for i in range(jobs):
        cores.put(sorted(os.sched_getaffinity(0))[i % len(os.sched_getaffinity(0))])
    saved = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read when a worker imports numpy
    if jobs > 1:
        pool = ProcessPoolExecutor(jobs, context, initializer=take_core, initargs=(cores,))
    else:
        pool = ProcessPoolExecutor(jobs, context)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in saved.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def take_core(cores: Any) -> None:  # noqa: ANN401 (a queue of the context has no public type)
    """Keep this process to one core."""
    os.sched_setaffinity(0, {cores.get()})


def run_campaign(
    plans: Sequence[Plan],
    folder: Path,
    jobs: int,
    oracle: bool,
    keep: bool,
) -> Iterator[Case]:
    """Fly and diagnose sessions; yields each as it is done, in no order.

    Args:
        plans: the sessions.
        folder: for their logs.
        jobs: worker processes.
        oracle: fit the true structure too.
        keep: leave the logs in `folder`.
    """
    waiting = iter([plans[i : i + BATCH] for i in range(0, len(plans), BATCH)])
    flying: dict[Future, Sequence[Plan]] = {}
    running: dict[Future, Plan] = {}

    def fly_next(pool: ProcessPoolExecutor) -> None:
        if batch := next(waiting, None):
            flying[pool.submit(fly_sessions, batch, folder)] = batch

    with open_pool(jobs) as pool:
        fly_next(pool)
        while flying or running:
            done, _ = wait([*flying, *running], return_when=FIRST_COMPLETED)
            for future in done:
                if (batch := flying.pop(future, None)) is not None:
                    fly_next(pool)  # ahead of this batch's diagnoses, so that there is always something to do
                    for plan, logs in zip(batch, future.result()):
                        running[pool.submit(run_session, plan, logs, oracle)] = plan
                else:
                    plan = running.pop(future)
                    if not keep:
                        shutil.rmtree(folder / f"case_{plan.number:04d}")
                    yield future.result()


def read_results(path: Path) -> dict[str, Any]:
    """A results file."""
    return json.loads(path.read_text())


def write_results(path: Path, head: dict[str, Any], cases: Sequence[Case]) -> None:
    """Write a results file, whole or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    ordered = sorted(cases, key=lambda case: case.plan.number)
    temporary.write_text(json.dumps(head | {"cases": [case.as_dict() for case in ordered]}, indent=1) + "\n")
    os.replace(temporary, path)
