"""Tables and pictures of README and docs that come from recorded results say what these results say."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from vpptwin.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
LOOP = " ".join(f"benchmarks/results/close_the_loop_{seed}.json" for seed in range(3))
RECORDED = {
    "loop": f"close_the_loop.py --report {LOOP} --picture OUT/loop.svg",
    "stuck": "close_the_loop.py --report benchmarks/results/close_the_loop_stuck.json",
    "hidden_51959": "hidden_effects.py --report benchmarks/results/hidden_51959.json --pictures OUT",
    "paper_table": "paper_table.py --report benchmarks/results/paper_table.json --pictures OUT",
    "switches": "paper_table.py --report benchmarks/results/switches.json",
    "paper_method": "paper_table.py --report benchmarks/results/paper_table_paper.json",
}
"""What prints a record's tables and draws its pictures."""
PICTURES = {
    "loop.svg": "loop",
    "hidden_confusion.svg": "hidden_51959",
    "hidden_detection.svg": "hidden_51959",
    "training_curves.svg": "paper_table",
}
NUMBER = re.compile(r"\d+ of \d+|\d+(?:\.\d+)?")


@cache
def replay_record(name: str, folder: Path) -> str:
    """What a record's command prints; its pictures lie in a folder then."""
    given = shlex.split(RECORDED[name].replace("OUT", str(folder)))
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as said:
        patch.chdir(ROOT)
        patch.syspath_prepend(str(ROOT / "benchmarks"))
        patch.setattr(sys, "argv", [f"benchmarks/{given[0]}", *given[1:]])
        try:
            runpy.run_path(sys.argv[0], run_name="__main__")
        except SystemExit as ended:
            if ended.code:
                pytest.fail(f"{RECORDED[name]}: {ended.code}")
    return said.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pictures are drawn."""
    return tmp_path_factory.mktemp("pictures")


@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_is_the_one_that_its_record_draws(picture: str, folder: Path) -> None:
    """To the last byte: `docs/pictures` holds what the command draws now."""
    replay_record(PICTURES[picture], folder)
    assert (ROOT / "docs/pictures" / picture).read_text() == (folder / picture).read_text(), RECORDED[PICTURES[picture]]


@pytest.mark.parametrize("picture", ["flight.svg", "policy_flip.svg", pytest.param("wall.svg", marks=pytest.mark.slow)])
def test_the_picture_of_a_flight_is_the_one_that_its_commands_draw(tmp_path: Path, picture: str) -> None:
    """The same words, and lines within a hundredth of its size: another machine rounds otherwise."""
    log = ROOT / "demo/flights/flip.mcap"
    if picture == "policy_flip.svg":
        log = tmp_path / "flip.mcap"
        assert main(["fly", "flip", "--out", str(log)]) == 0
    if picture == "wall.svg":
        log = tmp_path / "wall.mcap"
        given = ["wall-backtrack", "--flights", "1", "--effects", "none", "--log", str(log)]
        subprocess.run([sys.executable, "benchmarks/policy_in_reality.py", *given], cwd=ROOT, check=True)
    twin = "strong" if picture == "wall.svg" else "nominal"
    assert main(["plot", str(log), "--twin", twin, "--out", str(tmp_path / picture)]) == 0
    texts = [path.read_text(encoding="utf-8") for path in (tmp_path / picture, ROOT / "docs/pictures" / picture)]
    words, lines = zip(*((re.findall(r">([^<>]+)</text>", text), re.findall(r' d="([^"]+)"', text)) for text in texts))
    assert words[0] == words[1]
    drawn, kept = (np.array([float(n) for n in re.findall(r"-?[\d.]+", " ".join(found))]) for found in lines)
    assert np.abs(drawn - kept).max() < 0.01 * kept.max()


def read_rows(text: str) -> list[list[str]]:
    """Rows of Markdown tables, as cells."""
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows]


def read_section(page: str, words: str) -> str:
    """The section of a page of docs that speaks of a record."""
    sections = re.split(r"^## ", (ROOT / "docs" / page).read_text(encoding="utf-8"), flags=re.MULTILINE)
    (section,) = [section for section in sections[1:] if words in section]
    return section


def test_the_page_of_results_is_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    """docs/benchmarks.md is what `python benchmarks/tables.py` prints."""
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    page = runpy.run_path("benchmarks/tables.py")["write_page"]()
    assert page == (ROOT / "docs/benchmarks.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "least"), [("hidden_51959", 4), ("other_*", 4)])
def test_rates_of_the_readme_are_those_of_the_page(name: str, least: int) -> None:
    """Every `a of b` that README claims of a record stands in the tables of docs/benchmarks.md."""
    rows = [row for row in read_rows((ROOT / "README.md").read_text(encoding="utf-8")) if f"{name}.json" in row[-1]]
    claimed = re.findall(r"\d+ of \d+", " ".join(row[1] for row in rows))
    printed = set(re.findall(r"\d+ of \d+", (ROOT / "docs/benchmarks.md").read_text(encoding="utf-8")))
    assert len(claimed) >= least
    assert set(claimed) <= printed


@pytest.mark.parametrize(
    ("name", "page", "file", "least"),
    [
        ("loop", "loop.md", "close_the_loop_0.json", 10),
        ("stuck", "loop.md", "close_the_loop_stuck.json", 3),
        ("paper_table", "train.md", "paper_table.json", 10),
        ("switches", "train.md", "switches.json", 13),
        ("paper_method", "train.md", "paper_table_paper.json", 3),
    ],
)
def test_tables_are_those_of_the_record(name: str, page: str, file: str, least: int, folder: Path) -> None:
    """Every row of the first table behind the record's name has the numbers of one that its command prints."""
    printed = [set(NUMBER.findall(" ".join(row[1:]))) for row in read_rows(replay_record(name, folder))]
    section = read_section(page, f"results/{file}")
    table = re.search(r"^\|.*?\n\n", section[section.index(f"results/{file}") :], flags=re.DOTALL | re.MULTILINE)
    assert table is not None
    documented = [set(NUMBER.findall(" ".join(row[1:]))) for row in read_rows(table[0])]
    assert len(documented) >= least
    for row in documented:
        assert any(row <= other for other in printed), row


