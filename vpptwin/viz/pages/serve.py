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
from tornado.iostream import IOStream, StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from vpptwin.system.errors import InputError
from vpptwin.viz.pages.page import TEMPLATES
from vpptwin.viz.scene.nodes import VIEWER, Message

LOOPBACK = "127.0.0.1"
MAX_BODY_BYTES = 1000
"""Longest request taken [bytes]."""
MAX_CONNECTIONS = 400
"""Connections held at once; more are closed as they come, before the process runs out of file descriptors."""
MAX_WRITE_S = 25.0
"""A viewer that takes nothing for so long is cut off [s]."""
SEND_BUFFER = 1 << 16
"""What the kernel may hold for one viewer [bytes]: a viewer that reads nothing costs no more."""
Key = tuple[object, ...]
Answer = Callable[[bytes], tuple[str, bytes]]
"""From the body of a request to the type and content of what is answered; ValueError refuses it."""


class Server:
    """A scene that browsers watch, and pages around it.

    Args:
        host: address of this machine to listen on; by default only this machine can connect.
        gets: path below the secret → what answers a GET.
        posts: path below the secret → what answers a POST.
        port: to listen on; 0 for any that is free.

    Raises:
        InputError: if there is no such address.
    """

    def __init__(
        self, host: str = LOOPBACK, gets: Mapping[str, Answer] | None = None, posts: Mapping[str, Answer] | None = None,
        port: int = 0,
    ) -> None:  # fmt: skip
        try:
            self._sockets = bind_sockets(port, host, family=socket.AF_UNSPEC)[:1]
        except (OSError, OverflowError) as error:
            named = f" --port {port}" if port else ""
            found = f"--host {host}{named} ({getattr(error, 'strerror', None) or error})"
            expected = f"an address of this machine{', and a free port of it' if port else ''}"
            raise InputError(found, expected, f"leave out {'--port' if port else f'it for {LOOPBACK}'}") from error
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
        self._kept: dict[Key, bytes] = {}
        self._viewers: dict[Any, _Outbox] = {}
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
                if (stream := find_stream(self)) is not None:
                    stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
                viewers[self] = _Outbox(self, kept)
                viewers[self].start()

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

    def send(self, message: Message) -> None:
        """Show a message to who watches, and keep it for who comes later; the last of its kind replaces it."""
        content = dict(message)
        key = content["type"], content["path"], content.get("property")
        self._loop.call_soon_threadsafe(self._show, key, umsgpack.packb(content))

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._loop.stop)

    def _show(self, key: tuple[object, ...], message: bytes) -> None:
        _keep(self._kept, key, message)
        for outbox in self._viewers.values():
            outbox.put(key, message)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = _LimitedServer(
            self._app, max_body_size=MAX_BODY_BYTES, max_header_size=1 << 14, idle_connection_timeout=60.0
        )
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


class _LimitedServer(HTTPServer):
    """Holds `MAX_CONNECTIONS` at once."""

    _streams: tuple[IOStream, ...] = ()

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        self._streams = tuple(held for held in self._streams if not held.closed())
        if len(self._streams) >= MAX_CONNECTIONS:
            stream.close()
            return
        self._streams += (stream,)
        super().handle_stream(stream, address)


class _Outbox:
    """What one viewer has yet to be sent: the last command of each kind.

    One batch is under way at a time, and commands that come meanwhile replace each other. A viewer that reads slowly
    skips pictures; one that reads nothing holds no more than one scene, and costs no time.
    """

    def __init__(self, viewer: WebSocketHandler, kept: Mapping[Key, bytes]) -> None:
        self._viewer, self._due, self._busy = viewer, dict(kept), False

    def put(self, key: Key, message: bytes) -> None:
        """Send a command, or have it wait for the batch that is under way."""
        self._due.pop(key, None)  # what comes later is sent later
        _keep(self._due, key, message)
        self.start()

    def start(self) -> None:
        """Send what is due, unless a batch is under way."""
        if self._due and not self._busy:
            self._busy = True
            self._task = asyncio.ensure_future(self._drain())

    async def _drain(self) -> None:
        try:
            while self._due:
                batch, self._due = self._due, {}
                writes = [self._viewer.write_message(message, binary=True) for message in batch.values()]
                await asyncio.wait_for(asyncio.gather(*writes), MAX_WRITE_S)
        except (WebSocketClosedError, StreamClosedError):
            pass
        except TimeoutError:
            if (stream := find_stream(self._viewer)) is not None:
                stream.close()  # a closing handshake would wait behind what nobody reads
        finally:
            self._busy = False


def find_stream(viewer: WebSocketHandler) -> IOStream | None:
    """The connection of a viewer, while it is there."""
    protocol = viewer.ws_connection
    return None if protocol is None else getattr(protocol, "stream", None)


def _keep(kept: dict[Key, bytes], key: Key, message: bytes) -> None:
    """Keep the last command of a kind; one that deletes takes what lies below its path along."""
    if key[0] == "delete":
        path = str(key[1]).rstrip("/")
        for other in [k for k in kept if f"{k[1]}/".startswith(f"{path}/")]:
            del kept[other]
    kept[key] = message


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
