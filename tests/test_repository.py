"""One setting says where the repository lies: `make repository URL=...`."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from shutil import copy

import yaml

ROOT = Path(__file__).resolve().parents[1]
FILES = ("pyproject.toml", "CITATION.cff", "mkdocs.yml", "README.md")
URL = "https://example.org/somebody/vpptwin"


def test_one_setting_fills_all_places(tmp_path: Path) -> None:
    """Metadata, citation, site and README name it once; another takes its place, and none leaves no trace."""
    (tmp_path / ".ci").mkdir()
    copy(ROOT / ".ci/repository.py", tmp_path / ".ci")
    for name in FILES:
        copy(ROOT / name, tmp_path)

    def run(url: str) -> int:
        return subprocess.run([sys.executable, tmp_path / ".ci/repository.py", url], capture_output=True).returncode

    before = {}
    for url in ("", "https://example.org/first", URL):
        assert run(url) == 0
        before = before or {name: (tmp_path / name).read_text() for name in FILES}
    urls = tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]["urls"]
    assert (urls["Repository"], urls["Issues"]) == (URL, f"{URL}/issues")
    assert yaml.safe_load((tmp_path / "CITATION.cff").read_text())["repository-code"] == URL
    assert f"repo_url: {URL}\n" in (tmp_path / "mkdocs.yml").read_text()
    assert (tmp_path / "README.md").read_text().count(f"Source: <{URL}>.") == 1
    assert run("somewhere") == 1
    assert run("") == 0
    assert {name: (tmp_path / name).read_text() for name in FILES} == before
