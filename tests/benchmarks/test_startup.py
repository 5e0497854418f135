"""The benchmark of start-up: its table and its file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "startup.py"
PACKAGE = 'python -c "import vpptwin"'


def test_commands_against_the_reference(tmp_path: Path) -> None:
    """One round of the cheapest: the package itself costs less than MuJoCo and NumPy do."""
    out = tmp_path / "out.json"
    command = [sys.executable, str(BENCHMARK), "--rounds", "1", "--only", PACKAGE, "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    reference, package = json.loads(out.read_text())["rows"]
    assert reference["wall_ratio"] == reference["processor_ratio"] == 1.0
    assert package["name"] == PACKAGE
    assert 0.0 < package["processor_ratio"] < 1.0
    assert f"| `{PACKAGE}` |" in done.stdout
