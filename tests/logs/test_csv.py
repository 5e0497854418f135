"""CSV as spreadsheets and scripts leave it: thousands, titles, encodings, clocks, columns of no interest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.logs.test_foreign import read_all, read_joint, read_stream, write_csv
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError


@pytest.fixture(autouse=True, params=["Arrow", "Python alone"])
def _read_by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """With Arrow, and without it."""
    if request.param != "Arrow":
        monkeypatch.setattr("vpptwin.logs.formats.delimited.load_arrow", lambda: None)


COUNT = 300
TIME = 0.005 * np.arange(COUNT)
PLACE = 12.5 * np.arange(COUNT) - 40.25


def spell(value: float, places: int, decimal: str, group: str) -> str:
    """A number as a spreadsheet shows it."""
    return f"{value:,.{places}f}".replace(",", "G").replace(".", decimal).replace("G", group)


def sheet(names: str, decimal: str, group: str, delimiter: str = ";", quote: str = "", end: str = "\n") -> str:
    """Rows of a clock in whole ms and of places."""
    rows = [(spell(1e3 * t, 0, decimal, group), spell(x, 2, decimal, group)) for t, x in zip(TIME, PLACE)]
    return end.join([names, *(delimiter.join(f"{quote}{cell}{quote}" for cell in row) for row in rows)]) + end


SHEETS = {
    "German thousands": sheet("Zeit [ms];Weg", ",", "."),
    "Swiss thousands": sheet("Zeit [ms];Weg", ".", "'"),
    "French thousands": sheet("temps [ms];Weg", ",", "\u202f"),
    "English thousands in quotes": sheet("Laufzeit (ms),Weg", ".", ",", ",", '"'),
    "English thousands between tabs": sheet("time_ms\tWeg", ".", ",", "\t"),
    "decimal commas in quotes": sheet("tick [ms],Weg", ",", "", ",", '"'),
    "a title of one cell": "Versuch 3\n\n" + sheet("Zeit [ms];Weg", ",", "."),
    "titles of as many cells": "Versuch 3;\nDatum;12.03.2026\n" + sheet("Zeit [ms];Weg", ",", "."),
    "a title with commas and a row of units": "links, vorn, ohne Last\nt;Weg\n" + sheet("ms;mm", ",", "."),
    "titles that are no units": "Ensayo nº 4\nOperador;J. García;\n"
    + sheet("Tiempo (ms);Weg;Par (Nm)", ",", ".", end=";0,1\n").replace("(Nm);0,1", "(Nm)"),
    "what Excel is told of the delimiter": sheet("sep=;\r\nZeit [ms];Weg", ",", ".", end="\r\n"),
    "a delimiter at the end of rows": sheet("Zeit [ms];Weg", ",", "", end=";\n").replace("Weg;", "Weg"),
}


@pytest.mark.parametrize("name", SHEETS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le"])
def test_spreadsheets_are_read(tmp_path: Path, name: str, encoding: str) -> None:
    """Numbers whose thousands are parted, titles above the names; the clock is the column with a unit of time."""
    log = write_csv(tmp_path / "run.csv", SHEETS[name].encode(encoding))
    stream = read_stream(log, "run", position="Weg")
    assert stream["position"].tolist() == PLACE.tolist()
    np.testing.assert_allclose(stream.time, TIME)


def test_thousands_without_any_fraction_are_thousands(tmp_path: Path) -> None:
    """A column that goes from 995 to 1.000; one of three decimals throughout does not, and none is 999 and 1.5."""
    whole = "t;x\n" + "".join(f"{spell(0.01 * k, 2, ',', '')};{spell(5 * k, 0, ',', '.')}\n" for k in range(300))
    read = read_joint(write_csv(tmp_path / "a.csv", whole.replace(",", "0")), "a", position="x", stamp="t")
    assert read.joints["/joint_states"]["j"]["position"].tolist() == [5.0 * k for k in range(300)]
    parts = "t;x\n" + "".join(f"{0.01 * k:.3f};{1 + 0.001 * k:.3f}\n" for k in range(300))
    read = read_joint(write_csv(tmp_path / "b.csv", parts), "b", position="x")
    assert read.joints["/joint_states"]["j"]["position"][-1] == 1.299


def test_a_sign_of_windows_is_read(tmp_path: Path) -> None:
    """Windows-1252 has signs where Latin-1 has none."""
    text = "Prüfstand – Kraft €\n" + sheet("Zeit [ms];Kraft „1“", ",", ".")
    flight = read_joint(write_csv(tmp_path / "run.csv", text.encode("cp1252")), "run", position="Kraft „1“")
    assert len(flight.joints["/joint_states"]["j"]) == COUNT
    assert flight.warnings == ("run.csv is not in UTF-8, read as Windows-1252 (Latin-1)",)


def write_odd(path: Path, cell: str, first: int = 0, before: str = "nan") -> Path:
    """Rows of whose third column the cells are these from row `first` on, with {k} for its number."""
    cells = [cell.format(k=k, many=[0.0899] * (k % 4)) if k >= first else before for k in range(COUNT)]
    return write_csv(path, "t,x,odd\n" + "".join(f'{t},{x},"{odd}"\n' for t, x, odd in zip(TIME, PLACE, cells)))


ODD = {
    "lists after empty cells": ("[0.0899, 0.2]", 60, "cells that are not as the others in odd (240, the first '[0.08"),
    "lists of several lengths": ("{many}", 0, "no numbers in odd, left out"),
    "lists over several lines": ("[0.0899\n {k}]", 0, ""),
    "text": ("run {k}", 0, "no numbers in odd, left out"),
    "numbers, then text": ("off {k}", 200, "cells that are not as the others in odd (100, the first 'off 200'), left"),
    "text after blank cells": ("kicked, {k}", 100, "no numbers in odd, left out"),
    "errors of a spreadsheet": ("#DIV/0!", 100, ""),
    "structures": ("{{'gain': {k}}}", 0, "no numbers in odd, left out"),
}


@pytest.mark.parametrize("name", ODD)
def test_columns_that_nobody_maps_stop_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """What a twin names is read whatever else a row holds; whoever looks at everything is told what was left out."""
    monkeypatch.setattr("vpptwin.logs.formats.delimited._BLOCK", 2000)
    cell, first, note = ODD[name]
    log = write_odd(tmp_path / "run.csv", cell, first, "" if "blank" in name else "nan")
    flight = read_joint(log, "run", position="x")
    assert flight.joints["/joint_states"]["j"]["position"].tolist() == PLACE.tolist()
    assert flight.warnings == ()
    recording, signals = survey(log)
    assert [len(signal.time) for signal in signals if signal.field == "x"] == [COUNT]
    assert len(recording.files[0].notes) == bool(note)
    assert all(note in found for found in recording.files[0].notes)
    if "over several lines" in name:
        assert read_all(log, "/run", "odd")[:, 1].tolist() == list(range(COUNT))


@pytest.mark.parametrize(("cell", "first", "said"), [
    ("off", 200, "line 202: 'off' as odd; expected a number, as in the lines before"),
    ("1.5.{k}", 200, "line 202: '1.5.200' as odd"),
    ("run", 0, "no numeric column odd"),
])  # fmt: skip
def test_a_column_that_is_named_holds_numbers(tmp_path: Path, cell: str, first: int, said: str) -> None:
    """Or the log is refused, as before."""
    with pytest.raises(InputError, match=said):
        read_joint(write_odd(tmp_path / "run.csv", cell, first), "run", position="odd")


def test_cells_of_any_length_are_read(tmp_path: Path) -> None:
    """Longer than Python's csv takes by itself, in the first line and where a line is looked for; a quote left open."""
    long = write_odd(tmp_path / "run.csv", "y" * 200_000, 299)
    with pytest.raises(InputError, match="line 301: 'yyy"):
        read_joint(long, "run", position="odd")
    assert len(read_stream(long, "run", position="x")) == COUNT
    first = write_csv(tmp_path / "first.csv", "t,x," + "z" * 300_000 + "\n" + sheet("", ".", "", ",").lstrip() * 2)
    with pytest.raises(InputError, match="line 1: 3 cells; expected 2 cells a line"):
        read_joint(first, "first", position="x")
    torn = write_csv(tmp_path / "torn.csv", sheet("t,x", ".", "", ",") + '9.9,"' + "7" * 400_000)
    with pytest.raises(InputError, match=r"torn\.csv"):
        read_joint(torn, "torn", position="x")
