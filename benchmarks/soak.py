"""An hour of random commands with random inputs from a seed, valid, broken and hostile: what ends badly is counted.

    python benchmarks/soak.py --seconds 3600 --seed 1
    python benchmarks/soak.py --trials 50 --seed 1

A third of the commands are killed at a random moment, by SIGTERM, SIGINT or SIGKILL; what was in the folder of results
before has to be whole. With `--trials` every command that writes is killed so often over results of another run, half
of the times by `kill -9`, half by Ctrl-C, a third of them as it writes; then run twice at once into one place, onto a
full disk and onto one that cannot be written. Exit status 1 if anything ended in a traceback, hung, left a process or a
file behind, lost or halved a file, or took too much memory.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from proving.fuzzers import DRAW  # noqa: E402

DEMO = ROOT / "demo" / "flights"
HANG = 240.0
"""Longest time that a command may take [s]: a diagnosis of one flight takes 60 to 120 on a busy core."""
MOST_MB = 4000
SIGNALS = {signal.SIGTERM: 143, signal.SIGINT: 130, signal.SIGKILL: -signal.SIGKILL}
"""What kills a command, and the code that it ends with then."""
WRITING = {
    "diagnose": ["diagnose", "LOG", "--out", "out/diagnosis"],
    "fly": ["fly", "--manoeuvre", "x_steps", "--duration", "6", "--seed", "SEED", "--out", "out/flight.mcap"],
    "evaluate": ["evaluate", "flip", "--tracks", "4", "--seed", "SEED", "--json", "out/evaluate.json"],
    "export c": ["export", "flip", "--twin", "TWIN", "--format", "c", "--out", "out/c"],
    "export onnx": ["export", "flip", "--twin", "TWIN", "--format", "onnx", "--out", "out/policy.onnx"],
    "plot": ["plot", "LOG", "--out", "out/plot.svg"],
    "play": ["play", "LOG", "--html", "out/page.html"],
    "compare": ["compare", "LOG", "--json", "out/compare.json"],
    "effects": ["effects", "--pictures", "out/pictures"],
    "layouts": ["layouts", "out/layouts"],
}
"""Commands that write, on one of two inputs."""
MOMENT = re.compile(rb'20\d\d-\d\d-\d\d[T ][\d:.+Z-]*|<script id="commands".*?</script>', re.DOTALL)
"""A date, or a scene with meshcat's random ids: what differs from run to run of one command."""
INPUTS = ({"LOG": "flip", "SEED": "1", "TWIN": "nominal"}, {"LOG": "steps", "SEED": "2", "TWIN": "typical"})


def draw_command(rng: np.random.Generator, folder: Path) -> list[str]:
    """A command with its inputs, which lie in a folder; results go to `out` there."""

    def pick(kind: str, sound: str, share: float = 0.5) -> str:
        return sound if rng.random() < share else str(DRAW[kind](rng, folder))

    flights = ("flip", "steps", "mixed", "aggressive")
    log = pick("log", str(DEMO / f"{flights[rng.integers(4)]}.mcap"))
    twin = pick("twin", "nominal", 0.6) if rng.random() < 0.7 else pick("model", "nominal", 0.3)
    policy = pick("checkpoint", "flip")
    parts = pick("parts", "nominal", 0.2)
    commands = (
        ["diagnose", log, "--twin", twin, "--out", "out"],
        ["compare", log, "--twin", twin, "--json", "out/compare.json"],
        ["play", log, "--twin", twin, "--html", "out/page.html"],
        ["plot", log, "--twin", twin, "--out", "out/plot.svg"],
        ["fly", policy, "--twin", twin, "--duration", "5", "--out", "out/flight.mcap"],
        ["fly", "--manoeuvre", "x_steps", "--twin", twin, "--duration", "6", "--out", "out/flight.mcap"],
        ["evaluate", policy, "--twin", twin, "--tracks", "4", "--json", "out/evaluate.json"],
        ["export", policy, "--format", "c", "--out", "out/c"],
        ["export", policy, "--format", "onnx", "--out", "out/policy.onnx"],
        ["effects", "--twin", twin],
        ["effects", "--twin", parts],
        ["inspect", pick("set", log, 0.2)],
        ["convert", pick("bag", log, 0.2), "out/converted.mcap"],
    )
    weights = np.array([1.0, *(len(commands) - 1) * [3.0]])
    return commands[rng.choice(len(commands), p=weights / weights.sum())]


