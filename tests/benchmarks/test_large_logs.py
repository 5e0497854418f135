"""The benchmark of large logs writes logs that are read, and says what that takes."""

from __future__ import annotations

import pytest

from benchmarks import large_logs


@pytest.mark.parametrize("kind", large_logs.KINDS)
def test_large_logs_are_written_and_read(capfd: pytest.CaptureFixture[str], kind: str) -> None:
    """Both ways."""
    large_logs.main([kind, "--gigabytes", "0.001"])
    lines = capfd.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["inspect", "read a joint"]
    assert all(" GB so far, " in line for line in lines)
