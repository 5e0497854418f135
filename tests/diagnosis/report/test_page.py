"""report.html: what a reader must find on it, that it needs nothing else, and that a phone can show it."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml

from tests.diagnosis.made_up import CAUSES, EXPERIMENT, UNSEEN, make_diagnosis, read_demo
from tests.viz.browser import Browser
from vpptwin.diagnosis.evidence.preflight import inspect_flight
from vpptwin.diagnosis.judgement.diagnose import Diagnosis
from vpptwin.diagnosis.judgement.verdict import Cause, Estimate, Misfit, Unexplained
from vpptwin.estimation.measurements import read_measurements
from vpptwin.report.html.page import tie_units
from vpptwin.report.provenance import trace_origin
from vpptwin.report.result import collect_result

HEADLINE = (
    "Dry friction of 0.306 ± 0.006 N on the horizontal rail and a bias of the gyro (0.012 ± 0.002 rad/s) together "
    "take the error half a second ahead from 39.4 to 19.5 mm (held-out stretches of flip)."
)
VOID = {"meta", "link", "br", "img", "path", "use", "rect", "line", "circle"}


def write(diagnosis: Diagnosis, folder: Path) -> str:
    """The report of a diagnosis of the demo flight."""
    spec, flight = read_demo()
    origin = trace_origin(["diagnose", str(flight.path), "--twin", spec.name], spec.name, [flight.path])
    collect_result(spec, [flight], diagnosis, origin, []).draw().write(folder, Path("x y"))
    return read_page(folder / "report.html")


def read_page(report: Path) -> str:
    """Its text, with the spaces that don't break as plain ones, words of commands without their tags."""
    return re.sub("<span>([^<]*)</span>", r"\1", report.read_text(encoding="utf-8")).replace("\N{NO-BREAK SPACE}", " ")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report with something in every section."""
    spec, flight = read_demo()
    folder = tmp_path_factory.mktemp("report")
    write(replace(make_diagnosis(), preflight=[inspect_flight(spec, read_measurements(spec, flight))]), folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def page(report: Path) -> str:
    """Its text."""
    return read_page(report)


class Checker(HTMLParser):
    """Collects headings, ids and tags that are left open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.headings: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember the tag until it is closed."""
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [value for name, value in attrs if name == "id" and value]

    def handle_endtag(self, tag: str) -> None:
        """Must close the tag that was opened last."""
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Collect headings."""
        if self.open and self.open[-1] in ("h1", "h2"):
            self.headings.append(data)


def test_the_sentence_comes_first_then_what_to_do_then_the_evidence(page: str) -> None:
    """Sections in the order in which a reader asks; no two elements share an id, or figures would be drawn wrong."""
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    assert len(checker.ids) == len(set(checker.ids)) > 50
    assert checker.headings == [
        HEADLINE,
        "What now", "What the twin misses", "Error by horizon", "Log and twin", "Confidence and rivals",
        "Unexplained", "Candidates", "The logs", "Where this comes from",
    ]  # fmt: skip


WORDS = (
    CAUSES[1].summary[1:], "93 % probable", "or instead viscous friction, 6 %",
    "half a second ahead. It follows rail_x position.",
    "−70 to −60 %", "sensor noise", f"not identifiable: {UNSEEN[1].reason}",
    "dry friction on the vertical guide <code>rail_z.coulomb</code>", "ruled out: between 0 and 0.1 N",
    "vpptwin compare",
    "--twin &#39;x y/twin.yaml&#39;", '<a href="verdict.json">', '<a href="prediction.mcap">', EXPERIMENT.command,
    "flip.mcap: 2 gaps over 0.05 s", "of it usable", "vpptwin diagnose", "--out &#39;x y&#39;", "mujoco",
    "2cc387febc674e7fa99f6cd848fc7f7126397e29576ef37942c5ebce1b32c99f",
    "Missing force: dry friction on the horizontal rail (rail_x.coulomb)",
    "<summary>The other 38</summary>", "onbeforeprint",  # a long list is folded; printing unfolds it
    "Held-out chi² (mean squared", "predicts open loop",  # what figures mean
)  # fmt: skip


