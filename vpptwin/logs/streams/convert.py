"""Message fields to columns and back, by the channel table: sign, scale, and the angle of a planar rotation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vpptwin.logs.channels import AXES, Column, Source

_COMPONENTS = "xyzw"
Value = float | Sequence[float] | np.ndarray


def list_fields(source: Source) -> list[str]:
    """Numeric message fields that a column is made from; a rotation takes four."""
    if source.axis is None:
        return list(source.roots)
    return [f"{source.paths[0]}.{component}" for component in _COMPONENTS]


def convert_column(source: Source, fields: Mapping[str, np.ndarray]) -> np.ndarray:
    """Column, (n,) or (n, k), from message fields likewise; angles are in [-pi, pi] before scale and offset."""
    if source.axis is None:
        parts = [np.asarray(fields[path], dtype=float) for path in source.paths]
        values = parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)
    else:
        name, sign = AXES[source.axis]
        quaternion = np.stack([fields[path] for path in list_fields(source)], axis=-1)
        sine, cosine = sign * quaternion[:, _COMPONENTS.index(name)], quaternion[:, 3]
        upper = np.where(cosine < 0, -1.0, 1.0)  # a quaternion and its negative are one rotation
        values = 2.0 * np.arctan2(sine * upper, cosine * upper)  # q = (axis sin theta/2, cos theta/2)
    scale = np.asarray(source.scale if len(source.scale) > 1 else source.scale[0])
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is refused like any other
        if source.voltage:
            path, nominal = source.voltage
            values = values * np.asarray(fields[path], dtype=float) / nominal
        if source.polynomial:
            values = np.polynomial.polynomial.polyval(values, source.polynomial)
        values = values * scale if (scale != 1.0).any() else values
        return values + source.offset if source.offset else values


def split_column(column: Column, value: Value) -> dict[str, float | np.ndarray]:
    """Message fields, path -> number or (k,), of one sample of a column: the inverse of `convert_column`."""
    source = column.source
    raw = (np.asarray(value, dtype=float) - source.offset) / np.asarray(source.scale[0])
    if source.axis is None:
        return {source.paths[0]: raw}
    name, sign = AXES[source.axis]
    fields: dict[str, float | np.ndarray] = {f"{source.paths[0]}.{component}": 0.0 for component in "xyz"}
    fields[f"{source.paths[0]}.{name}"] = sign * np.sin(raw / 2.0)
    fields[f"{source.paths[0]}.w"] = np.cos(raw / 2.0)
    return fields
