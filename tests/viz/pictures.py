"""Draws the pictures of the documentation: python -m tests.viz.pictures (needs Chromium)."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.viz.browser import Browser
from vpptwin.demo import DIAGNOSED
from vpptwin.diagnosis.command import diagnose_logs
from vpptwin.estimation.replay import replay
from vpptwin.logs import read_flight
from vpptwin.twin.spec import load_twin
from vpptwin.viz.playback import play_page

ROOT = Path(__file__).resolve().parents[2]
MOMENT = 4.17  # s of flip.mcap: half turned, the twin lagging
SIZE = (1120, 630)  # px


def draw_flip(out: Path) -> None:
    """The page of demo/flights/flip.mcap beside the nominal twin, in the middle of a flip."""
    flight, spec = read_flight(ROOT / "demo/flights/flip.mcap"), load_twin()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        page = play_page(flight, replay(spec, flight), Path(folder) / "flip.html", spec=spec)
        with Browser(Path(folder) / "profile", size=SIZE) as browser:
            browser.open(page)
            browser.evaluate(f"scrub.value = {MOMENT}; scrub.dispatchEvent(new Event('input')); 0")
            browser.evaluate("view.value = 'craft'; view.dispatchEvent(new Event('change')); 0")
            browser.draw_frames()
            out.write_bytes(browser.take_picture())


def draw_report(out: Path) -> None:
    """The top of the report that `make demo` writes."""
    flights = [ROOT / f"demo/flights/{name}.mcap" for name in DIAGNOSED]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        diagnose_logs(flights, "nominal", Path(folder))
        with Browser(Path(folder) / "profile", size=(1120, 800)) as browser:
            browser.open(Path(folder) / "report.html")
            browser.draw_frames()
            out.write_bytes(browser.take_picture())


if __name__ == "__main__":
    draw_report(ROOT / "docs/pictures/report.png")
    draw_flip(ROOT / "docs/pictures/flip.png")
