"""Served pages: heard by this machine alone, by who has the address, by no other page; gone with the process."""

from __future__ import annotations

import asyncio
import http.client
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest
import umsgpack
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from tests.bad_files import DEMO
from vpptwin.cli.main import main
from vpptwin.robots.planar_drone.display.live import LivePage
from vpptwin.system.errors import InputError
from vpptwin.viz.pages.browse import tell_address
from vpptwin.viz.pages.serve import Server
from vpptwin.viz.scene.nodes import Node

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def panel() -> Iterator[LivePage]:
    """A page that takes one command."""
    panel = LivePage(["flip"])
    yield panel
    panel.server.close()


def ask(address: str, method: str = "GET", path: str = "", body: bytes = b"", **headers: str) -> int:
    """Status of a request to a path below an address, with these headers."""
    where = urlsplit(address)
    connection = http.client.HTTPConnection(str(where.hostname), int(where.port or 0), timeout=10.0)
    with suppress(ValueError):
        connection.request(method, where.path + path, body or None, headers)
    status = connection.getresponse().status
    connection.close()
    return status


def test_only_loopback_listens(panel: LivePage) -> None:
    """The socket is bound to 127.0.0.1; other addresses of this machine answer nothing."""
    where = urlsplit(panel.server.address)
    (heard,) = {c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.laddr.port == where.port}
    assert heard == "127.0.0.1"
    assert main(["play", str(DEMO), "--host", "203.0.113.7"]) == 2
    with pytest.raises(InputError, match=r"--host nowhere\.invalid"):
        Server("nowhere.invalid")


def test_without_the_secret_nothing_is_there(panel: LivePage) -> None:
    """Not the page, not its state, not the scene, no command."""
    other = panel.server.address.replace(panel.server.secret, "x" * len(panel.server.secret))
    bare = panel.server.address.replace(f"{panel.server.secret}/", "")
    for address in (other, bare):
        for path in ("", "state", "scene/", "scene/main.min.js", "socket"):
            assert ask(address, path=path) == 404
        assert ask(address, "POST", body=b"flip") == 404
    assert panel.asked.empty()
    assert len(panel.server.secret) >= 20


HOSTS = {
    "localhost:{}": 200, "[::1]:{}": 200, "evil.example:{}": 403, "127.0.0.1.evil.example:{}": 403, "127.0.0.1": 403,
    "192.168.1.5:{}": 403, "": 403,
}  # fmt: skip


@pytest.mark.parametrize("host", HOSTS)
def test_other_names_for_this_machine_are_refused(panel: LivePage, host: str) -> None:
    """A page whose name is made to point here (DNS rebinding) reads nothing and asks for nothing."""
    given = host.format(urlsplit(panel.server.address).port)
    assert ask(panel.server.address, Host=given) == HOSTS[host]
    assert ask(panel.server.address, "POST", body=b"flip", Host=given) == HOSTS[host]
    assert panel.asked.empty() == (HOSTS[host] != 200)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{}", "http://127.0.0.1:1", "http://localhost:{}"]
)
def test_other_pages_are_refused(panel: LivePage, origin: str) -> None:
    """What another page sends, whatever it knows, is not taken, and no viewer of its gets the scene."""
    port = urlsplit(panel.server.address).port
    given = origin.format(port)
    assert ask(panel.server.address, "POST", body=b"flip", Origin=given) == 403
    assert ask(panel.server.address, path="state", Origin=given) == 403
    assert panel.asked.empty()
    assert ask(panel.server.address, "POST", body=b"flip", Origin=f"http://127.0.0.1:{port}") == 200
    assert panel.asked.get_nowait() == "flip"
    with pytest.raises(HTTPClientError, match="403"):
        watch(panel.server, 1, Origin=given)


def test_bad_requests_are_refused(panel: LivePage) -> None:
    """Unknown commands, bytes that are no text, bodies of megabytes, other methods."""
    for body in (b"format the disk", b"\xff\xfe"):
        assert ask(panel.server.address, "POST", body=body) == 400
    with suppress(ConnectionError, http.client.HTTPException):
        assert ask(panel.server.address, "POST", body=b"flip" * 10**6) in (400, 413)
    assert ask(panel.server.address, "DELETE") == 405
    assert ask(panel.server.address, path="../../etc/passwd") == 404
    assert panel.asked.empty()
    assert ask(panel.server.address) == 200


