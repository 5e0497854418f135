"""What the extended twin still misses: how much against no-effect flights, in which channel, what it follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.bench import Bench, Key, Variation
from vpptwin.diagnosis.holdout import HeldOut
from vpptwin.diagnosis.likelihood import gust_std, rotary_dofs
from vpptwin.diagnosis.verdict import Unexplained
from vpptwin.diagnosis.wrench import WrenchPlot, missing_wrench

FORCE_LEVEL = 1.35
"""Mean square of the innovations of unmodelled force that no session without an effect has exceeded (benchmarks)."""
CHANNEL_LEVEL = 1.6
"""The same for the whitened residual of a channel."""
DEPENDS = 0.1
"""Share of the missing force's variance that a quantity must predict on other stretches of flight to be named."""
BINS = (4, 8, 16, 48)
FOLDS = 4


@dataclass(frozen=True)
class Level:
    """How large a residual is against what the noise model says: mean square, 1 if it is right, and its error."""

    square: float
    error: float

    @property
    def sigma(self) -> float:
        """Excess in standard errors."""
        return (self.square - 1.0) / max(self.error, 1e-9)


@dataclass(frozen=True)
class Leftover:
    """The remainder, what it follows, and the picture of that."""

    unexplained: Unexplained
    force: Level
    plot: WrenchPlot | None


def level_of_force(held_out: HeldOut, values: Mapping[Key, float]) -> Level:
    """Mean square of the innovations of unmodelled force on held-out windows."""
    likelihood = held_out.likelihood(values)
    innovation = likelihood.innovate(likelihood.response.along(held_out.residual(values)))
    square = (innovation**2).mean(axis=1)
    return Level(float(square.mean()), float(square.std() / np.sqrt(len(square))))


def levels_of_channels(held_out: HeldOut, values: Mapping[Key, float]) -> list[Level]:
    """Mean square of the whitened residual of every channel."""
    white = held_out.likelihood(values).whiten(held_out.residual(values))
    bench = held_out.short
    found = []
    for part in channel_slices(bench):
        number = np.maximum(bench.valid[:, part].sum(axis=1), 1)
        square = (white[:, part] ** 2).sum(axis=1) / number
        found.append(Level(float(square.mean()), float(square.std() / np.sqrt(len(square)))))
    return found


def channel_slices(bench: Bench) -> list[slice]:
    """Where every channel lies in a row of measurements."""
    ends = np.cumsum([c.value.shape[1] for c in bench.channels])
    return [slice(int(end) - c.value.shape[1], int(end)) for c, end in zip(bench.channels, ends)]


def judge_leftover(held_out: HeldOut, values: Mapping[Key, float]) -> Leftover:
    """Compare what is left with flights without effects.

    Unmodelled force is the sharpest measure: whatever pushes the rig must show there. Where it is unremarkable, the
    channel with the largest whitened mean square may still tell of a sensor. `share` is what remains of the held-out
    excess over what noise and gusts make of chi2.
    """
    force, channels = level_of_force(held_out, values), levels_of_channels(held_out, values)
    worst = int(np.argmax([level.square for level in channels]))
    significant = force.square > FORCE_LEVEL or channels[worst].square > CHANNEL_LEVEL
    before, after = level_of_force(held_out, {}), force
    excess = before.square - 1.0
    share = float(np.clip((after.square - 1.0) / excess, 0.0, 1.0)) if excess > 0.0 else 0.0
    sigma = max(force.sigma, 0.0)
    if not significant:
        return Leftover(Unexplained(False, share, None, [], sigma), force, None)
    depends, plot = find_dependence(held_out, values)
    channel = held_out.short.channels[worst].name
    return Leftover(Unexplained(True, share, channel, depends, sigma), force, plot)


