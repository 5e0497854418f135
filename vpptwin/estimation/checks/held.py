"""Free bodies that something holds or drives which the model lacks: a floor, a hand, commands that nobody logged."""

from __future__ import annotations

from collections.abc import Container, Sequence

import mujoco
import numpy as np

from vpptwin.estimation.checks.frames import BEND, FEWEST, look_up
from vpptwin.estimation.noise import find_spread
from vpptwin.estimation.series import Measurements
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import difference_attitudes
from vpptwin.twin.robot.model import find_free, find_meeting
from vpptwin.twin.spec import TwinSpec

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


def refuse_held(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs of free bodies that something holds or drives which the twin lacks: it would be found as a force.

    Raises:
        InputError: naming the first.
    """
    for log in measurements:
        for body, told in find_held(spec, log):
            raise InputError(
                f"{log.name}: {told}", "the commands of what drives it, and what holds it in the MJCF",
                "log the commands and list them under `actuators`, give the MJCF the floor, or whatever holds it, or "
                f"list {body} under `driven`, so that it follows its log",
            )  # fmt: skip


def find_held(spec: TwinSpec, log: Measurements) -> list[tuple[str, str]]:
    """Free bodies of which `tell_held` says something, and what."""
    found, model = [], spec.model
    for joint in find_free(model):
        dof, name = int(model.jnt_dofadr[joint]), model.body(int(model.jnt_bodyid[joint])).name
        if dof not in log.positions or dof + 3 not in log.attitudes or f"{name}.wind" in spec.effects:
            continue
        track, turned = [log.positions[dof + axis] for axis in range(3)], log.attitudes[dof + 3]
        time = track[0].time
        inside = (time >= log.start) & (time <= log.end)
        pose = np.column_stack([*(series.value for series in track), look_up(time, turned.time, turned.value)])
        told = tell_held(model, joint, spec.robot.signals.actuators, time[inside], pose[inside])
        found += [(name, told)] * bool(told)
    return found


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
    own, dof = model.body_treeid == model.body_treeid[body], int(model.jnt_dofadr[joint])
    tied = model.neq or model.tendon_stiffness.any() or model.tendon_limited.any() or model.body_gravcomp[own].any()
    afloat = model.opt.density > LIQUID or (model.opt.density > 0.0 and model.geom_fluid[:, 0].any())
    if tied or afloat or len(time) < FEWEST:
        return ""
    name, pushes = model.body(body).name, list_pushes(model, actuators)
    idle = not pushes[:, own[model.dof_bodyid]].any()
    lacking = "no commands of what drives it are mapped" if idle else "its commands do not either"
    if strength and not pushes[:, dof : dof + 3].any() and not touches(model, own):
        held = is_held(model, time, pose[:, :3])
        weight = float(model.body_subtreemass[body]) * strength
        if held:
            told = f"{name} does not fall: something bears its weight of {weight:.3g} N for {held:.0%} of the time"
            return f"{told}; nothing in the MJCF does, and {lacking}"
    alone = own[model.dof_bodyid].all() and not model.opt.wind.any()
    gains = count_gains(model, joint, time, pose) if idle and alone else 0
    return f"{name} gains energy {gains} times: something drives it, and {lacking}" if gains >= GAINS else ""


def list_pushes(model: mujoco.MjModel, actuators: Container[str]) -> np.ndarray:
    """What each actuator with a known input pushes by more for an input of one, (n, nv)."""
    data, found = mujoco.MjData(model), [np.zeros(model.nv)]
    mujoco.mj_forward(model, data)
    still = data.qfrc_actuator.copy()
    for i in (i for i in range(model.nu) if model.actuator(i).name in actuators):
        data.ctrl[:] = np.arange(model.nu) == i
        mujoco.mj_forward(model, data)
        found.append(data.qfrc_actuator - still)
    return np.array(found)


def touches(model: mujoco.MjModel, own: np.ndarray) -> bool:
    """Whether some bodies, `own` (nbody,) bool, may touch others."""
    geoms = own[model.geom_bodyid]
    return bool(find_meeting(model)[np.ix_(geoms, ~geoms)].any())


def is_held(model: mujoco.MjModel, time: np.ndarray, place: np.ndarray) -> float:
    """Share of the time in which a body's weight is borne, if it does not fall, nor sink as in a fluid; else 0."""
    gravity = model.opt.gravity
    strength = float(np.linalg.norm(gravity))
    reach = find_reach(time, place)
    force, _ = differentiate(time, place, reach, gravity)
    share = -(force @ gravity) / strength**2
    held = float(np.mean((share > BORNE[0]) & (share < BORNE[1]))) if len(share) >= FEWEST else 0.0
    if held < HELD:
        return 0.0
    sinks, slow = np.ptp(place @ gravity) > DEPTH * strength, max(SLOW, find_reach(time, place, QUIET))
    passive = sinks and is_passive(
        *differentiate(time, place, slow, gravity), np.sqrt(6.0) * find_noise(place) / slow**2
    )
    return 0.0 if passive else held


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
    before, now, after = (look_up(at + late, time, place) for late in (-reach, 0.0, reach))
    return (before - 2.0 * now + after) / reach**2 - gravity, 0.5 * (after - before) / reach


def find_noise(place: np.ndarray) -> float:
    """Noise of places (n, 3) of the noisiest axis, 1 sigma [m]."""
    return max(find_spread(column) for column in place.T)


def is_passive(force: np.ndarray, velocity: np.ndarray, noise: float) -> bool:
    """Whether forces (n, 3) are steady but for a drag, linear and quadratic in velocities (n, 3), and their noise."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    columns = np.stack([(law - law.mean(axis=0)).ravel() for law in (velocity, speed * velocity)], axis=1)
    told = (force - force.mean(axis=0)).ravel()
    left = told - columns @ np.linalg.lstsq(columns, told, rcond=None)[0]
    return bool(np.std(left) < max(PASSIVE * np.std(told), ROUGH * noise))


def count_gains(model: mujoco.MjModel, joint: int, time: np.ndarray, pose: np.ndarray) -> int:
    """How often a free body gained a good part of all the energy that it ever had, kinetic and of its weight."""
    reach = find_reach(time, pose[:, :3])
    at = np.arange(time[0] + reach, time[-1] - reach, reach)
    if len(at) < FEWEST:
        return 0
    before, now, after = (look_up(at + late, time, pose) for late in (-reach, 0.0, reach))
    moved = 0.5 * (after - before)[:, :3] / reach
    turned = 0.5 * difference_attitudes(before[:, 3:], after[:, 3:]) / reach
    energy = measure_energy(model, joint, now, np.column_stack([moved, turned]))
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


def measure_energy(model: mujoco.MjModel, joint: int, pose: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Energy of motion and weight (n,) J of a free body with poses (n, 7) and velocities (n, 6), others at rest."""
    data, q, dof = mujoco.MjData(model), int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    energy = np.zeros(len(pose))
    for i in range(len(pose)):
        data.qpos[q : q + 7], data.qvel[dof : dof + 6] = pose[i], velocity[i]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        energy[i] = data.energy.sum()
    return energy
