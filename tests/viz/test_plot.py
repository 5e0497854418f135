"""`vpptwin plot`: what stands in the panels, the three formats, training runs, other rigs, bad input."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tests.viz.browser import Browser
from tests.viz.conftest import HOVER_PITCH
from vpptwin.cli.main import main
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight, Stream
from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import load_twin
from vpptwin.viz.command import name_apart
from vpptwin.viz.plots.curves import name_runs, read_curve, tell_runs
from vpptwin.viz.plots.figure import INK, open_figure
from vpptwin.viz.plots.palette import BRIGHT, TARGET, TWIN, VERMILION, to_rgb
from vpptwin.viz.plots.panels import (
    COLOURS,
    TWIN_NAME,
    Line,
    Panel,
    Story,
    differentiate,
    lay_over,
    tell_flight,
)
from vpptwin.viz.plots.plot import THEMES, brighten, draw_story, write_story

FLIP = Path(__file__).parents[2] / "demo/flights/flip.mcap"
CART = """
<mujoco><worldbody><body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
<geom name="box" type="box" size="0.1 0.05 0.05"/></body></worldbody>
<actuator><motor name="motor" joint="slide"/></actuator></mujoco>
"""


def find_panel(story: Story, label: str) -> Panel:
    """The panel with this label."""
    (panel,) = [panel for panel in story.panels if panel.label == label]
    return panel


def values_of(panel: Panel, name: str) -> np.ndarray:
    """The values of a panel's line."""
    (line,) = [line for line in panel.lines if line.name == name]
    return line.values


def test_panels_hold_log_twin_and_setpoint(flight: Flight, prediction: Prediction) -> None:
    """Position, velocity, angle, rotors, each with its unit; the trigger is where another angle is asked for."""
    story = tell_flight(flight, prediction, load_twin())
    labels = [panel.label for panel in story.panels]
    assert labels == [
        "x [m]", "x velocity [m/s]", "z [m]", "z velocity [m/s]", "θ [rad]", "thrust [N]", "rotor speed [rad/s]",
    ]  # fmt: skip
    place = find_panel(story, "x [m]")
    assert [line.name for line in place.lines] == ["log", "setpoint", "twin"]
    np.testing.assert_array_equal(values_of(place, "log"), flight.streams["/mocap/pose"]["x"])
    np.testing.assert_array_equal(values_of(place, "setpoint"), [0.0, 0.5, 0.5])
    assert story.triggers.tolist() == [2.0]
    rotor = load_vehicle().rotor
    thrust = values_of(find_panel(story, "thrust [N]"), "rotor 1, by the map")
    assert thrust[0] == pytest.approx(rotor.k_t * 471.239 * HOVER_PITCH)
    assert thrust[-1] == pytest.approx(-thrust[0])
    np.testing.assert_allclose(values_of(find_panel(story, "x velocity [m/s]"), "log"), 0.2, rtol=1e-9)


def test_the_twin_is_broken_where_it_was_set_back(flight: Flight, prediction: Prediction) -> None:
    """No line joins the end of one prediction with the start of the next."""
    twin = values_of(find_panel(tell_flight(flight, prediction, load_twin()), "z [m]"), "twin")
    broken = np.flatnonzero(np.isnan(twin) & (prediction.time >= 0.5))
    np.testing.assert_allclose(prediction.time[broken], [1.0, 1.5])


def test_the_setpoint_turns_with_the_craft(flight: Flight) -> None:
    """Asked for 0 after a turn by π, a craft that goes on to 2π meets its setpoint there."""
    time = flight.streams["/mocap/pose"].time
    pose = Stream(time, {**flight.streams["/mocap/pose"].values, "theta": np.pi * np.clip(time - 1.0, 0.0, 2.0)})
    asked = {"x": np.zeros(3), "z": np.ones(3), "theta": np.array([0.0, np.pi, 0.0])}
    streams = {**flight.streams, "/mocap/pose": pose, "/setpoint/pose": Stream(np.array([0.0, 1.0, 2.0]), asked)}
    angle = find_panel(tell_flight(replace(flight, streams=streams), None, load_twin()), "θ [rad]")
    np.testing.assert_allclose(values_of(angle, "setpoint"), [0.0, np.pi, 2.0 * np.pi, 2.0 * np.pi])


