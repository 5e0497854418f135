"""Several twins beside one log: a scene each on one page, in step, and how far each is off."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.made_up import FLIP, make_up
from tests.viz.browser import Browser
from tests.viz.test_other_rig import CART_POLE
from vpptwin.cli import demo
from vpptwin.cli.main import main
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight, Stream
from vpptwin.twin.spec import load_twin
from vpptwin.viz.pages.beside import draw_beside

SIGNALS = "model: cart.xml\nsignals:\n  joints: {slide: /joint_states, hinge: /joint_states}\n"
BEFORE = "</script><b>before"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A cart that rolls by 0.3 m/s; one twin is 0.1 m ahead and its pole 0.2 rad, the other half of both."""
    (tmp_path / "cart.xml").write_text(CART_POLE)
    (tmp_path / "cart.yaml").write_text(SIGNALS)
    spec, seconds = load_twin(tmp_path / "cart.yaml"), np.arange(201) / 100.0
    track = np.stack([0.3 * seconds, np.sin(seconds)], axis=1)
    joints = {name: Stream(seconds, {"position": track[:, i]}) for i, name in enumerate(("slide", "hinge"))}
    none, off = np.zeros((201, 0)), np.array([0.1, 0.2])
    shown = [
        (name, Prediction(seconds, track + share * off, 0 * track, none, none, np.array([0.0])), spec)
        for name, share in ((BEFORE, 1.0), ("after", 0.5))
    ]
    html = draw_beside(Flight(Path("cart.mcap"), 0, {}, {"/joint_states": joints}), shown)
    (tmp_path / "beside.html").write_text(html, encoding="utf-8")
    return tmp_path / "beside.html"


def test_numbers_by_hand(page: Path) -> None:
    """100 mm and 50 mm, 0.2 rad and 0.1 rad; a name's markup is text."""
    text = page.read_text(encoding="utf-8")
    rows = {row[0]: row[1:] for row in re.findall(r"<tr><th>(\w+)</th><td>(.*?)</td><td>(.*?)</td></tr>", text)}
    assert rows == {"slide": ("100 mm", "50 mm"), "hinge": ("11.5°", "5.73°")}
    assert "runs freely" in text
    assert "<b>" not in text


@pytest.mark.browser
def test_scenes_are_in_step(page: Path, tmp_path: Path) -> None:
    """Offline, without complaint; where the bar is put both are, each with its own twin beside the log."""
    with Browser(tmp_path / "profile", size=(1000, 600), scale=0.5) as browser:
        browser.open(page)
        deadline = time.monotonic() + 60.0
        while not browser.evaluate("players().every(player => player && player.duration)"):
            assert time.monotonic() < deadline
            time.sleep(0.2)
        browser.evaluate("scrub.value = 1.0; scrub.dispatchEvent(new Event('input')); 0")
        browser.draw_frames()
        assert browser.evaluate("players().map(player => player.time)") == [1.0, 1.0]
        place = 'frame.contentWindow.viewer.scene_tree.find(["rig", "NAME", "cart"]).object.position.x'
        for name, wanted in (("log", [0.3, 0.3]), ("twin", [0.4, 0.35])):
            found = browser.evaluate(f"frames.map(frame => {place.replace('NAME', name)})")
            assert found == pytest.approx(wanted, abs=1e-3)
        assert browser.evaluate("clock.textContent") == "1.00 / 2.00 s"
        assert browser.complaints == []
        assert [url for url in browser.requests if not url.startswith(("file:", "data:"))] == []


def test_the_page_of_the_demo_has_both_twins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The nominal one and the one that the diagnosis wrote, which here is made up; friction is what it adds."""
    make_up(monkeypatch)
    monkeypatch.setattr(demo, "DIAGNOSED", ("flip",))
    monkeypatch.setattr(demo, "show_wall", lambda out: None)
    demo.show_demo(tmp_path / "out")
    text = (tmp_path / "out/flip.html").read_text(encoding="utf-8")
    assert re.findall(r"<figcaption>(.*?)</figcaption>", text) == ["nominal", "twin"]
    ((before, after),) = re.findall(r"<tr><th>rail_x</th><td>([\d.]+) mm</td><td>([\d.]+) mm</td></tr>", text)
    assert float(after) < 0.6 * float(before)


def test_a_video_has_one_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line says so, before anything is drawn."""
    twins = ["--twin", "nominal", "--twin", "typical"]
    assert main(["play", str(FLIP), *twins, "--video", str(tmp_path / "flip.gif")]) == 2
    said = capsys.readouterr().err
    assert "2 twins in a video or a window; expected one" in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
