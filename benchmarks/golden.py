"""Whether a change of the code changes anything that comes out of it: outputs recorded once, compared to the last bit.

    python benchmarks/golden.py record ../golden --json benchmarks/results/golden.json
    python benchmarks/golden.py compare ../golden --jobs 2
    python benchmarks/golden.py compare benchmarks/results/golden.json --quick
    python benchmarks/golden.py compare ../golden --only 'kernel/*' example/antx_rail

Verdicts, reports, twins and predictions of sessions of all proving grounds and of measured logs, the texts of compiled
kernels, steps of the environments, exported controllers, what commands print (golden_set/items.py). Every item is a
process of its own in a folder of its own. `record` writes inputs and outputs below a folder, and their digests with the
causes that are named; `compare` runs everything again on the stored inputs and says where outputs differ first. With
digests alone inputs are made again. Processors and versions of packages other than the recorded ones give other floats.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import dataclass, field
from fnmatch import fnmatch
from itertools import zip_longest
from pathlib import Path
from typing import Any

from golden_set.inputs import ROOT
from golden_set.items import list_items
from golden_set.outputs import Outputs, digest, drop_varying
from same_rig.report import describe_machine

ALONE = {
    "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "COLUMNS": "120", "TERM": "dumb", "NO_COLOR": "1",
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
}  # fmt: skip
"""Environment of every item."""
SUMMARY = "golden.json"
SAID = 2000
"""Characters of what a process that failed said last."""


@dataclass(frozen=True)
class Done:
    """Outputs of an item, and what is kept of them: digests, the causes that are named, processor time [s]."""

    outputs: Outputs = field(default_factory=dict)
    told: dict[str, Any] = field(default_factory=dict)


def perform(name: str, inputs: Path) -> Done:
    """Prepare an item's inputs where they are not there, and run it.

    Raises:
        RuntimeError: with the end of what it said, if it failed.
    """
    with tempfile.TemporaryDirectory(prefix="golden_", dir="/tmp") as folder:  # a path as long as any other
        work = Path(folder)
        if (inputs / name).is_dir():
            shutil.copytree(inputs / name, work / "in")
        else:
            start("prepare", name, work)
            shutil.copytree(work / "in", inputs / name)
        seconds = start("run", name, work)
        given = read_folder(work / "in")
        outputs = {file: content.decode() for file, content in read_folder(work / "got").items()}
    told: dict[str, Any] = {"seconds": round(seconds, 1)}
    if "verdict.json" in outputs:
        told["causes"] = [[c["effect"], c["confidence"]] for c in json.loads(outputs["verdict.json"])["causes"]]
    told["inputs"] = digest(*(part for pair in given.items() for part in pair))
    told["files"] = {file: digest(text) for file, text in outputs.items()}
    return Done(outputs, told)


def start(stage: str, name: str, work: Path) -> float:
    """One stage of an item, `prepare` or `run`, in a process; processor time [s] with that of its children.

    Raises:
        RuntimeError: as `perform`.
    """
    said = work / f"{stage}.log"
    with said.open("w") as log:
        command = [sys.executable, str(Path(__file__).resolve()), stage, name]
        child = subprocess.Popen(command, cwd=work, env=os.environ | ALONE, stdout=log, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{stage}: {said.read_text()[-SAID:]}")
    return usage.ru_utime + usage.ru_stime


def work_here(stage: str, name: str) -> None:
    """What the process of `start` does: inputs go into `in`, outputs into `got` of the current folder."""
    item, here = list_items()[name], Path.cwd()
    if stage == "prepare":
        (here / "in").mkdir()
        item.prepare(here / "in")
        return
    (here / "out").mkdir()
    write_folder(here / "got", {file: drop_varying(text, here) for file, text in item.run().items()})


def read_folder(folder: Path) -> dict[str, bytes]:
    """The files of a folder by their path in it."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def write_folder(folder: Path, texts: Outputs) -> None:
    """Write the files of a folder, of which nothing else stays."""
    shutil.rmtree(folder, ignore_errors=True)
    for file, text in texts.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text)