def test_a_turning_setpoint_is_one_trigger(flight: Flight) -> None:
    """The angle that turns through 2π step by step began to once."""
    time = np.concatenate([[0.0], 1.0 + 0.01 * np.arange(50), [3.0]])
    theta = np.concatenate([[0.0], np.linspace(0.1, 6.2, 50), [np.pi]])
    asked = Stream(time, {"x": 0 * time, "z": 0 * time, "theta": theta})
    streams = {**flight.streams, "/setpoint/pose": asked}
    story = tell_flight(replace(flight, streams=streams), None, load_twin())
    np.testing.assert_allclose(story.triggers, [1.0, 3.0])


def test_slopes_of_a_noisy_sine() -> None:
    """Velocity from positions with a millimetre of noise, some samples missing, within 3 cm/s of the truth."""
    rng = np.random.default_rng(0)
    time = np.delete(np.arange(400) / 100.0, [50, 51, 200])
    slope = differentiate(time, np.sin(2.0 * time) + 0.001 * rng.standard_normal(len(time)))
    error = slope - 2.0 * np.cos(2.0 * time)
    assert np.sqrt((error**2).mean()) < 0.03


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_pictures_are_drawn_in_either_theme(flight: Flight, prediction: Prediction, tmp_path: Path, theme: str) -> None:
    """The PNG's ground is the theme's, the lines' colours are there, and text stands out against the ground."""
    out = write_story(tell_flight(flight, prediction, load_twin()), tmp_path / "flight.png", theme)
    picture = np.asarray(Image.open(io.BytesIO(out.read_bytes())).convert("RGB")).astype(int)
    ground = picture[0, 0]
    assert (ground.mean() > 200) == (theme == "light")
    assert np.abs(picture - ground).max() > 150
    for colour in (TWIN if theme == "light" else BRIGHT, TARGET, VERMILION):
        assert (np.abs(picture - 255.0 * np.array(to_rgb(colour))).max(axis=-1) < 8).sum() > 100


