"""JointState topics of any rig: one stream per named joint or actuator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vpptwin.errors import InputError
from vpptwin.logs.channels import JOINT_COLUMNS
from vpptwin.logs.recording import Recording


@dataclass
class _Part:
    """Samples of one joint, all with the same columns."""

    number: np.ndarray
    stamp: np.ndarray
    values: dict[str, np.ndarray]


@dataclass(frozen=True)
class JointSamples:
    """Samples of one joint in record order: stamp (n,) ns, values column -> (n,)."""

    stamp: np.ndarray
    values: dict[str, np.ndarray]
    warnings: tuple[str, ...] = field(default_factory=tuple)


def read_joints(recording: Recording, topic: str) -> dict[str, JointSamples]:
    """Read all joints of one JointState topic.

    Args:
        recording: with the messages of the topic.
        topic: name in the log.

    Returns:
        Joint or actuator name -> samples. Columns that are empty or NaN throughout are left out.

    Raises:
        InputError: if a message has another number of values than names.
    """
    stamp_paths = ("header.stamp.sec", "header.stamp.nanosec")
    parts: dict[str, list[_Part]] = {}
    for batch in recording.decode(topic, (*stamp_paths, *JOINT_COLUMNS), texts=("name",)):
        names = batch.texts["name"]
        stamp = batch.values[stamp_paths[0]].astype(np.int64) * 10**9 + batch.values[stamp_paths[1]].astype(np.int64)
        for column in JOINT_COLUMNS:
            width = batch.values[column].shape[1]
            if width not in (0, len(names)):
                raise InputError(
                    f"{recording.path}: {topic} has {width} values of {column} for {len(names)} names ({', '.join(names[:4])})",
                    "one value per name, or none",
                    "correct the program that publishes it",
                )
        present = [column for column in JOINT_COLUMNS if batch.values[column].shape[1]]
        for index, name in enumerate(names):
            values = {column: batch.values[column][:, index].astype(float) for column in present}
            parts.setdefault(name, []).append(_Part(batch.number, stamp, values))
    return {name: _join_parts(f"{topic} {name}", items) for name, items in parts.items()}


def _join_parts(label: str, parts: list[_Part]) -> JointSamples:
    total = sum(len(part.stamp) for part in parts)
    counts = {column: sum(len(p.stamp) for p in parts if column in p.values) for column in JOINT_COLUMNS}
    kept = [column for column, count in counts.items() if count > total / 2]
    usable = [part for part in parts if all(column in part.values for column in kept)] if kept else []
    number = np.concatenate([part.number for part in usable]) if usable else np.zeros(0, np.int64)
    order = np.argsort(number, kind="stable")
    stamp = np.concatenate([part.stamp for part in usable])[order] if usable else np.zeros(0, np.int64)
    values = {column: np.concatenate([part.values[column] for part in usable])[order] for column in kept if usable}
    values = {column: data for column, data in values.items() if not np.isnan(data).all()}
    warnings = []
    if len(stamp) < total:
        warnings.append(
            f"{total - len(stamp)} of {total} messages on {label} lack {' or '.join(kept) or 'values'}, left out"
        )
    return JointSamples(stamp, values, tuple(warnings))
