"""Track `watch`: when does the force that the model lacks begin to follow another law?"""

from __future__ import annotations

from typing import Any

import numpy as np

from proving.simgap.entrants.fits import MEMORY
from proving.simgap.entrants.lab import RATE, SMOOTHED, Lab

EDGE, LEAST = 0.05, 8.0
"""Share of the run at either end where no change is looked for, and nats that one must be worth (both from seed 1)."""


def find_change(lab: Lab) -> dict[str, Any]:
    """Regressions of the lacking force before and after every instant; the posterior over instants.

    Each joint's lacking force follows sign(v), v, q and 1 with coefficients of its own before and after.
    """
    motion, lacking, _ = lab.residuals[-1]
    kept = slice(SMOOTHED, -SMOOTHED)
    time, count = motion.time[kept], len(motion.time[kept])
    speed = np.sqrt(np.mean(motion.v**2, axis=0)) + 1e-12
    splits = np.arange(int(EDGE * count), int((1.0 - EDGE) * count), 5)
    total, worth = np.zeros(len(splits)), np.zeros(len(splits))
    for j in range(lacking.shape[1]):
        v, target = motion.v[kept, j], lacking[kept, j]
        design = np.stack([np.tanh(v / (0.05 * speed[j])), v, motion.q[kept, j], np.ones(count)], axis=1)
        whole = misfit(design, target)
        for k, split in enumerate(splits):
            parts = misfit(design[:split], target[:split]) + misfit(design[split:], target[split:])
            worth[k] = 0.5 * count / (MEMORY * RATE) * np.log(whole / max(parts, 1e-30))
        total += worth
    chance = 1.0 / (1.0 + np.exp(np.clip(LEAST - total.max(), -50.0, 50.0)))
    weights = np.exp(total - total.max())
    rng = np.random.default_rng(0)
    times = rng.choice(time[splits], 50, p=weights / weights.sum())
    return {"probability": float(chance), "times": sorted(float(t) for t in times)}


def misfit(design: np.ndarray, target: np.ndarray) -> float:
    """Sum of squares that least squares leaves."""
    left = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    return float(left @ left)
