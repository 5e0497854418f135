"""`vpptwin play --live`: flips and pushes on demand, the page's requests, and the page in a real browser."""

from __future__ import annotations

import io
import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import umsgpack
from PIL import Image

from tests.viz.browser import Browser
from tests.viz.server import serve
from vpptwin.cli.main import main
from vpptwin.robots.planar_drone.display.live import KEYS, LivePage, fly_live
from vpptwin.system.errors import InputError
from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.evaluate.live import KICK, LiveFlight
from vpptwin.viz.pages.serve import Server


@pytest.fixture(scope="module")
def flight() -> LiveFlight:
    """The shipped policy."""
    return LiveFlight("flip", seed=3)


def fly(flight: LiveFlight, seconds: float) -> np.ndarray:
    """Poses (n, 3) of so many seconds."""
    poses = []
    for _ in range(round(seconds / flight.period)):
        flight.step()
        poses.append(flight.env.state.qpos[0].copy())
    return np.array(poses)


def test_it_flips_on_demand_and_stays_in_the_air(flight: LiveFlight) -> None:
    """Nothing happens by itself; a flip turns the craft over within a second, another one back."""
    fly(flight, 4.0)
    before = flight.env.episodes.target[0, 2]
    fly(flight, 3.0)
    assert flight.env.episodes.target[0, 2] == before
    for _ in range(2):
        flight.commands["flip"]()
        assert abs(wrap_angle(flight.env.episodes.target[:1, 2] - before)[0]) == pytest.approx(np.pi)
        before = flight.env.episodes.target[0, 2]
        fly(flight, 1.5)
        told = flight.tell()
        assert told["angle"] < 0.5
        assert told["distance"] < 0.2
    assert flight.begun == 1


@pytest.mark.parametrize(("command", "sign"), [("turn left", 1.0), ("turn right", -1.0)])
def test_a_full_turn_goes_the_way_it_was_asked(flight: LiveFlight, command: str, sign: float) -> None:
    """Through 2 pi, left is counter-clockwise."""
    fly(flight, 2.0)
    start = flight.env.state.qpos[0, 2]
    flight.commands[command]()
    angle = fly(flight, 2.0)[:, 2] - start
    assert angle[-1] == pytest.approx(sign * 2.0 * np.pi, abs=0.6)


def test_pushes_change_the_motion(flight: LiveFlight) -> None:
    """Each pushes the way it is called, and the craft comes back."""
    fly(flight, 2.0)
    for command, axis, sign in (("push left", 0, -1), ("push right", 0, 1), ("push up", 1, 1), ("push down", 1, -1)):
        before = flight.env.state.qvel[0].copy()
        flight.commands[command]()
        np.testing.assert_allclose(flight.env.state.qvel[0] - before, np.eye(3)[axis] * sign * KICK, atol=1e-12)
        fly(flight, 2.5)
        assert flight.tell()["distance"] < 0.1
    flight.commands["spin"]()
    fly(flight, 2.5)
    assert flight.tell()["angle"] < 0.4
    assert flight.begun == 1


def test_the_target_moves_within_reach(flight: LiveFlight) -> None:
    """A step at a time, not beyond the rig."""
    place = flight.env.episodes.target[0, 0]
    flight.commands["target right"]()
    assert flight.env.episodes.target[0, 0] == pytest.approx(place + 0.2)
    for _ in range(30):
        flight.commands["target right"]()
        flight.commands["target down"]()
    np.testing.assert_allclose(flight.env.episodes.target[0, :2], [1.2, 0.65])
    for _ in range(30):
        flight.commands["target left"]()
        flight.commands["target up"]()
    np.testing.assert_allclose(flight.env.episodes.target[0, :2], [-1.2, 2.0])


def test_every_key_asks_for_something_there_is(flight: LiveFlight) -> None:
    """Keys and commands are the same set."""
    assert sorted(KEYS.values()) == sorted(flight.commands)


@pytest.fixture
def panel() -> Iterator[LivePage]:
    """A page around no scene."""
    panel = LivePage(["flip", "push up"])
    yield panel
    panel.server.close()


