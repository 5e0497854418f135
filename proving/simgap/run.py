"""Runs entrants on a set, each session in a process of its own, whose time and memory are measured."""

from __future__ import annotations

import json
import os
import resource
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from proving.simgap.answers import check_answer
from proving.simgap.sets import list_sessions
from proving.simgap.storage import read_session

LIMIT = 900.0
"""Time that a session may take [s]."""


def run_entrant(entrant: str, folder: Path, command: str = "", jobs: int = 1, limit: float = LIMIT) -> int:
    """Answers of an entrant to all sessions of a set that it has not answered; returns how many are valid.

    Args:
        entrant: of this package, or any name where `command` is given.
        folder: the set.
        command: with `{session}` and `{answer}`, the session's folder and the file to write; "" for one of ours.
        jobs: sessions at once.
        limit: time that a session may take [s].
    """
    homes = list_sessions(folder)
    with ThreadPoolExecutor(jobs) as pool:
        return sum(
            pool.map(lambda home: answer_one(entrant, home, folder / "answers" / entrant, command, limit), homes)
        )


def answer_one(entrant: str, home: Path, folder: Path, command: str, limit: float) -> bool:
    """One answer; what fails leaves a file with the reason."""
    folder.mkdir(parents=True, exist_ok=True)
    answer, failed = folder / f"{home.name}.json", folder / f"{home.name}.failed"
    if answer.exists():
        return True
    failed.unlink(missing_ok=True)
    unfinished = folder / f".{home.name}.json"
    ours = [sys.executable, "-m", "proving.simgap", "answer", entrant, str(home), "--out", str(unfinished)]
    given = [part.format(session=home, answer=unfinished) for part in shlex.split(command)]
    began = time.perf_counter()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), os.environ.get("PYTHONPATH", "")])}
    with subprocess.Popen(
        given or ours, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as process:  # fmt: skip
        try:
            said, _ = process.communicate(timeout=limit)
            reason = said.strip().splitlines()[-1:] or [f"ended with {process.returncode}"]
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            reason = [f"took more than {limit:.0f} s"]
    seconds = time.perf_counter() - began
    try:
        content = json.loads(unfinished.read_text())
        own = content.get("memory_mb")
        memory = own or resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
        content |= {"seconds": round(seconds, 2), "memory_mb": round(memory, 1)}
        check_answer(content, read_session(home), entrant)
    except (OSError, ValueError) as error:
        failed.write_text(f"{reason[0] if isinstance(error, OSError) else error}\n")
        unfinished.unlink(missing_ok=True)
        return False
    unfinished.write_text(json.dumps(content) + "\n")
    unfinished.replace(answer)
    return True


def measure_self() -> float:
    """The most memory that this process and its children held [MB]."""
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1024.0


def list_entrants(folder: Path) -> Sequence[str]:
    """Who has answered sessions of a set."""
    return sorted(p.name for p in (folder / "answers").iterdir() if p.is_dir()) if (folder / "answers").is_dir() else []
