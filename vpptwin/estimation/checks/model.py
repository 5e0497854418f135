"""What in an MJCF keeps a rig from moving as it did: joints beyond their range, parts that lie in each other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.series import Measurements
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import HINGE, SLIDE, find_meeting
from vpptwin.twin.spec import TwinSpec

DEEP = 0.25
"""Share of the thinner geom's thickness from which on two lie in each other: feet and grasps sink in less."""
MOSTLY = 0.5
"""Share of the log."""
LOOKS = 60
"""Instants that are looked at."""


BEYOND, OFTEN = 0.1, 0.25
"""Share of its range by which a joint may leave it, and of the log from which on it leaves it by more."""


def refuse_beyond(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs of which simulated joints lie beyond their range for long: stops would hold the twin.

    Raises:
        InputError: naming the joint.
    """
    model = spec.model
    for log, joint in product(measurements, np.flatnonzero(model.jnt_limited)):
        series, (low, high) = log.positions.get(int(model.jnt_dofadr[joint])), model.jnt_range[joint].tolist()
        if series is None or model.jnt_type[joint] not in (HINGE, SLIDE):
            continue
        away = np.maximum(low - series.value, series.value - high) > BEYOND * (high - low)
        if (share := float(np.mean(away))) < OFTEN:
            continue
        rotary = model.jnt_type[joint] == HINGE
        most, unit = float(np.abs(series.value).max()), "rad" if rotary else "m"
        degrees = rotary and most < np.degrees(max(abs(low), abs(high)))
        action = 'write <compiler angle="radian"/>, if the range is in rad' if degrees else "correct the range"
        name = model.joint(int(joint)).name
        found = f"{log.name}: {name} lies beyond its range of {low:.3g} to {high:.3g} {unit} for {share:.0%} of the log"
        object_to(InputError(found, "positions that the MJCF allows", f"{action}, or zero, sign and unit of {name}"))


class Overlap(NamedTuple):
    """Two bodies whose geoms lie in each other: their names, how deep [m], for which share of a log."""

    bodies: tuple[str, str]
    depth: float
    share: float


def refuse_overlap(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse a model of which parts that move against each other lie in each other for most of a log.

    Raises:
        InputError: naming the two bodies.
    """
    for log in measurements if find_meeting(spec.model).any() else ():
        found = find_overlap(spec.model, log)
        if found is not None:
            first, second = found.bodies
            told = f"{log.name}: in the MJCF {first} and {second} lie {1e3 * found.depth:.3g} mm in each other for "
            action = f'write <contact><exclude body1="{first}" body2="{second}"/></contact> into the MJCF'
            object_to(InputError(f"{told}{found.share:.0%} of the log", "parts that touch at most", action))


def find_overlap(model: mujoco.MjModel, log: Measurements) -> Overlap | None:
    """The two bodies that lie in each other for most of a log, and deepest; None where none do."""
    pose, _ = estimate_states(log, np.linspace(log.start, log.end, LOOKS), model, False)
    data, depths = mujoco.MjData(model), dict[tuple[int, int], list[float]]()
    open_ended = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    thick = np.where(np.isin(model.geom_type, open_ended), np.nan, 2.0 * model.geom_aabb[:, 3:].min(axis=1))
    for place in pose:
        data.qpos[:] = place
        mujoco.mj_fwdPosition(model, data)
        now = dict[tuple[int, int], float]()
        for contact in data.contact:
            if -contact.dist > DEEP * thick[contact.geom].min():  # never of grounds, whose thickness is no number
                first, second = sorted(model.geom_bodyid[contact.geom].tolist())
                now[first, second] = max(now.get((first, second), 0.0), float(-contact.dist))
        for pair, depth in now.items():
            depths.setdefault(pair, []).append(depth)
    often = {pair: each for pair, each in depths.items() if len(each) > MOSTLY * LOOKS}
    if not often:
        return None
    pair = max(often, key=lambda each: float(np.median(often[each])))
    names = model.body(pair[0]).name, model.body(pair[1]).name
    return Overlap(names, float(np.median(often[pair])), len(often[pair]) / LOOKS)
