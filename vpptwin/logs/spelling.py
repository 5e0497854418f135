"""How logs are spelled: FILE, FOLDER, FILE#TEST, FOLDER#EPISODE, a pattern, A+B, LOG@START-END of each; what they are.

Whoever is given a log asks here which recordings it is, of which files, and what to call it. What is there under the
very name that was given is that, whatever signs the name has.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import suppress
from glob import glob, has_magic
from itertools import takewhile
from pathlib import Path, PurePosixPath

import yaml

from vpptwin.logs.formats.lerobot import find_episode, list_episodes, read_info
from vpptwin.logs.formats.readers import FORMATS, LOG
from vpptwin.logs.parts import is_lerobot, is_part, split_episode, split_number, split_span, split_test
from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml

PathLike = str | os.PathLike[str]
_PACKED = (".zstd", ".zst")
"""What names of files end with that are compressed as a whole."""
_ENDINGS = tuple(ending + packed for form in FORMATS for ending in form.endings for packed in ("", *_PACKED))
_MAX_NAMES = 3  # files of one recording that are all named
_MAX_STEM = 200  # bytes of a name that is made of a log's
_METADATA = "metadata.yaml"


def spell(log: PathLike | Sequence[PathLike]) -> Path:
    """A log, or the files of one recording, as one name."""
    text = str(Path(log)) if isinstance(log, str | os.PathLike) else "+".join(map(str, log))
    return Path(text if os.path.exists(text) else text.replace("/@", "@").replace("/#", "#"))  # of a shell's completion


def list_flights(log: PathLike) -> list[Path]:
    """The flights that a log stands for: in a folder that is no rosbag2 every log is one, and all that a pattern finds.

    Raises:
        InputError: if a folder holds no log, or a pattern finds nothing.
    """
    given = spell(log)
    if (found := expand(given)) != [given]:
        return [flight for each in found for flight in list_flights(each)]
    plain, span = split_span(given)
    if span is not None:
        return [_cut(flight, given, plain) for flight in list_flights(plain)]
    if not os.path.isdir(given) or is_bag(given):
        return list_tests(given)
    if is_lerobot(given):
        return list_episodes(given)
    held = sorted(given.iterdir())
    files = [item for item in held if item.is_file() and item.name.lower().endswith(_ENDINGS)]
    logs = [test for file in files for test in list_tests(file)]
    logs += [item for item in held if item.is_dir() and is_bag(item)]
    if not logs:
        shown = ", ".join(item.name for item in held[:5]) or "nothing"
        raise InputError(f"folder {given} holds {shown}", "logs, or a rosbag2 folder", "give a log")
    return logs


def list_tests(file: Path) -> list[Path]:
    """The flights that a file stands for: FILE#NUMBER each where it holds several; whoever reads tells damage."""
    numbers: list[int] = []
    with suppress(InputError):
        for form in FORMATS:
            if form.list_tests is not None and file.suffix.lower() in form.endings and file.is_file():
                numbers = form.list_tests(file)
    return [Path(f"{file}#{number}") for number in numbers] if len(numbers) > 1 else [file]


def expand(log: PathLike) -> list[Path]:
    """What a pattern such as `runs/*.mcap` finds, in order of names; anything else is itself.

    Raises:
        InputError: if it finds nothing.
    """
    text = str(log)
    if not has_magic(text) or _is_there(text):
        return [Path(log)]
    plain = _strip(text)
    found = [Path(f"{file}{text[len(plain) :]}") for file in sorted(glob(plain, recursive=True))]
    if not found and len(split_sum(text)) == 1:
        raise InputError(f"no file matches {text}", LOG, "check the pattern")
    return found or [Path(log)]


def find_files(log: PathLike | Sequence[PathLike]) -> list[Path]:
    """Files of one recording, as readers take them: FILE or FOLDER#EPISODE, each with its @START-END.

    Raises:
        InputError: if there are none, or it stands for several flights.
    """
    if not isinstance(log, str | os.PathLike):
        if not log:
            raise InputError("no log given", LOG, "name at least one file")
        return [file for item in log for file in find_files(item)]
    given = spell(log)
    if is_part(given):
        return [given]
    if os.path.exists(given) and not os.path.isdir(given):
        if not os.path.isfile(given):
            found, action = f"{given} is a pipe or a device", "write it to a file first, and give that"
            raise InputError(found, "a file, as logs are read more than once", action)
        return [given]
    pieces, (plain, span) = split_sum(str(given)), split_span(given)
    if len(pieces) > 1 and (span is None or any(split_span(Path(piece))[1] for piece in pieces[:-1])):
        return [file for piece in pieces for each in expand(piece) for file in find_files(each)]
    within = list_flights(given)
    if len(within) > 1:
        what = f"folder {given}" if os.path.isdir(given) else str(given)
        found, action = f"{what} holds {len(within)} recordings", f"give one, such as {within[0]}"
        raise InputError(found, "one recording here", action)
    if span is not None:
        return [_cut(file, given, plain) for file in find_files(plain)]
    if within != [given]:
        return find_files(within[0])
    if os.path.isdir(given):
        return list_bag(given)
    text = str(given)
    if text == "-":
        raise InputError("- as a log", "a file, as logs are read more than once", "write it to a file first")
    for mark, wanted in (("@", "LOG@START-END in seconds, one of them at least"), ("#", "FOLDER#EPISODE of LeRobot")):
        log_name, _, rest = text.rpartition(mark)
        if log_name and os.path.exists(log_name):
            raise InputError(f"{mark}{rest} of {log_name}", wanted, f"correct it, or give {log_name}")
    raise InputError(f"no file {given}", LOG, "check the path")


