"""Parquet files and LeRobot data sets, whose episodes are flights."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.errors import InputError, load_extra
from vpptwin.fields import Stamp
from vpptwin.logs.headings import check_times, count_ns, find_clock, guess_unit, part_units
from vpptwin.logs.raw import Wish
from vpptwin.logs.tables import Table, choose_fields

_ROWS = 1 << 16  # rows converted at once
_BUFFER = 1 << 16  # bytes of a column read at once
_ROWS_OF_SETS = ("index", "frame_index", "episode_index", "task_index")  # bookkeeping of LeRobot


def read_parquet(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Rows of a Parquet file, in pieces.

    Raises:
        InputError: if it is damaged, or has no column with the time.
    """
    yield from read_rows(path, path, topic, wish.stamps.get(topic), wish, notes, None, {})


def read_rows(
    path: Path, file: Path, topic: str, stamp: Stamp | None, wish: Wish, notes: list[str], episode: int | None,
    names: Mapping[str, list[str]],
) -> Iterator[Table]:  # fmt: skip
    """Rows of a Parquet file, those of one episode if it has several; `names` are those of elements of lists."""
    pa = load_extra("pyarrow", path)
    parquet = load_extra("pyarrow.parquet", path)
    try:
        content = parquet.ParquetFile(file, pre_buffer=False, buffer_size=_BUFFER)  # else all of it is held
        unit: str | None = None
        units: dict[str, str] = {}
        given = dict(zip(part_units(content.schema_arrow.names, units), content.schema_arrow.names))
        clock = find_clock(path, list(given), stamp, units)
        fields: dict[str, str] | None = None
        for first in content.iter_batches(batch_size=_ROWS):  # only rows tell whether lists have one length
            held = {n: read_arrow(pa, n, first.column(k), units, names) for k, n in enumerate(given)}
            held = {n: columns for n, columns in held.items() if episode is None or n not in _ROWS_OF_SETS}
            if not held[clock] or held[clock][clock].dtype.kind not in "iuf":
                raise InputError(f"{path}: {clock} holds no numbers", "a column of times", "name another as its stamp")
            fields = choose_fields(wish, topic, [column for columns in held.values() for column in columns])
            given = {n: given[n] for n, columns in held.items() if n == clock or not fields.keys().isdisjoint(columns)}
            break
        wanted = [*given.values(), *(["episode_index"] if episode is not None else [])]
        for batch in content.iter_batches(batch_size=_ROWS, columns=wanted):
            if episode is not None:
                batch = batch.filter(pa.array(np.asarray(batch.column("episode_index")) == episode))
            if not batch.num_rows:
                continue
            columns: dict[str, np.ndarray] = {}
            for name, source in given.items():
                columns |= read_arrow(pa, name, batch.column(source), units, names)
            if lost := (fields or {}).keys() - columns.keys():
                found = f"{path}: {min(lost)} holds lists of several lengths"
                raise InputError(found, "one length", "leave the column out")
            time = columns[clock]
            check_times(path, clock, time)
            unit = unit or (stamp.unit if stamp is not None else None) or units.get(clock) or guess_unit(time)
            yield Table(topic, count_ns(time, unit), columns, units, fields)
        if unit is None:
            raise InputError(f"{path} has no rows", "a table with rows", "check what wrote it")
        if unit not in ("s", units.get(clock)) and stamp is None:
            notes.append(f"{topic}: {clock} is taken to count {unit}")
    except (pa.ArrowInvalid, OSError, KeyError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{file} is damaged ({reason})", "a whole Parquet file", "copy it again") from None


def read_arrow(
    pa: Any,  # noqa: ANN401
    name: str,
    column: Any,  # noqa: ANN401
    units: dict[str, str],
    names: Mapping[str, list[str]],
) -> dict[str, np.ndarray]:
    """A column as arrays: dates in ns, lists (n, k) or one column per named element, what is neither left out."""
    kind = column.type
    if pa.types.is_timestamp(kind):
        units[name] = "ns"
        return {name: np.asarray(column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64()))}
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        inner = column.flatten()
        width, rest = divmod(len(inner), len(column))
        if rest or not width or not (pa.types.is_floating(inner.type) or pa.types.is_integer(inner.type)):
            return {}  # pictures, ragged lists
        values = np.asarray(inner.to_numpy(zero_copy_only=False)).reshape(-1, width)
        labels = names.get(name, [])
        if len(labels) == width and len(set(labels)) == width:
            return {f"{name}.{label}": values[:, k] for k, label in enumerate(labels)}
        return {name: values}
    if pa.types.is_boolean(kind):
        return {name: np.asarray(column.fill_null(False).to_numpy(zero_copy_only=False)).astype(bool)}
    if pa.types.is_integer(kind) and not column.null_count:
        return {name: np.asarray(column.to_numpy(zero_copy_only=False))}
    if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind):
        code = pa.float32() if pa.types.is_float32(kind) else pa.float64()
        return {name: np.asarray(column.cast(code, safe=False).to_numpy(zero_copy_only=False))}
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return {name: np.asarray(column.fill_null("").to_numpy(zero_copy_only=False))}
    return {}


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return (folder / "meta" / "info.json").is_file()


