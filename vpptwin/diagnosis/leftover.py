"""What the extended twin still misses on held-out windows: how much, in which channel, and what it follows."""

from __future__ import annotations

import numpy as np

from vpptwin.diagnosis.holdout import HeldOut, Score
from vpptwin.diagnosis.search import Fit
from vpptwin.diagnosis.verdict import Unexplained

NO_EFFECT_LEVEL = 1.6
"""Mean square of a channel's whitened residual that no flight without an effect has exceeded (tests, benchmarks)."""
DEPENDS = 0.2
"""Share of a residual's variance that a quantity must explain to be named."""


def judge_leftover(held_out: HeldOut, fit: Fit, before: Score, after: Score) -> Unexplained:
    """Compare what is left with flights without effects.

    The channel with the largest whitened mean square is named; `share` is what remains of the held-out excess chi2.
    """
    white = held_out.whitened(fit.values)
    bench = held_out.short
    bins = bench.channels[0].value.shape[1]
    levels = []
    for i in range(len(bench.channels)):
        part = slice(i * bins, (i + 1) * bins)
        levels.append(float((white[:, part] ** 2).sum() / max(bench.valid[:, part].sum(), 1)))
    worst = int(np.argmax(levels))
    significant = levels[worst] > NO_EFFECT_LEVEL
    excess = before.chi2 - 1.0
    share = float(np.clip((after.chi2 - 1.0) / excess, 0.0, 1.0)) if excess > 0 else 0.0
    if not significant:
        return Unexplained(False, share, None, [])
    return Unexplained(True, share, bench.channels[worst].name, find_dependence(held_out, fit, worst))


def find_dependence(held_out: HeldOut, fit: Fit, channel: int) -> list[str]:
    """Quantities at the windows' starts that the channel's mean residual follows, by binned means, strongest first."""
    bench = held_out.short
    bins = bench.channels[0].value.shape[1]
    white = held_out.whitened(fit.values)[:, channel * bins : (channel + 1) * bins].mean(axis=1)
    named: list[tuple[float, str]] = []
    model = bench.spec.model
    for dof in range(model.nv):
        joint = model.joint(int(model.dof_jntid[dof])).name
        for label, value in (
            (f"{joint} position", bench.windows.pose[:, dof]),
            (f"{joint} velocity", bench.windows.velocity[:, dof]),
        ):
            named.append((explained_share(value, white), label))
    for i in range(model.nu):
        command = bench.windows.command[:, :, i].mean(axis=1)
        named.append((explained_share(command, white), f"command of {model.actuator(i).name}"))
    return [label for share, label in sorted(named, reverse=True) if share > DEPENDS]


def explained_share(quantity: np.ndarray, residual: np.ndarray, groups: int = 6) -> float:
    """Share of the residual's variance between groups of equal size sorted by a quantity, less what chance gives."""
    order = np.argsort(quantity)
    parts = np.array_split(residual[order], min(groups, max(len(order) // 5, 1)))
    total = float(((residual - residual.mean()) ** 2).sum())
    if total <= 0.0 or len(parts) < 2:
        return 0.0
    between = sum(len(part) * (part.mean() - residual.mean()) ** 2 for part in parts)
    degrees = (len(parts) - 1) / max(len(residual) - 1, 1)
    return float((between / total - degrees) / (1.0 - degrees))
