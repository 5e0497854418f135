"""What bears a body that its model lets fall: a floor, a hand, a drive whose commands nobody logged.

Before and after a flight it stands, which is cut from the log. What is held or driven all the time is told.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

import mujoco
import numpy as np

from vpptwin.estimation.checks.orientation import BEND, MIN_STEPS
from vpptwin.estimation.noise import find_spread
from vpptwin.estimation.series import Measurements, Series, interpolate
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import FREE, difference_attitudes
from vpptwin.twin.robot.model import find_free, find_meeting
from vpptwin.twin.spec import TwinSpec

STILL, STOOD = 0.5, 2e-3
"""Whoever moves by less than this [m] in the first or last so many seconds stands there."""
CLEARANCE = 0.05
"""It flies as soon as it is so far above there [m]: clear of its feet, though not of the cushion under it."""

ROUGHEST, QUIET = 2.0, 0.1
"""Noise that forces by mass may have [m/s²]: to see a weight, and to see what drives."""
SLOW = 0.25
"""Forces that are looked at for what a fluid makes of them are means over this time before and after [s]."""
BORNE, HELD = (0.5, 1.5), 0.6
"""Shares of its weight by which a body is held, and of the time from which on it does not fall."""
DEPTH, PASSIVE, ROUGH = 0.05, 0.5, 1.5
"""What rises or sinks by more [m] may be borne by a fluid, if its drag leaves less than this share of how forces vary
(as an amplitude), or no more than so many times their noise."""
LIQUID = 100.0
"""Density of a medium [kg/m³] that may bear what is in it."""
BOUNCE, GAIN, GAINS = 0.5, 0.25, 3
"""Energy that comes back within so long [s] was a contact's; what gains this share of all that it ever has so often is
driven: a hand throws once."""


def find_flown(
    model: mujoco.MjModel, positions: Mapping[int, Series], start: float, end: float
) -> tuple[float, float, list[str]]:
    """Span in which every body that can fall and touches nothing flies [s], and what is said of the rest, in one line.

    Args:
        model: of the rig; where such a body may touch something, nothing is left out.
        positions: degree of freedom → position.
        start: from when on everything needed is there [s].
        end: until when [s].
    """
    first, last, strength = start, end, max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
    for joint in range(model.njnt):
        dof, body = int(model.jnt_dofadr[joint]), int(model.jnt_bodyid[joint])
        axes = 3 if model.jnt_type[joint] == FREE else int(slides_down(model, joint))
        geoms = model.body_treeid[model.geom_bodyid] == model.body_treeid[body]
        if not axes or dof not in positions or (model.geom_contype[geoms] | model.geom_conaffinity[geoms]).any():
            continue
        track = [positions[dof + axis] for axis in range(axes)]
        time = track[0].time[(track[0].time >= start) & (track[0].time <= end)]
        if len(time) < 3:
            continue
        place = np.stack([np.interp(time, series.time, series.value) for series in track], axis=1)
        clear = np.ones(len(time), dtype=bool)
        for rows in (time <= start + STILL, time >= end - STILL):
            stood = np.median(place[rows], axis=0)
            away = np.abs((place - stood) @ (model.opt.gravity / strength if axes == 3 else np.ones(1)))
            if (np.linalg.norm(place[rows] - stood, axis=1) < STOOD).all():
                clear &= away > CLEARANCE
        edges = np.flatnonzero(np.diff(clear, prepend=False, append=False)).reshape(-1, 2)  # of runs; one hops, bounces
        aloft = edges[time[edges[:, 1] - 1] - time[edges[:, 0]] > STILL]
        if len(aloft):  # whoever comes by that height again, as from a hover, flies on
            begin, stop = aloft[0, 0], aloft[-1, 1]
            first = max(first, float(time[begin])) if begin else first
            last = min(last, float(time[stop - 1])) if stop < len(time) else last
    if (first == start and last == end) or last <= first:
        return start, end, []
    cut = [f"the first {first - start:.1f} s"] * (first > start) + [f"the last {end - last:.1f} s"] * (last < end)
    return first, last, [f"{' and '.join(cut)} are left out: it is still there, and the MJCF has nothing to stand on"]


def slides_down(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint is a slide along gravity on which nothing but actuators and constraints hold a body."""
    dof, gravity = model.jnt_dofadr[joint], model.opt.gravity
    held = model.dof_frictionloss[dof] or model.jnt_stiffness[joint] or model.jnt_limited[joint]
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and not model.body_parentid[model.jnt_bodyid[joint]]
    return bool(slide and not held and abs(model.jnt_axis[joint] @ gravity) > 0.9 * np.linalg.norm(gravity) > 0.0)


