"""Devices: those that torch finds, and those that Warp steps simulations on."""

from __future__ import annotations

import torch

from vpptwin.errors import InputError
from vpptwin.twin.warp_step import load_warp

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
    wp = load_warp()
    if device.type == "cuda" and not wp.is_cuda_available():
        driver, wanted = (
            ".".join(map(str, version or ("none",)))
            for version in (wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version())
        )
        found = f"device={device} with a driver for CUDA {driver}, and Warp {wp.__version__} built with CUDA {wanted}"
        raise InputError(found, "a driver at least as new", f"install one, or {PROCESSOR}")
