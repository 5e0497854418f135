"""Hinges and slides in a tree, in numbers of our own: what MuJoCo computes of them in a step without any contact.

MuJoCo spends most of its step on what a small mechanism does not have. Where nothing touches and no end stop is near,
its inertia, bias and Euler step are these few functions, which numba compiles together with the inner step; they run in
plain Python too. MuJoCo stays the reference: both are held against each other, and what is not here steps there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vpptwin.engine.compile import compilable


class Tree(NamedTuple):
    """How bodies hang together; bodies in MuJoCo's order, degree of freedom j is joint j."""

    parent: np.ndarray  # of each body, (nbody,)
    first: np.ndarray  # the first joint of each body, (nbody,)
    last: np.ndarray  # one past its last, (nbody,)
    deepest: np.ndarray  # the last joint on its way from the world, -1 for none, (nbody,)
    before: np.ndarray  # the joint before each on that way, -1 for none, (nv,)
    hinge: np.ndarray  # whether a joint turns instead of slides, (nv,) bool
    seat: np.ndarray  # body that each actuator pushes at a site, -1 where it drives a joint, (nu,)
    drives: np.ndarray  # that joint, (nu,)


class Shape(NamedTuple):
    """The numbers of one simulation's model, with MuJoCo's names; rotations as rows of matrices."""

    body_pos: np.ndarray  # (nbody, 3) m
    body_mat: np.ndarray  # (nbody, 9)
    body_ipos: np.ndarray  # (nbody, 3) m
    body_imat: np.ndarray  # (nbody, 9)
    body_mass: np.ndarray  # (nbody,) kg
    body_inertia: np.ndarray  # (nbody, 3) kg m²
    jnt_pos: np.ndarray  # (nv, 3) m
    jnt_axis: np.ndarray  # (nv, 3)
    qpos0: np.ndarray  # (nv,)
    jnt_stiffness: np.ndarray  # (nv,)
    qpos_spring: np.ndarray  # (nv,)
    dof_damping: np.ndarray  # (nv,)
    dof_armature: np.ndarray  # (nv,)
    site_pos: np.ndarray  # of the site that each actuator pushes, (nu, 3) m
    gear_force: np.ndarray  # what it pushes with there, in the body's axes, (nu, 3)
    gear_torque: np.ndarray  # likewise, (nu, 3)
    gear: np.ndarray  # ratio of one that drives a joint, (nu,)


class Pose(NamedTuple):
    """Where everything is, in the world's axes."""

    place: np.ndarray  # of the bodies, (nbody, 3) m
    turn: np.ndarray  # of the bodies, (nbody, 9)
    anchor: np.ndarray  # of the joints, (nv, 3) m
    axis: np.ndarray  # of the joints, (nv, 3)
    spin: np.ndarray  # angular velocity of the bodies, (nbody, 3) rad/s
    twist: np.ndarray  # angular acceleration without that of the joints, (nbody, 3) rad/s²
    pull: np.ndarray  # likewise acceleration of the bodies' places, less gravity's, (nbody, 3) m/s²
    arm: np.ndarray  # how each joint moves a point, and how it turns, (nv, 3) and (nv, 3) in one, (2, nv, 3)
    # of each body with all that hangs from it, about the body's place: mass, its first moment, its second (xx, yy, zz,
    # xy, xz, yz), force and torque without joints' accelerations, (nbody, 16)
    whole: np.ndarray


Vector = tuple[float, float, float]


@compilable(forceinline=True, keep=True)
def rotate(turn: np.ndarray, x: float, y: float, z: float) -> Vector:
    """A vector of a body's axes in the world's; turn (9,)."""
    return (
        turn[0] * x + turn[1] * y + turn[2] * z,
        turn[3] * x + turn[4] * y + turn[5] * z,
        turn[6] * x + turn[7] * y + turn[8] * z,
    )


