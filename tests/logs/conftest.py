"""A recording of the independent simulation to spoil."""

from __future__ import annotations

import pytest

from proving.drone.flight import fly
from proving.drone.recording import Recording


@pytest.fixture(scope="session")
def recording() -> Recording:
    """Eight seconds with a half flip and back at up to 12 rad/s, in gusts, mocap gaps included."""
    return fly({}, "flip", 8.0, seed=3)