def walk(old: Any, new: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:  # noqa: ANN401
    """Where two JSON contents differ: path and both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            yield from walk(old.get(key, "nothing"), new.get(key, "nothing"), f"{path}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, pair in enumerate(zip(old, new)):
            yield from walk(*pair, f"{path}[{i}]")
    elif repr(old) != repr(new):  # tells 1 from 1.0 and -0.0 from 0.0, and takes NaN for NaN
        yield path, old, new


def tell_difference(old: Outputs, new: Outputs) -> str:
    """Where outputs differ first, the verdict before all else, and how far floats do; "" where nothing does."""
    order = sorted({**old, **new}, key=lambda file: (file != "verdict.json", file))
    different = [file for file in order if old.get(file) != new.get(file)]
    if not different:
        return ""
    file, *others = different
    if file not in old or file not in new:
        told = f"{file} is {'new' if file in new else 'missing'}"
    elif file.endswith(".json"):
        told = f"{file} {tell_contents(json.loads(old[file]), json.loads(new[file]))}"
    else:
        lines = enumerate(zip_longest(old[file].split("\n"), new[file].split("\n"), fillvalue="nothing"), 1)
        told = next(f"{file}, line {i}: {a[:80]} -> {b[:80]}" for i, (a, b) in lines if a != b)
    return told + (f"; also {', '.join(others)}" if others else "")


def tell_contents(old: Any, new: Any) -> str:  # noqa: ANN401
    """The first difference of two JSON contents, how many there are, and the largest relative one of floats."""
    found = list(walk(old, new))
    if not found:
        return "in the order of its keys"
    place, before, after = found[0]
    pairs = [(a, b) for _, a, b in found if isinstance(a, float) and isinstance(b, float)]
    off = max((abs(a - b) / max(abs(a), abs(b), 1e-300) for a, b in pairs), default=0.0)
    floats = f", floats by {off:.2g} of their value at most" if pairs else ""
    return f"at {place}: {str(before)[:60]} -> {str(after)[:60]}; {len(found)} places{floats}"


def tell_causes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Whether two verdicts name the same causes in the same order."""
    if "causes" not in old or "causes" not in new:
        return ""
    before, after = (", ".join(effect for effect, _ in told["causes"]) or "nothing" for told in (old, new))
    return f"; same causes ({before})" if before == after else f"; CAUSES {before} -> {after}"


def compare(done: Done, stored: Mapping[str, Any], folder: Path | None) -> str:
    """What differs from what is stored, "" for nothing: by the texts in a folder, or by digests alone."""
    if folder is not None:
        told = tell_difference({file: text.decode() for file, text in read_folder(folder).items()}, done.outputs)
    else:
        old, new = stored["files"], done.told["files"]
        told = ", ".join(file for file in sorted({**old, **new}) if old.get(file) != new.get(file))
    changed = "" if stored["inputs"] == done.told["inputs"] else "; INPUTS DIFFER"
    return told and told + tell_causes(stored, done.told) + changed


def read_summary(path: Path) -> dict[str, Any]:
    """What `write_summary` wrote; nothing where there is none."""
    return json.loads(path.read_text()) if path.is_file() else {"items": {}}


def write_summary(path: Path, items: Mapping[str, Any]) -> None:
    """Digests and causes, a line an item, with machine and commit; items that were not run stay."""
    known = {**read_summary(path)["items"], **items}
    parts = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in describe_machine().items()]
    rows = ",\n".join(f"  {json.dumps(name)}: {json.dumps(known[name])}" for name in sorted(known))
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")  # others may be comparing with it
    draft.write_text("{\n" + ",\n".join([*parts, f' "items": {{\n{rows}\n }}']) + "\n}\n")
    draft.replace(path)


def record_all(names: Sequence[str], folder: Path, jobs: int, also: Path | None) -> list[str]:
    """Record items; those that failed."""

    def record(name: str) -> tuple[Done, str]:
        done = perform(name, folder / "inputs")
        write_folder(folder / name, done.outputs)
        return done, ""

    kept: dict[str, Any] = {}

    def keep(name: str, done: Done) -> None:
        kept[name] = done.told
        for path in filter(None, (folder / SUMMARY, also)):
            write_summary(path, kept)

    return run_all(names, record, jobs, "recorded", keep)


def compare_all(names: Sequence[str], stored: Path, jobs: int) -> list[str]:
    """Compare items with a folder, or with a file of digests; those that differ or failed."""
    alone = stored.is_file()
    summary = read_summary(stored if alone else stored / SUMMARY)
    for key, now in describe_machine().items():
        then = summary.get(key, {})
        changed = [part for part in now if now[part] != then.get(part)] if isinstance(now, dict) else []
        for part in (part for part in changed if part != "load_average"):
            print(f"{part} was {then.get(part)}, is {now[part]}")
    with ExitStack() as stack:
        spare = Path(stack.enter_context(tempfile.TemporaryDirectory()))

        def check(name: str) -> tuple[Done, str]:
            if name not in summary["items"]:
                return Done(), "was not recorded"
            done = perform(name, spare if alone else stored / "inputs")
            return done, compare(done, summary["items"][name], None if alone else stored / name)

        return run_all(names, check, jobs, "equal")


def run_all(
    names: Sequence[str], handle: Callable[[str], tuple[Done, str]], jobs: int, good: str,
    keep: Callable[[str, Done], None] = lambda name, done: None,
) -> list[str]:  # fmt: skip
    """Handle items, so many at once, and print a line for each; those that something is wrong with."""
    wrong = []
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(handle, name): name for name in names}
        for future in as_completed(running):
            name = running[future]
            try:
                done, told = future.result()
                keep(name, done)
            except RuntimeError as error:
                done, told = Done(), f"failed in {error}"
            wrong += [name] if told else []
            seconds = done.told.get("seconds", 0.0)
            print(f"{'DIFFERS' if told else good:8} {name:30} {seconds:6.1f} s  {told}".rstrip(), flush=True)
    return wrong


def main() -> int:
    """Record or compare; 1 where something differs or failed."""
    if sys.argv[1:2] in (["prepare"], ["run"]):  # by `start`
        work_here(*sys.argv[1:])
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("folder", type=Path, help="of inputs and outputs; to compare, a file of digests will do")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="PATTERN", help="items, such as 'drone/*'")
    parser.add_argument("--quick", action="store_true", help="a subset that takes less than three minutes")
    parser.add_argument("--jobs", type=int, default=1, help="items at once")
    parser.add_argument("--json", type=Path, help="record: where digests go besides FOLDER/golden.json")
    options = parser.parse_args()
    items = list_items()
    names = [n for n in items if any(fnmatch(n, p) for p in options.only) and (items[n].quick or not options.quick)]
    if not names:
        parser.error(f"no item is called {' '.join(options.only)}; there are {', '.join(items)}")
    if options.what == "record":
        wrong = record_all(names, options.folder, options.jobs, options.json)
    else:
        wrong = compare_all(names, options.folder, options.jobs)
    print(
        f"{len(names) - len(wrong)} of {len(names)} {'fine' if not wrong else 'fine, not ' + ', '.join(sorted(wrong))}"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
