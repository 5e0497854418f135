"""What `vpptwin plot` shows of a flight: panels over time with the log, the twin beside it, setpoint and triggers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.estimation.joints import find_input, straighten_joint
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import BALL, FREE, read_angles
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.robot.signals import Tracked
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.plots.figure import INK
from vpptwin.viz.plots.palette import GREEN, ORANGE, PURPLE, TWIN, VERMILION
from vpptwin.viz.scene.show import place_body

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight

TWIN_NAME, COLOURS, DASHES = "twin", (TWIN, VERMILION, GREEN, ORANGE, PURPLE), ("--", ":", "-.")
"""What the legend calls a twin; colours and dashes of several."""
SMOOTHED = 0.07
"""Window of the quadratic that velocities are the slope of, s."""


@dataclass(frozen=True)
class Line:
    """One line of a panel."""

    name: str  # what the legend calls it
    time: np.ndarray  # (n,) s from the start of the log
    values: np.ndarray  # (n,); NaN breaks the line
    colour: str  # "#RRGGBB"; `INK` for that of text
    dash: str = "-"  # `-`, `--`, `:`
    steps: bool = False  # whether a value holds until the next
    band: np.ndarray | None = None  # from and to around it, (2, n); None for none


@dataclass(frozen=True)
class Panel:
    """Lines that share an axis, logarithmic or not, whose label carries the unit in brackets."""

    label: str
    lines: list[Line] = field(default_factory=list)
    log: bool = False


@dataclass(frozen=True)
class Story:
    """A flight, or a training run, in panels."""

    title: str  # its name
    panels: list[Panel]  # in reading order
    # times at which another angle was asked for, (k,) s
    triggers: np.ndarray = field(default_factory=lambda: np.empty(0))
    across: str = "time [s]"  # label of the axis that panels share
    columns: int = 1  # panels side by side

    @property
    def rows(self) -> int:
        """Rows of panels."""
        return -(-len(self.panels) // self.columns)


def tell_flight(flight: Flight, prediction: Prediction | None, spec: TwinSpec) -> Story:
    """Panels of what the log holds.

    Args:
        flight: the log.
        prediction: the twin's motion under the log's commands; None for the log alone.
        spec: whose rig it is.

    Raises:
        InputError: if the log holds nothing to draw.
    """
    panels = tell_robot(spec.robot, flight, prediction)
    if not panels:
        present = ", ".join([*flight.streams, *flight.joints]) or "none"
        expected = "a log of our craft, or of the joints that the twin's signals name"
        advice = "name the rig's twin with --twin, or use a topic map"
        raise InputError(f"{flight.path}: nothing to plot, topics {present}", expected, advice)
    return Story(flight.name, panels, find_triggers(spec.robot, flight))


@by_robot
def find_triggers(robot: Robot, flight: Flight) -> np.ndarray:
    """Times (k,) [s] at which something else was asked for, drawn across all panels: of most rigs none."""
    return np.empty(0)


@by_robot
def tell_robot(robot: Robot, flight: Flight, prediction: Prediction | None) -> list[Panel]:
    """Position and velocity of each joint of a rig, and the inputs of its actuators, as far as recorded."""
    panels = []
    for tracked in robot.tracked:
        joint, model = tracked.name, robot.model.joint(tracked.joint)
        if model.type[0] in (FREE, BALL):
            panels += tell_body(robot, tracked, flight, prediction)
            continue
        stream, turns = flight.joints.get(tracked.topic, {}).get(joint), robot.rotary[model.dofadr[0]]
        if stream is None:
            continue
        stream, _ = straighten_joint(robot.model, tracked, stream)
        for column, unit, kind, place in (
            ("position", "rad" if turns else "m", "qpos", model.qposadr[0]),
            ("velocity", "rad/s" if turns else "m/s", "qvel", model.dofadr[0]),
        ):
            if column in stream.values:
                lines = [measured(stream.time, stream[column]), *twin_line(prediction, kind, int(place))]
                panels.append(Panel(f"{joint} {column} [{unit}]", lines))
    for actuator, topic in robot.signals.actuators.items():
        stream = flight.joints.get(topic, {}).get(actuator)
        if stream is not None and (column := find_input(stream)):
            panels.append(Panel(f"{actuator}, input", [measured(stream.time, stream[column])]))
    return panels


def tell_body(robot: Robot, tracked: Tracked, flight: Flight, prediction: Prediction | None) -> list[Panel]:
    """Position, of a free body, and attitude, as roll, pitch and yaw."""
    poses = place_body(robot.model, tracked, flight)
    if poses is None:
        return []
    (time, values), panels = poses, []
    q, told = int(robot.model.jnt_qposadr[tracked.joint]), prediction
    turn = q + values.shape[1] - 4
    if prediction is not None:  # whose quaternion gives way to angles
        qpos = prediction.qpos.copy()
        qpos[:, turn : turn + 3] = read_angles(qpos[:, turn : turn + 4])
        told = replace(prediction, qpos=qpos)
    for axis in range(turn - q):
        lines = [measured(time, values[:, axis]), *twin_line(prediction, "qpos", q + axis)]
        panels.append(Panel(f"{tracked.name} {'xyz'[axis]} [m]", lines))
    for axis, angle in enumerate(read_angles(values[:, -4:]).T):
        lines = [measured(time, angle), *twin_line(told, "qpos", turn + axis)]
        panels.append(Panel(f"{tracked.name} {('roll', 'pitch', 'yaw')[axis]} [rad]", lines))
    return panels


def lay_over(stories: Sequence[Story], twins: Sequence[str]) -> Story:
    """One story of a log with several twins: the lines of each, called and coloured by it."""
    first, *_ = stories
    panels = []
    for i, panel in enumerate(first.panels):
        lines = [line for line in panel.lines if line.name != TWIN_NAME]
        for k, (story, twin) in enumerate(zip(stories, twins, strict=True)):
            own = [line for line in story.panels[i].lines if line.name == TWIN_NAME]
            colour, dash = COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)]
            lines += [replace(line, name=twin, colour=colour, dash=dash) for line in own]
        panels.append(replace(panel, lines=lines))
    return replace(first, panels=panels)


def measured(time: np.ndarray, values: np.ndarray) -> Line:
    """The log's line."""
    return Line("log", time, values, INK)


