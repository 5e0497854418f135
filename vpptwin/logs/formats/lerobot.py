"""LeRobot data sets, whose episodes are flights, FOLDER#EPISODE: nothing that one says of itself is believed unseen."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vpptwin.logs.formats.columnar import read_rows
from vpptwin.logs.formats.raw import Query
from vpptwin.logs.formats.tables import Table
from vpptwin.logs.parts import split_episode
from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.fields import Stamp
from vpptwin.system.plain import is_within, read_json

MAX_EPISODES = 100_000
"""Flights that one name may stand for."""
MAX_FILES = 10**6
"""Above every chunk's and file's number."""
_SLOT = re.compile(r"\{(chunk_index|file_index|episode_chunk|episode_index)(?::0?([1-9])d)?\}")
"""A number in a name of a file, and its width."""
_AGAIN = "correct it, or copy the data set again"
_PLACE = ("data/chunk_index", "data/file_index")
Count = Annotated[int, Field(ge=1)]


class Info(BaseModel):
    """What `meta/info.json` says, as far as anything is read of it."""

    model_config = ConfigDict(frozen=True, strict=True)
    total_episodes: Count | None = None
    chunks_size: Count = 1000
    data_path: Annotated[str, Field(max_length=500)] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    features: dict[str, Any] = {}

    def name_elements(self) -> dict[str, list[str]]:
        """Feature → the names of its elements, where it says some."""
        names = {}
        for feature, about in self.features.items():
            given = about.get("names") if isinstance(about, dict) else None
            given = next(iter(given.values()), None) if isinstance(given, dict) else given
            if isinstance(given, list) and all(isinstance(name, str | int | float) for name in given):
                names[feature] = [str(name) for name in given]
        return names


def list_episodes(folder: Path) -> list[Path]:
    """The flights of a LeRobot data set: FOLDER#EPISODE."""
    total = read_info(folder).total_episodes
    if total is None:
        found = f"{folder}/meta/info.json without total_episodes"
        raise InputError(found, "a LeRobot data set with episodes", "check the data set")
    files = list_parquet(folder / "data")  # which have room for an episode each, or for one a row
    held = len([file for file in files if file.name.startswith("episode_")])
    if not held:
        parquet = load_extra("pyarrow.parquet", folder)
        for file in files:
            try:
                held += parquet.read_metadata(file).num_rows
            except (OSError, ValueError):  # reading it will say so
                held = total
            if held >= total:
                break
    held = min(held, total, MAX_EPISODES)
    if total > held:
        found = f"{folder}/meta/info.json says {total} episodes"
        raise InputError(found, f"at most {held}, by the files below data", f"copy all of it, or give one, {folder}#0")
    return [Path(f"{folder}#{episode}") for episode in range(total)]


def list_parquet(folder: Path) -> list[Path]:
    """The Parquet files below a folder."""
    return sorted(file for file in folder.rglob("*.parquet") if file.is_file())


def read_info(folder: Path) -> Info:
    """What a LeRobot data set says of itself."""
    file = folder / "meta" / "info.json"
    try:
        return Info.model_validate(read_json(file))
    except ValidationError as error:  # of ValueError's kind, too
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"])) or "no JSON object"
        expected = re.sub("^(Input should be|String should have) ", "", first["msg"])
        raise InputError(f"{file}: {key}", expected if first["loc"] else "keys and values", _AGAIN) from None
    except (OSError, ValueError) as error:
        found = f"{file} cannot be read ({error})"
        raise InputError(found, "that of a LeRobot data set", "copy it again") from None


def read_lerobot(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Rows of one episode of a LeRobot data set, named FOLDER#EPISODE."""
    folder, episode = split_episode(path)
    assert episode is not None
    info, found = read_info(folder), False
    for file in find_episode(folder, episode, info):
        try:
            clock = query.stamps.get(topic) or Stamp(path="timestamp", unit="s")
            for table in read_rows(path, file, topic, clock, query, notes, episode, info.name_elements()):
                found = True
                yield table
        except InputError as error:
            if "has no rows" not in error.found:
                raise
    if not found:
        expected = f"0 to {info.total_episodes - 1}" if info.total_episodes else "one of the data set's"
        raise InputError(f"{path}: no rows of episode {episode}", expected, "check the number")


def find_episode(folder: Path, episode: int, info: Info) -> list[Path]:
    """The Parquet files that may hold an episode: the one that the data set names, or else all."""
    numbers = {"episode_index": episode, "episode_chunk": episode // info.chunks_size}
    numbers |= find_place(folder, episode)
    needed = {slot[1] for slot in _SLOT.finditer(info.data_path)}
    if {"{", "}"} & {*_SLOT.sub("", info.data_path)} or not is_within(_SLOT.sub("0", info.data_path)):
        found = f"{folder}/meta/info.json: data_path {info.data_path!r}"
        raise InputError(found, f"a file in the folder, such as {Info().data_path}", _AGAIN)
    if needed <= numbers.keys():
        named = folder / _SLOT.sub(lambda slot: f"{numbers[slot[1]]:0{slot[2] or 1}d}", info.data_path)
        if named.is_file():
            return [named]
        if "chunk_index" in numbers:
            found = f"{folder}: {named.relative_to(folder)} of episode {episode} is missing"
            raise InputError(found, "all files of the data set", "copy it")
    files = list_parquet(folder / "data")
    return [file for file in files if file.name == f"episode_{episode:06d}.parquet"] or files


def find_place(folder: Path, episode: int) -> Mapping[str, int]:
    """Numbers of the chunk and file that hold an episode, by the data set's own index; none where it has none."""
    pa, parquet = load_extra("pyarrow", folder), load_extra("pyarrow.parquet", folder)
    for file in list_parquet(folder / "meta" / "episodes"):
        try:
            index = parquet.ParquetFile(file)
            if index.metadata.num_rows > 10 * MAX_EPISODES:
                break
            rows = index.read(columns=["episode_index", *_PLACE]).to_pylist()
        except (pa.ArrowException, OSError, KeyError, ValueError):
            break
        for row in rows:
            if row.get("episode_index") == episode:
                place = {name.removeprefix("data/"): row.get(name) for name in _PLACE}
                if any(type(number) is not int or not 0 <= number < MAX_FILES for number in place.values()):
                    found = f"{file}: {' and '.join(_PLACE)} of episode {episode}"
                    raise InputError(found, "numbers of a chunk and a file", "copy the data set again")
                return place
    return {}
