"""Steps of rigs that touch nothing, without MuJoCo: tree, inner step and Euler or implicitfast in one compiled call."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import indent
from threading import Lock
from typing import Any

import mujoco
import numpy as np

from vpptwin.engine.tree import Pose, Reach, Shape, Tree
from vpptwin.system.cores import in_parts
from vpptwin.twin.stepping.layout import PER_SIMULATION, TreeLayout, make_pose, read_matrices

FIELDS = (*Shape._fields, "gravity", "gain", "bias", "force_range")
"""Numbers that may differ by simulation, in the order of the table of their addresses."""

FEW = 16
"""Simulations for which another thread does not pay."""

FLIGHT = """
implicit, damped, touches = {implicit}, False, False
for j in range({nv}):
    damped = damped or shape.dof_damping[j] > 0.0
    row.memory[2 + j] = 0.0
for k in range(steps):
    place_bodies(tree, shape, qpos, qvel, gravity, at)
    if not is_clear(reach, qpos, at):
        touches = True
        break
    weigh_bodies(tree, shape, at, mass, qfrc_bias)
    gear_actuators(tree, shape, at, moment)
    for j in range({nv}):
        passive[j] = -shape.dof_damping[j] * qvel[j] - shape.jnt_stiffness[j] * (qpos[j] - shape.qpos_spring[j])
        for n in range(row_length[j]):
            inertia[row_start[j] + n] = mass[j, column[row_start[j] + n]]
    for a in range({nu}):
        length[a] = shape.gear[a] * qpos[tree.drives[a]] if tree.seat[a] < 0 else 0.0
        velocity[a] = 0.0
        for j in range({nv}):
            velocity[a] += moment[a, j] * qvel[j]
    view = View(
        clock[0], dt, qpos, qvel, ctrl, applied, passive, qfrc_bias, nothing, warmstart, 0, False,
        inertia, row_length, row_start, column, shape.dof_damping, shape.dof_armature, shape.body_mass, gravity,
        moment_flat, moment_length, moment_start, moment_column, length, velocity, gain, bias, gain_type,
        bias_type, ctrl_limited, force_limited, ctrl_range, force_range, joint, joint_limited, joint_range,
        joint_lifted, nothing,
    )
    if context.qpos:
        for j in range({nv}):
            kept_qpos[k, j], kept_qvel[k, j] = qpos[j], qvel[j]
    {step}
    if context.rotor_speed:
        for a in range({nu}):
            kept_speed[k, a] = row.layer.rotor_speed[a]
    foresee_actuators(view, exerted)
    for j in range({nv}):
        exerted[j] += passive[j] - qfrc_bias[j] + applied[j]
    solve_inertia(mass, shape.dof_damping, 0.0, dense, exerted, warmstart)
    if implicit:
        foresee_drag(view, drag)
        solve_inertia(mass, drag, dt, dense, exerted, faster)
    elif damped:
        solve_inertia(mass, shape.dof_damping, dt, dense, exerted, faster)
    for j in range({nv}):
        qvel[j] += dt * (faster[j] if implicit or damped else warmstart[j])
        qpos[j] += dt * qvel[j]
    clock[0] += dt