def watch(server: Server, count: int, **headers: str) -> list[dict[str, object]]:
    """The first commands that a viewer is sent."""

    async def read() -> list[dict[str, object]]:
        request = HTTPRequest(server.address.replace("http", "ws", 1) + "socket", headers=headers)
        connection = await websocket_connect(request)
        messages = [await asyncio.wait_for(connection.read_message(), 10.0) for _ in range(count)]
        connection.close()
        return [umsgpack.unpackb(message) for message in messages]

    return asyncio.run(read())


def test_an_invitation_holds_once(panel: LivePage) -> None:
    """It leads to the page, for whoever comes first, and from no other page."""
    invitation = panel.server.invite()
    assert panel.server.secret not in invitation
    assert ask(invitation, Host="evil.example:80") == 403
    with urllib.request.urlopen(invitation, timeout=10.0) as answer:
        assert answer.url == panel.server.address
    assert ask(invitation) == 404
    assert ask(panel.server.invite() + "x") == 404


def test_a_flight_is_served_as_it_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`play` and `play --html` are one page; one address is printed."""
    assert main(["play", str(DEMO), "--html", str(tmp_path / "flight.html")]) == 0
    served = []

    def look(seconds: float) -> None:
        address = capsys.readouterr().out.splitlines()[-1].split()[0]
        with urllib.request.urlopen(address, timeout=10.0) as answer:
            served.append(answer.read())
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vpptwin.viz.pages.playback.time", SimpleNamespace(sleep=look))
        assert main(["play", str(DEMO)]) == 0
    written, (page,) = tmp_path / "flight.html", served
    assert page == written.read_bytes()


@pytest.mark.parametrize(
    ("terminal", "screen", "named", "opened"),
    [
        (True, ":0", None, True), (False, ":0", None, False), (True, "", None, False), (True, ":0", "mine", True),
        (True, ":0", "lynx", False), (True, ":0", "none", False),
    ],
)  # fmt: skip
def test_a_browser_is_opened_if_there_is_one(
    panel: LivePage, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    terminal: bool, screen: str, named: str | None, opened: bool,
) -> None:  # fmt: skip
    """Where somebody sits before a terminal and a screen, not one in that terminal; without the secret on its line."""
    addresses: list[str] = []
    graphical, text = webbrowser.BackgroundBrowser("firefox"), webbrowser.GenericBrowser("lynx")
    found = text if named in ("lynx", "mine") else graphical
    monkeypatch.setattr(found, "open", addresses.append, raising=False)

    def get() -> webbrowser.BaseBrowser:
        if named == "none":
            raise webbrowser.Error("could not locate runnable browser")
        return found

    monkeypatch.setattr(webbrowser, "get", get)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal, raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", screen)
    monkeypatch.setenv("BROWSER", "mine %s" if named == "mine" else "")
    tell_address(panel.server, "shows it.")
    assert capsys.readouterr().out == f"{panel.server.address} shows it.\n"
    assert bool(addresses) == opened
    assert not [address for address in addresses if panel.server.secret in address]


def test_who_comes_late_sees_the_scene_as_it_is() -> None:
    """The last of every kind of command, nothing of what was deleted, however long it has been moving."""
    server = Server()
    node = Node(server)["rig"]
    for i in range(1000):
        node.set_transform(i * np.eye(4))
        node.set_property("visible", i % 2 == 0)
    Node(server)["gone/part"].set_transform(np.eye(4))
    Node(server)["gone"].delete()
    seen = watch(server, 3)
    server.close()
    assert [command["type"] for command in seen] == ["set_transform", "set_property", "delete"]
    assert seen[0]["matrix"][0] == 999.0  # type: ignore[index]
    assert seen[1]["value"] is False
    assert len(server._kept) == 3


COMMANDS = {"log": ["play", str(DEMO)], "live": ["play", "--live", "flip"]}
ENDS = ("SIGTERM", "SIGINT", "SIGHUP", "SIGKILL", "parent")
OFTEN = (("log", "SIGTERM"), ("live", "SIGINT"))
SHELL = "import subprocess, sys, time; subprocess.Popen(sys.argv[1:]); time.sleep(600)"


@pytest.mark.parametrize(
    ("command", "how"),
    [
        pytest.param(command, how, marks=[] if (command, how) in OFTEN else [pytest.mark.slow])
        for command in COMMANDS
        for how in ENDS
    ],
)
def test_nothing_is_left_running(command: str, how: str, tmp_path: Path) -> None:
    """After Ctrl-C, SIGTERM, a closed terminal, kill -9, or the death of who started it: no process, no open port."""
    arguments = [sys.executable, "-u", "-m", "vpptwin", *COMMANDS[command]]
    if how == "parent":
        arguments = [sys.executable, "-c", SHELL, *arguments]
    with (tmp_path / "out").open("w") as out:
        started = subprocess.Popen(
            arguments, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip
    address = ""
    deadline = time.monotonic() + 120.0
    while not address and time.monotonic() < deadline:
        address = next((w for w in (tmp_path / "out").read_text().split() if w.startswith("http")), "")
        time.sleep(0.1)
    assert ask(address) == 200
    if command == "live":  # whose policy is loaded while the page is open
        wait_for(lambda: b"time" in urllib.request.urlopen(f"{address}state", timeout=10.0).read())
    every = [psutil.Process(started.pid), *psutil.Process(started.pid).children(recursive=True)]
    started.send_signal(signal.SIGKILL if how == "parent" else signal.Signals[how])
    started.wait(120)
    _, alive = psutil.wait_procs(every, timeout=120)
    assert alive == []
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((str(urlsplit(address).hostname), int(urlsplit(address).port or 0)), timeout=5.0)
    if how in ("SIGTERM", "SIGHUP"):
        assert started.returncode == 128 + signal.Signals[how]
        assert (tmp_path / "out").read_text().endswith("vpptwin: stopped\n")
    if how == "SIGINT":
        assert started.returncode == 0


def connect(server: Server) -> socket.socket:
    """A viewer that never reads: a socket that has asked for the scene."""
    reader = socket.create_connection((server.host, server.port), timeout=10.0)
    lines = (
        f"GET /{server.secret}/socket HTTP/1.1", f"Host: {server.host}:{server.port}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", "", "",
    )  # fmt: skip
    reader.sendall("\r\n".join(lines).encode())
    return reader


def test_viewers_that_do_not_read_hold_one_scene() -> None:
    """Of a thousand pictures nothing piles up for them, and who reads sees the last one."""
    server = Server()
    nodes = [Node(server)[f"part {i}/{500 * 'x'}"] for i in range(20)]
    idle = [connect(server) for _ in range(30)]
    wait_for(lambda: len(server._viewers) == 30)
    for picture in range(1000):
        for node in nodes:
            node.set_transform(picture * np.eye(4))
    seen = watch(server, len(nodes))
    assert all(command["matrix"][0] == 999.0 for command in seen)  # type: ignore[index]
    waiting = [viewer.ws_connection.stream._write_buffer for viewer in server._viewers if viewer.ws_connection]
    assert len(waiting) >= 30
    assert max(len(buffer) for buffer in waiting) <= len(nodes) * len(umsgpack.packb(seen[0])) * 1.1
    for reader in idle:
        reader.close()
    server.close()


def test_viewers_that_read_nothing_for_long_are_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """What they hold is let go; the others go on."""
    monkeypatch.setattr("vpptwin.viz.pages.serve.MAX_WRITE_S", 0.2)
    server = Server()
    reader = connect(server)
    wait_for(lambda: len(server._viewers) == 1)
    for i in range(40):
        Node(server)[f"{i}"].set_property("visible", "x" * 10**6)
    wait_for(lambda: not server._viewers)
    assert ask(server.address, path="scene/") == 200
    reader.close()
    server.close()


def test_connections_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """One more than there may be is closed at once; when one goes, another may come."""
    monkeypatch.setattr("vpptwin.viz.pages.serve.MAX_CONNECTIONS", 3)
    server = Server()
    idle = [connect(server) for _ in range(3)]
    wait_for(lambda: len(server._viewers) == 3)
    with connect(server) as late, suppress(ConnectionResetError):
        assert late.recv(100) == b""
    idle[0].close()
    wait_for(lambda: len(server._viewers) == 2)
    assert ask(server.address, path="scene/") == 200
    for reader in idle:
        reader.close()
    server.close()


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something is so; two minutes at most, so that a hang is a failure."""
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_port_is_taken_or_refused() -> None:
    """The one that is named; a second server on it is told so."""
    first = Server()
    with pytest.raises(InputError, match=rf"--port {first.port} \(Address already in use\); expected .* a free port"):
        Server(port=first.port)
    first.close()
