"""What tests/quadrotor.py and tests/servo_arm.py have in common: the twin's files, and what may be hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Hidden = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value, in the catalogue's terms."""
Spans = Mapping[str, tuple[str, float, float]]
"""What may be hidden, a word behind it for what has either sign: strength, and its span from slight to strong."""


def save_twin(folder: Path, name: str, mjcf: str, twin: str) -> Path:
    """Write the nominal twin and its MJCF."""
    (folder / f"{name}.xml").write_text(mjcf)
    (folder / "twin.yaml").write_text(twin)
    return folder / "twin.yaml"


def draw_one(seed: Sequence[int], spans: Spans) -> Hidden:
    """One effect, all equally likely, its strength log-uniform; in one of six sessions none."""
    rng = np.random.default_rng(seed)
    if rng.random() < 1.0 / 6.0:
        return {}
    effect = str(rng.choice(list(spans)))
    name, low, high = spans[effect]
    value = float(low * (high / low) ** rng.random())
    return {effect.split()[0]: {name: value * (rng.choice([-1.0, 1.0]) if " " in effect else 1.0)}}
