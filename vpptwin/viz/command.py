"""`vpptwin play` and `vpptwin plot`: a log, and beside it the twin driven by the log's commands; training curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vpptwin.estimation.checks.gate import check_columns
from vpptwin.estimation.measurements import list_warnings, read_measurements
from vpptwin.estimation.replay import Prediction, replay
from vpptwin.logs import Flight, read_flight
from vpptwin.logs.spelling import expand
from vpptwin.system.doubt import list_overruled
from vpptwin.system.errors import InputError
from vpptwin.system.files import write_whole
from vpptwin.system.terminal import print_dropped, print_warnings
from vpptwin.twin.spec import TwinSpec, load_twin


@dataclass(frozen=True)
class LogSource:
    """What is shown."""

    files: Sequence[Path]  # of one recording, or, for plots, folders of training runs
    twin: str | None = None  # `nominal` or a twin YAML beside it; None for the log alone, on the nominal rig
    restart: float | None = 0.5  # seconds between the twin's restarts; None lets it run freely
    topic_map: Path | None = None  # YAML that renames topics of other people's bags
    effects: Sequence[Path] = ()  # Python files with effects of the user's own

    def read(self) -> tuple[Flight, Prediction | None, TwinSpec]:
        """The recording, what the twin does under its commands, and the rig."""
        twin, restart = self.twin, self.restart
        if not self.files:
            raise InputError("no LOG", "an MCAP file", "name one, or a policy with --live")
        if restart is not None and not restart > 0.0:
            advice = "use --free for a twin that is never restarted"
            raise InputError(f"--restart {restart:g}", "seconds above 0", advice)
        spec = load_twin(twin or "nominal", self.effects)
        files = [file for log in self.files for file in expand(log)]
        flight = read_flight(files[0] if len(files) == 1 else files, self.topic_map, spec.robot.signals.entries)
        if twin is None and "/mocap/pose" not in flight.streams and flight.joints:
            found = f"{flight.path}: joints on {', '.join(flight.joints)} and no /mocap/pose"
            advice = "name that rig's twin with --twin"
            raise InputError(found, "a log of our craft, or the twin of another rig", advice)
        if twin is None:
            print_warnings(look_over(spec, flight))
            return flight, None, spec
        measurements = read_measurements(spec, flight)
        check_columns(spec, [flight], [measurements])
        prediction = replay(spec, flight, restart, measurements=measurements)
        print_dropped({flight.name: flight.dropped})
        print_warnings([*prediction.warnings, *list_overruled()])
        return flight, prediction, spec


def name_apart(twins: Sequence[str | None]) -> list[str]:
    """What the legend calls twins: one alone `twin`, several by their files as far as these differ."""
    if len(twins) == 1:
        return ["twin"]
    stems = [Path(str(twin)).stem for twin in twins]
    return [str(twin) if stems.count(stem) > 1 else stem for twin, stem in zip(twins, stems)]


def look_over(spec: TwinSpec, flight: Flight) -> list[str]:
    """Warnings about a log that no twin flies; where a twin could not fly it, those of reading it."""
    try:
        return list_warnings([flight], [read_measurements(spec, flight)])
    except InputError:
        return [f"{flight.name}: {text}" for text in flight.warnings]


def play_log(
    source: LogSource, html: Path | None, video: Path | None = None, host: str = "127.0.0.1", in_window: bool = False,
    port: int = 0, others: Sequence[str] = (),
) -> None:  # fmt: skip
    """Play one recording.

    Args:
        source: the recording, and a twin beside it.
        html: the page to write; without it, and without `video`, a server shows it until Ctrl-C.
        video: the animation to write, .gif, .webp or .mp4; None for none.
        host: address of this machine to serve on.
        port: to serve on; 0 for any that is free.
        in_window: show it in MuJoCo's own viewer instead of serving it.
        others: more twins, each in a scene of its own on the same page.

    Raises:
        InputError: on bad input, and on several twins where one scene is all there is.
    """
    from vpptwin.viz.pages.playback import play_live, play_page  # neither of the two commands waits for the other's

    if others:
        play_beside(source, others, html, video is not None or in_window, host, port)
        return
    if video is not None:
        from vpptwin.viz.scene.video import check_video, write_video

        check_video(video)
    if in_window:
        from vpptwin.viz.pages.window import check_screen, play_window

        check_screen()
        play_window(*source.read())
        return
    flight, prediction, spec = source.read()
    if video is not None:
        print(write_video(flight, prediction, video, spec=spec))
    if html is not None:
        print(play_page(flight, prediction, html, spec=spec))
    if html is None and video is None:
        play_live(flight, prediction, spec=spec, host=host, port=port)


def play_beside(
    source: LogSource, others: Sequence[str], html: Path | None, alone: bool, host: str, port: int
) -> None:  # fmt: skip
    """Play one recording with several twins, side by side; `alone` is whether one scene is asked for."""
    from vpptwin.viz.pages.beside import draw_beside
    from vpptwin.viz.pages.playback import serve_page

    twins = [str(source.twin), *others]
    if alone:
        found, action = f"{len(twins)} twins in a video or a window", "name one, or write a page with --html"
        raise InputError(found, "one", action)
    read = [replace(source, twin=twin).read() for twin in twins]
    shown = [(name, prediction, spec) for name, (_, prediction, spec) in zip(name_apart(twins), read) if prediction]
    page = draw_beside(read[0][0], shown)
    if html is None:
        serve_page(page, host, port)
    else:
        print(write_whole(html, page))


def plot(source: LogSource, out: Path, theme: str = "light", others: Sequence[str] = ()) -> None:
    """Draw one recording, or training runs.

    Args:
        source: the recording, and a twin beside it, or folders of training runs.
        out: .png, .svg or .html.
        theme: `light` or `dark`.
        others: more twins beside the same recording.
    """
    from vpptwin.viz.plots.curves import is_run, tell_runs
    from vpptwin.viz.plots.panels import lay_over, tell_flight
    from vpptwin.viz.plots.plot import check_format, write_story

    check_format(out)
    files = [file for given in source.files for file in expand(given)]
    runs = [file for file in files if is_run(file)]
    if not runs:
        twins = [source.twin, *others] if source.twin is not None else [None]
        story = lay_over([tell_flight(*replace(source, twin=twin).read()) for twin in twins], name_apart(twins))
    elif len(runs) < len(files) or source.twin is not None:
        other = f"--twin {source.twin}" if source.twin is not None else next(str(s) for s in files if s not in runs)
        raise InputError(f"{runs[0]} is a training run, and {other}", "logs or runs", "plot them one after the other")
    else:
        story = tell_runs(runs)
    print(write_story(story, out, theme))