def twin_line(prediction: Prediction | None, kind: str, joint: int) -> list[Line]:
    """The twin's line of `qpos` or `qvel`, broken where it was set back to the log; none without a twin."""
    if prediction is None:
        return []
    values = np.array(getattr(prediction, kind)[:, joint], dtype=float)
    values[np.searchsorted(prediction.time, prediction.restarts[1:] - 1e-9).clip(0, len(values) - 1)] = np.nan
    return [Line(TWIN_NAME, prediction.time, values, TWIN, "--")]


def differentiate(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Slope of a quadratic over `SMOOTHED` around every sample (n,), per second; the times are nearly regular.

    That is Savitzky and Golay's filter; SciPy's takes half a second to import.
    """
    step = float(np.median(np.diff(time)))
    half = min(max(round(0.5 * SMOOTHED / step), 1), (len(time) - 1) // 2)
    regular = np.arange(time[0], time[-1] + 0.5 * step, step)
    smooth, place = np.interp(regular, time, values), np.arange(-half, half + 1)
    slopes = [np.correlate(smooth, place, "valid") / (place @ place)]
    for end, own in ((smooth[: len(place)], place[:half]), (smooth[-len(place) :], place[-half:])):
        bend, slope, _ = np.polyfit(place, end, 2)
        slopes.append(2.0 * bend * own + slope)
    inner, first, last = slopes
    return np.interp(time, regular, np.concatenate([first, inner, last]) / step)
