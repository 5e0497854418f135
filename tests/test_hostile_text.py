"""Names and words of files, full of markup and control characters: in terminals and pages they are text, no more."""

from __future__ import annotations

import html
import io
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.diagnosis.made_up import FLIP, make_diagnosis
from tests.twin.own_effect_files import SLIDE, WAVE, write_effects, write_rig
from vpptwin.cli.main import main
from vpptwin.logs.write import FlightWriter
from vpptwin.report import result
from vpptwin.system.errors import InputError
from vpptwin.system.terminal import Screen, open_console, show_plainly
from vpptwin.train.learn.checkpoint import read_checkpoint
from vpptwin.twin import load_twin

MARKUP = "</script><script>alert(1)</script><img src=x onerror=alert(1)>$\\frac{_[/b]:bug:"
HOLDS_CODE = ("script", "style", "img", "iframe", "a", "object", "embed", "base", "meta", "link", "form", "svg")


class Tags(HTMLParser):
    """Counts the elements of a page that may do something, and lists attributes that run code."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag, and its handlers of events."""
        self.found += [tag] if tag in HOLDS_CODE else []
        self.found += [f"{tag} {name}" for name, _ in attrs if name.startswith("on")]


def list_tags(page: Path) -> list[str]:
    """What in a page may do something, in order."""
    return Tags(page.read_text(encoding="utf-8")).found


def write_hostile(folder: Path, joint: str) -> tuple[Path, Path]:
    """A twin whose joint, actuator and bodies have such a name, and a log of 6 s of it."""
    named = html.escape(joint)
    model = SLIDE.replace("slide", named).replace('"motor"', f'"{named}.motor"').replace('"cart"', f'"{named}"')
    (folder / "rig.xml").write_text(model.replace(f'type="{named}"', 'type="slide"'))
    moved = {"joints": {joint: "/joint_states"}, "driven": {"lift": "/joint_states"}}
    signals = {**moved, "actuators": {f"{joint}.motor": "/c"}}
    (folder / "rig.yaml").write_text(f"model: rig.xml\nsignals: {json.dumps(signals)}\n")
    rng = np.random.default_rng(1)
    log = folder / f"{joint.replace('/', '')}.mcap"
    with FlightWriter(log) as writer:
        for k in range(3000):
            time, noise = 0.002 * k, 1e-5 * rng.standard_normal()
            moving = {"position": 0.1 * np.sin(3.0 * time) + noise, "velocity": 0.3 * np.cos(3.0 * time)}
            writer.write_joints("/joint_states", time, {joint: moving, "lift": {"position": 0.0, "velocity": 0.0}})
            force = -2.7 * np.sin(3.0 * time) + 0.15 * np.cos(3.0 * time)  # moves 3 kg against 0.5 N s/m
            writer.write_joints("/c", time, {f"{joint}.motor": {"effort": float(force)}})
    return folder / "rig.yaml", log


def test_pages_of_a_hostile_rig_hold_its_names_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every page and picture of `play`, `plot` and `compare` has the tags of a harmless rig's, and no others."""
    monkeypatch.chdir(tmp_path)
    tags = {}
    for name in ("harmless", MARKUP):
        folder = tmp_path / str(len(tags))
        folder.mkdir()
        twin, log = write_hostile(folder, name)
        given = [str(log), "--twin", str(twin)]
        assert main(["play", *given, "--html", str(folder / "play.html")]) == 0
        assert main(["compare", *given, "--json", str(folder / "compare.json")]) == 0
        for kind in ("html", "svg", "png"):
            assert main(["plot", *given, "--out", str(folder / f"plot.{kind}")]) == 0
        tags[name] = [list_tags(folder / page) for page in ("play.html", "plot.html", "plot.svg")]
        assert f"{name} rate" in json.loads((folder / "compare.json").read_text())["error"]["velocity_rmse"]
    assert tags[MARKUP] == tags["harmless"]


