"""What the extended twin still misses: how much against no-effect flights, in which channel, what it follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lombscargle

from vpptwin.diagnosis.evidence.bench import Bench, Key, Variation
from vpptwin.diagnosis.judgement.blocks import blocks_of
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.verdict import Unexplained
from vpptwin.diagnosis.judgement.wrench import WrenchPlot, missing_wrench
from vpptwin.diagnosis.search.fits import Fit
from vpptwin.diagnosis.search.likelihood import (
    Likelihood,
    Response,
    couple_gusts,
    gust_std,
    middles_of_segments,
    tune_gust,
)
from vpptwin.diagnosis.search.search import Search

FITTED = 10**6
"""Tells fitted windows of a flight from its held-out ones."""
BINS = (4, 8, 16, 48)
SWINGS, LESS = 4.0, 0.2
"""A force swings at least so often in a log, or it only drifts; share by which it is believed less than a state."""
FOLDS = 4


@dataclass(frozen=True)
class Part:
    """Windows with what a twin misses on them.

    Attributes:
        bench: K windows.
        response: of the twin to starting states and pulses.
        residual: (K, M), build tolerances taken out.
        gust: strength of the gusts that whiten it, in multiples of what is assumed; None for as assumed.
    """

    bench: Bench
    response: Response
    residual: np.ndarray
    gust: np.ndarray | None = None

    @property
    def likelihood(self) -> Likelihood:
        """What whitens it."""
        return couple_gusts(
            self.bench, self.response, np.ones(self.bench.spec.model.nv) if self.gust is None else self.gust
        )

    def squares_of_force(self) -> np.ndarray:
        """Mean square of the innovations of unmodelled force in every window, (K,): 1 for gusts as assumed."""
        return (self.likelihood.innovate(self.response.along(self.residual)) ** 2).mean(axis=1)

    def squares_of_channels(self) -> np.ndarray:
        """Mean square of the whitened residual of every channel in every window, (C, K)."""
        white, found = self.likelihood.whiten(self.residual), []
        for columns in self.bench.columns:
            number = np.maximum(self.bench.valid[:, columns].sum(axis=1), 1)
            found.append((white[:, columns] ** 2).sum(axis=1) / number)
        return np.array(found)

    def missed_on_average(self, kind: str, dof: int) -> np.ndarray:
        """How far a joint's position or velocity was off the twin's in every gust segment, (K, segments).

        Zero where it was not measured.
        """
        segments = self.bench.segments
        for channel, columns in zip(self.bench.channels, self.bench.columns):
            if (channel.kind, channel.axis) == (kind, dof):
                valid = np.array_split(self.bench.valid[:, columns], segments, axis=1)
                missed = np.array_split(self.residual[:, columns], segments, axis=1)
                return np.stack([m.sum(axis=1) / np.maximum(v.sum(axis=1), 1) for m, v in zip(missed, valid)], axis=1)
        return np.zeros((len(self.bench.windows), segments))


@dataclass(frozen=True)
class Leftover:
    """The remainder, what it follows, and the picture of that."""

    unexplained: Unexplained
    plot: WrenchPlot | None


def judge_leftover(held_out: HeldOut, search: Search, fit: Fit) -> Leftover:
    """Compare what is left with flights without effects, flight by flight, fitted or not.

    Unmodelled force is the sharpest measure: whatever pushes the rig must show there. Where it is unremarkable, the
    channel with the largest whitened mean square may still tell of a sensor. `share` is what remains of the force that
    the twin missed before.
    """
    fitted, judged = search.bench.residual(fit.likeliest), held_out.residual(fit.likeliest)
    looser = search.responses.without_dry_friction(fit.frame.floor, fit.values)
    # A stormy day is no effect: gusts are those that the fit found, up to what weather there is.
    blew = np.clip(fit.likelihood.gust, 1.0, search.criteria.storm)
    parts = [
        with_looser_response(Part(search.bench, fit.likelihood.response, fitted, blew), looser),
        with_looser_response(
            Part(held_out.short, held_out.response(fit.values), judged, blew),
            held_out.response(held_out.short.loosen(fit.values)),
        ),
    ]
    before = [
        Part(search.bench, search.start.likelihood.response, search.start.about.missed, blew),
        Part(held_out.short, held_out.response({}), held_out.residual({}), blew),
    ]
    if search.bench.guessed:
        return judge_structure(parts[1], before[1], fit.likeliest, share_left(held_out, fit))
    flights = np.concatenate([part.bench.windows.flight + FITTED * i for i, part in enumerate(parts)])
    names = np.unique(flights)
    criteria = search.criteria
    force = clip_astray(np.concatenate([part.squares_of_force() for part in parts]), flights, criteria.astray)
    rows = np.concatenate([part.squares_of_channels() for part in parts], axis=1)
    channels = np.array([clip_astray(row, flights, criteria.astray) for row in rows])
    levels = np.array([force[flights == name].mean() for name in names])
    errors = np.array([force[flights == name].std() / np.sqrt((flights == name).sum()) for name in names])
    of_channels = np.array([[row[flights == name].mean() for name in names] for row in channels])
    excess = np.concatenate([part.squares_of_force() for part in before]).mean() - criteria.no_effect
    share = float(np.clip((force.mean() - criteria.no_effect) / excess, 0.0, 1.0)) if excess > 0.0 else 0.0
    worst = int(np.argmax(levels))
    sigma = float(max((levels[worst] - criteria.no_effect) / max(errors[worst], 1e-9), 0.0))
    quiet = levels[worst] <= criteria.force_level and of_channels.max() <= criteria.channel_level
    if quiet or (fit.effects and share < criteria.matters):
        return Leftover(Unexplained(False, share, None, [], sigma), None)
    loud, where = np.unravel_index(np.argmax(of_channels), of_channels.shape)
    flight = names[worst if levels[worst] > criteria.force_level else where]
    index = int(flight >= FITTED)
    found = find_dependence(parts[index], before[index], fit.likeliest)
    channel = search.bench.channels[int(loud)].name
    return Leftover(Unexplained(True, share, channel, found.depends_on, sigma), found.plot)


def clip_astray(squares: np.ndarray, flights: np.ndarray, times: float) -> np.ndarray:
    """Squares of windows, (K,), none above so many times the median of its flight: early slips are no effect."""
    most = {flight: times * float(np.median(squares[flights == flight])) for flight in np.unique(flights)}
    return np.minimum(squares, [most[flight] for flight in flights])


def with_looser_response(part: Part, response: Response) -> Part:
    """The part, or the same under another response that leaves less to explain: what sticks in a twin may yield."""
    return min(part, replace(part, response=response), key=lambda p: float(p.squares_of_force().sum()))


def share_left(held_out: HeldOut, fit: Fit) -> float:
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
    loads = bench.spec.robot.loads
    force = np.full(bench.spec.model.nv, np.inf) if loads is None else loads.force
    shares = tune_gust(bench, part.response, part.residual) * gust_std(bench) / force
    found = find_dependence(part, before, values)
    structured = found.share >= criteria.structure and found.kept >= criteria.matters
    sigma = float(found.share / max(1.0 - found.share, 1e-6) * np.sqrt(len(bench.windows)))
    dof = int(np.argmax(shares))
    if shares[dof] < (criteria.noticed if structured else criteria.material):
        return Leftover(Unexplained(False, left, None, [], sigma, float(shares[dof])), None)
    joint = bench.spec.model.joint(int(bench.spec.model.dof_jntid[dof])).name
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
    model = bench.spec.model
    dof = int(np.argmax((missing**2).sum(axis=(0, 1)) / np.maximum(gust_std(bench), 1e-30) ** 2))
    force = missing[:, :, dof].ravel()
    fold = np.repeat(blocks_of(bench.windows, bench.criteria.block) % FOLDS, bench.segments)
    quantities = [*list_quantities(part, values), find_swing(bench, missing[:, :, dof])]
    found = [(predicted_share(q.ravel(), force, fold), label, q) for label, q in quantities]
    # What moves periodically makes everything swing: that must tell clearly more than what moves.
    found.sort(key=lambda item: -item[0] * (1.0 - LESS * (item[2] is quantities[-1][1])))
    joint = model.joint(int(model.dof_jntid[dof])).name
    unit = "N m" if bench.spec.robot.rotary[dof] else "N"
    share, label, quantity = found[0]
    kept = float(np.clip((missing**2).sum() / max((old**2).sum(), 1e-30), 0.0, 1.0))
    y_label = f"missing {'torque' if unit == 'N m' else 'force'} on {joint} [{unit}]"
    plot = WrenchPlot(quantity.ravel(), old[:, :, dof].ravel(), force, label, y_label)
    named = [name.split(" [")[0] for part_of_it, name, _ in found if part_of_it > bench.criteria.depends][:3]
    return Dependence(named, share, kept, plot)


def list_quantities(part: Part, values: Mapping[Key, float]) -> list[tuple[str, np.ndarray]]:
    """Quantities that a force may follow, averaged over the gust segments of every window, (K, segments) each.

    Positions and velocities are the measured ones where there are any: the twin, which lacks the force, goes elsewhere.
    """
    bench = part.bench
    pose, velocity, _ = bench.simulate([bench.without_sensors(Variation(dict(values)))], values)
    model, windows = bench.spec.model, bench.windows
    named: list[tuple[str, np.ndarray]] = []

    def add(label: str, track: np.ndarray, missed: np.ndarray | float = 0.0) -> None:
        pieces = np.array_split(track, bench.segments, axis=1)
        named.append((label, np.stack([piece.mean(axis=1) for piece in pieces], axis=1) + missed))

    rotary = bench.spec.robot.rotary
    for dof in range(model.nv):
        joint, unit = model.joint(int(model.dof_jntid[dof])).name, "rad" if rotary[dof] else "m"
        add(f"{joint} position [{unit}]", pose[0, :, 1:, dof], part.missed_on_average("position", dof))
        add(f"{joint} velocity [{unit}/s]", velocity[0, :, 1:, dof], part.missed_on_average("velocity", dof))
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


def find_swing(bench: Bench, force: np.ndarray) -> tuple[str, np.ndarray]:
    """Phase of the strongest swing of a force (K, segments), which Lomb's and Scargle's periodogram finds, likewise.

    Every log has the frequency of the one in which it stands out most, and swings from its own start on.
    """
    time, windows = middles_of_segments(bench), bench.windows
    best = (-1.0, 0.0)
    for flight in np.unique(windows.flight):
        rows = windows.flight == flight
        at, pushed = time[rows].ravel(), force[rows].ravel() - force[rows].mean()
        slowest = SWINGS / max(float(np.ptp(at)), 1e-9)
        fastest = 0.5 * bench.segments / (windows.steps * windows.dt)
        rates = np.arange(slowest, fastest, slowest / (2.0 * SWINGS))
        if len(rates) and np.any(pushed):
            power = lombscargle(at, pushed, 2.0 * np.pi * rates, normalize=True)
            best = max(best, (float(power.max()), float(rates[np.argmax(power)])))
    phase = time * best[1] % 1.0
    for flight in np.unique(windows.flight):  # each log's swing has a phase of its own
        rows = windows.flight == flight
        turn = np.angle(np.sum(force[rows] * np.exp(-2j * np.pi * phase[rows])))
        phase[rows] = (phase[rows] + turn / (2.0 * np.pi)) % 1.0
    return f"a swing at {best[1]:.2g} Hz [periods]", phase


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
