"""When a rig strikes something: an end stop, the floor, a wall. No twin tells how it rebounds, no slope leads there.

What a window that holds a blow misses is hundreds of times the noise, whatever the twin, and differs from hypothesis
to hypothesis by more than all other windows together.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import mujoco
import numpy as np

from vpptwin.estimation.gaps import LOOK_BACK, touch
from vpptwin.estimation.series import Measurements

STEP, SPAN = 0.01, 3
"""Poses are looked at so often [s]; how fast they change is told over so many steps, and so long a blow is felt."""
NEAR = 0.03
"""Share of the rig's extent within which bodies are looked at: none moves farther in a step."""
VISIBLE = 5.0
"""Standard deviations by which a distance must change over `SPAN`: what rests on something does not strike it."""
RARE = 0.25
"""Share of windows at most: who strikes something in more of them moves like that."""
LIMIT = mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
SIDES = (LIMIT, mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)


def mark_strikes(model: mujoco.MjModel, measured: Measurements, window: float = 1.0) -> Measurements:
    """The measurements with the spans in which the rig strikes something, and a warning of them; windows in s."""
    strikes, warnings, blows = find_strikes(model, measured, window)
    if len(strikes) or len(blows):  # what strikes something no span foretells, and the shortest gets over it first
        measured = measured.in_eights()
    return replace(measured, strikes=strikes, blows=blows, warnings=(*measured.warnings, *warnings))


def find_strikes(
    model: mujoco.MjModel, measured: Measurements, window: float = 1.0
) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Spans in which a rig of hinges and slides strikes something, (n, 2) s, what is said of that, and blows.

    It does where it would be inside of something a step on, if it went on, or had come, as its poses tell. Spans, and
    the line about them, are empty where it does so all the time; blows are those between geoms, whatever their share.

    Args:
        model: that has the end stops, and the geoms that collide.
        measured: positions of all its joints; where one is not known nothing is found.
        window: of windows that they spoil [s].
    """
    none = np.zeros((0, 2))
    tracks = measured.positions | measured.driven
    solid = model.jnt_limited.any() or (model.geom_contype.any() and model.geom_conaffinity.any()) or model.npair
    if not solid or model.nq != model.nv or set(tracks) != set(range(model.nv)):
        return none, [], none
    time = np.arange(measured.start, measured.end, STEP)
    pose = np.stack([np.interp(time, tracks[dof].time, tracks[dof].value) for dof in range(model.nv)], axis=1)
    struck = find_struck(model, pose, np.array([tracks[dof].std for dof in range(model.nv)]))
    spans = join_rows(time, list(struck))
    blows = join_rows(time, [row for row, sides in struck.items() if any(sides.values())])
    starts = np.arange(measured.start + LOOK_BACK, measured.end - window, STEP)
    if not len(spans) or not len(starts) or touch(spans, starts - LOOK_BACK, starts + window).mean() > RARE:
        return none, [], blows
    what, when = sorted(set().union(*struck.values())), ", ".join(f"{begin + SPAN * STEP:.1f}" for begin in spans[:, 0])
    return spans, [f"impacts on {', '.join(what)} at {when} s: windows there are left out"], blows


def join_rows(time: np.ndarray, rows: Sequence[int]) -> np.ndarray:
    """Rows of poses at `time` (T,) s as spans, those near each other as one, (n, 2) s."""
    runs = np.split(time[rows], np.flatnonzero(np.diff(rows) > 2 * SPAN) + 1) if rows else []
    return np.array([(run[0] - SPAN * STEP, run[-1] + SPAN * STEP) for run in runs]).reshape(-1, 2)


def find_struck(model: mujoco.MjModel, pose: np.ndarray, std: np.ndarray) -> dict[int, dict[str, bool]]:
    """What is struck in which rows of poses (n, nv), `STEP` apart, of noise `std` (nv,): row → names, in order.

    And for each name whether geoms touch there: it is no end stop.
    """
    model = copy(model)  # to which end stops, and without friction contacts, are constraints before they are met
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.geom_condim[:], model.pair_dim[:] = 1, 1
    model.geom_margin[:], model.pair_margin[:] = NEAR * model.stat.extent, NEAR * model.stat.extent
    model.jnt_margin[:] = np.ptp(model.jnt_range, axis=1)
    data, struck = mujoco.MjData(model), dict[int, dict[str, bool]]()
    moved = (pose[SPAN:] - pose[:-SPAN]) / SPAN
    for row in range(SPAN, len(pose) - SPAN):
        data.qpos[:] = pose[row]
        mujoco.mj_fwdPosition(model, data)
        sides = np.flatnonzero(np.isin(data.efc_type, SIDES))
        clear, slope = data.efc_pos[sides], data.efc_J.reshape(-1, model.nv)[sides]
        noise = np.sqrt(2.0 * ((slope * std) ** 2).sum(axis=1)) / SPAN
        # Of the way there, as before, and of the way back, as after.
        opening = np.stack([slope @ moved[row - SPAN], -slope @ moved[row]])
        hit = ((opening < -VISIBLE * noise) & (clear + opening <= 0.0)).any(axis=0)
        if hit.any():
            struck[row] = {name_side(model, data, i): bool(data.efc_type[i] != LIMIT) for i in sides[hit]}
    return struck


def name_side(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> str:
    """What a constraint keeps a joint in, or bodies from: of two the one that does not move, if one doesn't."""
    index = int(data.efc_id[row])
    if data.efc_type[row] == LIMIT:
        return f"the end stop of {model.joint(index).name}"
    geom = min(data.contact.geom[index], key=lambda geom: model.body_weldid[model.geom_bodyid[geom]])
    return model.geom(geom).name or model.body(model.geom_bodyid[geom]).name
