"""What the extended twin still misses: whether it is more than gusts, in which channel, what it follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Track, Variation
from vpptwin.diagnosis.judgement.blocks import blocks_of
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.selection import Explanation
from vpptwin.diagnosis.judgement.verdict import Unexplained
from vpptwin.diagnosis.judgement.weather import BINS, FOLDS, Missing, find_swing, leave_behind
from vpptwin.diagnosis.judgement.wrench import WrenchPlot, missing_wrench
from vpptwin.diagnosis.search.likelihood import (
    Response,
    couple_gusts,
    gust_std,
    measure_response,
    middles_of_segments,
    tune_gust,
)
from vpptwin.diagnosis.search.motion import find_track
from vpptwin.diagnosis.search.search import Search
from vpptwin.twin.robot.manifold import chart

LESS = 0.2
"""Share by which a swing is believed less than a state."""


@dataclass(frozen=True)
class Part:
    """Windows with what a twin misses on them.

    Attributes:
        bench: K windows.
        response: of the twin to starting states and pulses.
        missed: by the twin, (K, M), build tolerances taken out.
        track: about which it was simulated.
        felt: whether pulses could have moved their joints, (K, segments, nv).
    """

    bench: Bench
    response: Response
    missed: np.ndarray
    track: Track | None
    felt: np.ndarray | None = None

    @property
    def residual(self) -> np.ndarray:
        """What a twin without a track would have missed, (K, M)."""
        return self.response.restore(self.missed, self.track)

    def square_of_force(self, gust: np.ndarray) -> float:
        """Mean square of the innovations of unmodelled force, under gusts `gust` times as strong as assumed, (nv,)."""
        likelihood = couple_gusts(self.bench, self.response, gust)
        return float((likelihood.innovate(self.response.along(self.residual)) ** 2).mean())

    def missing_force(self) -> np.ndarray:
        """Force pulses that explain the residual, in multiples of the assumed gusts, (K, segments, nv)."""
        return missing_wrench(self.bench, self.response, self.residual) / gust_std(self.bench)

    def levels_of_channels(self) -> np.ndarray:
        """Mean square of every channel's whitened residual, of the flight where it is largest, (C,).

        Gusts are as strong as the residual tells, within what is assumed and the strongest weather.
        """
        bench, criteria = self.bench, self.bench.criteria
        blew = np.clip(tune_gust(bench, self.response, self.residual), 1.0, criteria.storm)
        white, flight, found = couple_gusts(bench, self.response, blew).whiten(self.residual), bench.windows.flight, []
        for columns in bench.columns:
            number = np.maximum(bench.valid[:, columns].sum(axis=1), 1)
            squares = clip_astray((white[:, columns] ** 2).sum(axis=1) / number, flight, criteria.astray)
            found.append(max(squares[flight == name].mean() for name in np.unique(flight)))
        return np.array(found)

    def missed_on_average(self, kind: str, dof: int) -> np.ndarray:
        """How far a joint's position or velocity was off the twin's in every gust segment, (K, segments).

        Zero where it was not measured.
        """
        segments = self.bench.segments
        for channel, columns in zip(self.bench.channels, self.bench.columns):
            if (channel.kind, channel.axis) == (kind, dof):
                valid = np.array_split(self.bench.valid[:, columns], segments, axis=1)
                missed = np.array_split(self.missed[:, columns], segments, axis=1)
                return np.stack([m.sum(axis=1) / np.maximum(v.sum(axis=1), 1) for m, v in zip(missed, valid)], axis=1)
        return np.zeros((len(self.bench.windows), segments))


@dataclass(frozen=True)
class Leftover:
    """The remainder, what it follows, and the picture of that."""

    unexplained: Unexplained
    plot: WrenchPlot | None


def judge_leftover(held_out: HeldOut, search: Search, fit: Explanation) -> Leftover:
    """Judge what is left: where gusts are known, of all windows, else of those that judge."""
    known = search.bench.spec.robot.disturbance.known
    bench = search.bench if known else held_out.short
    part, before = open_part(bench, fit.likeliest, fit), open_part(bench, {}, fit)
    if known:
        return judge_weather([part], [before], fit.likeliest, bool(fit.effects))
    return judge_structure(part, before, fit.likeliest, share_left(held_out, fit))


def open_part(bench: Bench, values: Mapping[Key, float], fit: Explanation) -> Part:
    """Windows with what a twin misses on them: where it strays from what was measured, about the likeliest motion."""
    track = find_track(bench, values)
    about = bench.about(track)
    missed = about.residual(values)
    loose, own = bench.loosen(values), dict(values)
    parts = [Part(bench, measure_response(about, each), missed, track) for each in (loose, own)]
    if track is not None:  # the twin slips when the rig did
        return replace(parts[0], felt=feel(*parts))
    blew = np.clip(fit.gust, 1.0, bench.criteria.storm)  # what sticks may yield: judged is what leaves less to explain
    return min(parts, key=lambda part: part.square_of_force(blew))


def judge_weather(
    parts: Sequence[Part], before: Sequence[Part], values: Mapping[Key, float], extended: bool
) -> Leftover:
    """What is left is unexplained if it follows something, is stronger than weather, or shows where no force does.

    How gusts are is fitted to what is left. `share` is what remains of the force that the twin missed before.

    Args:
        parts: all windows.
        before: the same before the fit.
        values: of the fit.
        extended: whether the fit has causes, beside which little does not matter.
    """
    bench, criteria = parts[0].bench, parts[0].bench.criteria
    missing, old = lay_out(parts, values), join([part.missing_force() for part in before])
    kept = float(np.clip((missing.force**2).sum() / max((old**2).sum(), 1e-30), 0.0, 1.0))
    pushes = [missing.inspect(dof, criteria) for dof in range(bench.spec.model.nv)]
    sigmas = [push.sigma * (push.foretold > criteria.push) for push in pushes]
    sigma, follows = max(sigmas), max(sigmas) > criteria.followed
    worst = pushes[int(np.argmax(sigmas if follows else [push.strength for push in pushes]))]
    levels = np.max([part.levels_of_channels() for part in parts], axis=0)
    strange = levels.max() > criteria.channel_level
    found = follows or strange or worst.strength > criteria.gale
    if not found or (extended and kept < criteria.matters):
        return Leftover(Unexplained(False, kept, None, [], sigma), None)
    joint = bench.spec.robot.name_dof(worst.dof)
    channel = bench.channels[int(np.argmax(levels))].name if strange else joint
    names = [each.label.split(" [")[0] for each in worst.followed if each.sigma > criteria.followed][:3]
    label, unit = worst.followed[0].label, "N m" if bench.spec.robot.rotary[worst.dof] else "N"
    y_label = f"missing {'torque' if unit == 'N m' else 'force'} on {joint} [{unit}]"
    after, first = (force[:, worst.dof] * gust_std(bench)[worst.dof] for force in (missing.force, old))
    plot = WrenchPlot(missing.quantities[label], first, after, label, y_label)
    return Leftover(Unexplained(True, kept, channel, names if follows else [], sigma if follows else 0.0), plot)


def feel(loose: Part, sticking: Part) -> np.ndarray:
    """Whether pulses move their joints in a twin that sticks at least half as far as if it did not."""
    far = [np.square(part.response.push / part.bench.std[..., None]).sum(axis=1) for part in (loose, sticking)]
    return (far[1] > 0.25 * far[0]).reshape(len(far[0]), loose.bench.segments, -1)


def lay_out(parts: Sequence[Part], values: Mapping[Key, float]) -> Missing:
    """The missing force of windows in parts, with what it may follow, the ways that joints have come among it.

    Commands are those at the start of every pulse: later ones answer it.
    """
    time = join([middles_of_segments(part.bench)[..., None] for part in parts])[:, 0]
    flight = np.concatenate([np.repeat(part.bench.windows.flight, part.bench.segments) for part in parts])
    listed = [dict(list_quantities(part, values)) | commands_at_start(part.bench) for part in parts]
    quantities = {label: np.concatenate([each[label].ravel() for each in listed]) for label in listed[0]}
    for label in [label for label in quantities if " position [" in label]:
        way = leave_behind(quantities[label], time, flight, parts[0].bench.spec.robot.disturbance.memory)
        quantities[label.replace("position", "displacement within a window")] = way
    felt = [part.felt for part in parts if part.felt is not None]
    return Missing(
        join([part.missing_force() for part in parts]), time, flight, quantities, join(felt) if felt else None
    )


def commands_at_start(bench: Bench) -> dict[str, np.ndarray]:
    """Commands at the start of the gust segments of every window, label → (K, segments)."""
    model, windows = bench.spec.model, bench.windows
    first = [piece[0] for piece in np.array_split(np.arange(windows.steps), bench.segments)]
    return {f"command of {model.actuator(i).name}": windows.command[:, first, i] for i in range(model.nu)}


def join(pieces: Sequence[np.ndarray]) -> np.ndarray:
    """Values (K, segments, n) of windows in parts, one after the other, (K segments, n)."""
    return np.concatenate([piece.reshape(-1, piece.shape[-1]) for piece in pieces])


def clip_astray(squares: np.ndarray, flights: np.ndarray, times: float) -> np.ndarray:
    """Squares of windows, (K,), none above so many times the median of its flight: early slips are no effect."""
    most = {flight: times * float(np.median(squares[flights == flight])) for flight in np.unique(flights)}
    return np.minimum(squares, [most[flight] for flight in flights])


def share_left(held_out: HeldOut, fit: Explanation) -> float:
    """Share of the held-out excess chi² that a fit leaves."""
    before, after = held_out.chi2({}), held_out.chi2(fit.values)
    return float(np.clip((after - 1.0) / max(before - 1.0, 1e-9), 0.0, 1.0)) if after > 1.0 else 0.0


def judge_structure(part: Part, before: Part, values: Mapping[Key, float], left: float) -> Leftover:
    """The same for rigs of which no logs without an effect are known: what is left must be large, or follow something.

    How strong a random force would have to be that makes the held-out error is fitted to it: a share of what drives
    each joint. Whatever a rig's state or command predicts of it on stretches that it was not learnt from is no noise.

    Args:
        part: held-out windows.
        before: the same before the fit.
        values: of the fit.
        left: share of the excess chi² that it leaves.
    """
    bench, criteria = part.bench, part.bench.criteria
    shares = tune_gust(bench, part.response, part.residual) * gust_std(bench) / bench.spec.robot.exposure
    found = find_dependence(part, before, values)
    structured = found.share >= criteria.structure and found.kept >= criteria.matters
    sigma = float(found.share / max(1.0 - found.share, 1e-6) * np.sqrt(len(bench.windows)))
    dof = int(np.argmax(shares))
    if shares[dof] < (criteria.noticed if structured else criteria.material):
        return Leftover(Unexplained(False, left, None, [], sigma, float(shares[dof])), None)
    joint = bench.spec.robot.name_dof(dof)
    depends = found.depends_on if found.share >= criteria.depends else []
    return Leftover(
        Unexplained(True, max(left, found.share * found.kept), joint, depends, sigma, float(shares[dof])), found.plot
    )


@dataclass(frozen=True)
class Dependence:
    """What a missing force follows.

    Attributes:
        depends_on: quantities, strongest first.
        share: of the force's variance that the strongest predicts.
        kept: energy of the missing force as a share of what was missing before.
        plot: force against the strongest.
    """

    depends_on: list[str]
    share: float
    kept: float
    plot: WrenchPlot


def find_dependence(part: Part, before: Part, values: Mapping[Key, float]) -> Dependence:
    """Quantities that the missing force follows on stretches of flight other than those it was learnt from."""
    bench = part.bench
    missing, old = (missing_wrench(bench, p.response, p.residual) for p in (part, before))
    dof = int(np.argmax((missing**2).sum(axis=(0, 1)) / np.maximum(gust_std(bench), 1e-30) ** 2))
    force = missing[:, :, dof].ravel()
    fold = np.repeat(blocks_of(bench.windows, bench.criteria.block) % FOLDS, bench.segments)
    quantities = [(label, q.ravel()) for label, q in list_quantities(part, values)]
    swing = find_swing(force, middles_of_segments(bench).ravel(), np.repeat(bench.windows.flight, bench.segments))
    found = [(predicted_share(q, force, fold), label, q) for label, q in (*quantities, swing)]
    # What moves periodically makes everything swing: that must tell clearly more than what moves.
    found.sort(key=lambda item: -item[0] * (1.0 - LESS * (item[2] is swing[1])))
    joint = bench.spec.robot.name_dof(dof)
    unit = "N m" if bench.spec.robot.rotary[dof] else "N"
    share, label, quantity = found[0]
    kept = float(np.clip((missing**2).sum() / max((old**2).sum(), 1e-30), 0.0, 1.0))
    y_label = f"missing {'torque' if unit == 'N m' else 'force'} on {joint} [{unit}]"
    plot = WrenchPlot(quantity, old[:, :, dof].ravel(), force, label, y_label)
    named = [name.split(" [")[0] for part_of_it, name, _ in found if part_of_it > bench.criteria.depends][:3]
    return Dependence(named, share, kept, plot)


def list_quantities(part: Part, values: Mapping[Key, float]) -> list[tuple[str, np.ndarray]]:
    """Quantities that a force may follow, averaged over the gust segments of every window, (K, segments) each.

    Positions and velocities are the measured ones where there are any: the twin, which lacks the force, goes elsewhere.
    """
    bench = part.bench.about(part.track)
    pose, velocity, _ = bench.simulate([bench.without_sensors(Variation(dict(values)))], values)
    model, windows = bench.spec.model, bench.windows
    named: list[tuple[str, np.ndarray]] = []

    def add(label: str, track: np.ndarray, missed: np.ndarray | float = 0.0) -> None:
        pieces = np.array_split(track, bench.segments, axis=1)
        named.append((label, np.stack([piece.mean(axis=1) for piece in pieces], axis=1) + missed))

    rotary, placed = bench.spec.robot.rotary, chart(model, pose[0, :, 1:])
    for dof in range(model.nv):
        joint, unit = bench.spec.robot.name_dof(dof), "rad" if rotary[dof] else "m"
        add(f"{joint} position [{unit}]", placed[..., dof], part.missed_on_average("position", dof))
        add(f"{joint} velocity [{unit}/s]", velocity[0, :, 1:, dof], part.missed_on_average("velocity", dof))
    for i in range(model.nu):
        command = windows.command[:, :, i]
        add(f"command of {model.actuator(i).name}", command)
        add(f"speed of command of {model.actuator(i).name} [1/s]", np.abs(np.gradient(command, windows.dt, axis=1)))
    for i in range(model.nv):
        for j in range(i):
            first, second = (bench.spec.robot.name_dof(d) for d in (j, i))
            add(f"{first} velocity times {second} velocity", velocity[0, :, 1:, i] * velocity[0, :, 1:, j])
    add("time [s]", windows.start[:, None] + windows.dt * np.arange(windows.steps))
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
