"""Models of anyone's are compiled in a process of their own first: MuJoCo crashes on some, and on some never ends.

How large they may be is bounded too, as an MJCF may ask for any amount of memory.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile

import mujoco

from vpptwin.system.errors import InputError
from vpptwin.system.resources import models_dir
from vpptwin.twin.robot.parts import Element, multiply

MAX_BYTES = 1 << 30
"""Memory that compiling a model may take [bytes]."""
MAX_DATA = 1 << 28
"""What one simulation of it may take [bytes]."""
MAX_COPIES = 100_000
"""How often `replicate` and `composite` may repeat an element."""
MAX_CELLS = 4_000_000
SIDES = (("nrow", "ncol"), ("width", "height"))
"""Cells of a height field or texture: they are counted before MuJoCo allocates, which it does not survive unharmed."""
SECONDS = 60
"""Processor time that compiling a model may take [s]."""
PATIENCE = 3.0 * SECONDS
"""How long it may take by the clock [s], as on a machine that is busy."""
TRY = """
import ctypes, os, resource, sys
_, library, plugins, path, seconds, room = sys.argv
mujoco = ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
for plugin in filter(None, plugins.split(os.pathsep)):
    ctypes.CDLL(plugin)
told = ctypes.CFUNCTYPE(None, ctypes.c_char_p)
quiet, leave = told(lambda text: None), told(lambda text: os._exit(0))
for name, call in (("mju_user_warning", quiet), ("mju_user_error", leave)):
    ctypes.c_void_p.in_dll(mujoco, name).value = ctypes.cast(call, ctypes.c_void_p).value
limits = {resource.RLIMIT_CPU: int(seconds), resource.RLIMIT_CORE: 0}
if os.path.exists("/proc/self/statm"):
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    limits[resource.RLIMIT_AS] = used + int(room)
for what, most in limits.items():
    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
mujoco.mj_loadXML(os.fsencode(path), None, ctypes.create_string_buffer(1000), 1000)
"""
"""What the process runs: MuJoCo's library alone, which takes a tenth of what its Python package would."""
_sound: set[tuple[object, ...]] = set()  # models of this process that compiled


def try_model(path: Path, elements: list[Element], room: int, urdf: ET.Element | None = None) -> None:
    """Compile a model in a process that may die; those that ship, and those that lived, are not tried again.

    Whatever MuJoCo refuses lives too: the reason is told where it is compiled for good.

    Args:
        path: of the model.
        elements: of it and of its parts.
        room: memory that it may take [bytes].
        urdf: the <robot> as MuJoCo is to read it, where that is not the file.

    Raises:
        InputError: if it crashes, or does not end.
    """
    real = Path(os.path.realpath(path))
    if real.parent == models_dir().resolve():
        return
    files = {os.path.realpath(element.file) for element in elements}
    text = None if urdf is None else ET.tostring(urdf)
    state = (real, text, *(item for file in sorted(files) for item in (file, os.stat(file).st_mtime_ns)))
    if state in _sound:
        return
    home = Path(mujoco.__file__).parent
    (library,) = [file for file in home.glob("libmujoco*") if ".so" in file.name or file.suffix == ".dylib"][:1]
    plugins = os.pathsep.join(map(str, sorted((home / "plugin").glob("lib*"))))
    command = [sys.executable, "-I", "-S", "-c", TRY, str(library), plugins]
    advice = "open it in MuJoCo's viewer, and take out what it needs so long for"
    try:
        with NamedTemporaryFile(suffix=".urdf") as written:
            if text is not None:
                written.write(text)
                written.flush()
            command += [str(real) if text is None else written.name, str(SECONDS), str(room)]
            ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE, cwd="/")
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: MuJoCo waits for a file", "regular files", advice) from None
    died = -ended.returncode
    if died == signal.SIGXCPU:
        raise InputError(f"{path}: MuJoCo needs more than {SECONDS} s", "a model that compiles sooner", advice)
    if died > 0:
        found = f"{path}: MuJoCo crashes on it ({signal.Signals(died).name})"
        raise InputError(found, "an MJCF that compiles", "take out its parts one by one until it does")
    _sound.add(state)


@contextmanager
def bound_memory() -> Iterator[None]:
    """Let this process grow by `MAX_BYTES` at most; beyond, what asks for memory fails. Nothing where it can't be."""
    try:
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([used + MAX_BYTES, *limits]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def check_claims(path: Path, elements: Iterable[Element]) -> None:
    """Refuse an MJCF that repeats an element, or spans a grid, so often that MuJoCo would not come back.

    Raises:
        InputError: naming the element.
    """
    for _, tag, given, times in elements:
        for largest, number in ((MAX_COPIES, times), *((MAX_CELLS, multiply(given, *sides)) for sides in SIDES)):
            if number > largest:
                named = " ".join(f"{name}={value!r}" for name, value in given.items() if value[:1].isdecimal())
                raise InputError(f"{path}: <{tag} {named}>", f"at most {largest} of anything", "lower it")


def check_size(model: mujoco.MjModel, path: Path) -> None:
    """Refuse a model whose simulations take more than `MAX_DATA` each.

    Raises:
        InputError: with what one takes.
    """
    size = mujoco.mj_sizeModel(model) + int(model.narena)
    if size > MAX_DATA:
        found = f"{path}: a model of {size / 1e6:.0f} MB with what it asks for in <size>"
        raise InputError(found, f"at most {MAX_DATA / 1e6:.0f} MB", "leave out meshes and height fields, lower <size>")
