"""Pages served to browsers: a secret in the address, no other page let in, loopback only, gone with the process."""

from __future__ import annotations

import asyncio
import ipaddress
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import umsgpack
from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from vpptwin.errors import InputError
from vpptwin.viz.page import TEMPLATES, VIEWER, Command

LOOPBACK = "127.0.0.1"
MOST_BODY = 1000
"""Longest request taken [bytes]."""
MOST_WAITING = 20_000
"""Messages that a viewer may lag behind before it is cut off: 25 s of a flight."""
Answer = Callable[[bytes], tuple[str, bytes]]
"""From the body of a request to the type and content of what is answered; ValueError refuses it."""


class Server:
    """A scene that browsers watch, and pages around it; takes the place of meshcat's window.

    Args:
        host: address of this machine to listen on; the default is heard by this machine alone.
        gets: path below the secret → what answers a GET.
        posts: path below the secret → what answers a POST.

    Raises:
        InputError: if there is no such address.
    """

    def __init__(
        self, host: str = LOOPBACK, gets: Mapping[str, Answer] | None = None, posts: Mapping[str, Answer] | None = None
    ) -> None:
        try:
            self._sockets = bind_sockets(0, host, family=socket.AF_UNSPEC)[:1]
        except OSError as error:
            found = f"--host {host} ({error.strerror or error})"
            raise InputError(found, "an address of this machine", f"leave it out for {LOOPBACK}") from error
        self.host, self.port = host, int(self._sockets[0].getsockname()[1])
        self.secret = secrets.token_urlsafe(16)
        scene = TEMPLATES.get_template("scene.html").render().encode()
        viewer = VIEWER.read_bytes()
        shown: dict[str, Answer] = {
            "scene/": lambda body: ("text/html; charset=utf-8", scene),
            "scene/main.min.js": lambda body: ("text/javascript", viewer),
            **(gets or {}),
        }
        answers = {"GET": shown, "POST": dict(posts or {})}
        self._kept: dict[tuple[object, ...], bytes] = {}
        self._viewers: dict[Any, int] = {}
        self._invitations: set[str] = set()
        kept, viewers = self._kept, self._viewers

        class Page(_Guarded):
            server = self

            def _answer(self, path: str) -> None:
                known = answers[str(self.request.method)]
                if path not in known:
                    raise HTTPError(404)
                try:
                    kind, content = known[path](self.request.body)
                except ValueError as error:
                    raise HTTPError(400) from error
                self.set_header("Content-Type", kind)
                self.finish(content)

            get = post = _answer

        class Viewer(_Guarded, WebSocketHandler):
            server = self

            def open(self, *args: str) -> None:
                viewers[self] = 0
                for message in list(kept.values()):
                    _push(viewers, self, message)

            def on_close(self) -> None:
                viewers.pop(self, None)

            def on_message(self, message: str | bytes) -> None:
                """A viewer has nothing to say."""

        class Invited(_Guarded):
            server = self

            def get(self, token: str) -> None:
                if token not in self.server._invitations:
                    raise HTTPError(404)
                self.server._invitations.remove(token)
                self.redirect(where)

        where = f"/{self.secret}/"
        rules = [(f"{where}socket", Viewer), (f"{where}(.*)", Page), ("/once/(.*)", Invited)]
        self._app = Application(rules, log_function=lambda handler: None)
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()
        self._ready.wait()

    @property
    def address(self) -> str:
        """Where the pages are, the secret included."""
        return f"{self._origin}/{self.secret}/"

    @property
    def _origin(self) -> str:
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    def invite(self) -> str:
        """An address that leads to the pages once: everybody on a machine can read with what a browser was opened."""
        token = secrets.token_urlsafe(16)
        self._invitations.add(token)
        return f"{self._origin}/once/{token}"

    def send(self, command: Command) -> None:
        """Show a command to who watches, and keep it for who comes later; the last of its kind replaces it."""
        content = dict(command.lower())
        key = content["type"], content["path"], content.get("property")
        self._loop.call_soon_threadsafe(self._show, key, umsgpack.packb(content))

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._loop.stop)

    def _show(self, key: tuple[object, ...], message: bytes) -> None:
        if key[0] == "delete":
            path = str(key[1]).rstrip("/")
            for other in [k for k in self._kept if f"{k[1]}/".startswith(f"{path}/")]:
                del self._kept[other]
        self._kept[key] = message
        for viewer in list(self._viewers):
            _push(self._viewers, viewer, message)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = HTTPServer(self._app, max_body_size=MOST_BODY, max_header_size=1 << 14, idle_connection_timeout=60.0)
        server.add_sockets(self._sockets)
        self._loop.call_soon(self._ready.set)
        self._loop.run_forever()
        server.stop()

    def knows(self, host: str) -> bool:
        """Whether a Host header is one of this machine's addresses, not a name that someone made point here."""
        name, _, port = host.rpartition(":")
        name = name.strip("[]").lower()
        if port != str(self.port):
            return False
        if name in ("localhost", self.host.lower()):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return self.host != LOOPBACK and name == socket.gethostname().lower()
        return address.is_loopback or self.host != LOOPBACK


class _Guarded(RequestHandler):
    """Answers nobody else's pages: Host must be ours, and so must be Origin where there is one."""

    server: Server

    def prepare(self) -> None:
        headers = self.request.headers
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if not self.server.knows(host) or origin not in (None, f"http://{host}"):
            raise HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Frame-Options", "SAMEORIGIN")
        self.set_header("X-Content-Type-Options", "nosniff")

    def write_error(self, status_code: int, **kwargs: object) -> None:
        """Say no more than the status does."""
        self.finish()


def _push(viewers: dict[Any, int], viewer: Any, message: bytes) -> None:  # noqa: ANN401
    """Send a message to a viewer; one that has long stopped listening is cut off, or its messages would pile up."""
    if viewers.get(viewer, MOST_WAITING) >= MOST_WAITING:
        viewer.close()
        return
    viewers[viewer] += 1

    async def write() -> None:
        try:
            await viewer.write_message(message, binary=True)
        except (WebSocketClosedError, StreamClosedError):
            pass
        finally:
            if viewer in viewers:
                viewers[viewer] -= 1

    asyncio.ensure_future(write())  # noqa: RUF006 - the loop keeps it until its first wait, the socket from there on


def keep_going() -> Iterator[None]:
    """Go on until Ctrl-C, or until who started this process is gone: nobody is left to end it then."""
    parent, asked = os.getppid(), time.monotonic()
    while True:
        now = time.monotonic()
        if now > asked + 0.5:
            if os.getppid() != parent:
                return
            asked = now
        yield
