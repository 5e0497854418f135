"""The measurements of a rig that is not the drone: joint states and control inputs named by the twin's `signals`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vpptwin.estimation.checks.orientation import (
    RateSource,
    find_rate_source,
    find_spatial,
    turn_from_site,
    turn_rates_to_body,
    vet_pushes,
    vet_turns,
)
from vpptwin.estimation.checks.support import find_flown, find_held
from vpptwin.estimation.checks.turns import TURN, follow_turns, measure_counter, unwrap_turns
from vpptwin.estimation.checks.units import vet_joint, vet_rates, vet_travel
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.estimation.gaps import tell_cut, tell_gaps
from vpptwin.estimation.initial import choose_span
from vpptwin.estimation.noise import MIN_SAMPLES, estimate_noise, find_spread
from vpptwin.estimation.outliers import clean_series
from vpptwin.estimation.series import Measurements, Series, align_rates, integrate, interpolate
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.actuation import INTEGRATES, integrate_input, tell_control
from vpptwin.twin.robot.manifold import BALL, FREE, difference_attitudes, follow_sign, multiply_attitudes, turn_to_world
from vpptwin.twin.robot.model import HINGE, is_indifferent
from vpptwin.twin.robot.signals import Tracked, find_base, turn_from_parent
from vpptwin.twin.spec import TwinSpec

POSITION_SHARE, VELOCITY_SHARE = 0.003, 0.02
"""Shares of its range below which a joint's logged position and velocity are not believed."""
SPANS = (0.02, 0.25)
"""Over which times [s] positions are compared with what velocities integrate to."""
EXPLAINED, LATEST = 0.5, 0.1
"""Share of a disagreement from which on lateness is its reason; the latest that a stream may be [s]."""
WHEEL = (
    "joint {}: only its velocity is logged; its position is the integral from 0 on, and nothing in the MJCF depends "
    "on it"
)
TARGET = "{}: {} of {} targets are taken whole turns from where they were logged, on the turn that its joint is on"
DRIFT = 1.0
"""Such a position is known to what its velocity's noise would make of it in so long, were it all bias [s]."""