def list_sources(log: PathLike) -> list[Path]:
    """The files on disk that a log is read from.

    Raises:
        InputError: as `find_files`.
    """
    found: list[Path] = []
    for file in find_files(log):
        plain = split_span(file)[0]
        folder, episode = split_episode(plain)
        if episode is not None:
            found += [folder / "meta" / "info.json", *find_episode(folder, episode, read_info(folder))]
        else:
            found.append(split_test(plain)[0])
    return list(dict.fromkeys(found))


def list_parts(log: PathLike) -> list[tuple[Path, float, float]]:
    """Files of one recording, whatever links lead there, and from when to when they are taken [s].

    Raises:
        InputError: as `find_files`.
    """
    found = []
    for plain, span in map(split_span, find_files(log)):
        folder, mark, number = str(plain).rpartition("#") if is_part(plain) else (str(plain), "", "")
        place = Path(f"{Path(folder).resolve()}{mark}{number}")
        found.append((place, span.start if span else 0.0, span.end if span else math.inf))
    return found


def split_sum(text: str) -> list[str]:
    """The logs of A+B; a name with a plus of what is there stays whole."""
    pieces: list[str] = []
    for piece in [text] if _is_there(text) else text.split("+"):
        pieces.append(piece)
        joined = ("+".join(pieces[start:]) for start in range(len(pieces)))
        apart = len(list(takewhile(lambda whole: not _is_there(whole), joined)))
        if apart < len(pieces):
            pieces[apart:] = ["+".join(pieces[apart:])]
    if not all(pieces):
        raise InputError(f"{text} has a plus with nothing beside it", "FILE+FILE", "leave it out, or name the file")
    return pieces


def name_log(log: PathLike) -> str:
    """A log's name in messages: without its folders, and short."""
    names = [_base(Path(piece)) for piece in split_sum(str(log))]
    return "+".join(names) if len(names) <= _MAX_NAMES else f"{names[0]}+{len(names) - 1} more"


def stem_log(log: PathLike) -> str:
    """What files that belong to a log are called: its name without ending, in signs that links and shells take."""
    plain, span = split_span(spell(log))
    files = [split_span(Path(piece))[0] for piece in split_sum(str(plain))]
    stems = []
    for file in files:
        plain_file, number = split_test(file)
        whole = os.path.isdir(file) or split_episode(file)[1] is not None
        stems.append(_base(file) if whole else plain_file.stem + ("" if number is None else f"#{number}"))
    stem = "_".join(stems) if len(stems) <= _MAX_NAMES else f"{stems[0]}_and_{len(stems) - 1}_more"
    text = stem + (str(spell(log))[len(str(plain)) :] if span is not None else "")
    return text.replace("#", "_").replace("@", "_").encode()[:_MAX_STEM].decode(errors="ignore")


def _cut(file: Path, given: Path, plain: Path) -> Path:
    """A file, and of it the stretch that is given of the whole."""
    return Path(f"{file}{str(given)[len(str(plain)) :]}")


def _base(path: Path) -> str:
    """A path without its folders, also of `.` and `..`."""
    return (path if path.name.strip(".") else path.resolve()).name


def _is_there(text: str) -> bool:
    """Whether a piece of a name, its stretch and episode aside, is the name of something."""
    return bool(text) and (os.path.exists(text) or os.path.exists(_strip(text)))


def _strip(text: str) -> str:
    """A log without its stretch, test and episode."""
    return split_number(split_span(Path(text))[0])[0]


def is_bag(folder: Path) -> bool:
    """Whether a folder is a rosbag2."""
    return (folder / _METADATA).exists()


def list_bag(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder that its metadata name, or that it holds where those cannot be read."""
    try:
        content = read_yaml(folder / _METADATA)
        named = [str(name) for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        held = (file.name for file in folder.iterdir())
        named = sorted(name for name in held if _unpacked(name.lower()).endswith((".mcap", ".db3")))
    if not named:
        raise InputError(f"{folder} with a {_METADATA} that names none of its files", "a rosbag2 folder", "remove it")
    return [_find_named(folder, name) for name in dict.fromkeys(named)]


def _find_named(folder: Path, name: str) -> Path:
    """A file that metadata name: from the folder on, or its parent as up to version 3, or by name alone."""
    bare = PurePosixPath(name).name
    for place in (folder / name, folder.parent / name, folder / bare, folder / _unpacked(bare)):
        with suppress(OSError):  # of names that are too long, folders that nobody may read
            if place.is_file() and place.resolve().is_relative_to(folder.resolve()):
                return place
    raise InputError(f"{folder}/{_METADATA} names {name}, which is missing", "all files of the recording", "copy it")


def _unpacked(name: str) -> str:
    """A file's name once it is unpacked."""
    return next((name.removesuffix(ending) for ending in _PACKED if name.endswith(ending)), name)