def judge_files(folder: Path) -> list[str]:
    """What in the folder of results is not whole, or left behind."""
    wrong = [f"left behind: {path.name}" for path in folder.rglob(".*") if path.exists()]
    for path in folder.rglob("*.json"):
        try:
            json.loads(path.read_text())
        except ValueError:
            wrong.append(f"no JSON: {path.name}")
    for pattern, end in (("*.html", b"</html>"), ("*.mcap", b"\x89MCAP0")):
        files = folder.rglob(pattern)
        wrong += [f"not whole: {path.name}" for path in files if not path.read_bytes().rstrip().endswith(end)]
    return wrong


@dataclass
class Ended:
    """How a command ended: its exit code (None if it hung), what it said on stderr, and what was bad about it."""

    code: int | None = None
    said: str = ""
    problems: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Kill:
    """A signal and when it comes: so long [s] after the program heeds signals, or after the command began to write."""

    how: signal.Signals
    after: float
    writing: bool = False

    def wait(self, child: subprocess.Popen[bytes], out: Path) -> None:
        """Until it is time, or the command has ended."""
        until = time.monotonic() + HANG
        while not is_ready(child.pid) and child.poll() is None and time.monotonic() < until:
            time.sleep(0.0005)
        while self.writing and child.poll() is None and time.monotonic() < until:
            with suppress(OSError):  # which come and go
                if any(path.is_file() for drafts in out.rglob(".vpptwin.*") for path in drafts.glob("*")):
                    break
            time.sleep(0.0005)
        with suppress(subprocess.TimeoutExpired):
            child.wait(self.after)


