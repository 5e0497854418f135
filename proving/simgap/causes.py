"""What may be wrong with a rig, and a session of what was recorded of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from proving.logs import Log
from proving.simgap.session import PREDICTED, Cause, Session, Truth, cut_windows, make_run

LAWS = {
    "coulomb": ("dry friction", "-size sign(v)", "force"),
    "stiction": ("dry friction", "-size sign(v) exp(-(v / v_s)²)", "force"),
    "viscous": ("damping", "-size v", "damping"),
    "drag": ("damping", "-size |v| v", "drag"),
    "bias": ("steady force", "size", "force"),
    "spring": ("spring", "-size (q - rest)", "stiffness"),
    "cogging": ("cogging", "size sin(2 pi waves q + phase)", "force"),
    "inertia": ("inertia", "-size a", "inertia"),
    "offset": ("zero", "the encoder reads size too much", "angle"),
    "gain": ("gain", "size times the commanded force", "gain"),
    "delay": ("timing", "the command acts size later", "delay"),
    "lag": ("timing", "a first-order lag of size", "time_constant"),
    "backlash": ("limits", "play of width size in the command", "gap"),
    "rate_limit": ("limits", "the command changes by at most size a second", "rate"),
    "saturation": ("limits", "the command acts up to size", "limit"),
    "load": ("dry friction", "-size |drive force| sign(v)", "mu"),
    "stiffness": ("gain", "size times the servo's stiffness", "stiffness"),
    "dead_band": ("limits", "errors up to size have no effect", "band"),
    "force_limit": ("limits", "size times the servo's largest force", "limit"),
    "payload": ("inertia", "a mass of size at the tip", "mass"),
    "mass": ("inertia", "a mass of size more", "mass"),
    "com": ("steady force", "the centre of mass is off by size along an axis", "m"),
    "wind": ("steady force", "a steady force of size along an axis", "force"),
    "twist": ("steady force", "a steady torque of size about an axis", "torque"),
}
"""Kind of effect → its group, its law as force or torque of `size`, and what its size is called."""
UNITS = {
    "force": ("N", "N m"), "damping": ("N s/m", "N m s/rad"), "drag": ("N s²/m²", "N m s²/rad²"),
    "stiffness": ("N/m", "N m/rad"), "inertia": ("kg", "kg m²"), "angle": ("m", "rad"),
}  # fmt: skip
"""Parameter → unit at a slide and at a hinge."""
PLAIN = {"delay": "s", "time_constant": "s", "torque": "N m", "mass": "kg", "m": "m", "band": "rad"}
Made = tuple[Session, list[Log], Truth]
Deal = Callable[[Sequence[str]], str]


def make_cause(kind: str, parameter: str, rotary: bool, off: float, size: float) -> Cause:
    """A cause of a kind at a slide or hinge, whose typical difference from its off value is that size.

    `parameter` is what its size is called, "" for as in `LAWS`.
    """
    group, law, called = LAWS[kind]
    unit = UNITS.get(called, (PLAIN.get(called, ""),) * 2)[rotary]
    return Cause(group, law, parameter or called, unit, float(f"{off:.4g}"), float(f"{size:.4g}"))


def first(values: Mapping[str, float]) -> float:
    """The size of an effect: the first of its parameters."""
    return next(iter(values.values()))


def assemble(
    mjcf: str, logs: Sequence[Log], causes: Mapping[str, Cause], truth: Truth, data_sheet: Mapping[str, float],
    units: Mapping[str, str], tracks: Sequence[str] = ("name", "predict"),
    known: Mapping[str, float] = MappingProxyType({}),
) -> Made:  # fmt: skip
    """A session of logs, of which the last is held out where forecasts are asked for."""
    runs, told = zip(*(make_run(log) for log in logs))
    columns = {name: replace(column, unit=units.get(name, "")) for name, column in told[0].items()}
    shown = len(runs) - ("predict" in tracks)
    predicted = [name for name, column in columns.items() if column.role in PREDICTED]
    scales = {n: float(f"{np.nanstd(np.concatenate([r.columns[n] for r in runs[:shown]])):.4g}") for n in predicted}
    windows, measured = cut_windows(runs[-1], columns, predicted) if shown < len(runs) else ([], np.empty(0))
    session = Session(
        "",
        list(tracks),
        mjcf,
        columns,
        dict(causes),
        scales,
        dict(data_sheet),
        dict(known),
        list(runs[:shown]),
        windows,
    )
    return session, list(logs[:shown]), replace(truth, forecasts=np.round(measured, 9).tolist())