"""
"""Lines that step one simulation, of which numba and Warp (`vpptwin.twin.warp.step`) get the same."""

ENTRY = """
def fly(address, begin, end, room):
    context = array_at(address, (1,), CONTEXT)[0]
    addresses = array_at(context.fields, (2 * {fields},), np.int64)
    static = array_at(context.static, ({statics},), np.int64)
    tree = Tree({tree})
    reach = Reach({reach})
    rig = Rig(array_at(context.active, ({places},), np.bool_), array_at(context.dry, ({nv},), np.float64), {carriage})
{room}
    dt = timestep[0]
    for i in range(begin, end):
        shape = Shape({shape})
        gravity = array_at(addresses[{gravity}] + addresses[{gravity} + 1] * i, (3,), np.float64)
        gain = array_at(addresses[{gain}] + addresses[{gain} + 1] * i, ({nu}, {ngain}), np.float64)
        bias = array_at(addresses[{bias}] + addresses[{bias} + 1] * i, ({nu}, {nbias}), np.float64)
        force_range = array_at(addresses[{force_range}] + addresses[{force_range} + 1] * i, ({nu}, 2), np.float64)
        qpos = array_at(context.state_qpos + {nv} * 8 * i, ({nv},), np.float64)
        qvel = array_at(context.state_qvel + {nv} * 8 * i, ({nv},), np.float64)
        warmstart = array_at(context.warmstart + {nv} * 8 * i, ({nv},), np.float64)
        clock = array_at(context.time + 8 * i, (1,), np.float64)
{row}
        kept_qpos = array_at(context.qpos + steps * {nv} * 8 * i, (steps if context.qpos else 0, {nv}), np.float64)
        kept_qvel = array_at(context.qvel + steps * {nv} * 8 * i, (steps if context.qvel else 0, {nv}), np.float64)
        rows = steps if context.rotor_speed else 0
        kept_speed = array_at(context.rotor_speed + steps * {nu} * 8 * i, (rows, {nu}), np.float64)
{flight}
        array_at(context.stuck, (i + 1,), np.int64)[i] = int(touches)
"""


def list_statics(layout: TreeLayout, model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Arrays that all simulations share, by name, for the table of their addresses."""
    nv, nu = int(model.nv), int(model.nu)
    shared = {f"tree.{n}": a for n, a in zip(Tree._fields, layout.tree)}
    shared |= {f"reach.{n}": a for n, a in zip(Reach._fields, layout.reach)}
    shared |= {
        "row_length": np.array(model.M_rownnz, np.int32), "row_start": np.array(model.M_rowadr, np.int32),
        "column": np.array(model.M_colind, np.int32), "moment_length": np.full(nu, nv, np.int32),
        "moment_start": np.arange(0, nu * nv, nv, dtype=np.int32),
        "moment_column": np.tile(np.arange(nv, dtype=np.int32), nu),
        "gain_type": np.array(model.actuator_gaintype, np.int32),
        "bias_type": np.array(model.actuator_biastype, np.int32),
        "ctrl_limited": np.array(model.actuator_ctrllimited, np.bool_),
        "force_limited": np.array(model.actuator_forcelimited, np.bool_),
        "ctrl_range": np.array(model.actuator_ctrlrange, float),
        "joint": np.arange(nv, dtype=np.int32), "joint_limited": np.array(model.jnt_actfrclimited, np.bool_),
        "joint_range": np.array(model.jnt_actfrcrange, float), "joint_lifted": np.zeros(nv, np.bool_),
        "timestep": np.array([model.opt.timestep]),
    }  # fmt: skip
    return {name: np.ascontiguousarray(array) for name, array in shared.items()}


def list_room(nbody: int, nv: int, nu: int, nc: int) -> dict[str, tuple[int, ...]]:
    """Arrays that a thread works in, by name, with their shapes."""
    pose = make_pose(nbody, nv)
    return {f"at.{name}": array.shape for name, array in zip(Pose._fields, pose)} | {
        "mass": (nv, nv), "dense": (nv, nv), "moment": (nu, nv), "inertia": (nc,), "qfrc_bias": (nv,), "passive": (nv,),
        "applied": (nv,), "exerted": (nv,), "drag": (nv,), "faster": (nv,), "nothing": (nv,), "ctrl": (nu,),
        "length": (nu,), "velocity": (nu,),
    }  # fmt: skip


def array_at(address: str, array: np.ndarray | tuple[int, ...]) -> str:
    """The text of an array at an address."""
    shape, kind = (array, "float64") if isinstance(array, tuple) else (array.shape, array.dtype.name)
    return f"array_at({address}, {shape}, np.{kind})"