@pytest.mark.slow
def test_the_report_of_hostile_effects_holds_them_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The words of an effect of the user's own, and a log's name."""
    monkeypatch.setattr(result, "judge", lambda *given, **named: make_diagnosis())
    log = tmp_path / f"{MARKUP.replace('/', '')}.mcap"
    log.write_bytes(FLIP.read_bytes())
    text = WAVE.replace("slide", "rail_x").replace("a wavy rail", MARKUP.replace("\\", "\\\\"))
    own = write_effects(tmp_path, text.replace('"N"', '"<b>N"'))
    assert main(["diagnose", str(log), "--effects", str(own), "--out", str(tmp_path / "out")]) == 0
    assert set(list_tags(tmp_path / "out" / "report.html")) <= {"meta", "style", "svg", "a", "body onbeforeprint"}


def test_names_that_cannot_be_shown_are_refused(tmp_path: Path) -> None:
    """Escape sequences in an MJCF."""
    write_rig(tmp_path)
    (tmp_path / "slide.xml").write_text(SLIDE.replace("slide", "sl\x1b[2Jide"))
    with pytest.raises(InputError) as caught:
        load_twin(tmp_path / "twin.yaml")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", [b"a\xff.mcap", b"a\x1b[31m.mcap", b"a\n.mcap"])
def test_logs_whose_names_cannot_be_shown_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: bytes
) -> None:
    """Not in UTF-8, or with escapes: as an argument, and in a folder."""
    monkeypatch.chdir(tmp_path)
    log = tmp_path / os.fsdecode(name)
    log.write_bytes(FLIP.read_bytes())
    for given in (str(log), "."):
        for arguments in (["plot", given, "--out", "a.svg"], ["play", given, "--html", "a.html"], ["compare", given]):
            assert main(arguments) == 2
            out, err = capsys.readouterr()
            assert out == ""
            assert err.count("\n") == 1
            assert "expected one in UTF-8 without control characters; rename it" in err
    assert [path.name for path in tmp_path.iterdir()] == [log.name]


def test_a_terminal_is_not_steered(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever is printed: lines, tabs, bold and what a bar draws pass, the rest is shown."""
    with show_plainly():
        print("a\x1b[2J\x1b]0;title\x07b\x9b31m\r\u202ec\ttab")
        print("\rbar \x1b[1mbold\x1b[0m")
        print("\udcff")
        open_console().print("[red]a[/red] [/b] :bug:\x1b[5m")
    assert capsys.readouterr().out.split("\n") == [
        "a\\x1b[2J\\x1b]0;title\\x07b\\x9b31m\\r\\u202ec\ttab", "\rbar \x1b[1mbold\x1b[0m", "\\udcff",
        "[red]a[/red] [/b] :bug:\\x1b[5m", "",
    ]  # fmt: skip
    # On a terminal of another alphabet nothing fails.
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="latin-1")
    Screen(stream).write("chi² → 1\n")
    stream.flush()
    assert raw.getvalue() == b"chi\xb2 \\u2192 1\n"


def test_words_of_a_checkpoint_end_no_comment_of_its_c_source(tmp_path: Path) -> None:
    """Its commit and the twin's name are comments there, its configuration a string, and stay that: no code gets in."""
    evil = '*/ int evil(void) { return 1; } /* ??/" \\\n'
    content = read_checkpoint("flip")
    torch.save({**content, "commit": evil}, tmp_path / "evil.pt")
    sources = []
    for checkpoint in ("flip", str(tmp_path / "evil.pt")):
        out = tmp_path / f"c{len(sources)}"
        assert main(["export", checkpoint, "--format", "c", "--out", str(out)]) == 0
        text = "".join((out / name).read_text() for name in ("vpptwin.h", "vpptwin.c"))
        assert "??" not in text
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        sources.append(re.sub(r'"(\\.|[^"\\])*"\n? *', "", code))
    assert sources[0] == sources[1]
