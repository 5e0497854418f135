"""LeRobot data sets that say of themselves what is not so: one line, no file from elsewhere, nothing that waits."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet

from tests.logs.bags import refuse
from tests.logs.test_foreign import write_lerobot
from vpptwin.logs.spelling import list_flights
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError

INFO, INDEX, DATA = "meta/info.json", "meta/episodes/chunk-000/file-000.parquet", "data/chunk-000/file-000.parquet"


def change(folder: Path, **changes: Any) -> None:  # noqa: ANN401
    """Write other values into what a data set says of itself."""
    about = json.loads((folder / INFO).read_text())
    (folder / INFO).write_text(json.dumps(about | changes))


def survey_all(folder: Path) -> None:
    """Look at all of a data set's flights."""
    list(map(survey, list_flights(folder)))


@pytest.mark.parametrize(
    "template",
    ["data/{chunk_index:0999999999d}.parquet", "data/{chunk_index.__class__.__mro__}", "{chunk_index[0]}", "{x}", "{",
     "}", "{}", "{chunk_index!r:>9}", "{chunk_index:{file_index}}", "/etc/passwd", "../../x.parquet", "data/../../x",
     "", "a\0b", "{chunk_index:x}"],
)  # fmt: skip
def test_names_of_files_are_filled_in_by_known_numbers_alone(tmp_path: Path, template: str) -> None:
    """Neither Python's formatting, nor a file elsewhere, whatever `data_path` says."""
    folder = write_lerobot(tmp_path / "set")
    change(folder, data_path=template)
    refuse(folder, f"meta/info.json: data_path {template!r}", "expected a file in the folder", read=survey_all)


def test_old_data_sets_are_found_by_their_template(tmp_path: Path) -> None:
    """Version 2 names a file by its episode, in a chunk of so many."""
    folder = write_lerobot(tmp_path / "set")
    (folder / INDEX).unlink()
    rows = parquet.read_table(folder / DATA)
    for episode, name in ((0, "data/part-0/ep_000"), (1, "data/part-1/ep_001")):
        (folder / name).parent.mkdir()
        parquet.write_table(rows.filter(pa.compute.equal(rows["episode_index"], episode)), folder / f"{name}.parquet")
    (folder / DATA).unlink()
    change(folder, chunks_size=1, data_path="data/part-{episode_chunk}/ep_{episode_index:03d}.parquet")
    assert [survey(flight)[0].files[0].channels[0].count for flight in list_flights(folder)] == [30, 20]


@pytest.mark.parametrize("total", [3_000_000, 10**30, 51])
def test_no_more_episodes_than_rows(tmp_path: Path, total: int) -> None:
    """Each has one at least."""
    folder = write_lerobot(tmp_path / "set")
    change(folder, total_episodes=total)
    refuse(folder, f"says {total} episodes; expected at most 50, by the files below data", read=survey_all)


@pytest.mark.parametrize(
    ("changes", "part"),
    [({"total_episodes": True}, "total_episodes; expected a valid integer"),
     ({"total_episodes": 0}, "total_episodes; expected greater than"),
     ({"total_episodes": None}, "without total_episodes"), ({"chunks_size": "1"}, "chunks_size"),
     ({"data_path": ["data"]}, "data_path; expected a valid string"),
     ({"data_path": "{chunk_index}" * 99}, "data_path; expected at most 500 characters"),
     ({"features": [1, 2]}, "features; expected a valid dictionary")],
)  # fmt: skip
def test_keys_of_another_kind_are_named(tmp_path: Path, changes: dict[str, object], part: str) -> None:
    """Lists for objects, text for numbers, nothing at all."""
    folder = write_lerobot(tmp_path / "set")
    change(folder, **changes)
    refuse(folder, part, read=survey_all)


@pytest.mark.parametrize(
    ("text", "part"),
    [("[" * 100_000, "nested too deeply"), ('{"features": ' * 20_000, "nested too deeply"), ("[]", "no JSON object"),
     ('{"total_episodes": ' + "9" * 5000 + "}", "cannot be read"), ('{"x": "' + "y" * (1 << 18), "longer than")],
)  # fmt: skip
def test_json_is_read_within_bounds(tmp_path: Path, text: str, part: str) -> None:
    """However deep and long it is."""
    folder = write_lerobot(tmp_path / "set")
    (folder / INFO).write_text(text)
    refuse(folder, part, read=survey_all)


@pytest.mark.parametrize("number", [-1, 10**7, "0", "../..", 0.5, None, [0], True])
def test_places_in_the_index_are_small_numbers(tmp_path: Path, number: object) -> None:
    """What else stands there is refused, not put into a name."""
    folder = write_lerobot(tmp_path / "set")
    index = {"episode_index": [0, 1], "data/chunk_index": [number] * 2, "data/file_index": [0, 0]}
    parquet.write_table(pa.table(index), folder / INDEX)
    refuse(
        folder,
        "data/chunk_index and data/file_index of episode 0; expected numbers of a chunk and a file",
        read=survey_all,
    )


@pytest.mark.parametrize("kind", ["pipe", "folder", "loop", "device"])
@pytest.mark.parametrize("file", [INFO, INDEX, DATA])
def test_only_regular_files_are_opened(tmp_path: Path, file: str, kind: str) -> None:
    """Whatever lies there instead, a line comes; without its index a data set is read all the same."""
    folder = write_lerobot(tmp_path / "set")
    (folder / file).unlink()
    if kind == "pipe":
        os.mkfifo(folder / file)
    elif kind == "folder":
        (folder / file).mkdir()
    else:
        (folder / file).symlink_to("/dev/zero" if kind == "device" else Path(file).name)
    if file == INDEX:
        assert [survey(flight)[0].files[0].channels[0].count for flight in list_flights(folder)] == [30, 20]
    else:
        refuse(folder, "holds data, meta" if file == INFO else "expected at most 0", read=survey_all)


@pytest.mark.parametrize("value", ["x", [1.0, 2.0], {"a": 1.0}, None])
@pytest.mark.parametrize("column", ["timestamp", "episode_index"])
def test_columns_of_another_kind_are_refused(tmp_path: Path, column: str, value: object) -> None:
    """Those by which rows are told apart, too."""
    folder = write_lerobot(tmp_path / "set")
    rows = parquet.read_table(folder / DATA)
    place = rows.schema.get_field_index(column)
    parquet.write_table(rows.set_column(place, column, pa.array([value] * 50)), folder / DATA)
    refuse(folder, "set", read=survey_all)


@pytest.mark.parametrize("number", ["²", "9" * 20, "9" * 5000, "-1", "1.5"])
def test_odd_numbers_of_episodes_are_no_files(tmp_path: Path, number: str) -> None:
    """FOLDER#NUMBER with what is no number of an episode."""
    folder = write_lerobot(tmp_path / "set")
    with pytest.raises(InputError, match="expected FOLDER#EPISODE of LeRobot"):
        survey(Path(f"{folder}#{number}"))
