"""The Cortex-M4F benchmark, where its tools are installed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")


def test_the_controller_runs_on_an_emulated_cortex_m4(tmp_path: Path) -> None:
    """Test vectors pass on the target; the policy fits into its 10 ms many times over, the cascade into its 1 ms."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}")
    out = tmp_path / "cortex.json"
    command = [sys.executable, str(ROOT / "benchmarks/cortex_m4.py"), "flip", "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for result in json.loads(out.read_text())["results"].values():
        assert result["failed"] == 0
        assert 10_000 < result["policy"] < 100_000
        assert 100 < result["cascade_map"] < result["cascade_adaptive"] < 5_000
        assert result["flash"] < 60_000
        assert result["image_ram"] < 4_000
