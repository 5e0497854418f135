"""Parts of an MJCF that lie in each other all along a log: contacts would hold what in truth never touches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.series import Measurements
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import find_meeting
from vpptwin.twin.spec import TwinSpec

DEEP = 0.25
"""Share of the thinner geom's thickness from which on two lie in each other: feet and grasps sink in less."""
MOSTLY = 0.5
"""Share of the log."""
LOOKS = 60
"""Instants that are looked at."""


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
