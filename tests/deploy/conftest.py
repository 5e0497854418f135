"""Controllers exported and compiled once."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from vpptwin.actuators.adaptive import SIZE
from vpptwin.deploy.c_source import write_c
from vpptwin.deploy.content import Content, collect_content, make_content
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.learn.actor import Actor
from vpptwin.train.learn.networks import Policy
from vpptwin.train.main import compose_config

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-O2")


class State(ctypes.Structure):
    """`vpptwin_state` of the header."""

    _fields_ = [
        ("integral", ctypes.c_float * 2), ("gyro", ctypes.c_float), ("governor", ctypes.c_float * 2),
        ("throttle", ctypes.c_float * 2), ("adaptive", ctypes.c_int), ("learned", ctypes.c_float * SIZE * 2),
    ]  # fmt: skip


def find_compiler() -> str:
    """The C compiler; tests that need one are skipped without."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs gcc: apt install gcc")
    return compiler


def compile_library(folder: Path) -> Path:
    """The exported source as a shared library, without a warning."""
    out = folder / "vpptwin.so"
    command = [find_compiler(), *STRICT, "-shared", "-fPIC", str(folder / "vpptwin.c"), "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return out


def make_random(*overrides: str, vehicle: Vehicle | None = None) -> Content:
    """What an export of an untrained policy holds."""
    torch.manual_seed(7)
    trained = compose_config(["task=flip", *overrides])
    policy = Policy(trained.observation, (trained.hidden[0], trained.hidden[1]))
    with torch.no_grad():
        for layer in policy.layers():
            layer.weight.mul_(1.5)
    content = make_content(
        Actor(policy.state_dict()), trained, {"checkpoint": "random", "steps": 0, "trained_at": "none"}
    )
    return content if vehicle is None else replace(content, vehicle=vehicle)


@pytest.fixture(scope="session")
def shipped() -> Content:
    """What an export of the shipped policy holds."""
    return collect_content("flip")


@pytest.fixture(scope="session")
def library(shipped: Content, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy, exported and compiled."""
    folder = tmp_path_factory.mktemp("exported")
    write_c(shipped, folder)
    return compile_library(folder)
