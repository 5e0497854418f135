"""The campaign of the paper's table goes on from its results."""

from __future__ import annotations

import json
from pathlib import Path

import paper_table as table
import pytest
from training import campaign


def test_a_campaign_goes_on_from_its_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the file has is not trained again, what it lacks is added after every run; other options are refused."""
    trained = []

    def finish(run: object, tracks: int) -> dict:
        if len(trained) == 1 and not (tmp_path / "broken").exists():
            (tmp_path / "broken").touch()
            raise KeyboardInterrupt
        trained.append((run.variant, run.seed))  # type: ignore[attr-defined]
        error = {"mean": 0.01}
        measured = {"fail_rate": 0.0, "success_share": 1.0, "full_turns": {"asked": 1, "made": 1}}
        key = {"variant": run.variant, "seed": run.seed, "tracks": tracks, "curve": {}}  # type: ignore[attr-defined]
        return measured | key | {"upright_error_m": error, "inverted_error_m": error}

    monkeypatch.setattr(campaign, "finish", finish)
    file = tmp_path / "table.json"
    command = [
        "--variants",
        "VA",
        "All",
        "--tracks",
        "5",
        "--jobs",
        "1",
        "--folder",
        str(tmp_path),
        "--json",
        str(file),
    ]
    with pytest.raises(KeyboardInterrupt):
        table.main([*command, "--seeds", "1"])
    assert [run["variant"] for run in json.loads(file.read_text())["runs"]] == ["VA"]
    assert table.main([*command, "--seeds", "2"]) == 0
    assert trained == [("VA", 0), ("All", 0), ("VA", 1), ("All", 1)]
    assert [(run["variant"], run["seed"]) for run in json.loads(file.read_text())["runs"]] == trained
    assert table.main([*command, "--seeds", "2", "--options", "preset=paper"]) == 2