@compilable(forceinline=True, keep=True)
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Vector:
    """Vector product."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@compilable(forceinline=True, keep=True)
def multiply(left: np.ndarray, right: np.ndarray, result: np.ndarray) -> None:
    """Product of two rotations, (9,) each; `result` is none of them."""
    for i in range(3):
        for k in range(3):
            result[3 * i + k] = left[3 * i] * right[k] + left[3 * i + 1] * right[3 + k] + left[3 * i + 2] * right[6 + k]


@compilable(forceinline=True, keep=True)
def turn_about(turn: np.ndarray, axis: np.ndarray, sine: float, cosine: float) -> None:
    """Turn a body, (9,), about an axis of the world, (3,)."""
    for k in range(3):  # Rodrigues' formula on every column
        x, y, z = turn[k], turn[3 + k], turn[6 + k]
        along = (axis[0] * x + axis[1] * y + axis[2] * z) * (1.0 - cosine)
        c_x, c_y, c_z = cross(axis[0], axis[1], axis[2], x, y, z)
        turn[k] = x * cosine + c_x * sine + axis[0] * along
        turn[3 + k] = y * cosine + c_y * sine + axis[1] * along
        turn[6 + k] = z * cosine + c_z * sine + axis[2] * along


@compilable(forceinline=True, keep=True)
def shift_pull(spin: np.ndarray, twist: np.ndarray, pull: np.ndarray, x: float, y: float, z: float) -> None:
    """Acceleration of another point of a body, (3,), from that of one from which it is so far away."""
    # a_P = a_O + α × r + ω × (ω × r)
    t_x, t_y, t_z = cross(twist[0], twist[1], twist[2], x, y, z)
    s_x, s_y, s_z = cross(spin[0], spin[1], spin[2], x, y, z)
    s_x, s_y, s_z = cross(spin[0], spin[1], spin[2], s_x, s_y, s_z)
    pull[0] += t_x + s_x
    pull[1] += t_y + s_y
    pull[2] += t_z + s_z


@compilable(forceinline=True, keep=True)
def place_bodies(tree: Tree, shape: Shape, qpos: np.ndarray, qvel: np.ndarray, gravity: np.ndarray, at: Pose) -> None:
    """Write where bodies and joints are and how bodies are accelerated by velocities alone, gravity upside down."""
    for i in range(3):  # the rest of the world's row is never written, and is zero
        at.turn[0, 4 * i] = 1.0
        at.pull[0, i] = -gravity[i]
    for b in range(1, len(tree.parent)):
        p = tree.parent[b]
        place, turn, spin, twist, pull = at.place[b], at.turn[b], at.spin[b], at.twist[b], at.pull[b]
        x, y, z = rotate(at.turn[p], shape.body_pos[b, 0], shape.body_pos[b, 1], shape.body_pos[b, 2])
        multiply(at.turn[p], shape.body_mat[b], turn)
        for i in range(3):
            spin[i], twist[i], pull[i] = at.spin[p, i], at.twist[p, i], at.pull[p, i]
        shift_pull(spin, twist, pull, x, y, z)
        place[0], place[1], place[2] = at.place[p, 0] + x, at.place[p, 1] + y, at.place[p, 2] + z
        for j in range(tree.first[b], tree.last[b]):
            axis, anchor, moved, speed = at.axis[j], at.anchor[j], qpos[j] - shape.qpos0[j], qvel[j]
            axis[0], axis[1], axis[2] = rotate(turn, shape.jnt_axis[j, 0], shape.jnt_axis[j, 1], shape.jnt_axis[j, 2])
            away = shape.jnt_pos[j, 0] != 0.0 or shape.jnt_pos[j, 1] != 0.0 or shape.jnt_pos[j, 2] != 0.0
            x, y, z = 0.0, 0.0, 0.0
            if away:
                x, y, z = rotate(turn, shape.jnt_pos[j, 0], shape.jnt_pos[j, 1], shape.jnt_pos[j, 2])
            anchor[0], anchor[1], anchor[2] = place[0] + x, place[1] + y, place[2] + z
            c_x, c_y, c_z = cross(spin[0], spin[1], spin[2], axis[0] * speed, axis[1] * speed, axis[2] * speed)
            if tree.hinge[j]:
                if away:
                    shift_pull(spin, twist, pull, x, y, z)
                turn_about(turn, axis, np.sin(moved), np.cos(moved))
                twist[0], twist[1], twist[2] = twist[0] + c_x, twist[1] + c_y, twist[2] + c_z
                for i in range(3):
                    spin[i] += axis[i] * speed
                if away:
                    x, y, z = rotate(turn, shape.jnt_pos[j, 0], shape.jnt_pos[j, 1], shape.jnt_pos[j, 2])
                    place[0], place[1], place[2] = anchor[0] - x, anchor[1] - y, anchor[2] - z
                    shift_pull(spin, twist, pull, -x, -y, -z)
            else:
                d_x, d_y, d_z = axis[0] * moved, axis[1] * moved, axis[2] * moved
                shift_pull(spin, twist, pull, d_x, d_y, d_z)
                place[0], place[1], place[2] = place[0] + d_x, place[1] + d_y, place[2] + d_z
                pull[0], pull[1], pull[2] = pull[0] + 2.0 * c_x, pull[1] + 2.0 * c_y, pull[2] + 2.0 * c_z


@compilable(forceinline=True, keep=True)
def point_arms(tree: Tree, at: Pose, body: int, x: float, y: float, z: float) -> None:
    """Write how the joints on the way to a body move a point of the world on it, and turn it, into `at.arm`."""
    j = tree.deepest[body]
    while j >= 0:
        axis, moves, turns = at.axis[j], at.arm[0, j], at.arm[1, j]
        if tree.hinge[j]:
            away = x - at.anchor[j, 0], y - at.anchor[j, 1], z - at.anchor[j, 2]
            moves[0], moves[1], moves[2] = cross(axis[0], axis[1], axis[2], away[0], away[1], away[2])
            turns[0], turns[1], turns[2] = axis[0], axis[1], axis[2]
        else:
            moves[0], moves[1], moves[2] = axis[0], axis[1], axis[2]
            turns[0] = turns[1] = turns[2] = 0.0
        j = tree.before[j]


@compilable(forceinline=True, keep=True)
def weigh_body(shape: Shape, at: Pose, b: int) -> None:
    """Write mass, its first and second moment, force and torque of one body by itself into its row of `at.whole`."""
    m, own, turn, local = shape.body_mass[b], shape.body_inertia[b], at.turn[b], shape.body_imat[b]
    x, y, z = rotate(turn, shape.body_ipos[b, 0], shape.body_ipos[b, 1], shape.body_ipos[b, 2])
    # Principal axes in the world, u v w, and with them the inertia's six numbers: I = I_1 u uᵀ + I_2 v vᵀ + I_3 w wᵀ.
    u_x, u_y, u_z = rotate(turn, local[0], local[3], local[6])
    v_x, v_y, v_z = rotate(turn, local[1], local[4], local[7])
    w_x, w_y, w_z = rotate(turn, local[2], local[5], local[8])
    xx = own[0] * u_x * u_x + own[1] * v_x * v_x + own[2] * w_x * w_x
    yy = own[0] * u_y * u_y + own[1] * v_y * v_y + own[2] * w_y * w_y
    zz = own[0] * u_z * u_z + own[1] * v_z * v_z + own[2] * w_z * w_z
    xy = own[0] * u_x * u_y + own[1] * v_x * v_y + own[2] * w_x * w_y
    xz = own[0] * u_x * u_z + own[1] * v_x * v_z + own[2] * w_x * w_z
    yz = own[0] * u_y * u_z + own[1] * v_y * v_z + own[2] * w_y * w_z
    spin, twist, pull, whole = at.spin[b], at.twist[b], at.pull[b], at.whole[b]
    t_x, t_y, t_z = cross(twist[0], twist[1], twist[2], x, y, z)
    s_x, s_y, s_z = cross(spin[0], spin[1], spin[2], x, y, z)
    s_x, s_y, s_z = cross(spin[0], spin[1], spin[2], s_x, s_y, s_z)
    f_x, f_y, f_z = m * (pull[0] + t_x + s_x), m * (pull[1] + t_y + s_y), m * (pull[2] + t_z + s_z)
    # Newton and Euler: f = m a_C, n = r × f + I α + ω × I ω (Featherstone 2008, chapter 2).
    h_x = xx * spin[0] + xy * spin[1] + xz * spin[2]
    h_y = xy * spin[0] + yy * spin[1] + yz * spin[2]
    h_z = xz * spin[0] + yz * spin[1] + zz * spin[2]
    n_x, n_y, n_z = cross(spin[0], spin[1], spin[2], h_x, h_y, h_z)
    o_x, o_y, o_z = cross(x, y, z, f_x, f_y, f_z)
    whole[0], whole[1], whole[2], whole[3] = m, m * x, m * y, m * z
    # Parallel axes: I_O = I_C + m (r² 1 - r rᵀ).
    whole[4], whole[5], whole[6] = xx + m * (y * y + z * z), yy + m * (x * x + z * z), zz + m * (x * x + y * y)
    whole[7], whole[8], whole[9] = xy - m * x * y, xz - m * x * z, yz - m * y * z
    whole[10], whole[11], whole[12] = f_x, f_y, f_z
    whole[13] = o_x + n_x + xx * twist[0] + xy * twist[1] + xz * twist[2]
    whole[14] = o_y + n_y + xy * twist[0] + yy * twist[1] + yz * twist[2]
    whole[15] = o_z + n_z + xz * twist[0] + yz * twist[1] + zz * twist[2]


@compilable(forceinline=True, keep=True)
def carry_body(at: Pose, b: int, p: int) -> None:
    """Add what `at.whole` has of a body, and of all that hangs from it, to the row of the one that carries it."""
    own, whole = at.whole[b], at.whole[p]
    x, y, z = at.place[b, 0] - at.place[p, 0], at.place[b, 1] - at.place[p, 1], at.place[b, 2] - at.place[p, 2]
    m, h_x, h_y, h_z = own[0], own[1], own[2], own[3]
    n_x, n_y, n_z = cross(x, y, z, own[10], own[11], own[12])
    g_x, g_y, g_z = h_x + h_x + m * x, h_y + h_y + m * y, h_z + h_z + m * z
    along_x, along_y, along_z = x * g_x, y * g_y, z * g_z
    whole[0], whole[1], whole[2], whole[3] = (
        whole[0] + m,
        whole[1] + h_x + m * x,
        whole[2] + h_y + m * y,
        whole[3] + h_z + m * z,
    )
    whole[4], whole[5] = whole[4] + own[4] + along_y + along_z, whole[5] + own[5] + along_x + along_z
    whole[6] = whole[6] + own[6] + along_x + along_y
    whole[7] = whole[7] + own[7] - x * h_y - y * h_x - m * x * y
    whole[8] = whole[8] + own[8] - x * h_z - z * h_x - m * x * z
    whole[9] = whole[9] + own[9] - y * h_z - z * h_y - m * y * z
    for k in range(10, 13):
        whole[k] += own[k]
    whole[13], whole[14], whole[15] = whole[13] + own[13] + n_x, whole[14] + own[14] + n_y, whole[15] + own[15] + n_z


@compilable(forceinline=True, keep=True)
def weigh_bodies(tree: Tree, shape: Shape, at: Pose, mass: np.ndarray, bias: np.ndarray) -> None:
    """Write the joint-space inertia, (nv, nv), and the forces of gravity and velocities, (nv,), as MuJoCo has them.

    Composite rigid bodies: what a joint accelerates is all that hangs from it, as one body (Featherstone, Rigid Body
    Dynamics Algorithms, 2008, section 6.2).
    """
    nv, nbody = len(bias), len(tree.parent)
    for i in range(nv):
        for j in range(nv):
            mass[i, j] = 0.0
    for b in range(1, nbody):
        if tree.deepest[b] >= 0:
            weigh_body(shape, at, b)
    for b in range(nbody - 1, 0, -1):
        if tree.deepest[tree.parent[b]] >= 0:
            carry_body(at, b, tree.parent[b])
        whole, place = at.whole[b], at.place[b]
        for i in range(tree.first[b], tree.last[b]):
            axis, anchor = at.axis[i], at.anchor[i]
            x, y, z = axis[0], axis[1], axis[2]
            if tree.hinge[i]:
                e_x, e_y, e_z = place[0] - anchor[0], place[1] - anchor[1], place[2] - anchor[2]
                c_x, c_y, c_z = cross(x, y, z, e_x, e_y, e_z)
                p_x, p_y, p_z = cross(x, y, z, whole[1], whole[2], whole[3])
                p_x, p_y, p_z = p_x + whole[0] * c_x, p_y + whole[0] * c_y, p_z + whole[0] * c_z
                l_x, l_y, l_z = cross(whole[1], whole[2], whole[3], c_x, c_y, c_z)
                l_x += whole[4] * x + whole[7] * y + whole[8] * z
                l_y += whole[7] * x + whole[5] * y + whole[9] * z
                l_z += whole[8] * x + whole[9] * y + whole[6] * z
                bias[i] = c_x * whole[10] + c_y * whole[11] + c_z * whole[12]
                bias[i] += x * whole[13] + y * whole[14] + z * whole[15]
            else:
                p_x, p_y, p_z = whole[0] * x, whole[0] * y, whole[0] * z
                l_x, l_y, l_z = cross(whole[1], whole[2], whole[3], x, y, z)
                bias[i] = x * whole[10] + y * whole[11] + z * whole[12]
            j = i
            while j >= 0:  # M_ij = S_jᵀ I^c S_i for every joint j that carries i
                a, o = at.axis[j], at.anchor[j]
                if tree.hinge[j]:
                    t_x, t_y, t_z = cross(place[0] - o[0], place[1] - o[1], place[2] - o[2], p_x, p_y, p_z)
                    mass[i, j] = a[0] * (l_x + t_x) + a[1] * (l_y + t_y) + a[2] * (l_z + t_z)
                else:
                    mass[i, j] = a[0] * p_x + a[1] * p_y + a[2] * p_z
                j = tree.before[j]
    for i in range(nv):
        mass[i, i] += shape.dof_armature[i]
        for j in range(i):
            mass[j, i] = mass[i, j]


@compilable(forceinline=True, keep=True)
def gear_actuators(tree: Tree, shape: Shape, at: Pose, moment: np.ndarray) -> None:
    """Write what a unit force of each actuator makes on each degree of freedom, (nu, nv)."""
    for i in range(len(tree.seat)):
        b = tree.seat[i]
        for j in range(len(tree.before)):
            moment[i, j] = 0.0
        if b < 0:
            moment[i, tree.drives[i]] = shape.gear[i]
            continue
        turn, site = at.turn[b], shape.site_pos[i]
        x, y, z = rotate(turn, site[0], site[1], site[2])
        point_arms(tree, at, b, at.place[b, 0] + x, at.place[b, 1] + y, at.place[b, 2] + z)
        f_x, f_y, f_z = rotate(turn, shape.gear_force[i, 0], shape.gear_force[i, 1], shape.gear_force[i, 2])
        n_x, n_y, n_z = rotate(turn, shape.gear_torque[i, 0], shape.gear_torque[i, 1], shape.gear_torque[i, 2])
        j = tree.deepest[b]
        while j >= 0:
            a, g = at.arm[0, j], at.arm[1, j]
            moment[i, j] = a[0] * f_x + a[1] * f_y + a[2] * f_z + g[0] * n_x + g[1] * n_y + g[2] * n_z
            j = tree.before[j]


@compilable(forceinline=True, keep=True)
def eliminate(dense: np.ndarray) -> None:
    """Factors of a symmetric positive definite matrix in the place of its upper half, D Lᵀ, on the diagonal 1/D.

    A = L D Lᵀ, by rows (Golub, Van Loan, Matrix Computations, 2013, section 4.1).
    """
    n = len(dense)
    for k in range(n):
        pivot = 1.0 / dense[k, k]
        dense[k, k] = pivot
        for i in range(k + 1, n):
            share = dense[k, i] * pivot
            for j in range(i, n):
                dense[i, j] -= share * dense[k, j]


@compilable(forceinline=True, keep=True)
def substitute(dense: np.ndarray, result: np.ndarray) -> None:
    """Multiply a vector, (n,), in its place, by the inverse of the matrix of which `eliminate` left factors."""
    # What is known is taken from all that follow at once: they do not wait for each other.
    n = len(result)
    for k in range(n):
        share = result[k] * dense[k, k]
        for i in range(k + 1, n):
            result[i] -= share * dense[k, i]
    for k in range(n - 1, -1, -1):
        found = result[k] * dense[k, k]
        result[k] = found
        for i in range(k):
            result[i] -= found * dense[i, k]


@compilable(forceinline=True, keep=True)
def solve_inertia(
    mass: np.ndarray, damping: np.ndarray, dt: float, dense: np.ndarray, force: np.ndarray, result: np.ndarray
) -> None:
    """Write (M + dt D)⁻¹ force, (nv,); `dense`, (nv, nv), is room."""
    n = len(force)
    for i in range(n):
        for j in range(i, n):
            dense[i, j] = mass[i, j]
        dense[i, i] += dt * damping[i]
        result[i] = force[i]
    eliminate(dense)
    substitute(dense, result)


class Reach(NamedTuple):
    """What could touch, and where joints end: a geom is taken for the ball around it."""

    ranges: np.ndarray  # within which no end stop acts, (nv, 2) m, rad
    body: np.ndarray  # that each ball is on, (P,)
    ball: np.ndarray  # its centre in the body's axes, radius with margin, (P, 4) m
    flat: np.ndarray  # what stands still beside it, 0 a plane, 1 a box, 2 another ball, that of a body, (P,)
    other: np.ndarray  # that body, (P,)
    stands: np.ndarray  # place, rotation and half sizes (of a ball the radius first) of what stands beside it, (P, 15)


@compilable(forceinline=True, keep=True)
def is_clear(reach: Reach, qpos: np.ndarray, at: Pose) -> bool:
    """Whether no joint is at an end stop and no ball touches what it could touch; false, too, where numbers are not."""
    clear = True
    for i in range(len(qpos)):
        clear = clear and reach.ranges[i, 0] < qpos[i] < reach.ranges[i, 1]
    for i in range(len(reach.body)):
        ball, stands, b = reach.ball[i], reach.stands[i], reach.body[i]
        x, y, z = rotate(at.turn[b], ball[0], ball[1], ball[2])
        x, y, z = at.place[b, 0] + x, at.place[b, 1] + y, at.place[b, 2] + z
        o, turn = reach.other[i], stands[3:12]
        p_x, p_y, p_z = rotate(at.turn[o], stands[0], stands[1], stands[2])
        x, y, z = x - at.place[o, 0] - p_x, y - at.place[o, 1] - p_y, z - at.place[o, 2] - p_z
        # In the axes of what stands still.
        l_x = turn[0] * x + turn[3] * y + turn[6] * z
        l_y = turn[1] * x + turn[4] * y + turn[7] * z
        l_z = turn[2] * x + turn[5] * y + turn[8] * z
        if reach.flat[i] == 2:
            clear = clear and x * x + y * y + z * z > (ball[3] + stands[12]) ** 2
        elif reach.flat[i] == 0:
            clear = clear and l_z > ball[3]
        else:
            d_x, d_y = max(abs(l_x) - stands[12], 0.0), max(abs(l_y) - stands[13], 0.0)
            d_z = max(abs(l_z) - stands[14], 0.0)
            clear = clear and d_x * d_x + d_y * d_y + d_z * d_z > ball[3] * ball[3]
    return clear


FUNCTIONS = (place_bodies, is_clear, weigh_bodies, gear_actuators, solve_inertia)
"""Those that a step consists of, in this order."""
