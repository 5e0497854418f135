"""The page in a real browser, cut off from the network."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.viz.browser import Browser
from tests.viz.conftest import make_flight, make_prediction
from tests.viz.server import serve
from vpptwin.viz.pages.playback import play_page

pytestmark = pytest.mark.browser
CRAFT = 'viewer.scene_tree.find(["rig", "log", "craft"]).object'
SCALE = 0.5  # pixels of a picture for each of the window's, in either direction
CANVAS = (slice(20, 320), slice(175, 510))  # rows and columns of a picture that show only the scene


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A page of log and twin, loaded."""
    folder = tmp_path_factory.mktemp("browser")
    flight = make_flight()
    page = play_page(flight, make_prediction(flight), folder / "flight.html")
    profile = folder / "profile"
    profile.mkdir()
    with Browser(profile, scale=SCALE) as browser:
        browser.open(page)
        browser.draw_frames()
        yield browser


def scrub(browser: Browser, seconds: float) -> np.ndarray:
    """Drag the slider to a time [s] and return the window's pixels (rows, columns, 3)."""
    browser.evaluate(f"scrub.value = {seconds}; scrub.dispatchEvent(new Event('input')); 0")
    browser.draw_frames()
    return np.asarray(Image.open(io.BytesIO(browser.take_picture())).convert("RGB")).astype(int)


def test_page_loads_offline_without_complaint(browser: Browser) -> None:
    """No console error, no request but the file itself and data inside it."""
    assert browser.complaints == []
    assert [url for url in browser.requests if not url.startswith(("file:", "data:"))] == []


def test_canvas_is_not_blank(browser: Browser) -> None:
    """The scene shows the dark craft, a green arrow and the pale backdrop."""
    scene = scrub(browser, 1.0)[CANVAS].reshape(-1, 3)
    red, green, blue = scene.T
    assert np.count_nonzero(scene.max(axis=1) < 70) > 75  # craft
    assert np.count_nonzero((green > red + 60) & (green > blue + 20)) > 25  # thrust
    assert np.count_nonzero(scene.min(axis=1) > 190) > 12_500  # backdrop


def test_negative_thrust_has_its_own_colour(browser: Browser) -> None:
    """After the flip the green arrows give way to vermilion ones."""
    scene = scrub(browser, 3.5)[CANVAS].reshape(-1, 3)
    red, green, blue = scene.T
    assert np.count_nonzero((green > red + 60) & (green > blue + 20)) == 0
    assert np.count_nonzero((red > green + 70) & (red > blue + 100)) > 25


def test_scrubbing_moves_the_craft(browser: Browser) -> None:
    """The log flies to the right at 0.2 m/s, in the scene and on the screen, and ends upside down."""
    early = scrub(browser, 1.0)
    assert browser.evaluate(f"{CRAFT}.position.x") == pytest.approx(0.2, abs=1e-4)
    late = scrub(browser, 4.0)
    assert browser.evaluate(f"{CRAFT}.position.x") == pytest.approx(0.8, abs=1e-4)
    assert abs(browser.evaluate(f"{CRAFT}.quaternion.y")) == pytest.approx(1.0, abs=1e-6)
    columns = [np.nonzero(picture[CANVAS].max(axis=2) < 70)[1].mean() for picture in (early, late)]
    assert columns[1] > columns[0] + 15
    assert browser.evaluate("clock.textContent") == "4.00 / 4.00 s"


def test_readout_tells_how_far_the_twin_is_off(browser: Browser) -> None:
    """The made-up twin is 10 cm away, and hidden at first."""
    scrub(browser, 2.0)
    assert "twin off by 10.0 cm, 0.0°" in browser.evaluate("readout.textContent")
    scrub(browser, 0.2)
    assert "twin" not in browser.evaluate("readout.textContent")


def test_play_pause_and_speed(browser: Browser) -> None:
    """Playing advances the clock, pausing stops it; the speed sets the mixer's time scale."""
    scrub(browser, 0.5)
    browser.evaluate("speed.value = '0.25'; speed.dispatchEvent(new Event('change')); toggle.click(); 0")
    browser.draw_frames(5)
    playing = browser.evaluate("viewer.animator.time")
    assert playing > 0.5
    assert browser.evaluate("viewer.animator.mixer.timeScale") == 0.25
    browser.evaluate("toggle.click(); 0")
    stopped = browser.evaluate("viewer.animator.time")
    browser.draw_frames()
    assert browser.evaluate("viewer.animator.time") == stopped
    assert browser.evaluate("toggle.textContent") == "play"


def test_view_follows_the_craft(browser: Browser) -> None:
    """In the view "craft" the rig is shifted so that the craft stays in the middle."""
    browser.evaluate("view.value = 'craft'; view.dispatchEvent(new Event('change')); 0")
    scrub(browser, 3.0)
    root = browser.evaluate('viewer.scene_tree.find(["rig"]).object.position.x')
    assert root == pytest.approx(-0.6, abs=1e-4)
    browser.evaluate("view.value = 'flight'; view.dispatchEvent(new Event('change')); 0")


@pytest.mark.slow
def test_live_server_plays_until_interrupted(tmp_path: Path) -> None:
    """The printed address shows a running animation; Ctrl-C ends it quietly."""
    imports = "from tests.viz.conftest import make_flight; from vpptwin.viz.pages.playback import play_live"
    with serve("-c", f"{imports}; play_live(make_flight())") as address, Browser(tmp_path, offline=False) as browser:
        browser.open(address)
        deadline = time.monotonic() + 30.0
        while not browser.evaluate("viewer.animator.duration") and time.monotonic() < deadline:
            browser.draw_frames()
        assert browser.evaluate("viewer.animator.duration") == pytest.approx(4.0)
        first = browser.evaluate(f"{CRAFT}.position.x")
        browser.draw_frames(10)
        assert browser.evaluate(f"{CRAFT}.position.x") != first
        assert [c for c in browser.complaints if "favicon" not in c] == []
