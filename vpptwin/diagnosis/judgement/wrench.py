"""The force that the twin lacks: the pulses that would have to act on each joint to explain what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.search.likelihood import Response, gust_std, measure_response
from vpptwin.diagnosis.search.motion import find_track
from vpptwin.effects import Effect
from vpptwin.inference.covariance import solve
from vpptwin.twin.robot.manifold import FREE, chart


@dataclass(frozen=True)
class WrenchPlot:
    """A missing force against what it follows, of a twin without something and with it.

    Attributes:
        quantity: (n,) what it is plotted against.
        before: missing force without it [N or N m], (n,).
        after: the same with it.
        x_label: quantity with unit.
        y_label: force with unit.
    """

    quantity: np.ndarray
    before: np.ndarray
    after: np.ndarray
    x_label: str
    y_label: str


def missing_wrench(bench: Bench, response: Response, residual: np.ndarray) -> np.ndarray:
    """Force pulses that explain the residuals (K, M) of a twin that responds so, (K, segments, nv) N, N m."""
    white = response.sensors.apply(residual)
    columns = response.sensors.apply(np.moveaxis(response.push, 2, 0))
    gram = np.einsum("pkm,qkm->kpq", columns, columns) + np.eye(len(columns)) / bench.criteria.missing_force**2
    share = solve(gram, np.einsum("pkm,km->kp", columns, white)[..., None])[..., 0]
    return share.reshape(len(residual), bench.segments, -1) * gust_std(bench)


def plot_wrench(held_out: HeldOut, values: Mapping[Key, float], effect: Effect) -> WrenchPlot:
    """The force that is missing without an effect, and with it, on its joint or where that changes most."""
    bench = held_out.short
    model = bench.spec.model
    others = {key: value for key, value in values.items() if key[0] != effect.id}
    before, after = (measure_wrench(bench, each) for each in (others, values))
    joints = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt) if model.jnt_type[i] != FREE}
    drop = (before**2 - after**2).mean(axis=(0, 1)) / gust_std(bench) ** 2
    dof = joints.get(effect.target, int(np.argmax(drop)))
    joint = bench.spec.robot.name_dof(dof)
    rotary = bool(bench.spec.robot.rotary[dof])
    quantity, x_label = quantity_of_segments(bench, values, effect, dof, joint, rotary)
    kind, unit = ("torque", "N m") if rotary else ("force", "N")
    return WrenchPlot(
        quantity,
        before[:, :, dof].ravel(),
        after[:, :, dof].ravel(),
        x_label,
        f"missing {kind} on {joint} [{unit}]",
    )


def measure_wrench(bench: Bench, values: Mapping[Key, float]) -> np.ndarray:
    """Force pulses that a twin with `values` lacks, (K, segments, nv) N, N m."""
    track = find_track(bench, values)
    about = bench.about(track)
    response = measure_response(about, values)
    return missing_wrench(bench, response, response.restore(about.residual(values), track))


def quantity_of_segments(
    bench: Bench, values: Mapping[Key, float], effect: Effect, dof: int, joint: str, rotary: bool
) -> tuple[np.ndarray, str]:
    """What an effect's force follows, averaged over each gust segment of each window, (K segments,), and its label.

    Where there are no commands, what would follow them is shown against the position.
    """
    windows = bench.windows
    follows = effect.follows if windows.command.shape[2] or effect.follows == "velocity" else "position"
    if follows in ("velocity", "position"):
        motion = bench.simulate([Variation(values)])
        placed = chart(bench.spec.model, motion.pose[0, :, 1:])
        track = motion.velocity[0, :, 1:, dof] if follows == "velocity" else placed[..., dof]
        unit = "rad" if rotary else "m"
        label = f"{joint} {follows} [{unit}{'/s' if follows == 'velocity' else ''}]"
    else:
        shares, label = bench.spec.robot.weigh_commands(effect, dof)
        track = command = windows.command @ shares
        if follows == "command change":
            track, label = np.gradient(command, windows.dt, axis=1), f"rate of {label.replace(']', '/s]')}"
    parts = np.array_split(track, bench.segments, axis=1)
    return np.stack([part.mean(axis=1) for part in parts], axis=1).ravel(), label