def ask(address: str, body: bytes | None = None) -> bytes:
    """Answer to a request."""
    with urllib.request.urlopen(address, data=body, timeout=10.0) as answer:
        content: bytes = answer.read()
        return content


def test_the_page_takes_commands_and_tells_the_state(panel: LivePage) -> None:
    """What is known waits in order; what is not is refused, as are other addresses."""
    assert b"vpptwin live" in ask(panel.server.address)
    panel.state = {"time": 1.5}
    assert json.loads(ask(panel.server.address + "state")) == {"time": 1.5}
    ask(panel.server.address, b"push up")
    ask(panel.server.address, b"flip")
    assert [panel.asked.get_nowait(), panel.asked.get_nowait()] == ["push up", "flip"]
    for address, body in ((panel.server.address, b"format the disk"), (panel.server.address + "etc/passwd", None)):
        with pytest.raises(urllib.error.HTTPError):
            ask(address, body)
    assert panel.asked.empty()
    assert panel.server.address.startswith("http://127.0.0.1:")


def test_the_craft_is_there_before_the_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens the page sees it upright in the air, while torch is loaded."""
    opened: list[Server] = []
    monkeypatch.setattr(
        "vpptwin.robots.planar_drone.display.live.tell_address", lambda server, _: opened.append(server)
    )

    def begin() -> LiveFlight:
        raise InputError("no policy", "one", "train it")

    with pytest.raises(InputError, match="no policy"):
        fly_live(begin)
    time.sleep(0.5)  # the server's thread takes what it was sent
    kept = [umsgpack.unpackb(message) for message in list(opened[0]._kept.values())]
    assert any(message["type"] == "set_object" and "/rig/log" in message["path"] for message in kept)
    moved = {m["path"]: m["matrix"][12:15] for m in kept if m["type"] == "set_transform" and "/rig/log" in m["path"]}
    assert any(np.allclose(place, [0.0, 0.0, 1.0]) for place in moved.values()), moved


@pytest.mark.browser
def test_a_button_flips_the_craft_in_the_browser(tmp_path: Path) -> None:
    """The printed page shows the scene; a key asks for a flip, and thrust turns negative. Ctrl-C ends it."""
    with (
        serve("-m", "vpptwin", "play", "--live", "flip", said="shows the flight") as address,
        Browser(tmp_path, offline=False, scale=0.5) as browser,
    ):
        browser.open(address)
        wait_until(lambda: sum(count_arrows(browser)) > 50)
        green, orange = count_arrows(browser)
        browser.evaluate("dispatchEvent(new KeyboardEvent('keydown', {key: 'f'})); 0")
        wait_until(lambda: np.argmax(count_arrows(browser)) != np.argmax([green, orange]))
        text = "document.getElementById('state').textContent"
        wait_until(lambda: "from the target" in browser.evaluate(text))
        assert [c for c in browser.complaints if "favicon" not in c] == []


def count_arrows(browser: Browser) -> tuple[int, int]:
    """Pixels of the window in the colours of positive and of negative thrust."""
    seen = np.asarray(Image.open(io.BytesIO(browser.take_picture())).convert("RGB")).astype(int)
    red, green, blue = seen.reshape(-1, 3).T
    return np.count_nonzero((green > red + 60) & (green > blue + 20)), np.count_nonzero(
        (red > green + 60) & (red > 180)
    )


def wait_until(condition: Callable[[], bool]) -> None:
    """Until it holds, two minutes at most."""
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.2)


def test_a_log_and_a_policy_are_one_too_many(capsys: pytest.CaptureFixture[str]) -> None:
    """Told so in a line, as are neither of them, and a policy that does not exist."""
    for arguments, hint in (
        (["a.mcap", "--live", "flip"], "leave one out"),
        ([], "--live"),
        (["--live", "flop"], "flop"),
    ):
        assert main(["play", *arguments]) == 2
        said = capsys.readouterr().err.strip()
        assert hint in said
        assert "\n" not in said