def is_ready(pid: int) -> bool:
    """Whether a process catches SIGTERM, as vpptwin does from the moment on in which it promises how it ends.

    Before that Python itself is starting, and what a signal does then is Python's affair.
    """
    with suppress(OSError):  # which has ended
        caught = re.search(r"^SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
        return caught is not None and bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def start(arguments: list[str], folder: Path, name: str = "") -> subprocess.Popen[bytes]:
    """Start a command in a folder; what it says goes to `stdout` and `stderr` there, before which `name` is put."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    with (folder / f"{name}stdout").open("w") as out, (folder / f"{name}stderr").open("w") as err:
        command = [sys.executable, "-m", "vpptwin", *arguments]
        return subprocess.Popen(command, stdout=out, stderr=err, cwd=folder, env=environment, start_new_session=True)


def finish(child: subprocess.Popen[bytes], folder: Path, kill: Kill | None = None, name: str = "") -> Ended:
    """Wait for a command, or kill it; how it ended."""
    ended = Ended()
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    if kill is not None:
        kill.wait(child, folder / "out")
        child.send_signal(kill.how)
    try:
        ended.code = child.wait(HANG if kill is None else 20.0)
    except subprocess.TimeoutExpired:
        ended.problems.append("hung" if kill is None else f"does not end by {kill.how.name}")
        child.kill()
        child.wait()
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    if peak > before and peak > MOST_MB * 1024:
        ended.problems.append(f"{peak / 1024:.0f} MB")
    said = ended.said = (folder / f"{name}stderr").read_text(errors="replace")
    if "Traceback" in said or "Exception ignored" in said:
        ended.problems.append(said[-1500:])
    allowed = {None, 0, 2} | ({SIGNALS[kill.how], -kill.how} if kill else set())
    if ended.code not in allowed:
        ended.problems.append(f"exit code {ended.code}: {said[-300:]}")
    lines = [line for line in re.split(r"[\r\n]", said) if line.startswith("vpptwin: ")]
    if ended.code == 2 and len(lines) != 1:
        ended.problems.append(f"{len(lines)} lines for exit code 2: {said[-500:]}")
    if ended.code in (130, 143) and lines != ["vpptwin: stopped"]:
        ended.problems.append(f"exit code {ended.code}: {said[-500:]}")
    if any(ord(c) < 32 and c not in "\n\r\t" for c in said):
        ended.problems.append(f"control characters: {said!r}")
    until = time.monotonic() + 3.0
    while (left := list_session(child.pid)) and time.monotonic() < until:
        time.sleep(0.05)  # Python's tracker of shared memory ends when it notices
    for process in left:
        ended.problems.append(f"left running: {process.cmdline()}")
        process.kill()
    if kill is not None and kill.how == signal.SIGKILL:  # which nothing can clean up after
        for path in (folder / "out").rglob(".vpptwin.*"):
            shutil.rmtree(path)
    return ended


def list_session(leader: int) -> list[psutil.Process]:
    """The processes of a session that are still there."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error, OSError):
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def run_one(rng: np.random.Generator, folder: Path) -> tuple[str, list[str]]:
    """Run a random command; its name with how it ended, and what was bad about it."""
    arguments = draw_command(rng, folder)
    kill = None
    if rng.random() < 1 / 3:
        kill = Kill(list(SIGNALS)[rng.integers(3)], float(rng.exponential(8.0)))
    ended = finish(start(arguments, folder), folder, kill)
    problems = [*ended.problems, *judge_files(folder / "out")]
    return f"{arguments[0]} {ended.code}", [f"{' '.join(arguments)}: {problem}" for problem in problems]


def fill(name: str, which: int) -> list[str]:
    """The arguments of a command that writes, on one of the two inputs."""
    words = INPUTS[which]
    return [str(DEMO / f"{words[word]}.mcap") if word == "LOG" else words.get(word, word) for word in WRITING[name]]


def read_files(folder: Path) -> dict[str, bytes]:
    """Every file below, without `MOMENT`."""
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: MOMENT.sub(b"", content) for name, content in files.items()}


def try_kills(name: str, rng: np.random.Generator, folder: Path, count: int) -> list[str]:
    """Kill a command over the results of another: each file is the old one or the new one, nothing else is there."""
    out, kept = folder / "out", folder / "kept"
    found, results = list[str](), []
    for which in (1, 0):
        out.mkdir()
        began = time.monotonic()
        found += finish(start(fill(name, which), folder), folder).problems
        took = time.monotonic() - began
        results.append(read_files(out))
        out.rename(kept if which else folder / "new")
    shutil.rmtree(folder / "new")
    old, new = results
    for number in range(count):
        shutil.copytree(kept, out)
        how = (signal.SIGKILL, signal.SIGINT)[number % 2]
        writing = rng.random() < 1 / 3
        kill = Kill(how, float(rng.uniform(0.0, 0.03) if writing else rng.uniform(0.0, 1.1 * took)), writing)
        ended = finish(start(fill(name, 0), folder), folder, kill)
        problems = [*ended.problems, *judge_files(out)]
        now = read_files(out)
        mixed = how == signal.SIGKILL  # in the very moment of exchange
        problems += [f"lost {file}" for file in old if file not in now and not (file not in new and now != old)]
        problems += [f"neither old nor new: {f}" for f in now if now[f] not in (old.get(f), new.get(f))]
        if not mixed and now not in (old, new):
            problems.append("of two runs")
        found += [f"{name}, {kill}: {problem}" for problem in problems]
        shutil.rmtree(out)
    shutil.rmtree(kept)
    return found