def list_episodes(folder: Path) -> list[Path]:
    """The flights of a LeRobot data set: FOLDER#EPISODE.

    Raises:
        InputError: if `meta/info.json` does not say how many.
    """
    total = read_info(folder).get("total_episodes")
    if not isinstance(total, int) or total < 1:
        found = f"{folder}/meta/info.json: total_episodes {total!r}"
        raise InputError(found, "a LeRobot data set with episodes", "check the data set")
    return [Path(f"{folder}#{episode}") for episode in range(total)]


def read_info(folder: Path) -> dict[str, Any]:
    """What a LeRobot data set says of itself."""
    try:
        content = json.loads((folder / "meta" / "info.json").read_text())
    except (OSError, ValueError) as error:
        found = f"{folder}/meta/info.json cannot be read ({error})"
        raise InputError(found, "that of a LeRobot data set", "copy it again") from None
    return content if isinstance(content, dict) else {}


def read_lerobot(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Rows of one episode of a LeRobot data set, named FOLDER#EPISODE.

    Raises:
        InputError: if it has no such episode, or is damaged.
    """
    folder, episode = split_episode(path)
    names = {}
    for feature, about in read_info(folder).get("features", {}).items():
        given = about.get("names") if isinstance(about, dict) else None
        given = next(iter(given.values()), None) if isinstance(given, dict) else given
        if isinstance(given, list):
            names[feature] = [str(name) for name in given]
    pa = load_extra("pyarrow", path)
    files = find_episode(folder, episode, pa)
    found = False
    for file in files:
        try:
            clock = wish.stamps.get(topic) or Stamp(path="timestamp", unit="s")
            for table in read_rows(path, file, topic, clock, wish, notes, episode, names):
                found = True
                yield table
        except InputError as error:
            if "has no rows" not in error.found:
                raise
    if not found:
        total = len(list_episodes(folder))
        raise InputError(f"{path}: no rows of episode {episode}", f"0 to {total - 1}", "check the number")


def split_episode(path: Path) -> tuple[Path, int]:
    """Folder and number of FOLDER#EPISODE."""
    folder, _, number = str(path).rpartition("#")
    return Path(folder), int(number)


def find_episode(folder: Path, episode: int, pa: Any) -> list[Path]:  # noqa: ANN401
    """The Parquet files that may hold an episode: the one that the data set's own index names, or else all."""
    info = read_info(folder)
    parquet = load_extra("pyarrow.parquet", folder)
    for file in sorted((folder / "meta" / "episodes").rglob("*.parquet")):
        try:
            rows = parquet.read_table(
                file, columns=["episode_index", "data/chunk_index", "data/file_index"]
            ).to_pylist()
        except (pa.ArrowInvalid, OSError, KeyError):
            break
        for row in rows:
            if row["episode_index"] == episode:
                place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
                template = str(info.get("data_path", "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"))
                return [folder / template.format(**place)]
    alone = sorted((folder / "data").rglob(f"episode_{episode:06d}.parquet"))
    return alone or sorted((folder / "data").rglob("*.parquet"))
