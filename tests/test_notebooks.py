"""The notebooks of examples/notebooks run from top to bottom, and say what their text promises."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

pytest.importorskip("ipykernel")
nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "notebooks"
PROMISED = {
    "quickstart": ["on the horizontal rail", "force rail_x.coulomb", "nominal: chi²", "report.html"],
    "own_rig": ["Dry friction of 0.", "slide.coulomb"],
    "so101": ["Viscous friction of 0.", "Rotation.viscous: damping", "so101/out/twin.yaml"],
    "training": ["of 20 flights failed", "mm off in the mean", "tensor("],
}
"""Words of their output."""


STORED = {"so101"}
"""Notebooks of measured data, whose outputs are kept."""
NUMBER = re.compile(r"[-+]?\d[\d,]*(?:\.\d+)?")


def read_said(notebook: nbformat.NotebookNode) -> str:
    """What all cells print to standard output, or show as text."""
    return "".join(
        str(output.get("text", "") or output.get("data", {}).get("text/plain", ""))
        for cell in notebook.cells if cell.cell_type == "code"
        for output in cell.outputs if output.get("name") != "stderr"
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PROMISED))
def test_notebook(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a kernel of its own, in an empty folder. Stored outputs are current: the same words, numbers within 5 %."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    stored = read_said(notebook)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    said = read_said(notebook)
    missing = [words for words in PROMISED[name] if words not in said]
    assert not missing, said
    if name in STORED:
        assert NUMBER.sub("#", said) == NUMBER.sub("#", stored)
        now, then = ([float(n.replace(",", "")) for n in NUMBER.findall(text)] for text in (said, stored))
        assert now == pytest.approx(then, rel=0.05)


def test_every_notebook_is_run() -> None:
    """None is left out; results are kept of measured data alone."""
    files = sorted(FOLDER.glob("*.ipynb"))
    assert {file.stem for file in files} == set(PROMISED)
    for file in files:
        kept = any(cell.get("outputs") for cell in nbformat.read(file, as_version=4).cells)
        assert kept == (file.stem in STORED), file


def test_stored_outputs_say_what_the_tutorial_says() -> None:
    """The headline of the SO-101 is one in the notebook and on the page."""
    told = " ".join(read_said(nbformat.read(FOLDER / "so101.ipynb", as_version=4)).split())
    page = " ".join((ROOT / "docs/tutorials/so101.md").read_text(encoding="utf-8").split())
    headline = re.search(r"```text (.*?) takes? the error", page)
    assert headline is not None
    assert headline[1] in told
