"""`vpptwin history`: friction that grows from flight to flight, found in carts that no MuJoCo simulated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import vpptwin
from tests.diagnosis.rigs import CARTS, record
from tests.viz.browser import Browser
from vpptwin.cli.main import main
from vpptwin.drift import history as module
from vpptwin.drift.free_flight import FlightFit
from vpptwin.drift.history import EARLIEST, FitTask, History, fit_flight, parse_bands

WEEK = 604_800 * 10**9
GROWING, STAYING = (0.30, 0.35, 0.40, 0.45, 0.50), (0.30,) * 5
TWIN_FORCE = 0.3  # N


def fly_weekly(friction: Sequence[float], folder: Path) -> list[Path]:
    """A flight of 12 s a week, with that much friction [N]; the twin beside them has `TWIN_FORCE`."""
    folder.mkdir()
    for i, force in enumerate(friction):
        _, twin = record(CARTS, force, folder, 20 + i, f"{i}", EARLIEST + i * WEEK, 0.5)
    twin.write_text(twin.read_text() + f"effects:\n  slide.coulomb: {{force: {TWIN_FORCE}}}\n")
    return [folder / f"{i}.mcap" for i in range(len(friction))]


@pytest.fixture(scope="module")
def growing(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five flights between which friction grows."""
    return fly_weekly(GROWING, tmp_path_factory.mktemp("carts") / "growing")


@pytest.fixture(scope="module")
def found(growing: list[Path]) -> History:
    """What they tell; given in another order than they were flown in."""
    bands = {"slide.coulomb.force": (0.0, 0.42)}
    return vpptwin.history(growing[::-1], growing[0].parent / "rig.yaml", bands=bands, progress=False)


@pytest.fixture
def known(found: History, monkeypatch: pytest.MonkeyPatch) -> History:
    """The same without fitting again."""
    fits: dict[str, FlightFit] = {flight.log: flight.fit for flight in found.flights}
    monkeypatch.setattr(module, "fit_flight", lambda task: fits[str(task.flight.path)])
    return found


def test_friction_that_grows_is_found(found: History) -> None:
    """Every flight's within three standard deviations of the truth; a steady growth, by date, and how much."""
    (course,) = found.courses
    for value, truth in zip(course.values, GROWING, strict=True):
        assert value is not None
        assert value.value == pytest.approx(truth, abs=3.0 * value.std)
        assert value.std < 0.03
    assert course.trend is not None
    assert course.trend.kind == "line"
    assert course.trend.change[0] == pytest.approx(0.2, abs=3.0 * course.trend.change[1])
    assert found.dated
    assert found.time.tolist() == [0.0, 7.0, 14.0, 21.0, 28.0]
    assert all(flight.fit.after.chi2 < flight.fit.before.chi2 for flight in found.flights[1:])


def test_it_is_told_in_plain_words(found: History) -> None:
    """What left its band first, then what it does."""
    left, grows = str(found).splitlines()
    assert left.startswith("Dry friction on joint slide (slide.coulomb.force) left its band of 0 to 0.42 N in 2 of 5")
    assert "first on 2000-01-22" in left
    assert grows.startswith("Dry friction on joint slide (slide.coulomb.force) grows steadily by 0.")
    assert "over all 5 logs" in grows


def test_two_logs_have_no_empty_columns(growing: list[Path], known: History) -> None:
    """Columns of changes that so few logs cannot show are left out; those of more have all."""
    page = vpptwin.history(growing[:2], growing[0].parent / "rig.yaml", "slide.coulomb", progress=False).render([])
    assert "<td></td>" not in page
    assert "steady" not in page
    assert "A change needs 3 logs" in page
    assert all(f"<th>{change}</th>" in known.render([]) for change in ("any change", "steady", "at once"))


