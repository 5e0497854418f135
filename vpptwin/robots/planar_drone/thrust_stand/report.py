"""The page of an identification: fits beside what was measured, constants, held-out errors. One file, offline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vpptwin.report.html.page import open_templates
from vpptwin.report.provenance import Provenance
from vpptwin.robots.planar_drone.thrust_stand.actuator import WINDOW, Actuator, Constant, find_steps, lag_pitch
from vpptwin.robots.planar_drone.thrust_stand.bench import BenchRun
from vpptwin.robots.planar_drone.thrust_stand.thrust_map import ThrustMap
from vpptwin.viz.plots.figure import name_axes, open_figure, write_svg
from vpptwin.viz.plots.palette import BLUE, GREEN, ORANGE, VERMILION


def render_page(found: Actuator, runs: Sequence[BenchRun], origin: Provenance) -> str:
    """The page as HTML."""
    rows = []
    form, terms = found.thrust.candidate.name, zip(("k_1", "k_2", "k_3"), found.thrust.values, found.thrust.std)
    coefficients = (Constant(f"thrust map {name}", value, std, "", form) for name, value, std in terms)
    for c in (*coefficients, *found.constants):
        low, high = c.interval
        rows.append((c.name, f"{c.value:.5g}", f"{low:.5g} to {high:.5g}", c.unit, c.note))
    line = min((m for m in found.maps if len(m.values) == 1), key=lambda m: m.held_out)
    largest = float(np.abs(found.levels.thrust).max())
    return open_templates("vpptwin.robots.planar_drone.thrust_stand").get_template("identify.html.j2").render(
        found=found, rows=rows, maps=sorted(found.maps, key=lambda m: m.held_out), largest=largest, line=line,
        figures=[draw_thrust(found), draw_misses(found, line), draw_current(found), draw_step(found, runs)],
        origin=origin,
    )  # fmt: skip


def draw_thrust(found: Actuator) -> str:
    """Thrust of the levels against pitch, with the chosen map at each speed."""
    levels = found.levels
    with open_figure(4.6, 3.4) as figure:
        axes = figure.subplots()
        axes.plot(levels.pitch[:, 0], levels.thrust, "o", color=ORANGE, markersize=3.5, label="measured")
        pitch = np.linspace(levels.pitch.min(), levels.pitch.max(), 200)[:, None]
        for number, speed in enumerate(np.unique(np.round(levels.speed[:, 0] / 10.0)) * 10.0):
            thrust = found.thrust.predict(np.full_like(pitch, speed), pitch).sum(axis=1)
            axes.plot(pitch[:, 0], thrust, color=BLUE, linewidth=1.0, label="" if number else "map")
        name_axes(axes, "blade pitch [rad]", "thrust [N]", "Thrust")
        axes.legend()
        return write_svg(figure, "Thrust against blade pitch")


def draw_misses(found: Actuator, line: ThrustMap) -> str:
    """What the chosen map and the paper's line miss."""
    levels = found.levels
    with open_figure(4.6, 3.4) as figure:
        axes = figure.subplots()
        shown = [(found.thrust, BLUE, "o", found.thrust.candidate.name)]
        if line is not found.thrust:
            shown.insert(0, (line, VERMILION, "x", f"a line ({line.candidate.name})"))
        for fitted, colour, marker, label in shown:
            wrong = fitted.predict(levels.speed, levels.pitch).sum(axis=1) - levels.thrust
            axes.plot(levels.pitch[:, 0], wrong, marker, color=colour, markersize=4.0, label=label, fillstyle="none")
        name_axes(axes, "blade pitch [rad]", "map - measured [N]", "What a map misses")
        axes.legend()
        return write_svg(figure, "What maps miss")


def draw_current(found: Actuator) -> str:
    """Current of the levels against pitch, measured and by the constants."""
    levels, value = found.levels, {c.name: c.value for c in found.constants}
    alpha, speed = np.abs(levels.pitch - found.thrust.offset), levels.speed
    drag = value["rotor.k_d1"] * speed**2 + value["rotor.k_d2"] * (speed * alpha) ** 2
    drag = drag + value["rotor.k_d3"] * speed * alpha
    fitted = value["motor.no_load_current"] + value["motor.k_q"] * drag
    with open_figure(4.6, 3.4) as figure:
        axes = figure.subplots()
        axes.plot(levels.pitch[:, 0], levels.current[:, 0], "o", color=ORANGE, markersize=3.5, label="measured")
        axes.plot(levels.pitch[:, 0], fitted[:, 0], "+", color=BLUE, markersize=7.0, label="motor and drag constants")
        name_axes(axes, "blade pitch [rad]", "current [A]", "Current")
        axes.legend()
        return write_svg(figure, "Current against blade pitch")


def draw_step(found: Actuator, runs: Sequence[BenchRun]) -> str:
    """Thrust after the largest step, measured and by map, lag and delay."""
    run = max(runs, key=lambda r: len(find_steps(r)))
    steps = find_steps(run)
    step = max(steps, key=lambda s: float(np.abs(run.pitch[s] - run.pitch[s - 1]).max()))
    lag, delay = found.constant("servo.time_constant").value, found.constant("servo.delay").value
    part = slice(step - 20, step + round(WINDOW / run.dt))
    predicted = found.thrust.predict(run.speed, lag_pitch(run, lag, delay)).sum(axis=1)
    sent = found.thrust.predict(run.speed, run.pitch).sum(axis=1)
    time = 1000.0 * run.dt * (np.arange(part.start, part.stop) - step)
    with open_figure(4.6, 3.4) as figure:
        axes = figure.subplots()
        axes.plot(time, run.thrust[part], color=ORANGE, label="measured", linewidth=2.4)
        axes.plot(time, predicted[part], color=BLUE, label="with lag and delay", linewidth=1.2)
        axes.plot(time, sent[part], ":", color=GREEN, label="as commanded")
        name_axes(axes, "time after the command [ms]", "thrust [N]", "A step")
        axes.legend()
        return write_svg(figure, "Thrust after a step")