def try_pair(name: str, folder: Path) -> list[str]:
    """Run a command twice at once into one place: the results are those of one of the two."""
    out = folder / "out"
    results = []
    for which in range(2):
        out.mkdir()
        finish(start(fill(name, which), folder), folder)
        results.append(read_files(out))
        shutil.rmtree(out)
    out.mkdir()
    children = [start(fill(name, which), folder, str(which)) for which in range(2)]
    ended = [finish(child, folder, name=str(which)) for which, child in enumerate(children)]
    problems = [problem for end in ended for problem in end.problems] + judge_files(out)
    problems += [f"exit code {end.code}: {end.said}" for end in ended if end.code != 0]
    problems += [] if read_files(out) in results else ["of two runs"]
    shutil.rmtree(out)
    return [f"{name}, twice at once: {problem}" for problem in problems]


@contextmanager
def mount(folder: Path, options: str) -> Iterator[None]:
    """A small file system in a folder, for those who may."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "vpptwin", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextmanager
def limit_files(kilobytes: int) -> Iterator[None]:
    """What is started in the block writes no larger files."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * kilobytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def try_disks(name: str, folder: Path) -> list[str]:
    """Run a command onto disks that are full, soon full, and read-only: one line, and what was there stays.

    For users who may mount none, files that can grow no further stand for full disks.
    """
    found = []
    for options in ("size=4k", "size=8k", "size=32k", "size=64k", *(["size=64k,ro"] if os.geteuid() == 0 else [])):
        out = folder / "out"
        out.mkdir()
        with mount(out, options.partition(",")[0]) if os.geteuid() == 0 else limit_files(int(options[5:-1])):
            (out / "kept").write_text("old")
            if "," in options:
                subprocess.run(["mount", "-o", "remount,ro", str(out)], check=True)
            ended = finish(start(fill(name, 0), folder), folder)
            now = read_files(out)
            problems = [*ended.problems, *judge_files(out)]
            problems += [] if ended.code == 2 or len(now) > 1 else [f"exit code {ended.code}: {ended.said[-300:]}"]
            problems += [] if ended.code == 0 or now == {"kept": b"old"} else [f"there is {', '.join(now)}"]
            folders = [str(path) for path in out.rglob("*") if path.is_dir()] if ended.code else []
            problems += [f"left behind: {path}" for path in folders]
        out.rmdir()
        found += [f"{name}, {options}: {problem}" for problem in problems]
    return found


def main() -> int:
    """Run for so long, or so many trials; print what happened."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trials", type=int, help="kill every command that writes so often, instead")
    parser.add_argument("--only", action="append", metavar="NAME", help=f"of {', '.join(WRITING)}")
    options = parser.parse_args()
    counted: Counter[str] = Counter()
    problems: list[str] = []
    began, number = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only or WRITING if options.trials is not None else ():
            rng = np.random.default_rng([options.seed, *name.encode()])
            found = try_kills(name, rng, Path(folder), options.trials) + try_pair(name, Path(folder))
            found += try_disks(name, Path(folder))
            problems += found
            counted[name] += options.trials
            print(f"{name}: {options.trials} kills, {len(found)} problems", *found, sep="\n  ", file=sys.stderr)
        (Path(folder) / "out").mkdir(exist_ok=True)
        while options.trials is None and time.monotonic() < began + options.seconds:
            rng = np.random.default_rng([options.seed, number])
            name, found = run_one(rng, Path(folder))
            counted[name] += 1
            problems += [f"{number}: {problem}" for problem in found]
            for path in Path(folder).glob("fuzz_*"):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            number += 1
            print(f"\r{number} commands, {len(problems)} problems", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    report = {
        "commands": number,
        "seconds": round(time.monotonic() - began),
        "peak_MB": round(peak),
        "ends": dict(counted),
    }
    print(json.dumps({**report, "problems": problems}, indent=2))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
