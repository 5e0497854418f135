"""Work that falls into independent pieces: in processes of this machine, or in Ray's, here or on a cluster."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any, Literal, TypeVar

from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.trust import trust, trusted

Item = TypeVar("Item")
Found = TypeVar("Found")
Jobs = int | Literal["ray"]
"""How many processes share the work, or that Ray's do."""
RAY: Literal["ray"] = "ray"
FEWER = "see that they have the memory and files they need, or take fewer --jobs"
MAX_PROCESSES = 1024
ALONE = "start one with `ray start --head`, or unset RAY_ADDRESS to use this machine only"
SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_worker_register_timeout_seconds": "600",
}
"""Of Ray, if not set otherwise: no reports to its makers, no warnings about GPUs, ten minutes instead of one to start a
process, as on a busy machine Ray waits for ever for one that took longer."""
PATIENCE = 10.0
"""Time that a cluster's head has to answer, s."""


def read_jobs(text: str) -> Jobs:
    """The value of --jobs."""
    if text == RAY:
        return RAY
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MAX_PROCESSES):
        raise InputError(f"--jobs {text}", f"1 to {MAX_PROCESSES} processes, or ray", "leave it out for one")
    return int(text)


def share_out(task: Callable[[Item], Found], items: Sequence[Item], jobs: Jobs) -> Iterator[tuple[int, Found]]:
    """Do a task for every item; yields its number and what came out, as it comes.

    Args:
        task: a function of a module, so that other processes find it; what it takes and gives is pickled.
        items: what it is done for.
        jobs: processes; 1 does everything in this one.

    Raises:
        InputError: of a task, which ends the others; or if a process ends, or Ray can't be reached.
    """
    if jobs == RAY:
        yield from share_with_ray(task, items)
    elif jobs == 1 or len(items) < 2:
        yield from ((i, task(item)) for i, item in enumerate(items))
    else:
        yield from share_with_processes(task, items, min(jobs, len(items)))


def share_with_processes(
    task: Callable[[Item], Found], items: Sequence[Item], number: int
) -> Iterator[tuple[int, Found]]:
    """`share_out` to processes of this machine, which end when this one does, however that ends."""
    before = set(active_children())
    pool: Executor = ProcessPoolExecutor(number, get_context("spawn"), begin_work, (trusted(),))
    try:
        pending = {pool.submit(task, item): i for i, item in enumerate(items)}
        for done in as_completed(pending):
            yield pending[done], done.result()
    except BrokenProcessPool as error:
        raise InputError("a process ended", "processes that last as long as the work", FEWER) from error
    finally:
        for child in set(active_children()) - before:
            child.terminate()
        pool.shutdown(cancel_futures=True)


def begin_work(allowed: frozenset[Any]) -> None:
    """In a process that works for another: code that the user trusts runs here too; it ends when that one does."""
    trust(allowed)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the other one, which ends this one
    Thread(target=end_with_parent, daemon=True).start()


def end_with_parent() -> None:
    """Wait for the process that started this one to end, and end."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def share_with_ray(task: Callable[[Item], Found], items: Sequence[Item]) -> Iterator[tuple[int, Found]]:
    """`share_out` to the Ray that RAY_ADDRESS names, or to one of its own on this machine."""
    ray = load_extra("ray", "--jobs ray")
    allowed, started = trusted(), not ray.is_initialized()

    def work(item: Item) -> Found | InputError:
        trust(allowed)
        try:
            return task(item)
        except InputError as error:  # which Ray would wrap in a traceback
            return error

    try:
        if started:
            connect(1)
        with explain_failures(FEWER):
            far = ray.remote(num_cpus=1)(work)
            pending = {far.remote(item): i for i, item in enumerate(items)}
            while pending:
                (done,), _ = ray.wait(list(pending), num_returns=1)
                found = ray.get(done)
                if isinstance(found, InputError):
                    raise found
                yield pending.pop(done), found
    finally:
        if started:
            ray.shutdown()


def connect(cores: int) -> None:
    """Connect to Ray without a word.

    Args:
        cores: that a Ray of this machine alone has to offer; oversubscribing them is up to the user.

    Raises:
        InputError: if the Ray that RAY_ADDRESS names does not answer, or none can be started.
    """
    import ray

    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    quiet: dict[str, Any] = {"logging_level": "error", "log_to_driver": False}
    address = os.environ.get("RAY_ADDRESS") or "local"
    if address == "local":
        try:
            ray.init(address, num_cpus=max(cores, os.cpu_count() or 1), include_dashboard=False, **quiet)
        except Exception as error:  # Ray raises just that if its processes take longer than half a minute
            found = f"Ray does not start on this machine: {str(error).splitlines()[0]}"
            raise InputError(found, "its processes to start", "try again when the machine is less busy") from error
        return
    host, _, port = address.rpartition(":")
    if address != "auto" and ("://" in address or not port.isdigit()):
        expected = "auto, or host:port of the cluster that this machine belongs to"
        raise InputError(f"RAY_ADDRESS={address}", expected, ALONE)
    try:
        if address != "auto":
            socket.create_connection((host, int(port)), PATIENCE).close()  # Ray itself would try for minutes
        ray.init(address, **quiet)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"no Ray at RAY_ADDRESS={address}", "the address of a running Ray", ALONE) from error


@contextmanager
def explain_failures(advice: str) -> Iterator[None]:
    """Turn what Ray reports of a failed worker into one line.

    Args:
        advice: what to do about it.
    """
    import ray

    try:
        yield
    except ray.exceptions.RayError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
        # An exception in a worker comes as a traceback, whose last line tells; a lost worker as a description.
        told = lines[-1].partition("InputError: ")[2] or (lines[-1] if "Traceback" in str(error) else lines[0])
        raise InputError(f"a Ray worker ended: {told}", "workers that last as long as the run", advice) from error
