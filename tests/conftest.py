"""What every test may need: data outside the repository, and a browser."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_configure() -> None:
    """Draw the seed of what is hidden in flights, unless it is given; workers of xdist inherit it."""
    os.environ.setdefault("VPPTWIN_SEED", str(int.from_bytes(os.urandom(4))))


def pytest_report_header() -> str:
    """Print the seed, so that a run can be repeated even where nothing failed."""
    return f"VPPTWIN_SEED={os.environ['VPPTWIN_SEED']}"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data beside the checkout; the test is skipped where there is none."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the measured data in {folder}")
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests marked `browser` where there is no Chromium."""
    if shutil.which("chromium"):
        return
    for item in items:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.skip(reason="needs Chromium: apt install chromium"))
