"""The program: `vpptwin`, or `python -m vpptwin`."""

from __future__ import annotations

import gc
import os
import signal
import sys

TYPE_CHECKING = False  # as in `vpptwin/__init__.py`
if TYPE_CHECKING:
    from typing import NoReturn


def stop(number: int, frame: object = None) -> NoReturn:
    """End at once: before and after a command there is nothing to tidy up."""
    os.write(2, b"vpptwin: stopped\n")
    os._exit(128 + number)


signal.signal(signal.SIGINT, stop)

from vpptwin.cli.main import main  # noqa: E402


def run() -> int:
    """Run a command; its exit code."""
    try:
        return main()
    except KeyboardInterrupt:  # that came as the command ended
        stop(signal.SIGINT)
    finally:
        gc.freeze()  # the search for cycles at the end takes a second where torch is loaded, and frees what ends anyway


if __name__ == "__main__":
    sys.exit(run())
