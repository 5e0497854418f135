"""Devices: those that torch finds, and those that Warp steps simulations on."""

from __future__ import annotations

import torch

from vpptwin.system.errors import InputError
from vpptwin.twin.warp.device import check_driver, load_warp

PROCESSOR = "say engine=numba, which simulates on the processor"


def find_device(name: str) -> torch.device:
    """Where networks are trained, of `cpu`, `cuda` or `cuda:1`.

    Raises:
        InputError: if torch finds no such device.
    """
    device, count = torch.device(name), torch.cuda.device_count()
    if device.type == "cpu":
        return device
    device = torch.device("cuda", device.index or 0)
    if device.index >= count:
        found = f"device={name}, and torch {torch.__version__} finds {count} CUDA devices"
        raise InputError(found, "one that it finds", "say device=cpu, or install a torch for your GPU's driver")
    return device


def check_warp(device: torch.device) -> None:
    """Refuse a device that Warp does not step on.

    Raises:
        InputError: if Warp is not installed, or the card's driver is older than what it was built for.
    """
    load_warp()
    if device.type == "cuda":
        check_driver(f"device={device}", PROCESSOR)
