"""The benchmark of large logs writes logs that are read, and says what that takes."""

from __future__ import annotations

import pytest

from benchmarks import large_logs

JOBS = {kind: ["read"] for kind in large_logs.KINDS if kind != "csv"} | {"mcap": list(large_logs.JOBS)}


@pytest.mark.parametrize(
    "kind", [kind if kind == "mcap" else pytest.param(kind, marks=pytest.mark.slow) for kind in JOBS]
)
def test_large_logs_are_written_and_read(capfd: pytest.CaptureFixture[str], kind: str) -> None:
    """Read, inspected and converted, or a stretch of them."""
    large_logs.main([kind, "--gigabytes", "0.001", "--jobs", *JOBS[kind], "--stretch", "@0.1-0.5"])
    lines = capfd.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == JOBS[kind]
    assert all(" GB, " in line and "ended with" not in line for line in lines)