def find_dependence(held_out: HeldOut, values: Mapping[Key, float]) -> tuple[list[str], WrenchPlot | None]:
    """Quantities that the missing force follows on stretches of flight other than those it was learnt from."""
    bench = held_out.short
    missing, before = missing_wrench(held_out, values), missing_wrench(held_out, {})
    model = bench.spec.model
    share = (missing**2).sum(axis=(0, 1)) / np.maximum((missing**2).sum(), 1e-30)
    dof = int(np.argmax(share / np.maximum(gust_std(bench.spec) ** 2, 1e-30)))
    force, fold = missing[:, :, dof].ravel(), np.repeat(held_out.blocks(bench) % FOLDS, bench.segments)
    found = []
    for label, quantity in list_quantities(held_out, values):
        found.append((predicted_share(quantity.ravel(), force, fold), label, quantity))
    found.sort(key=lambda item: -item[0])
    joint = model.joint(int(model.dof_jntid[dof])).name
    named = [label for part, label, _ in found if part > DEPENDS]
    best = found[0]
    unit = "N m" if rotary_dofs(bench.spec)[dof] else "N"
    y_label = f"missing {'torque' if unit == 'N m' else 'force'} on {joint} [{unit}]"
    plot = WrenchPlot(best[2].ravel(), before[:, :, dof].ravel(), force, best[1], y_label)
    return [name.split(" [")[0] for name in named[:3]], plot


def list_quantities(held_out: HeldOut, values: Mapping[Key, float]) -> list[tuple[str, np.ndarray]]:
    """Quantities that a force may follow, averaged over the gust segments of every window, (K, segments) each."""
    bench = held_out.short
    pose, velocity, _ = bench.simulate([bench.without_sensors(Variation(dict(values)))], values)
    model, windows = bench.spec.model, bench.windows
    named: list[tuple[str, np.ndarray]] = []

    def add(label: str, track: np.ndarray) -> None:
        parts = np.array_split(track, bench.segments, axis=1)
        named.append((label, np.stack([part.mean(axis=1) for part in parts], axis=1)))

    rotary = rotary_dofs(bench.spec)
    for dof in range(model.nv):
        joint, unit = model.joint(int(model.dof_jntid[dof])).name, "rad" if rotary[dof] else "m"
        add(f"{joint} position [{unit}]", pose[0, :, 1:, dof])
        add(f"{joint} velocity [{unit}/s]", velocity[0, :, 1:, dof])
    for i in range(model.nu):
        command = windows.command[:, :, i]
        add(f"command of {model.actuator(i).name}", command)
        add(f"speed of command of {model.actuator(i).name} [1/s]", np.abs(np.gradient(command, windows.dt, axis=1)))
    for i in range(model.nv):
        for j in range(i):
            first, second = (model.joint(int(model.dof_jntid[d])).name for d in (j, i))
            add(f"{first} velocity times {second} velocity", velocity[0, :, 1:, i] * velocity[0, :, 1:, j])
    time = windows.start[:, None] + windows.dt * np.arange(windows.steps)
    add("time [s]", time)
    return named


def predicted_share(quantity: np.ndarray, force: np.ndarray, fold: np.ndarray) -> float:
    """Share of a force's variance that binned means over a quantity predict on folds they were not taken from."""
    total = float(((force - force.mean()) ** 2).sum())
    if total <= 0.0 or np.ptp(quantity) == 0.0:
        return 0.0
    best = 0.0
    for bins in BINS:
        edges = np.quantile(quantity, np.linspace(0.0, 1.0, bins + 1)[1:-1])
        place = np.searchsorted(edges, quantity)
        missed = 0.0
        for i in range(FOLDS):
            test, train = fold == i, fold != i
            number = np.bincount(place[train], minlength=bins)
            sums = np.bincount(place[train], weights=force[train], minlength=bins)
            mean = sums / np.maximum(number + 1.0, 1.0)  # shrunk towards zero where little was seen
            missed += float(((force[test] - mean[place[test]]) ** 2).sum())
        best = max(best, 1.0 - missed / float((force**2).sum()))
    return best
