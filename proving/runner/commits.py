"""At which commit a session was flown and diagnosed: figures of several versions are no figures of any."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from proving.runner.case import Case

ROOT = Path(__file__).resolve().parents[2]
CODE = ("vpptwin", "tests", "benchmarks", "models", ":!benchmarks/results")
"""What decides a session's outcome."""
CHANGES = "+changes"


def read_commit(root: Path = ROOT) -> str:
    """Commit of a checkout, `+changes` behind it where its code is not what was committed; "" outside git."""

    def ask(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False).stdout.strip()

    commit = ask("rev-parse", "HEAD")
    return commit + CHANGES * bool(commit and ask("status", "--porcelain", "--", *CODE))


def find_mixture(cases: Iterable[Case]) -> str:
    """What is wrong with the commits of cases: more than one, or not recorded; "" for nothing."""
    counts = Counter(case.commit for case in cases)
    told = ", ".join(f"{number} at {tell_commit(commit)}" for commit, number in counts.most_common())
    if len(counts) > 1:
        return f"sessions of several versions: {told}"
    return f"not at one clean commit: {told}" if any(not c or c.endswith(CHANGES) for c in counts) else ""


def tell_commit(commit: str) -> str:
    """A commit in short."""
    return commit[:9] + CHANGES * commit.endswith(CHANGES) if commit else "a commit not recorded"
