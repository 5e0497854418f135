"""Sets of sessions: drawn from a seed, sealed by hashes, checked."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from proving.simgap.lerobot import write_lerobot
from proving.simgap.session import VERSION, Truth, dump
from proving.simgap.storage import read_truth, write_session
from proving.simgap.worlds import draw_session


def draw_set(
    folder: Path, seed: int, chosen: Mapping[str, Sequence[int]], public: bool, lerobot: bool = False
) -> Path:  # fmt: skip
    """Draw sessions into a folder: `sessions/` for entrants, `truth/` for the judge, and the manifest.

    Args:
        folder: where; it may hold sessions of the same seed already.
        seed: of all.
        chosen: world → numbers of sessions.
        public: whether the manifest tells the seed; otherwise its hash alone.
        lerobot: write runs as LeRobot data sets too, where the format can hold them.

    Raises:
        ValueError: where the folder holds sessions of another seed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sessions: dict[str, dict[str, str]] = {}
    if (folder / "manifest.json").exists():
        before = read_manifest(folder)
        if before["seed_sha256"] != commit_seed(seed):
            raise ValueError(f"{folder} has sessions of another seed: give another folder")
        sessions = before["sessions"]
    for world, numbers in chosen.items():
        for number in numbers:
            session, logs, truth = draw_session(world, seed, number)
            home = write_session(session, logs, truth, folder)
            if lerobot:
                write_lerobot(session, home / "lerobot")
            sessions[home.name] = {"session_sha256": hash_folder(home), "truth_sha256": truth.seal()}
    manifest = {
        "simgap": VERSION, "seed": seed if public else None, "seed_sha256": commit_seed(seed), "sessions": sessions,
    }  # fmt: skip
    path = folder / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1) + "\n")
    return path


def add_to_manifest(folder: Path, home: Path, truth: Truth) -> None:
    """Add a session that was not drawn to a set, which is made where there is none."""
    path = folder / "manifest.json"
    empty = {"simgap": VERSION, "seed": None, "seed_sha256": None, "sessions": {}}
    manifest = read_manifest(folder) if path.exists() else empty
    manifest["sessions"][home.name] = {"session_sha256": hash_folder(home), "truth_sha256": truth.seal()}
    path.write_text(json.dumps(manifest, indent=1) + "\n")


def draw_seed() -> int:
    """A seed that nobody can guess: 128 bits."""
    return secrets.randbits(128)


def commit_seed(seed: int) -> str:
    """What is published of a secret seed before answers are collected."""
    return hashlib.sha256(f"simgap seed {seed}".encode()).hexdigest()


def publish_seed(folder: Path, seed: int) -> None:
    """Write the seed of a secret set into its manifest, once all have answered.

    Raises:
        ValueError: where it is not the one that was committed to.
    """
    manifest = read_manifest(folder)
    if manifest["seed_sha256"] != commit_seed(seed):
        raise ValueError(f"{seed} is not the seed of {folder}: its hash is not the one in manifest.json")
    (folder / "manifest.json").write_text(json.dumps(manifest | {"seed": seed}, indent=1) + "\n")


def hash_folder(home: Path) -> str:
    """SHA-256 of the names and contents of a session's files, MCAP left out (its bytes depend on the library)."""
    parts = {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest()
        for p in home.iterdir()
        if p.suffix in (".csv", ".xml", ".json")
    }
    return hashlib.sha256(dump(parts).encode()).hexdigest()


def hash_set(manifest: Mapping[str, Any]) -> str:
    """One hash of a whole set: of its sessions and truths."""
    return hashlib.sha256(dump(manifest["sessions"]).encode()).hexdigest()


def check_set(folder: Path, published: Mapping[str, Any] | None = None) -> int:
    """Check sessions and truths against the manifest, or one that was published; returns how many.

    Raises:
        ValueError: with the first that differs.
    """
    manifest = published or read_manifest(folder)
    for name, hashes in manifest["sessions"].items():
        home = folder / "sessions" / name
        if not home.is_dir():
            raise ValueError(f"{home} is missing: draw the set again")
        if hash_folder(home) != hashes["session_sha256"]:
            raise ValueError(f"{home} is not the session that was published: draw the set again with the same version")
        if (folder / "truth").is_dir() and read_truth(folder, home).seal() != hashes["truth_sha256"]:
            raise ValueError(f"the truth of {name} is not the one that was published")
    return len(manifest["sessions"])


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a set.

    Raises:
        ValueError: where there is none.
    """
    try:
        return dict(json.loads((folder / "manifest.json").read_text()))
    except (OSError, json.JSONDecodeError):
        raise ValueError(f"{folder} has no manifest.json: give a folder that `simgap draw` wrote") from None


def list_sessions(folder: Path) -> list[Path]:
    """Folders of a set's sessions, in order."""
    return [folder / "sessions" / name for name in sorted(read_manifest(folder)["sessions"])]
