"""The notebooks of examples/notebooks run from top to bottom, and say what their text promises."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("ipykernel")
nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "notebooks"
PROMISED = {
    "quickstart": ["on the horizontal rail", "force rail_x.coulomb", "nominal: chi²", "report.html"],
    "own_rig": ["Dry friction of 0.", "slide.coulomb"],
    "training": ["of 20 flights failed", "mm off in the mean", "tensor("],
}
"""Words of their output."""


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PROMISED))
def test_notebook(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a kernel of its own, in an empty folder."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    said = "".join(
        str(output.get("text", "") or output.get("data", {}).get("text/plain", ""))
        for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    )  # fmt: skip
    missing = [words for words in PROMISED[name] if words not in said]
    assert not missing, said


def test_every_notebook_is_run_and_bare() -> None:
    """None is left out; results of runs are not kept in the repository."""
    files = sorted(FOLDER.glob("*.ipynb"))
    assert {file.stem for file in files} == set(PROMISED)
    for file in files:
        cells = nbformat.read(file, as_version=4).cells
        assert not any(cell.get("outputs") for cell in cells)