@pytest.mark.slow
def test_friction_that_stays_is_not_said_to_grow(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two processes fit it; the command ends with 0, prints a sentence, writes page and data."""
    logs, out = fly_weekly(STAYING, tmp_path / "staying"), tmp_path / "out"
    band = ["--band", "slide.coulomb.force=0.2:0.4", "--jobs", "2"]
    assert main(["history", *map(str, logs), "--twin", str(logs[0].parent / "rig.yaml"), "--out", str(out), *band]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Dry friction on joint slide (slide.coulomb.force) stays at 0.")
    told = json.loads((out / "history.json").read_text())
    (parameter,) = told["parameters"]
    assert (parameter["trend"]["kind"], told["left_band"], parameter["left_band_in"]) == ("constant", False, [])
    assert parameter["trend"]["since"] is None
    for value in parameter["values"]:
        low, high = value["interval_90"]
        assert low - 0.01 < 0.3 < high + 0.01
    assert "stays at" in (out / "history.html").read_text()


def test_the_data(known: History, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--json - prints all of it, and the exit code is 3 where something left its band."""
    logs, twin = [flight.log for flight in known.flights], known.twin
    command = ["history", *logs, "--twin", twin, "--out", str(tmp_path), "--band", "slide.coulomb.force=:0.42"]
    assert main([*command, "--json", "-"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "history.json").read_text())
    assert told["axis"] == "date"
    assert [flight["date"][:10] for flight in told["flights"]][:2] == ["2000-01-01", "2000-01-08"]
    (parameter,) = told["parameters"]
    assert parameter["left_band_in"] == logs[3:]
    assert parameter["trend"]["since"] == logs[0]
    assert parameter["trend"]["evidences"].keys() == {"line", "step", "bend"}
    assert parameter["unit"] == "N"


def test_without_dates_flights_are_numbered(known: History, growing: list[Path], tmp_path: Path) -> None:
    """In the order in which they are given, if a clock knows no date, or two begin at the same instant."""
    flights = [replace(vpptwin.read_log(log), start_ns=i) for i, log in enumerate(growing)]
    found = vpptwin.history(flights, known.twin, progress=False)
    assert not found.dated
    assert "log 1" in found.render([])
    same = vpptwin.history([replace(f, start_ns=EARLIEST) for f in flights], known.twin, progress=False)
    assert not same.dated
    assert [flight.log for flight in same.flights] == [str(log) for log in growing]
    assert same.as_dict()["axis"] == "flight"
    found.save(tmp_path)
    assert (tmp_path / "history.html").is_file()
    assert "Logs in the order" in found._repr_html_()


def test_one_rule_about_files(known: History, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody's file is refused before any work; our own are written again."""
    logs = [flight.log for flight in known.flights]
    command = ["history", *logs, "--twin", known.twin, "--out", str(tmp_path)]
    for name in ("history.html", "history.json"):
        (tmp_path / name).write_text("mine")
        assert main(command) == 2
        assert f"{name} is there, and vpptwin did not write it" in capsys.readouterr().err
        assert main([*command, "--force"]) == 0
        assert main(command) == 0


def test_a_page_that_fails_costs_only_itself(
    known: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The figures are there, no old page lies beside them, and a line says why."""

    def fail(*given: object) -> str:
        raise IndexError("no such flight")

    monkeypatch.setattr(module, "render_history", fail)
    (tmp_path / "history.html").write_text("an old one, by vpptwin")
    logs = [flight.log for flight in known.flights]
    assert main(["history", *logs, "--twin", known.twin, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "history.html could not be made: IndexError: no such flight" in said.err
    assert "history.html" not in said.out
    assert [file.name for file in tmp_path.iterdir()] == ["history.json"]


def test_a_flight_that_shows_nothing(known: History) -> None:
    """Its place stays empty, on the page too; the trend is that of the others."""
    empty = replace(known.flights[2].fit, values={})
    flights = [*known.flights[:2], replace(known.flights[2], fit=empty), *known.flights[3:]]
    course = module.follow(replace(known, flights=flights), ("slide.coulomb", "force"), "dry friction", None)
    assert course.shown == [0, 1, 3, 4]
    assert course.values[2] is None
    assert "not shown" in replace(known, flights=flights, courses=[course]).render([])


def test_which_effects_are_followed(growing: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that a diagnosis found where the twin says so; else all that are on; or those that are named."""
    spec = vpptwin.load_twin(growing[0].parent / "rig.yaml")
    assert module.choose_causes(spec, None) == ["slide.coulomb"]
    both = spec.with_effects({"slide.viscous": {"damping": 0.1}, **spec.effects})
    assert module.choose_causes(both, None) == ["slide.viscous", "slide.coulomb"]
    told = replace(both, intervals={"slide.viscous.damping": (0.0, 0.2)})
    assert module.choose_causes(told, None) == ["slide.viscous"]
    assert module.choose_causes(told, "slide.bias") == ["slide.bias"]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--twin", "nominal"], "twin nominal has no effects to follow"),
        (["--parameters", "slide.coulom"], "unknown effect 'slide.coulom'"),
        (["--band", "slide.coulomb.force=0.4:0.2"], "from 0.4 to 0.2"),
        (["--band", "slide.coulomb.forse=0:1"], "did you mean slide.coulomb.force?"),
        (["--band", "slide.coulomb.force"], "expected EFFECT.PARAMETER=LOW:HIGH"),
        (["--band", "slide.coulomb.force=a:1"], "--band slide.coulomb.force=a:1"),
        (["--band", "slide.coulomb.force=nan:1"], "--band slide.coulomb.force=nan:1"),
        (["--band", "=0:1"], "--band =0:1"),
        (["--jobs", "0"], "--jobs 0"),
        (["--twin", "no.yaml"], "no readable twin no.yaml"),
    ],
)
def test_bad_input(
    more: list[str], told: str, growing: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line, exit code 2, no folder left behind."""
    out = tmp_path / "out"
    twin = ["--twin", str(growing[0].parent / "rig.yaml")]
    assert main(["history", str(growing[0]), *twin, "--out", str(out), *more]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_open_bands() -> None:
    """LOW or HIGH may be left out."""
    infinity = float("inf")
    given = ["a.b.c=1:", "d.e=:-2", "f.g=-1:1e-3"]
    assert parse_bands(given) == {"a.b.c": (1.0, infinity), "d.e": (-infinity, -2.0), "f.g": (-1.0, 0.001)}


def test_another_process_has_the_same_twin(growing: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A task carries effects that were switched on after the twin was read."""
    seen = []
    monkeypatch.setattr(module, "fit_flights", lambda spec, flights, causes: seen.append((spec, causes)))
    effects = {"slide.coulomb": {"force": 0.7}}
    flight = vpptwin.read_log(growing[0])
    fit_flight(FitTask(flight, str(growing[0].parent / "rig.yaml"), (), effects, "map", ("slide.coulomb",), False))
    ((spec, causes),) = seen
    assert (spec.effects, causes) == (effects, ("slide.coulomb",))


@pytest.mark.browser
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (1280, True), (390, False)])
def test_the_page_in_a_browser(found: History, tmp_path: Path, width: int, dark: bool) -> None:
    """Nothing is asked of the network or complained about, nothing runs over the side, dark is dark."""
    found.save(tmp_path)
    page = tmp_path / "history.html"
    with Browser(tmp_path / "profile", size=(width, 900), dark=dark) as browser:
        browser.open(page)
        browser.draw_frames()
        assert browser.complaints == []
        assert browser.requests == [page.resolve().as_uri()]
        assert browser.evaluate("document.documentElement.scrollWidth") == width
        ground = browser.evaluate("getComputedStyle(document.body).backgroundColor")
        assert ground == ("rgb(23, 25, 28)" if dark else "rgb(255, 255, 255)")
        assert browser.evaluate("document.querySelectorAll('svg').length") == 1