def test_an_svg_stands_alone(flight: Flight, prediction: Prediction, tmp_path: Path) -> None:
    """Well-formed, refers to nothing outside, text is text, and follows a dark screen."""
    out = write_story(tell_flight(flight, prediction, load_twin()), tmp_path / "new/flight.svg")
    text = out.read_text()
    root = ElementTree.fromstring(text)
    words = " ".join("".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text"))
    assert all(label in words for label in ("x [m]", "θ [rad]", "time [s]", "setpoint", "twin"))
    assert "prefers-color-scheme: dark" in text
    assert "#fe01fe" not in text
    assert 'href="http' not in text


@pytest.mark.browser
def test_the_page_works_offline(flight: Flight, prediction: Prediction, tmp_path: Path) -> None:
    """In a browser: no complaint, every panel is drawn, the log's line has its samples, a phone shows as much of it."""
    story = tell_flight(flight, prediction, load_twin())
    page = write_story(story, tmp_path / "flight.html")
    assert page.stat().st_size < 10e6
    profile = tmp_path / "profile"
    profile.mkdir()
    with Browser(profile) as browser:
        browser.open(page)
        browser.draw_frames()
        assert browser.evaluate("document.querySelectorAll('.scatterlayer .trace').length") == sum(
            len(panel.lines) for panel in story.panels
        )
        titles = browser.evaluate("[...document.querySelectorAll('text')].map(t => t.textContent).join('|')")
        assert all(panel.label in titles for panel in story.panels)
        assert browser.complaints == []
        assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []
        shown = np.asarray(Image.open(io.BytesIO(browser.take_picture())).convert("L"))
        assert shown.std() > 5.0
        browser.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        browser.open(page)
        width = browser.evaluate("document.querySelector('.scatterlayer .trace').getBoundingClientRect().width")
        assert 0.5 * 390 < width < 390


def make_run(folder: Path, values: Sequence[float], **options: object) -> Path:
    """A folder as training leaves it."""
    scalars = folder / "log" / "scalars"
    scalars.mkdir(parents=True)
    for name, scale in (("return", 1.0), ("exam_error_m", 0.01)):
        rows = [f"{1000 * (i + 1)},{scale * value}" for i, value in enumerate(values)]
        (scalars / f"{name}.csv").write_text("\n".join(rows) + "\n")
    lines = ["task:", "  name: flip", *(f"{key}: {value}" for key, value in options.items())]
    (folder / "config.yaml").write_text("\n".join(lines) + "\n")
    return folder


def test_runs_that_differ_in_their_seed_are_one_line(tmp_path: Path) -> None:
    """Median and band over seeds; a line for each setup in the paper's order of colours."""
    runs = [make_run(tmp_path / f"{s}{i}", [1.0 * i, 4.0], setup=s, seed=i) for s in ("VA", "All") for i in (1, 2, 6)]
    story = tell_runs(runs)
    assert [panel.label for panel in story.panels] == [
        "return of finished episodes", "position error, fixed flights [m]",
    ]  # fmt: skip
    lines = story.panels[0].lines
    assert [line.name for line in lines] == ["setup=VA", "setup=All"]
    assert len({line.colour for line in lines}) == len({line.dash for line in lines}) == 2
    for line in lines:
        np.testing.assert_allclose(line.time, [0.001, 0.002])
        np.testing.assert_allclose(line.values, [2.0, 4.0])
        assert line.band is not None
        np.testing.assert_allclose(line.band, [[1.0, 4.0], [6.0, 4.0]])
    for name in ("curves.png", "curves.svg", "curves.html"):
        assert write_story(story, tmp_path / name).stat().st_size > 10_000


def test_what_a_run_did_not_know_is_no_difference(tmp_path: Path) -> None:
    """An option that only the newer run has does not name them."""
    runs = [make_run(tmp_path / "old", [1.0]), make_run(tmp_path / "new", [2.0], again=0.2)]
    assert name_runs(runs) == ["flip", "flip"]


def test_long_curves_are_averaged(tmp_path: Path) -> None:
    """Six hundred values become sixty means; one that is no number is left out."""
    values = np.arange(600.0)
    values[5] = np.nan
    curve = read_curve(make_run(tmp_path / "run", values.tolist()), "return")
    assert curve is not None
    assert len(curve[0]) == len(curve[1]) == 60
    assert curve[1][0] == pytest.approx((45 - 5) / 9)
    assert curve[1][1] == pytest.approx(14.5)


def test_joints_of_another_rig(tmp_path: Path) -> None:
    """Position, velocity and input of what the twin's signals name, with the unit of the joint."""
    (tmp_path / "cart.xml").write_text(CART)
    (tmp_path / "cart.yaml").write_text(
        "model: cart.xml\nsignals:\n  joints: {slide: /joint_states}\n  actuators: {motor: /actuator_command}\n"
    )
    time = np.arange(101) / 100.0
    joints = {
        "/joint_states": {"slide": Stream(time, {"position": time, "velocity": 0 * time + 1.0})},
        "/actuator_command": {"motor": Stream(time, {"effort": 0.1 * time})},
    }
    flight = Flight(Path("cart.mcap"), 0, {}, joints)
    prediction = Prediction(time, time[:, None], 0 * time[:, None] + 1.0, time[:, None], time[:, None], np.zeros(1))
    story = tell_flight(flight, prediction, load_twin(tmp_path / "cart.yaml"))
    assert [panel.label for panel in story.panels] == ["slide position [m]", "slide velocity [m/s]", "motor, input"]
    np.testing.assert_allclose(values_of(story.panels[1], "twin"), 1.0)
    assert not len(story.triggers)
    with pytest.raises(InputError, match="nothing to plot"):
        tell_flight(replace(flight, joints={}), None, load_twin(tmp_path / "cart.yaml"))


def test_the_command_draws_a_log_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`vpptwin plot LOG --twin nominal` with a demo flight."""
    out = tmp_path / "flip.png"
    assert main(["plot", str(FLIP), "--twin", "nominal", "--out", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    assert out.read_bytes().startswith(b"\x89PNG")


def test_by_default_a_picture_in_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Named like the source."""
    monkeypatch.chdir(tmp_path)
    make_run(tmp_path / "runs" / "my-run", [1.0, 2.0])
    assert main(["plot", "runs/my-run"]) == 0
    assert (tmp_path / "my-run.png").stat().st_size > 10_000


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and what was found; no picture."""
    run, spoilt, empty = (make_run(tmp_path / name, [1.0]) for name in ("run", "spoilt", "empty"))
    (spoilt / "log/scalars/return.csv").write_text("not,numbers\n")
    for file in (empty / "log/scalars").iterdir():
        file.unlink()
    bare = make_run(tmp_path / "bare", [1.0])
    (bare / "config.yaml").unlink()
    before = {path.name for path in tmp_path.iterdir()}
    out = tmp_path / "out.png"
    for arguments, hint in (
        ([FLIP, "--out", tmp_path / "out.pdf"], ".png, .svg, .html"),
        ([FLIP, run, "--out", out], "is a training run"),
        ([run, "--twin", "nominal", "--out", out], "--twin nominal"),
        ([spoilt, "--out", out], "return.csv"),
        ([empty, "--out", out], "no return"),
        ([bare, "--out", out], "config.yaml"),
        ([FLIP, "--twin", "nominal", "--restart", "-1", "--out", out], "--free"),
        ([tmp_path / "none.mcap", "--out", out], "none.mcap"),
        ([FLIP, "--out", "/proc/out.png"], "cannot write"),
    ):
        assert main(["plot", *map(str, arguments)]) == 2
        said = capsys.readouterr().err.strip()
        assert hint in said
        assert "\n" not in said
    assert {path.name for path in tmp_path.iterdir()} == before


def test_a_picture_names_each_line_once() -> None:
    """Whatever the number of panels that it is in; in a page too."""
    time = np.arange(10.0)
    panels = [Panel(name, [Line("log", time, time, INK), Line("twin", time, -time, TWIN, "--")]) for name in "abc"]
    with open_figure(9.0, 4.0) as figure:
        draw_story(figure, Story("three", panels))
        legends = [axes.get_legend() for axes in figure.axes]
    assert [len(legend.get_texts()) if legend else 0 for legend in legends] == [2, 0, 0]


def test_the_twin_is_seen_on_dark_ground() -> None:
    """Contrast of its line to the paper is above 4.5, which WCAG asks of text; on light ground the colour stays."""

    def luminance(colour: str) -> float:
        parts = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
        return float(np.dot(parts, [0.2126, 0.7152, 0.0722]))

    time = np.arange(10.0)
    story = brighten(Story("one", [Panel("a", [Line("twin", time, time, TWIN, "--"), Line("log", time, time, INK)])]))
    twin, log = story.panels[0].lines
    assert (luminance(twin.colour) + 0.05) / (luminance(THEMES["dark"].paper) + 0.05) > 4.5
    assert log.colour == INK


def test_curves_of_a_short_run_are_seen(tmp_path: Path) -> None:
    """A single value is a dot; a scalar without any number takes no panel."""
    scalars = tmp_path / "run/log/scalars"
    scalars.mkdir(parents=True)
    (tmp_path / "run/config.yaml").write_text("task: {name: hover}\n")
    (scalars / "return.csv").write_text("128,3.5\n")
    (scalars / "exam_failures.csv").write_text("128,nan\n")
    story = tell_runs([tmp_path / "run"])
    assert [panel.label for panel in story.panels] == ["return of finished episodes"]
    with open_figure(9.0, 4.0) as figure:
        draw_story(figure, story)
        (line,) = figure.axes[0].get_lines()
    assert line.get_marker() == "o"


def test_every_twin_has_its_line(tmp_path: Path) -> None:
    """Called by its file where there are several, each in a colour of its own; by all of it where files are alike."""
    time = np.arange(3.0)
    stories = [
        Story("log", [Panel("q", [Line("log", time, time, "#000000"), Line(TWIN_NAME, time, k * time, "#0072B2")])])
        for k in range(2)
    ]
    (panel,) = lay_over(stories, ["rig", "twin"]).panels
    assert [(line.name, line.colour) for line in panel.lines[1:]] == [("rig", COLOURS[0]), ("twin", COLOURS[1])]
    assert [float(line.values[-1]) for line in panel.lines[1:]] == [0.0, 2.0]
    assert name_apart(["a/rig.yaml", "out/twin.yaml"]) == ["rig", "twin"]
    assert name_apart(["a/twin.yaml", "b/twin.yaml"]) == ["a/twin.yaml", "b/twin.yaml"]
    assert name_apart([None]) == ["twin"]