def test_the_page_tells(page: str) -> None:
    """Each finding of the verdict is on it in words; a sensor makes no missing force."""
    assert [words for words in WORDS if words not in page] == []
    assert "Missing force: a bias of the gyro" not in page
    shares = page.index("<td>79 %</td>")
    assert page.index("What remains") < 30_000 < shares < page.index("Shares are of the held-out excess chi²")
    assert "sigma beyond" not in page


def test_what_did_not_change_is_folded_and_drawn_once(page: str) -> None:
    """The error of z's rate, and tracks that both twins predict alike, which have one line, that of the twin before."""
    assert re.search(r"<summary>Predicted alike by both twins, drawn once: [^<]*z, ", page)
    folded = page[page.index("Predicted alike by both twins") :]
    panel = folded[folded.index('aria-label="Log and twin, z [m]"') :].split("</svg>")[0]
    assert "var(--before" in panel
    assert "var(--after" not in panel


def test_no_id_stands_without_words(page: str) -> None:
    """In lists, headings and sentences every id follows what it means."""
    spec, _ = read_demo()
    text = re.sub(r"<(svg|style|pre|dl)\b.*?</\1>", "", page, flags=re.DOTALL)
    words = " ".join(re.sub(r"<[^>]*>", "", text).lower().split())
    for effect in spec.catalogue:
        for match in re.finditer(rf"(?<![\w.]){re.escape(effect.id)}(?![\w.])", words):
            assert words[: match.start()].rstrip(" (").endswith(effect.summary.lower())


def test_pictures_of_suspects_and_of_the_rig(page: str) -> None:
    """Drag by its damping on the rail, at least nine in ten have one; the rig, what is accused lit, comes first."""
    assert page.count('<span class="print">') > 0.9 * len(read_demo()[0].catalogue)
    assert re.search(r"force 0\.5 N: x changes by up to [\d.]+ m in 0\.3 s", page)
    drawn = page.index('aria-label="The rig, lit: dry friction on the horizontal rail and a bias of the gyro"')
    assert drawn < page.index("<h1>")
    assert page.count("var(--lit)") > 4


def test_a_twin_that_is_right_has_a_short_report(tmp_path: Path) -> None:
    """Without causes there is no column `after`, no rival, nothing to fly, and the sentence says so."""
    diagnosis = make_diagnosis()
    right = replace(diagnosis.verdict.before, chi2=1.05)
    verdict = replace(
        diagnosis.verdict, causes=[], gap=False, before=right, after=right, experiment=None, improvement={},
        unexplained=Unexplained(False, 0.0, None, []), cleared=[], unseen=[], warnings=[],
    )  # fmt: skip
    page = write(replace(diagnosis, verdict=verdict, values={}, leftover_plot=None), tmp_path)
    assert "nothing is named" in page
    assert "vpptwin train task=flip twin=nominal" in page
    assert "vpptwin compare" not in page
    for absent in ("after</th>", "Confidence and rivals", "Fly next", "Unexplained<", "The logs", "twin after"):
        assert absent not in page


def test_weak_candidates_are_folded_away(tmp_path: Path) -> None:
    """Neither in a heading nor in twin.yaml, but in a file and a list of their own."""
    diagnosis = make_diagnosis()
    weak = Cause("rail_z.viscous", 0.0988, {"damping": Estimate(0.2, "N s/m", 0.1, 0.0)}, 0.01, [],
                 "viscous friction on the vertical guide", weak=True)  # fmt: skip
    verdict = replace(diagnosis.verdict, causes=[*CAUSES, weak], suggested=diagnosis.verdict.after)
    more = diagnosis.values | {("rail_z.viscous", "damping"): 0.2}
    text = write(replace(diagnosis, verdict=verdict, suggested=more), tmp_path).replace("\N{NO-BREAK SPACE}", " ")
    folded = text.index("Not in twin.yaml: 1")
    assert folded < text.index("viscous friction of 0.20 ± 0.10 N s/m on the vertical guide (10 % probable)")
    assert '<a href="twin_suggested.yaml">' in text
    effects = [
        yaml.safe_load((tmp_path / f"{name}.yaml").read_text())["effects"] for name in ("twin", "twin_suggested")
    ]
    assert [set(each) for each in effects] == [{"rail_x.coulomb", "gyro.bias"}, {*effects[0], "rail_z.viscous"}]