def refuse_held(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs of free bodies that something holds or drives which the twin lacks: it would be found as a force.

    Raises:
        InputError: naming the first.
    """
    for log in measurements:
        for body, text in find_held(spec, log):
            raise InputError(
                f"{log.name}: {text}", "the commands of what drives it, and what holds it in the MJCF",
                "log the commands and list them under `actuators`, give the MJCF the floor, or whatever holds it, or "
                f"list {body} under `driven`, so that it follows its log",
            )  # fmt: skip


def find_held(spec: TwinSpec, log: Measurements) -> list[tuple[str, str]]:
    """Free bodies of which `tell_held` says something, and what."""
    held, model = [], spec.model
    for joint in find_free(model):
        dof, name = int(model.jnt_dofadr[joint]), model.body(int(model.jnt_bodyid[joint])).name
        if dof not in log.positions or dof + 3 not in log.attitudes or f"{name}.wind" in spec.effects:
            continue
        track, turned = [log.positions[dof + axis] for axis in range(3)], log.attitudes[dof + 3]
        time = track[0].time
        inside = (time >= log.start) & (time <= log.end)
        pose = np.column_stack([*(series.value for series in track), interpolate(time, turned.time, turned.value)])
        text = tell_held(model, joint, spec.robot.signals.actuators, time[inside], pose[inside])
        held += [(name, text)] * bool(text)
    return held


def tell_held(
    model: mujoco.MjModel, joint: int, actuators: Container[str], time: np.ndarray, pose: np.ndarray
) -> str:  # fmt: skip
    """That a free body does not fall though nothing in the model holds it, or gains energy that nothing gives; or "".

    What sinks or rises as if a fluid bore it is left alone: drag, and a steady force, are effects.

    Args:
        model: of the rig.
        joint: of the body.
        actuators: those whose inputs are known.
        time: of poses (n,) s.
        pose: position and attitude w, x, y, z, (n, 7).
    """
    body, strength = int(model.jnt_bodyid[joint]), float(np.linalg.norm(model.opt.gravity))
    tree, dof = model.body_treeid == model.body_treeid[body], int(model.jnt_dofadr[joint])
    tied = model.neq or model.tendon_stiffness.any() or model.tendon_limited.any() or model.body_gravcomp[tree].any()
    afloat = model.opt.density > LIQUID or (model.opt.density > 0.0 and model.geom_fluid[:, 0].any())
    if tied or afloat or len(time) < MIN_STEPS:
        return ""
    name, pushes = model.body(body).name, list_pushes(model, actuators)
    idle = not pushes[:, tree[model.dof_bodyid]].any()
    lacking = "no commands of what drives it are mapped" if idle else "its commands do not either"
    geoms = tree[model.geom_bodyid]
    free = strength and not pushes[:, dof : dof + 3].any() and not find_meeting(model)[np.ix_(geoms, ~geoms)].any()
    if free and (held := measure_held(model, time, pose[:, :3])):
        weight = float(model.body_subtreemass[body]) * strength
        text = f"{name} does not fall: something bears its weight of {weight:.3g} N for {held:.0%} of the time"
        return f"{text}; nothing in the MJCF does, and {lacking}"
    alone = tree[model.dof_bodyid].all() and not model.opt.wind.any()
    gains = count_gains(model, joint, time, pose) if idle and alone else 0
    return f"{name} gains energy {gains} times: something drives it, and {lacking}" if gains >= GAINS else ""


def list_pushes(model: mujoco.MjModel, actuators: Container[str]) -> np.ndarray:
    """What each actuator with a known input pushes by more for an input of one, (n, nv)."""
    data, pushes = mujoco.MjData(model), [np.zeros(model.nv)]
    mujoco.mj_forward(model, data)
    still = data.qfrc_actuator.copy()
    for i in (i for i in range(model.nu) if model.actuator(i).name in actuators):
        data.ctrl[:] = np.arange(model.nu) == i
        mujoco.mj_forward(model, data)
        pushes.append(data.qfrc_actuator - still)
    return np.array(pushes)


def measure_held(model: mujoco.MjModel, time: np.ndarray, place: np.ndarray) -> float:
    """Share of the time in which a body's weight is borne, if it does not fall, nor sink as in a fluid; else 0."""
    gravity = model.opt.gravity
    strength = float(np.linalg.norm(gravity))
    force, _ = differentiate(time, place, find_reach(time, place), gravity)
    share = -(force @ gravity) / strength**2
    held = float(np.mean((share > BORNE[0]) & (share < BORNE[1]))) if len(share) >= MIN_STEPS else 0.0
    if held < HELD:
        return 0.0
    if np.ptp(place @ gravity) > DEPTH * strength:
        slow = max(SLOW, find_reach(time, place, QUIET))
        force, velocity = differentiate(time, place, slow, gravity)
        # Steady but for a drag, F = F₀ - c₁ v - c₂ |v| v, and the noise of a second difference, √6 σ / h²?
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        laws = np.stack([(law - law.mean(axis=0)).ravel() for law in (velocity, speed * velocity)], axis=1)
        varied = (force - force.mean(axis=0)).ravel()
        residual = varied - laws @ np.linalg.lstsq(laws, varied, rcond=None)[0]
        noise = np.sqrt(6.0) * find_noise(place) / slow**2
        if np.std(residual) < max(PASSIVE * np.std(varied), ROUGH * noise):
            return 0.0
    return held


def find_reach(time: np.ndarray, place: np.ndarray, noise: float = ROUGHEST) -> float:
    """Over which time places (n, 3) show accelerations, between their samples and with no more than that noise [s]."""
    needed = float(np.sqrt(np.sqrt(6.0) * find_noise(place) / noise))
    return max(BEND, 2.0 * float(np.median(np.diff(time))), min(needed, float(time[-1] - time[0]) / 10.0))


def differentiate(
    time: np.ndarray, place: np.ndarray, reach: float, gravity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Force by mass besides weight, and velocity, from places (n, 3) `reach` [s] before and after, every so often."""
    at = np.arange(time[0] + reach, time[-1] - reach, min(reach, SLOW))
    ahead = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    at = at[time[ahead] - time[ahead - 1] < reach]  # no motion is read off a gap
    before, now, after = (interpolate(at + late, time, place) for late in (-reach, 0.0, reach))
    return (before - 2.0 * now + after) / reach**2 - gravity, 0.5 * (after - before) / reach


def find_noise(place: np.ndarray) -> float:
    """Noise of places (n, 3) of the noisiest axis, 1 sigma [m]."""
    return max(find_spread(column) for column in place.T)


def count_gains(model: mujoco.MjModel, joint: int, time: np.ndarray, pose: np.ndarray) -> int:
    """How often a free body gained a good part of all the energy that it ever had, kinetic and of its weight."""
    reach = find_reach(time, pose[:, :3])
    at = np.arange(time[0] + reach, time[-1] - reach, reach)
    if len(at) < MIN_STEPS:
        return 0
    before, now, after = (interpolate(at + late, time, pose) for late in (-reach, 0.0, reach))
    moved = 0.5 * (after - before)[:, :3] / reach
    turned = 0.5 * difference_attitudes(before[:, 3:], after[:, 3:]) / reach
    energy, data = np.zeros(len(at)), mujoco.MjData(model)
    q, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    for i in range(len(at)):  # all other bodies at rest
        data.qpos[q : q + 7], data.qvel[dof : dof + 3], data.qvel[dof + 3 : dof + 6] = now[i], moved[i], turned[i]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        energy[i] = data.energy.sum()
    width = round(BOUNCE / reach)
    energy = np.array([energy[max(i - width, 0) : i + width + 1].max() for i in range(len(energy))])
    mass = float(model.body_subtreemass[model.jnt_bodyid[joint]])
    fastest = float(np.linalg.norm(moved, axis=1).max())
    rough = 10.0 * mass * fastest * find_noise(pose[:, :3]) / reach  # what noise of velocities makes
    gain, gains, turn, rising = max(GAIN * float(np.ptp(energy)), rough), 0, energy[0], False
    for value in energy:
        turn = max(turn, value) if rising else min(turn, value)
        if abs(value - turn) > gain:
            gains, turn, rising = gains + (not rising), value, not rising
    return gains
