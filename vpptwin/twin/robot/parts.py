"""The files that a model is made of, walked before MuJoCo opens any: it waits at pipes, and crashes on circles."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Mapping, Sequence
from html.parser import HTMLParser
from itertools import product
from pathlib import Path
from typing import NamedTuple

from vpptwin.system.errors import InputError
from vpptwin.system.plain import open_regular

MAX_PARTS = 1000
"""Files of MJCF that one model may be made of, one that is attached twice counted twice."""
MAX_NAMED = 1_000_000
"""Places where files that it names may lie."""
MAX_TEXT = 1 << 26
"""Bytes of one of its files."""
FOLDERS = ("meshdir", "texturedir", "assetdir")


class Element(NamedTuple):
    """An element of a model.

    Attributes:
        file: in which it stands.
        tag: its kind.
        given: its attributes.
        times: how often the model has it.
    """

    file: Path
    tag: str
    given: Mapping[str, str]
    times: float


class Claims(HTMLParser):
    """Elements of an MJCF with their attributes, and how many of each there will be.

    MuJoCo reads what no parser of XML would, so that one of HTML does, which refuses nothing either.

    Args:
        times: how often the file is included.
    """

    def __init__(self, times: float) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str], float]] = []
        self._times = [times]

    def set_cdata_mode(self, elem: str, *, escapable: bool = False) -> None:
        """Within `script`, HTML has no elements; MJCF has."""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An element whose children follow."""
        self.handle_startendtag(tag, attrs)
        self._times.append(self.found[-1][2])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An element without children."""
        given = {name: value or "" for name, value in attrs}
        self.found.append((tag, given, self._times[-1] * multiply(given, "count")))

    def handle_endtag(self, tag: str) -> None:
        """The children of the last element end."""
        if len(self._times) > 1:
            self._times.pop()


def multiply(given: Mapping[str, str], *names: str) -> float:
    """Product of all whole numbers in some attributes; 1 where there are none."""
    words = [word for name in names for word in given.get(name, "").split()]
    return math.prod(float(word) for word in words if word.isdecimal())


def read_parts(path: Path) -> list[Element]:
    """All elements of a model: those of files that it includes, each once, and of models that it attaches.

    Raises:
        InputError: if it attaches itself, or is made of too many files, or of one that is no regular file.
    """
    found: list[Element] = []
    around: tuple[str, ...] = (os.path.realpath(path),)
    waiting: list[tuple[Path, float, tuple[str, ...], set[str]]] = [(path, 1.0, around, set())]
    count = 0
    while waiting:  # a file, how often it counts, the models that it is in, its own the last, and what that has read
        file, times, models, read = waiting.pop()
        if os.path.realpath(file) in read:
            continue
        read.add(os.path.realpath(file))
        count += 1
        if count > MAX_PARTS:
            raise InputError(f"{path}: more than {MAX_PARTS} files", "fewer", "attach fewer models in models")
        home = Path(models[-1]).parent
        for tag, given, number in read_elements(file, times):
            found.append(Element(file, tag, given, number))
            name = given.get("file", "")
            if tag == "include":
                inside = [place for place in (home / name, file.parent / name) if os.path.isfile(place)]
                waiting += [(place, number, models, read) for place in inside[:1]]
            elif tag == "model" and os.path.isfile(home / name):
                real = os.path.realpath(home / name)
                if real in models:
                    action = "attach another, or take the <model> out"
                    raise InputError(f'{path}: <model file="{name}"> in {file} attaches itself', "another", action)
                waiting.append((home / name, number, (*models, real), set()))
    check_files(path, found)
    return found


def read_elements(file: Path, times: float) -> Sequence[tuple[str, dict[str, str], float]]:
    """Elements of one file; none where it cannot be read, which MuJoCo says."""
    claims = Claims(times)
    try:
        with open_regular(file) as content:
            text = content.read(MAX_TEXT + 1)
    except OSError:
        return []
    if len(text) > MAX_TEXT:
        raise InputError(f"{file}: more than {MAX_TEXT >> 20} MB", "less", "keep meshes in files of their own")
    claims.feed(text.decode("iso-8859-1"))
    return claims.found


def check_files(path: Path, elements: Sequence[Element]) -> None:
    """Refuse a model that names pipes or devices, wherever MuJoCo may look for what it names.

    Raises:
        InputError: naming the first.
    """
    folders = {""} | {value for e in elements for name, value in e.given.items() if name in FOLDERS}
    homes = {e.file.parent for e in elements}
    named = {value: e for e in elements for name, value in e.given.items() if name.startswith("file") and value}
    if len(folders) * len(homes) * len(named) > MAX_NAMED:
        raise InputError(f"{path}: {len(named)} files in {len(folders)} folders", "fewer", "leave out most")
    for home, folder, value in product(homes, folders, named):
        for name in {value, value.replace("\\", "/").rpartition("/")[2]}:
            try:
                kind = os.stat(home / folder / name).st_mode
            except (OSError, ValueError):  # MuJoCo says what is missing
                continue
            if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):
                found = f'{path}: <{named[value].tag} file="{value}"> is no regular file'
                raise InputError(found, "one, as a pipe or device may never end", "name another")
