"""What is typical of the bodies that joints move: which of them tell their mass, where it is, and what they carry."""

from __future__ import annotations

import copy
from collections.abc import Container

import mujoco
import numpy as np

from vpptwin.effects import Link
from vpptwin.effects.body import WEIGHT
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.robot.model import HINGE


def list_links(
    model: mujoco.MjModel, forces: np.ndarray, led: np.ndarray, apart: Container[str], room: float = 1.0
) -> list[Link]:  # fmt: skip
    """The bodies whose mass and its place show, and where the last ones of a chain may carry something.

    Args:
        model: nominal.
        forces: typical of every degree of freedom, (nv,) N, N m.
        led: degrees of freedom that follow their log.
        apart: names of bodies that fly or turn freely, whose centres of mass have effects of their own.
        room: factor on bounds of masses.
    """
    found = []
    for body in list_swung(model, led):
        name, mass = model.body(body).name, float(model.body_mass[body])
        if not name or mass <= 0.0:
            continue
        centre, tip, ways = model.body_ipos[body], None, ""
        away = centre - model.jnt_pos[model.body_jntadr[body]] if model.body_jntnum[body] else centre
        reach = measure_reach(model, body) or 0.1
        joint, fixed = find_hinge(model, body), bool(model.body_simple[body])  # MuJoCo takes it to be balanced
        if not (model.body_parentid == body).any() and not fixed:
            x, y, z = map(float, centre + away)
            tip = x, y, z
        if name not in apart and not fixed:
            balanced = list_balanced(model, body, 0.1 * reach, led)
            ways = "".join(axis for axis, nothing in zip("xyz", balanced) if not nothing)
        lever = float(forces[model.jnt_dofadr[joint]]) / (WEIGHT * mass)
        load, span = measure_load(model, body, forces)
        turned = str(model.joint(joint).name)
        found.append(Link(name, mass, tip, reach, ways, min(lever, reach), turned, load, span, room))
    return found


def measure_load(model: mujoco.MjModel, body: int, forces: np.ndarray) -> tuple[float, float]:
    """What the joints of a body's tree may carry [kg], and half of how far its longest body reaches [m].

    Twice the tree's mass, or what the forces on its hinges (nv,) hold up level; the body itself may be but a flange.
    """
    tree = np.flatnonzero(model.body_treeid == model.body_treeid[body])
    reach = {int(each): measure_reach(model, int(each)) or 0.1 for each in tree}
    held = [
        float(forces[model.jnt_dofadr[joint]]) / (WEIGHT * reach[int(model.jnt_bodyid[joint])])
        for joint in np.flatnonzero(np.isin(model.jnt_bodyid, tree) & (model.jnt_type == HINGE))
    ]
    return max(2.0 * float(model.body_mass[tree].sum()), *held, 0.0), max(reach.values())


def list_swung(model: mujoco.MjModel, led: np.ndarray) -> list[int]:
    """Bodies that a hinge and another joint move: of one joint alone, mass is but the inverse of its drive's gain.

    What only slides is left out, its mass being the inertia of its slide. A base that follows its log, as its degrees
    of freedom among `led` tell, is no joint.
    """
    found, counts = [], ~((model.jnt_type == FREE) & np.isin(model.jnt_dofadr, led))
    for body in range(1, model.nbody):
        chain, joints = body, list[int]()
        while chain:
            joints += range(model.body_jntadr[chain], model.body_jntadr[chain] + model.body_jntnum[chain])
            chain = int(model.body_parentid[chain])
        same = counts & (model.body_treeid[model.jnt_bodyid] == model.body_treeid[body])
        if {HINGE, BALL} & {int(model.jnt_type[i]) for i in joints} and np.count_nonzero(same) > 1:
            found.append(body)
    return found


def find_hinge(model: mujoco.MjModel, body: int) -> int:
    """Index of the last hinge or ball joint that moves a body; -1 where none does."""
    while body:
        first = int(model.body_jntadr[body])
        for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
            if model.jnt_type[joint] in (HINGE, BALL):
                return joint
        body = int(model.body_parentid[body])
    return -1


def measure_reach(model: mujoco.MjModel, body: int) -> float:
    """Half of how far a body gets from its first joint, or else its origin [m], if not more by its mass or inertia.

    Its geoms and sites tell, and where the bodies are that it carries.
    """
    start = model.jnt_pos[model.body_jntadr[body]] if model.body_jntnum[body] else np.zeros(3)
    geoms, sites = model.geom_bodyid == body, model.site_bodyid == body
    places = np.concatenate([model.geom_pos[geoms], model.site_pos[sites], model.body_pos[model.body_parentid == body]])
    room = np.zeros(len(places))
    room[: np.count_nonzero(geoms)] = model.geom_rbound[geoms]
    far = float((np.linalg.norm(places - start, axis=1) + room).max(initial=0.0))
    turned = float(np.sqrt(model.body_inertia[body].max() / max(float(model.body_mass[body]), 1e-12)))
    return max(float(np.linalg.norm(model.body_ipos[body] - start)), 0.5 * far, turned)


def list_balanced(model: mujoco.MjModel, body: int, step: float, led: np.ndarray) -> list[bool]:
    """Along which of a body's axes its centre of mass shows in nothing but the inertia of a joint, or not at all.

    Args:
        model: nominal.
        body: index.
        step: by which its centre of mass is moved [m].
        led: degrees of freedom that follow their log.
    """
    rng, free = np.random.default_rng(0), np.setdiff1d(np.arange(model.nv), led)
    poses = [(np.array(model.qpos0), *rng.uniform(-1.0, 1.0, (2, model.nv))) for _ in range(3)]
    for pose, way, _ in poses:
        mujoco.mj_integratePos(model, pose, way, 1.0)
    other = ~np.eye(model.nv, dtype=bool)[free]

    def weigh(moved: np.ndarray) -> np.ndarray:
        """What couples joints, and what acts on them as they move and weigh, (poses, ...)."""
        changed = copy.copy(model)
        changed.body_ipos[body] += moved
        changed.body_sameframe[body] = 0
        data, dense, found = mujoco.MjData(changed), np.zeros((model.nv, model.nv)), []
        for pose, _, speed in poses:
            data.qpos[:], data.qvel[:] = pose, speed
            mujoco.mj_fwdPosition(changed, data)
            mujoco.mj_fwdVelocity(changed, data)
            mujoco.mj_fullM(changed, data, dense)
            found.append(np.concatenate([dense[free][other], data.qfrc_bias[free]]))
        return np.array(found)

    nominal = weigh(np.zeros(3))
    least = 1e-9 * max(float(np.abs(nominal).max(initial=0.0)), 1e-12)
    return [bool(np.abs(weigh(way) - nominal).max(initial=0.0) <= least) for way in step * np.eye(3)]
