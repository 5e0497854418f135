"""Effects that a package brings: its entry point in `vpptwin.effects` is named wherever a file may be named."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.builders import VERDICT
from tests.twin.own_effect_files import WAVE, write_rig
from vpptwin.cli.main import main
from vpptwin.report.provenance import trace_origin
from vpptwin.report.twin_file import compose_twin
from vpptwin.system.installed import list_installed, locate_effects
from vpptwin.twin import load_twin

RUN = "raise SystemExit('a package was run that nobody named')"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages: one with effects in a module of its own, one whose module is missing."""
    site = tmp_path / "site"
    for folder, text in (("my_rigs", ""), ("my_rigs/belts", ""), ("loud", RUN)):
        (site / folder).mkdir(parents=True)
        (site / folder / "__init__.py").write_text(text)
    (site / "my_rigs/belts/wave.py").write_text(WAVE)
    info = site / "my_rigs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-rigs\nVersion: 1.0\n")
    points = "wavy-rail = my_rigs.belts.wave\nnothing = my_rigs.nothing\nloud = loud\n"
    (info / "entry_points.txt").write_text(f"[vpptwin.effects]\n{points}")
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    list_installed.cache_clear()
    yield site / "my_rigs/belts/wave.py"
    list_installed.cache_clear()


def test_a_name_is_the_file_of_its_module(package: Path, tmp_path: Path) -> None:
    """Found without running anything; a file of that name wins, an unknown name stays a path."""
    assert list_installed()["wavy-rail"] == package
    assert set(list_installed()) == {"wavy-rail", "loud"}
    assert locate_effects("wavy-rail", tmp_path) == package
    assert locate_effects("absent.py", tmp_path) == tmp_path / "absent.py"
    (tmp_path / "wavy-rail").write_text(WAVE)
    assert locate_effects("wavy-rail", tmp_path) == tmp_path / "wavy-rail"


def test_an_installed_effect_is_a_suspect_and_needs_no_further_word(package: Path, tmp_path: Path) -> None:
    """By its name on the command line; the extended twin names it so, and runs it, as installing it was the word."""
    twin = write_rig(tmp_path)
    spec = load_twin(twin, ["wavy-rail"])
    assert spec.catalogue[-1].id == "slide.wave"
    origin = trace_origin(["diagnose"], spec.name, [])
    text = compose_twin(spec, {"slide.wave": {"force": 0.4}}, VERDICT, origin, tmp_path)
    assert yaml.safe_load(text)["effects_from"] == ["wavy-rail"]
    (tmp_path / "extended.yaml").write_text(text)
    assert load_twin(tmp_path / "extended.yaml").effects == {"slide.wave": {"force": 0.4}}


def test_a_misspelt_name_is_answered(package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the installed one that is close."""
    assert main(["effects", "--twin", str(write_rig(tmp_path)), "--effects", "wavy_rail"]) == 2
    assert "no readable effects file wavy_rail; expected a Python file with effects; did you mean wavy-rail?" in (
        capsys.readouterr().err
    )
