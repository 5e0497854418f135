"""The tutorials of docs/tutorials are run as they are written, in an empty folder, and say what they promise.

python -m tests.test_tutorials own_rig arm     # quotes anew what their commands print; shows what else they say
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs/tutorials"
PROMISED = {
    "own_rig": ["wrote cart.yaml", "Dry friction of 0.5", "whole-log chi²"],
    "quadrotor": ["Correcting a wrong gain of actuator m2 (0.85", "whole-log chi² 300 of quadrotor.yaml, 0.9"],
    "arm": ["wrote arm.yaml", "A payload of 6", "whole-log chi² 292 of arm.yaml"],
    "so101": ["iscous friction of 0.", "motion.html"],
    "leg": ["N m on joint knee takes the error", "whole-log chi² 351,000 of leg.yaml, 4"],
    "retrain": ["ms from command to servo", "20 flights of flip"],
    "write_effect": ["no known effect explains", "It follows rail_x position",
        "A belt that cogs on the horizontal rail"],
    "close_the_loop": ["wrong thrust constant", "otors of unequal thrust", "20 flights of flip", "whole-log chi²"],
}  # fmt: skip
"""Words of what the commands of a page print, besides what the page quotes."""
ROW = re.compile(r"^(\| \S+ s \| )\S+ → \S+( mrad \|)$", re.MULTILINE)
"""A row of a page's table of errors."""
SHORTER = {
    "train": ["total_steps=8192", "num_envs=16", "rollout=32"],
    "evaluate": ["--tracks", "20"],
}
"""What makes a command short: what a policy is worth, others measure."""


def list_steps(page: str) -> list[tuple[str, str]]:
    """What a reader does: files (name, text) and commands ("", line), in order."""
    pattern = r'^```\w+ title="([^"]+)"\n(.*?)^```$|^ {4,8}((?:vpptwin|python) [^\n]*)$'
    return [(name, text or command) for name, text, command in re.findall(pattern, page, re.DOTALL | re.MULTILINE)]


def list_quotes(page: str) -> list[str]:
    """What a page says that its commands print: blocks of text, and errors at a horizon, without breaks of lines."""
    blocks = re.findall(r"^```text\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    rows = [re.sub(r"^\| (\S+ s) \| | mrad \|$", r"\1 │ ", row[0]).strip(" │") for row in ROW.finditer(page)]
    return [" ".join(text.split()) for text in [*blocks, *rows]]


def run_page(name: str, folder: Path) -> str:
    """Do what a page says in an empty folder; what its commands print."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "400"}
    said = ""
    for file, text in list_steps((FOLDER / f"{name}.md").read_text(encoding="utf-8")):
        if file:
            (folder / file).write_text(text, encoding="utf-8")
            continue
        done = subprocess.run(shorten(text), cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{text}\n{done.stderr[-2000:]}"
        said += done.stdout
    return said


def quote_anew(page: str, said: str) -> str:
    """A page with what its commands print now: the headlines of their verdicts, and errors at a horizon."""
    paragraphs = [part.strip("\n") for part in said.split("\n\n") if part.strip()]
    verdicts = [
        part if "takes the error" in part or "take the error" in part else "\n".join(paragraphs[i : i + 2])
        for i, part in enumerate(paragraphs)
        if re.search(r"takes? the error|no known effect explains", part)
    ]
    blocks = iter(verdicts)
    page = re.sub(
        r"^```text\n.*?^```$", lambda _: f"```text\n{next(blocks)}\n```", page, flags=re.DOTALL | re.MULTILINE
    )
    errors = dict(re.findall(r"^(\S+ s) +│ +(\S+ → \S+)", said, re.MULTILINE))
    return ROW.sub(lambda row: f"{row[1]}{errors[row[1].strip('| ')]}{row[2]}", page)


def shorten(command: str) -> list[str]:
    """A command as the test runs it."""
    words = shlex.split(command)
    if words[0] == "python":
        return [sys.executable, *words[1:]]
    return [sys.executable, "-m", *words, *SHORTER.get(words[1], [])]


@pytest.mark.parametrize(
    "name", [name if name == "own_rig" else pytest.param(name, marks=pytest.mark.slow) for name in PROMISED]
)
def test_tutorial(name: str, tmp_path: Path) -> None:
    """Every file, every command."""
    said, page = run_page(name, tmp_path), (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    missing = [words for words in [*PROMISED[name], *list_quotes(page)] if words not in " ".join(said.split())]
    assert not missing, f"python -m tests.test_tutorials {name}\n{said}"


def test_the_picture_of_a_measured_robot_is_of_its_page() -> None:
    """The sentence that it shows stands in the page."""
    page = (FOLDER / "so101.md").read_text(encoding="utf-8")
    picture = Image.open(ROOT / "docs/pictures/so101.png").info["Description"]
    assert picture in page, "vpptwin demo so101 && python -m tests.viz.pictures"


def test_the_readme_shows_what_a_tutorial_does() -> None:
    """Its first commands and what they say are those of the tutorial about a rig of one's own, which is run."""
    readme, page = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/tutorials/own_rig.md"))
    section = re.split(r"^## ", readme, flags=re.MULTILINE)[1]
    shown = [re.sub(r"\s+#.*", "", line) for line in re.findall(r"^ {4}(vpptwin .*)$", section, re.MULTILINE)]
    said = re.findall(r"^```text\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
    assert (len(shown), len(said)) == (3, 1)
    assert [words for words in [*shown, *said] if words not in page] == []


def test_every_tutorial_is_run_and_fits_a_page() -> None:
    """None is left out; none has more than a page's text."""
    pages = {page.stem: page.read_text(encoding="utf-8") for page in FOLDER.glob("*.md")}
    assert set(pages) == set(PROMISED)
    for text in pages.values():
        assert len(list_steps(text)) >= 5 or "vpptwin demo" in text
        assert len(text.splitlines()) <= 90


if __name__ == "__main__":
    for name in sys.argv[1:] or PROMISED:
        with TemporaryDirectory() as folder:
            said = run_page(name, Path(folder))
        path = FOLDER / f"{name}.md"
        path.write_text(quote_anew(path.read_text(encoding="utf-8"), said), encoding="utf-8")
        print(name, *re.findall(r"whole-log.*", said), sep="\n  ")
    readme, first = ROOT / "README.md", list_quotes((FOLDER / "own_rig.md").read_text(encoding="utf-8"))[0]
    text = readme.read_text(encoding="utf-8")
    readme.write_text(re.sub(r"(?<=^```text\n).*?(?=^```$)", f"{first}\n", text, flags=re.DOTALL | re.MULTILINE))
