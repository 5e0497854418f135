"""`vpptwin play` and `vpptwin plot`: a log, and beside it the twin driven by the log's commands; training curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vpptwin.estimation.measurements import list_warnings, read_measurements
from vpptwin.estimation.replay import Prediction, replay
from vpptwin.logs import Flight, read_flight
from vpptwin.logs.spelling import expand, stem_log
from vpptwin.system.errors import InputError
from vpptwin.system.terminal import print_warnings
from vpptwin.twin.spec import TwinSpec, load_twin


def play_log(
    logs: Sequence[Path], twin: str | None, html: Path | None, restart: float | None = 0.5,
    topic_map: Path | None = None, effects: Sequence[Path] = (), video: Path | None = None,
    host: str = "127.0.0.1", in_window: bool = False,
) -> None:  # fmt: skip
    """Play one recording.

    Args:
        logs: its MCAP files.
        twin: `nominal` or a twin YAML; None plays the log alone, on the nominal rig.
        html: the page to write; without it, and without `video`, a server shows it until Ctrl-C.
        restart: seconds between the twin's restarts; None lets it run freely.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own.
        video: the animation to write, .gif, .webp or .mp4; None for none.
        host: address of this machine to serve on.
        in_window: show it in MuJoCo's own viewer instead of serving it.
    """
    from vpptwin.viz.pages.playback import play_live, play_page  # neither of the two commands waits for the other's

    if video is not None:
        from vpptwin.viz.scene.video import check_video, write_video

        check_video(video)
    if in_window:
        from vpptwin.viz.pages.window import check_screen, play_window

        check_screen()
    flight, prediction, spec = read_both(logs, twin, restart, topic_map, effects)
    if in_window:
        play_window(flight, prediction, spec)
        return
    if video is not None:
        print(write_video(flight, prediction, video, spec=spec))
    if html is not None:
        print(play_page(flight, prediction, html, spec=spec))
    if html is None and video is None:
        play_live(flight, prediction, spec=spec, host=host)


def read_both(
    logs: Sequence[Path], twin: str | None, restart: float | None, topic_map: Path | None, effects: Sequence[Path]
) -> tuple[Flight, Prediction | None, TwinSpec]:
    """A recording, what the twin does under its commands, and the rig.

    Raises:
        InputError: if one of them is not what it should be.
    """
    if not logs:
        raise InputError("no LOG", "an MCAP file", "name one, or a policy with --live")
    if restart is not None and not restart > 0.0:
        raise InputError(f"--restart {restart:g}", "seconds above 0", "use --free for a twin that is never restarted")
    spec = load_twin(twin or "nominal", effects)
    files = [file for log in logs for file in expand(log)]
    flight = read_flight(files[0] if len(files) == 1 else files, topic_map, spec.robot.signals.entries)
    if twin is None:
        check_craft(flight)
    prediction = None if twin is None else replay(spec, flight, restart)
    print_warnings(look_over(spec, flight) if prediction is None else prediction.warnings)
    return flight, prediction, spec


def look_over(spec: TwinSpec, flight: Flight) -> list[str]:
    """Warnings about a log that no twin flies; where a twin could not fly it, those of reading it."""
    try:
        return list_warnings([flight], [read_measurements(spec, flight)])
    except InputError:
        return [f"{flight.name}: {text}" for text in flight.warnings]


def plot(
    sources: Sequence[Path], twin: str | None, out: Path, restart: float | None = 0.5,
    theme: str = "light", topic_map: Path | None = None, effects: Sequence[Path] = (),
) -> None:  # fmt: skip
    """Draw one recording, or training runs.

    Args:
        sources: MCAP files of one recording, or folders of training runs.
        twin: `nominal` or a twin YAML to draw beside a log; None for the log alone.
        out: .png, .svg or .html.
        restart: seconds between the twin's restarts; None lets it run freely.
        theme: `light` or `dark`.
        topic_map: YAML that renames topics of other people's bags.
        effects: Python files with effects of the user's own.

    Raises:
        InputError: if a source is not what it should be, or the picture cannot be written.
    """
    from vpptwin.viz.plots.curves import is_run, tell_runs
    from vpptwin.viz.plots.panels import tell_flight
    from vpptwin.viz.plots.plot import check_format, write_story

    check_format(out)
    sources = [file for source in sources for file in expand(source)]
    runs = [source for source in sources if is_run(source)]
    if not runs:
        story = tell_flight(*read_both(sources, twin, restart, topic_map, effects))
    elif len(runs) < len(sources) or twin is not None:
        other = f"--twin {twin}" if twin is not None else next(str(s) for s in sources if s not in runs)
        raise InputError(f"{runs[0]} is a training run, and {other}", "logs or runs", "plot them one after the other")
    else:
        story = tell_runs(runs)
    print(write_story(story, out, theme))


def name_picture(sources: Sequence[Path]) -> Path:
    """What is written if nobody says: a PNG named like the first source, in the current folder."""
    return Path(f"{stem_log(expand(sources[0])[0])}.png")


def check_craft(flight: Flight) -> None:
    """Refuse a log of another rig that comes without the twin that would describe it."""
    if "/mocap/pose" not in flight.streams and flight.joints:
        found = f"{flight.path}: joints on {', '.join(flight.joints)} and no /mocap/pose"
        raise InputError(found, "a log of our craft, or the twin of another rig", "name that rig's twin with --twin")
