"""The benchmark of large logs writes logs that are read, and says what that takes."""

from __future__ import annotations

import pytest

from benchmarks import large_logs


@pytest.mark.parametrize("kind", large_logs.KINDS)
def test_large_logs_are_written_and_read(capfd: pytest.CaptureFixture[str], kind: str) -> None:
    """Read, inspected, converted, and a stretch of it read."""
    large_logs.main([kind, "--gigabytes", "0.001"])
    large_logs.main([kind, "--gigabytes", "0.001", "--jobs", "read", "--stretch", "@0-0.5"])
    lines = capfd.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["read", "inspect", "convert", "read"]
    assert all(" GB, " in line and "ended with" not in line for line in lines)