def write_fused(layout: TreeLayout, model: mujoco.MjModel, places: int, carriage: int, step: str, row: str) -> str:
    """The text of the fused step for a model's sizes.

    Args:
        layout: of the model.
        model: that is stepped.
        places: number of switches of effects.
        carriage: index of the body that carries a guide, -1 without one.
        step: the call of the inner step.
        row: lines that make the row and the tape of simulation i.
    """
    nv, nu = int(model.nv), int(model.nu)
    statics = list_statics(layout, model)
    where = {name: array_at(f"static[{i}]", array) for i, (name, array) in enumerate(statics.items())}
    lines = [f"{name} = {text}" for name, text in where.items() if "." not in name]
    shapes, offset, room, starts = list_room(int(model.nbody), nv, nu, int(model.nC)), 0, {}, {}
    for name, size in shapes.items():
        starts[name] = f"room + {offset}"
        room[name] = array_at(starts[name], size)
        offset += 8 * int(np.prod(size))
    lines += [f"{name} = {text}" for name, text in room.items() if "." not in name]
    lines += [f"moment_flat = array_at({starts['moment']}, ({nu * nv},), np.float64)"]
    lines += [f"at = Pose({', '.join(room[f'at.{name}'] for name in Pose._fields)})"]
    fields = []
    for i, name in enumerate(Shape._fields):
        fields.append(array_at(f"addresses[{2 * i}] + addresses[{2 * i + 1}] * i", layout.numbers[name].shape))
    order = {name: 2 * i for i, name in enumerate(FIELDS)}
    return ENTRY.format(
        fields=len(FIELDS), statics=len(statics), tree=", ".join(where[f"tree.{n}"] for n in Tree._fields),
        reach=", ".join(where[f"reach.{n}"] for n in Reach._fields), places=places, carriage=carriage, nv=nv, nu=nu,
        room="\n".join("    " + line for line in lines), shape=", ".join(fields), gravity=order["gravity"],
        gain=order["gain"], bias=order["bias"], force_range=order["force_range"],
        ngain=int(mujoco.mjNGAIN), nbias=int(mujoco.mjNBIAS), row=row,
        flight=indent(FLIGHT.format(nv=nv, nu=nu, step=step, implicit=layout.implicit), 8 * " "),
    )  # fmt: skip


class Stepper:
    """Runs the fused step of one twin, all of whose numbers lie where they lay when it was made.

    Args:
        layout: of the model.
        model: that is stepped.
        table: constants of the twin, name → (N, ...), read again at every run.
        num_sims: number of simulations N.
        num_threads: threads at most.
    """

    def __init__(
        self,
        layout: TreeLayout,
        model: mujoco.MjModel,
        table: Mapping[str, np.ndarray],
        num_sims: int,
        num_threads: int,
    ) -> None:
        self._held = list(list_statics(layout, model).values())
        self._statics = np.array([array.ctypes.data for array in self._held], np.int64)
        own = {PER_SIMULATION[name]: array for name, array in table.items() if name in PER_SIMULATION}
        self._turns = own.get("body_imat")  # as effects write them, they are quaternions
        if self._turns is not None:
            own["body_imat"] = np.zeros((num_sims, int(model.nbody), 9))
        self._matrices = own.get("body_imat")
        words: list[int] = []
        for name in FIELDS:
            array = own.get(name)
            shared = np.ascontiguousarray(layout.numbers[name]) if array is None else array
            assert array is None or array[0].flags.c_contiguous
            self._held.append(shared)
            words += [shared.ctypes.data, 0 if array is None else array.strides[0]]
        self._fields = np.array(words, np.int64)
        self._workers = min(num_threads, max(num_sims // FEW, 1))
        sizes = list_room(int(model.nbody), int(model.nv), int(model.nu), int(model.nC)).values()
        self._rooms = np.zeros((self._workers, sum(int(np.prod(size)) for size in sizes)))
        self._lock = Lock()
        self._count = num_sims

    def run(self, function: Any, context: np.ndarray) -> None:  # noqa: ANN401
        """Run the compiled `function` on a context, its simulations shared out to threads."""
        context["static"], context["fields"] = self._statics.ctypes.data, self._fields.ctypes.data
        rooms = [room.ctypes.data for room in self._rooms]
        with self._lock:  # the room that threads work in is the twin's
            if self._turns is not None and self._matrices is not None:
                self._matrices[:] = read_matrices(self._turns)
            in_parts(lambda *part: function(context.ctypes.data, *part, rooms.pop()), self._count, self._workers, FEW)