def test_the_readme_tells_the_loop_as_it_was_measured(folder: Path) -> None:
    """Its mean errors are those that the record's command prints."""
    printed = replay_record("loop", folder)
    (row,) = [row for row in read_rows((ROOT / "README.md").read_text(encoding="utf-8")) if "close_the_loop" in row[-1]]
    nominal, extended, truth = re.findall(r"[\d.]+(?= mm)", row[1])
    assert f"mean score nominal {nominal} mm" in printed
    assert f"extended {extended} mm, oracle {truth} mm" in printed


@pytest.mark.slow
def test_the_readme_tells_what_the_policy_that_ships_is_worth(capsys: pytest.CaptureFixture[str]) -> None:
    """The row that names `evaluate flip --tracks 1000 --seed 1` has its figures."""
    assert main(["evaluate", "flip", "--tracks", "1000", "--seed", "1"]) == 0
    said = re.match(
        r"1000 flights of flip in twin nominal: (\d+) failed, ([\d.]+) mm upright, ([\d.]+) mm inverted, (\d+ of \d+)",
        capsys.readouterr().out,
    )
    assert said is not None
    rows = read_rows((ROOT / "README.md").read_text(encoding="utf-8"))
    (row,) = [row for row in rows if row[-1].startswith("`vpptwin evaluate flip --tracks 1000 --seed 1`")]
    wanted = f"{0.1 * int(said[1]):.1f} % failed, position error {said[2]} mm upright, {said[3]} mm inverted"
    assert row[1].startswith(wanted)
    assert f"{said[4]} full turns" in row[1]
