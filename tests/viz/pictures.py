"""Draws the pictures of the documentation, with Chromium: make demo, vpptwin demo so101, python -m tests.viz.pictures.

Those of a report carry its sentence, by which a test sees whether they are still of what the demo says.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tests.viz.browser import Browser
from vpptwin.estimation.replay import replay
from vpptwin.logs import read_flight
from vpptwin.twin.spec import load_twin
from vpptwin.viz.pages.playback import play_page

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


def draw_report(report: Path, top: Path, force: Path | None = None) -> None:
    """The top of a report, and its picture of the missing force."""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        Browser(Path(folder) / "profile", size=(880, 1000)) as browser,
    ):
        browser.open(report)
        browser.draw_frames()
        told = PngInfo()
        told.add_text("Description", str(browser.evaluate("document.title")))
        Image.open(io.BytesIO(browser.take_picture())).save(top, pnginfo=told)
        if force is None:
            return
        browser.evaluate("document.querySelector('.panels[aria-label^=\"Missing force\"]').scrollIntoView(); 0")
        height = browser.evaluate("document.querySelector('.panels[aria-label^=\"Missing force\"]').offsetHeight")
        browser.draw_frames()
        picture = Image.open(io.BytesIO(browser.take_picture()))
        picture.crop((0, 0, picture.width, round(height))).save(force, pnginfo=told)


if __name__ == "__main__":
    pictures = ROOT / "docs/pictures"
    draw_report(ROOT / "out/demo/report.html", pictures / "report.png", pictures / "force.png")
    draw_report(ROOT / "out/so101/report.html", pictures / "so101.png")
    draw_flip(pictures / "flip.png")