def read_joints(spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of another rig: the joint states, poses and control inputs that the twin's `signals` name."""
    signals, kinds = spec.robot.signals, spec.model.jnt_type
    read = Collected(warnings=vet_travel(spec.model, signals, flight))
    for each in spec.robot.tracked:
        if kinds[each.joint] in (FREE, BALL):
            read_body(spec, flight, each, read)
        else:
            read_joint(spec, flight, each, read)
        read.lead([int(dof) for dof in spec.robot.driven if spec.model.dof_jntid[dof] == each.joint])
    command = read_efforts(spec, flight, signals.actuators, read)
    spans = read.spans | ({"commands": (float(command.time[0]), float(command.time[-1]))} if signals.actuators else {})
    start, end = max(first for first, _ in spans.values()), min(last for _, last in spans.values())
    start, end, warnings = find_flown(spec.model, read.positions, start, end)
    measurements = Measurements(
        flight.name, read.positions, read.velocities, None, command, None, (), start, end, read.driven,
        attitudes=read.attitudes,
    )  # fmt: skip
    for each in spec.robot.tracked:
        if kinds[each.joint] == FREE and not each.led:
            vet_pushes(spec, flight, each, measurements)
    warnings += [f"{line}; such a force is not a candidate" for _, line in find_held(spec, measurements)]
    return replace(measurements, warnings=(*read.warnings, *warnings, *tell_cut(spans), *tell_gaps(measurements)))


@dataclass
class Collected:
    """What was read so far, as `Measurements` has it, and from when to when each stream goes [s]."""

    positions: dict[int, Series] = field(default_factory=dict)
    velocities: dict[int, Series] = field(default_factory=dict)
    attitudes: dict[int, Series] = field(default_factory=dict)
    driven: dict[int, Series] = field(default_factory=dict)
    spans: dict[str, tuple[float, float]] = field(default_factory=dict)
    turned: dict[int, float] = field(default_factory=dict)  # degree of freedom that was unwrapped → its turn [rad, m]
    warnings: list[str] = field(default_factory=list)

    def add(self, dof: int, tracks: tuple[Series, Series | None], label: str) -> None:
        """Position and velocity of a degree of freedom, without their spikes."""
        for kept, series, what in zip((self.positions, self.velocities), tracks, ("position", "velocity")):
            if series is not None:
                kept[dof], warnings = clean_series(series, f"{label}: {what}")
                self.warnings += warnings

    def lead(self, dofs: list[int]) -> None:
        """Have degrees of freedom follow what was read of them, those of a body smoothed by as much as its noise."""
        turns = [first for first in self.attitudes if first in dofs]
        for dof in dofs:
            track = self.positions.pop(dof)
            self.velocities.pop(dof, None)
            if not any(first <= dof < first + 3 for first in turns):
                self.driven[dof] = smooth_series(track) if turns else track
        for first in turns:
            self.driven[first] = smooth_series(self.attitudes.pop(first))


def smooth_series(series: Series) -> Series:
    """A series (n,) or (n, k) on smoothing splines whose residual is the noise that each column shows: Σ r² = n σ²."""
    from scipy.interpolate import splev, splrep  # which few rigs wait for

    time, columns = series.time, series.value.reshape(len(series.time), -1).T
    smooth = [splev(time, splrep(time, column, s=len(time) * find_spread(column) ** 2)) for column in columns]
    return replace(series, value=np.stack(smooth, axis=1).reshape(series.value.shape))


def read_joint(spec: TwinSpec, flight: Flight, tracked: Tracked, read: Collected) -> None:
    """Position and, where logged, velocity of a hinge or slide.

    Raises:
        InputError: if the log has no position of it.
    """
    joint, topic = tracked.name, tracked.topic
    dof, label = int(spec.model.jnt_dofadr[tracked.joint]), f"{topic} {joint}"
    rotary = bool(spec.robot.rotary[dof])
    logged = find_joint(flight, topic, joint)
    whole, unwrapped = straighten_joint(spec.model, tracked, logged)
    stream, unsound = vet_joint(whole, label)
    read.warnings += [*unwrapped, *unsound]
    if whole is not logged and "position" in logged.values:
        read.turned[dof] = TURN if rotary else measure_counter(logged.time, logged["position"])
    if "position" not in stream.values:
        raise InputError(
            f"{flight.path}: {topic} has no position of joint {joint!r}",
            "it: velocities alone are enough for wheels only",
            "record it",
        )
    read.spans[label] = (float(stream.time[0]), float(stream.time[-1]))
    position, velocity = read_track(stream, joint, rotary)
    if "position" not in logged.values and velocity is not None:
        position = replace(position, std=DRIFT * velocity.std)
    read.add(dof, (position, velocity), label)
    span = choose_span(read.positions[dof], read.velocities.get(dof))
    read.positions[dof] = replace(read.positions[dof], span=span)


def read_track(stream: Stream, name: str, rotary: bool) -> tuple[Series, Series | None]:
    """Position and, where logged, velocity of one degree of freedom, with the noise that they show."""
    length, unit = ("rad", "rad/s") if rotary else ("m", "m/s")
    late, apart = compare_streams(stream)
    ahead, behind = max(-late, 0.0), max(late, 0.0)
    # The one that runs behind was filtered: what is still apart is its fault.
    of_position, of_velocity = (None if late > 0.0 else apart), (None if late < 0.0 or apart is None else apart)
    widest = TURN if rotary else np.inf
    noise = estimate_noise(stream.time, stream["position"], POSITION_SHARE, of_position, widest)
    position = Series(name, length, stream.time - ahead, stream["position"], noise, white=False, late=ahead)
    if "velocity" not in stream.values:
        return position, None
    noise = estimate_noise(stream.time, stream["velocity"], VELOCITY_SHARE, of_velocity and of_velocity / SPANS[1])
    return position, Series(
        f"{name} rate", unit, stream.time - behind, stream["velocity"], noise, white=False, late=behind
    )


def read_body(spec: TwinSpec, flight: Flight, tracked: Tracked, read: Collected) -> None:
    """Attitude, of a free body also position, and their rates, from its pose and from an IMU on it.

    Raises:
        InputError: if the log has no such poses.
    """
    model, joint, label = spec.model, tracked.joint, f"{tracked.topic} {tracked.name}"
    free = int(model.jnt_type[joint]) == FREE
    pose = find_spatial(flight, tracked.topic, *["position"] * free, "attitude")
    time, dof, attitude = pose.time, int(model.jnt_dofadr[joint]), follow_sign(pose["attitude"])
    pose = Stream(time, pose.values | {"attitude": attitude})
    read.spans[label] = (float(time[0]), float(time[-1]))
    source = find_rate_source(spec, flight, tracked, pose)
    imu = source if source is not None and source.imu else None
    if imu is not None:
        clock = imu.stream.time
        read.spans[f"{spec.robot.signals.sites[imu.name]} {imu.name}"] = (float(clock[0]), float(clock[-1]))
    rates = None if source is None else read_rates(spec, flight, tracked, pose, source)
    linear = {}
    if free:
        linear["position"] = pose["position"]
        if "velocity" in pose.values:  # of a body in its own axes, as Odometry has it
            linear["velocity"] = turn_to_world(attitude, pose["velocity"])
    else:
        attitude = turn_from_parent(model, tracked, attitude)
    steps = difference_attitudes(attitude[:-1], attitude[1:])
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    angular = {"position": turned}
    if rates is not None:
        rate = interpolate(time, rates.time, rates["rate"])
        aligned = align_rates(time, turned, rate)
        vet_rates(f"{flight.path}: rates of {tracked.name}", time, turned, rate, aligned)
        angular["velocity"] = rate if imu is None else aligned  # how noisy it is, not how it is mounted
    turn = dof + 3 if free else dof
    for first, columns in ((dof, linear), (turn, angular)):
        for axis in range(3) if columns else ():
            track = Stream(time, {name: values[:, axis] for name, values in columns.items()})
            read.add(first + axis, read_track(track, spec.robot.name_dof(first + axis), first == turn), label)
        for kept in (read.positions, read.velocities):
            # Axes that never change, as of a body that rolls on a floor, are believed no more than those that do.
            axes = [axis for axis in range(first, first + 3) if axis in kept]
            most = max((kept[axis].std for axis in axes), default=0.0)
            kept |= {axis: replace(kept[axis], std=most) for axis in axes if np.ptp(kept[axis].value) == 0.0}
    for axis in range(3):
        rate_seen = read.velocities.get(turn + axis)
        if imu is not None and rates is not None and rate_seen is not None:
            whole = rates["rate"][:, axis]
            read.velocities[turn + axis] = replace(rate_seen, time=rates.time, value=whole, late=0.0)
    turns = [read.positions[turn + axis] for axis in range(3)]
    std = float(np.sqrt(np.mean([series.std**2 for series in turns])))
    moved = time  # that poses run behind the gyro is for a diagnosis to say, as they do whole
    if imu is None:
        moved = time - float(np.mean([time[0] - series.time[0] for series in turns]))
    read.attitudes[turn] = Series(f"{tracked.name} attitude", "rad", moved, attitude, std, white=False)
    for axis in range(3):  # all three or none: a spike in one is one in the attitude
        late = float(time[0] - moved[0])
        read.positions[turn + axis] = replace(turns[axis], time=moved, value=turned[:, axis], std=std, late=late)


def read_rates(spec: TwinSpec, flight: Flight, tracked: Tracked, pose: Stream, source: RateSource) -> Stream:
    """Rates about a body's axes, (n, 3) rad/s.

    Raises:
        InputError: if they and its attitudes turn alike only when either is read otherwise.
    """
    time, rate = source.stream.time, source.stream["rate"]
    if source.imu and source.frame == "body":
        rate = turn_from_site(spec, source.name, rate)
    vet_turns(spec, str(flight.path), tracked, pose, source, rate)
    attitude = multiply_attitudes(find_base(spec.model, tracked), interpolate(time, pose.time, pose["attitude"]))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return Stream(time, {"rate": turn_rates_to_body(attitude, rate, source.frame)})


def read_efforts(spec: TwinSpec, flight: Flight, actuators: dict[str, str], read: Collected) -> Series:
    """Control inputs of all actuators, (n, nu), held between samples; unlogged ones stay at zero, nu may be 0.

    Those of an integrator are integrated from where its joint is `read` first.
    """
    streams = {name: find_joint(flight, topic, name) for name, topic in actuators.items()}
    if not streams:
        if spec.model.nu:
            read.warnings.append("no actuator of the MJCF has a signal: all inputs stay at zero")
        return Series("control", "", np.array([0.0, flight.duration]), np.zeros((2, spec.model.nu)), 0.0)
    time = np.unique(np.concatenate([s.time for s in streams.values()]))
    time = time[time >= max(s.time[0] for s in streams.values())]
    value = np.zeros((len(time), spec.model.nu))
    for name, stream in streams.items():
        if (column := find_input(stream)) == "":
            raise InputError(
                f"{flight.path}: {actuators[name]} has {' and '.join(stream.values) or 'nothing'} of actuator {name!r}",
                "`effort`, its control input, or one of position and velocity, its target",
                "record it or correct `signals`",
            )
        held, index = np.searchsorted(stream.time, time, side="right") - 1, spec.model.actuator(name).id
        value[:, index] = straighten_targets(spec, index, stream, column, read)[held]
        if (noted := spec.model.actuator_dynprm[index])[INTEGRATES]:
            dof = int(spec.model.jnt_dofadr[spec.model.actuator_trnid[index, 0]])
            track = (read.positions | read.driven)[dof]
            start = float(spec.model.actuator_gear[index, 0] * np.interp(time[0], track.time, track.value))
            value[:, index] = integrate_input(noted, time, value[:, index], start)
    return Series("control", "", time, value, 0.0)


def find_input(stream: Stream) -> str:
    """Which column of an actuator's stream is its control input: `effort`, or the only one, a target; else ""."""
    columns = list(stream.values)
    return "effort" if "effort" in columns else columns[0] if len(columns) == 1 else ""


def find_joint(flight: Flight, topic: str, name: str) -> Stream:
    """The stream of a joint or actuator on a JointState topic."""
    joints = flight.joints.get(topic)
    if joints is None:
        known = ", ".join(flight.joints) or "no JointState topic at all"
        raise InputError(f"{flight.path}: no topic {topic}", f"it in the log, which has {known}", "correct `signals`")
    if name not in joints:
        raise InputError(f"{flight.path}: {topic} has no {name!r}", f"one of {', '.join(joints)}", "correct `signals`")
    return joints[name]


def straighten_joint(model: mujoco.MjModel, tracked: Tracked, stream: Stream) -> tuple[Stream, list[str]]:
    """The stream of a hinge or slide; of one that turns on its angle does, too, and a warning tells that.

    One that was logged by its velocity alone is where that leads, if nothing depends on where that is.
    """
    joint, values = tracked.joint, stream.values
    if "position" not in values and "velocity" in values and is_indifferent(model, joint):
        known, led = np.isfinite(values["velocity"]), np.full(len(stream), np.nan)
        led[known] = integrate(values["velocity"][known], stream.time[known])
        return Stream(stream.time, {"position": led, **values}), [WHEEL.format(tracked.name)]
    label, rotary = f"{tracked.topic} {tracked.name}", bool(model.jnt_type[joint] == HINGE)
    return unwrap_turns(stream, label, find_limits(model, joint), rotary)


def find_limits(model: mujoco.MjModel, joint: int) -> np.ndarray | None:
    """Between which a hinge or slide can be, (2,); None for one without limits."""
    return model.jnt_range[joint] if model.jnt_limited[joint] else None


def straighten_targets(spec: TwinSpec, actuator: int, target: Stream, column: str, read: Collected) -> np.ndarray:
    """Inputs (n,) of an actuator, those of a position servo on the turn that its joint is on, which is told."""
    model, logged, gear = spec.model, target[column], float(spec.model.actuator_gear[actuator, 0])
    joint = find_driven_joint(model, actuator)
    if tell_control(model, actuator) != "position" or joint is None or not gear:
        return logged
    dof = int(model.jnt_dofadr[joint])
    turn = abs(gear) * read.turned.get(dof, TURN if model.jnt_type[joint] == HINGE else 0.0)
    track, limits = (read.positions | read.driven).get(dof), find_limits(model, joint)
    if not turn or track is None:
        return logged
    limits = None if limits is None else np.sort(gear * limits)
    followed = follow_turns((target.time, logged), (track.time, gear * track.value), limits, turn, dof in read.turned)
    if changed := np.count_nonzero(followed != logged):
        read.warnings.append(TARGET.format(model.actuator(actuator).name, changed, len(logged)))
    return followed


def compare_streams(stream: Stream) -> tuple[float, float | None]:
    """By how much a joint's velocity runs behind its position [s], and how far they are apart otherwise [m, rad].

    What was low-passed or is late integrates to a position short of the other by that time's worth of velocity; less
    than none where the position runs behind. It is 0 where it explains less than `EXPLAINED` of how far the position
    strays from what the velocity integrates to within `SPANS[1]`. What strays as far within `SPANS[0]` is noise. How
    far they are apart is None without velocities.
    """
    if "velocity" not in stream.values or len(stream) < MIN_SAMPLES:
        return 0.0, None
    time, velocity = stream.time, stream["velocity"]
    apart = integrate(velocity, time) - stream["position"]
    steps = [max(round(span / float(np.median(np.diff(time)))), 1) for span in SPANS]

    def stray(apart: np.ndarray) -> float:
        near, far = (float(np.median(np.abs(apart[n:] - apart[:-n]))) if n < len(apart) else 0.0 for n in steps)
        return float(np.sqrt(max(far**2 - near**2, 0.0))) / 0.6745 / np.sqrt(2.0)

    grown, moved = (track[steps[1] :] - track[: -steps[1]] for track in (apart, velocity))
    late = -float(grown @ moved) / max(float(moved @ moved), 1e-300)
    before, after = stray(apart), stray(apart + late * velocity)
    if abs(late) > LATEST or after > (1.0 - EXPLAINED) * before:
        return 0.0, before
    return late, after
