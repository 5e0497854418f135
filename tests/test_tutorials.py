"""The tutorials of docs/tutorials are run as they are written, in an empty folder, and say what they promise."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs/tutorials"
PROMISED = {
    "own_rig": ["wrote cart.yaml", "± 0.03 N on joint slide takes the error half a second ahead", "whole-log chi²"],
    "quadrotor": ["Correcting a wrong gain of actuator m2 (0.85", "whole-log chi² 300 of quadrotor.yaml, 0.978 of"],
    "arm": ["wrote arm.yaml", "A payload of 61 ± 2 g on forearm", "whole-log chi² 292 of arm.yaml, 0.86"],
    "so101": ["Viscous friction of 0.5 ± 0.2 N m s/rad on joint Rotation", "ahead from 20.5 to 12.6 mrad",
        "│ 7.93 → 5.88", "│ 23.6 → 12.7", "│ 18.3 → 11.7", "motion.html"],
    "leg": ["Dry friction of 0.100 ± 0.005 N m on joint knee", "whole-log chi² 351,000 of leg.yaml, 41.6 of"],
    "retrain": ["ms from command to servo", "20 flights of flip"],
    "write_effect": ["no known effect explains", "It follows rail_x position",
        "A belt that cogs on the horizontal rail"],
    "close_the_loop": ["wrong thrust constant", "otors of unequal thrust", "20 flights of flip", "whole-log chi²"],
}  # fmt: skip
"""Words of what the commands of a page print."""
SHORTER = {
    "train": ["total_steps=8192", "num_envs=16", "rollout=32"],
    "evaluate": ["--tracks", "20"],
}
"""What makes a command short: what a policy is worth, others measure."""


def list_steps(page: str) -> list[tuple[str, str]]:
    """What a reader does: files (name, text) and commands ("", line), in order."""
    pattern = r'^```\w+ title="([^"]+)"\n(.*?)^```$|^ {4,8}((?:vpptwin|python) [^\n]*)$'
    return [(name, text or command) for name, text, command in re.findall(pattern, page, re.DOTALL | re.MULTILINE)]


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
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "400"}
    said = ""
    for file, text in list_steps((FOLDER / f"{name}.md").read_text(encoding="utf-8")):
        if file:
            (tmp_path / file).write_text(text, encoding="utf-8")
            continue
        done = subprocess.run(shorten(text), cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{text}\n{done.stderr[-2000:]}"
        said += done.stdout
    missing = [words for words in PROMISED[name] if words not in " ".join(said.split())]
    assert not missing, said


def test_pages_of_measured_robots_show_what_is_printed() -> None:
    """What `test_tutorial` finds in the output stands in the page, which so is current."""
    page = (FOLDER / "so101.md").read_text(encoding="utf-8")
    assert [words for words in PROMISED["so101"] if words.removeprefix("│ ") not in page] == []
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
