"""One step of a small model at start-up: what compiled code reads and counts on, against what MuJoCo shows and does."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import mujoco
import numpy as np

from vpptwin.engine.callback import FUNCTION, installed
from vpptwin.engine.structs import check_layout, data_offset, make_probe, model_offset, unsupported
from vpptwin.engine.view import View, foresee_actuators, look_at

SCALARS: dict[str, tuple[Any, Any]] = {
    "time": (data_offset, ctypes.c_double),
    "nefc": (data_offset, ctypes.c_int),
    "ncon": (data_offset, ctypes.c_int),
    "opt.timestep": (model_offset, ctypes.c_double),
    "opt.gravity": (model_offset, ctypes.c_double * 3),
    "nuserdata": (model_offset, ctypes.c_int64),
}
"""What lies in the structs themselves: field → its struct and the type that the step reads it with."""


@cache
def check_step() -> None:
    """Take one step, its forces written by a callback as ours are; once in a process, within milliseconds.

    Raises:
        ImportError: if the installed MuJoCo steps otherwise than the compiled step and its friction count on.
    """
    try:
        compared = compare_step()
    except (IndexError, ValueError) as error:  # of sparse arrays in another form
        raise unsupported(f"steps otherwise than vpptwin does: {error}") from error
    for what, (found, expected) in compared.items():
        if not np.allclose(found, expected, rtol=1e-9, atol=1e-11):
            raise unsupported(f"steps otherwise than vpptwin does: {what} is {expected}, not {found}")


def compare_step() -> dict[str, tuple[Any, Any]]:
    """What the callback saw or foresaw in a step, and what MuJoCo shows of it, by name."""
    check_layout()
    model, data = make_probe()
    seen: list[View] = []
    read: dict[str, Any] = {}

    def look(m: int, d: int) -> None:
        if d != data._address:  # another thread steps a model of its own meanwhile
            return
        data.ctrl[:], data.qfrc_applied[:] = (1.6, -1.8, 0.4, 0.9), (0.2, -0.1, 0.05)
        seen.append(View(*map(np.copy, look_at(model, data))))  # type: ignore[arg-type]
        for field, (offset, kind) in SCALARS.items():
            read[field] = np.copy(kind.from_address((m if offset is model_offset else d) + offset(field)))

    data.qpos[:], data.qvel[:] = (0.02, -0.01, 0.1), (0.3, -0.2, 0.7)
    with installed(None):
        mujoco.mj_step(model, data)  # so that there is a step before
    velocity = data.qvel.copy()
    shown = {"time": data.time, "nuserdata": model.nuserdata, "qacc_warmstart": data.qacc.copy()}
    shown |= {f"opt.{name}": getattr(model.opt, name) for name in ("timestep", "gravity")}
    shown |= {"qfrc_constraint": data.qfrc_constraint.copy()}
    with installed(FUNCTION(look)):
        mujoco.mj_step(model, data)
    if len(seen) != 1:
        raise unsupported(f"calls its control callback {len(seen)} times a step, not once")
    view = seen[0]
    exerted, inertia = np.empty(model.nv), np.diag(view.timestep * view.dof_damping)
    foresee_actuators(view, exerted)
    for i, (start, length) in enumerate(zip(view.row_start, view.row_length)):
        for j, entry in zip(view.column[start : start + length], view.inertia[start : start + length]):
            inertia[i, j] += entry
            inertia[j, i] += entry * (i != j)
    smooth = view.qfrc_applied + exerted + view.qfrc_passive - view.qfrc_bias
    shown |= {name: getattr(data, name) for name in ("nefc", "ncon", "qfrc_passive", "qfrc_bias")}
    return {name: (read.get(name, getattr(view, name, None)), value) for name, value in shown.items()} | {
        "qfrc_actuator": (exerted, data.qfrc_actuator),
        "qfrc_smooth": (smooth, data.qfrc_smooth),
        "momentum": (inertia @ (data.qvel - velocity), view.timestep * (smooth + data.qfrc_constraint)),
    }
