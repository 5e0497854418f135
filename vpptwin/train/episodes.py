"""What evolves in an environment besides the twin and its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Episodes:
    """The episodes that N simulations are in; arrays are written in place, never handed out.

    Attributes:
        target: x, z, θ, (N, 3) m, m, rad.
        integral: Γ, (N, 2) m.
        elapsed: (N,) s.
        switch: when the target's angle changes next, (N,) s.
        total: sum of rewards so far, (N,).
        observation: last one given out, (N, 11) or (N, 9).
    """

    target: np.ndarray
    integral: np.ndarray
    elapsed: np.ndarray
    switch: np.ndarray
    total: np.ndarray
    observation: np.ndarray
