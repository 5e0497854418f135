"""Warp, and the devices that it steps simulations on."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from vpptwin.system.errors import InputError, load_extra

NEED = "a twin on Warp"


def load_warp() -> Any:  # noqa: ANN401
    """Warp, which says nothing but errors.

    Raises:
        InputError: if it is not installed.
    """
    wp = load_extra("warp", NEED)
    wp.config.log_level = wp.LOG_ERROR
    with muted():  # no card is nothing to warn of
        wp.init()
    return wp


@contextmanager
def muted() -> Iterator[None]:
    """Nothing reaches standard error, not from compiled libraries either."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def check_driver(said: str, way_out: str) -> None:
    """Refuse to step on a card whose driver is older than what Warp was built for, or that has none.

    Args:
        said: by the user.
        way_out: what to do instead.

    Raises:
        InputError: if it is, or Warp is not installed.
    """
    wp = load_warp()
    if not wp.is_cuda_available():
        version, wanted = wp.get_cuda_driver_version(), ".".join(map(str, wp.get_cuda_toolkit_version()))
        driver = f"a driver for CUDA {'.'.join(map(str, version))}" if version else "no CUDA driver"
        found = f"{said} with {driver}, and Warp {wp.__version__} built with CUDA {wanted}"
        raise InputError(found, "a driver at least as new", f"install one, or {way_out}")


def find_device(name: str, way_out: str) -> str:
    """What Warp calls a device of `cpu`, its processor device, `cuda` or `cuda:1`.

    Args:
        name: given by the user.
        way_out: what to do where there is none.

    Raises:
        InputError: if there is no such device, or Warp is not installed.
    """
    if not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        raise InputError(f"device {name}", "cuda, cuda:1 and so on, or cpu", f"say one, or {way_out}")
    wp = load_warp()
    if name == "cpu":
        return name
    check_driver(f"device {name}", way_out)
    index, count = int(name.partition(":")[2] or 0), wp.get_cuda_device_count()
    if index >= count:
        raise InputError(f"device {name}, and Warp finds {count} CUDA devices", "one that it finds", way_out)
    return f"cuda:{index}"
