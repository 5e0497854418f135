"""Telling where a page is served: a line, and a browser, if there is somebody before a screen."""

from __future__ import annotations

import os
import sys
import webbrowser
from contextlib import suppress

from vpptwin.viz.pages.serve import Server


def has_screen() -> bool:
    """Whether windows can be shown."""
    return sys.platform == "darwin" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def find_browser() -> webbrowser.BaseBrowser | None:
    """The browser to open: that which BROWSER names, or one with windows; None without a terminal or a screen."""
    if not (sys.stdout.isatty() and has_screen()):
        return None
    with suppress(webbrowser.Error):
        found = webbrowser.get()
        if os.environ.get("BROWSER") or type(found) is not webbrowser.GenericBrowser:  # lynx and the like
            return found
    return None


def tell_address(server: Server, about: str) -> None:
    """Print where a server's page is and what is there; open it in the browser, if there is one."""
    print(f"{server.address} {about}", flush=True)
    browser = find_browser()
    if browser is not None:
        with suppress(webbrowser.Error, OSError):
            browser.open(server.invite())