def test_a_misfit_comes_first_with_what_would_help(tmp_path: Path) -> None:
    """The heading says what helps, then come the causes, how far off the twin still is, and what would help more."""
    diagnosis = make_diagnosis()
    verdict = replace(diagnosis.verdict, misfit=Misfit(9.2, "pitch", 0.1, 0.36, "rad"))
    text = write(replace(diagnosis, verdict=verdict), tmp_path).replace("\N{NO-BREAK SPACE}", " ")
    heading, cause, left, remedy = (
        text.index(words) for words in ("<h1>Dry friction of", "93 % probable", "What remains is ", "What may help:")
    )
    assert heading < cause < left < remedy
    assert "it is 9.2 times the sensor noise, largest in pitch" in text


def test_other_peoples_names_cannot_break_the_page(tmp_path: Path) -> None:
    """Markup in a warning is text."""
    diagnosis = make_diagnosis()
    page = write(
        replace(diagnosis, verdict=replace(diagnosis.verdict, warnings=["<script>alert(1)</script>"])), tmp_path
    )
    assert "<script>" not in page


def test_numbers_stay_with_their_units() -> None:
    """No line breaks between value, deviation and unit."""
    assert tie_units("of 0.31 ± 0.01 N on").replace("\N{NO-BREAK SPACE}", "_") == "of 0.31_±_0.01_N on"
    assert tie_units("of 1.1 N s²/m² on").replace("\N{NO-BREAK SPACE}", "_") == "of 1.1_N_s²/m² on"
    assert tie_units("of 1.1 N m s/rad on").replace("\N{NO-BREAK SPACE}", "_") == "of 1.1_N_m_s/rad on"
    assert tie_units("explains 94 % of").replace("\N{NO-BREAK SPACE}", "_") == "explains 94_% of"


@pytest.mark.browser
@pytest.mark.parametrize(("width", "dark"), [(1200, True), (390, False)])
def test_the_page_fits_the_screen(report: Path, tmp_path: Path, width: int, dark: bool) -> None:
    """On desk and phone nothing sticks out sideways, nothing is fetched, and text follows the reader's scheme."""
    with Browser(tmp_path / "profile", size=(width, 900), dark=dark) as browser:
        browser.open(report)
        browser.draw_frames()
        assert browser.complaints == []
        assert browser.requests == [report.resolve().as_uri()]
        assert browser.evaluate("document.documentElement.scrollWidth") == width
        body = "getComputedStyle(document.body)"
        colours = [browser.evaluate(f"{body}.{name}") for name in ("color", "backgroundColor")]
        light = ["rgb(28, 30, 33)", "rgb(255, 255, 255)"]
        assert colours == (["rgb(230, 232, 235)", "rgb(22, 24, 27)"] if dark else light)
        shown = "getComputedStyle(document.querySelector('.suspects .print')).display"
        assert browser.evaluate(shown) == "none"
        browser.evaluate("document.querySelector('.suspects li').focus(); 0")
        assert browser.evaluate(shown) == "block"
        texts = "[...document.querySelectorAll('.panels svg text')].filter(t => t.checkVisibility())"
        smallest = f"Math.min(...{texts}.map(t => t.getBoundingClientRect().height))"
        assert browser.evaluate(smallest) > 8.0
        scheme = {"name": "prefers-color-scheme", "value": "dark"}
        browser.call("Emulation.setEmulatedMedia", media="print", features=[scheme])
        assert browser.evaluate(f"{body}.backgroundColor") == "rgb(255, 255, 255)"  # on paper, whatever the screen
