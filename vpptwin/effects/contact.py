"""Effects where bodies touch: how stiff a contact is, how hard it damps, how much it rubs.

They act on all contacts alike, or on a named pair: where geoms are kept in the model does not matter to them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.constants import Constants, Site, multiply
from vpptwin.effects.parameter import Parameter, Prior

SOFTEST, HARDEST, DEADEST = 0.02, 20.0, 10.0
"""Factors on stiffness at least and at most, and on damping at most, where the step allows it."""
ROOM = 3.0
"""Steps that time constants keep at least: those below two MuJoCo clips."""
SOURCE = "assumption: by mass, N/m differ by a third with attitude"
TABLES = "assumption: read off tables, within a quarter"


def apply_compliance(constants: Constants, site: Site, /, stiffness: np.ndarray, damping: np.ndarray) -> None:
    """Factors on what springs and dampers of all contacts do to what touches.

    MuJoCo's time constant tc and damping ratio dr mean stiffness 1/(tc dr)² and damping 2/tc, each by mass and width of
    impedance; negative numbers are the two themselves.
    """
    for name in ("geom_solref", "pair_solref"):
        if name in constants:
            solref = constants[name]
            direct, tough, damped = solref[..., 0] <= 0.0, stiffness[:, None], damping[:, None]
            first = solref[..., 0] * np.where(direct, tough, 1.0 / damped)
            solref[..., 1] *= np.where(direct, damped, damped / np.sqrt(tough))
            solref[..., 0] = first


def factor(name: str, low: float, high: float, size: float, source: str) -> Parameter:
    """A factor on something of a contact."""
    prior = Prior("normal", 1.0, min(size, 0.3))
    return Parameter(name=name, unit="", off=1.0, low=low, high=high, prior=prior, size=size, tolerance=0.28 * size,
                     source=source)  # fmt: skip


def effects_for_contacts(
    shows: tuple[str, ...], solref: Sequence[Sequence[float]] | np.ndarray, dt: float, geoms: bool = True,
    pairs: Iterable[str] = (), needs: tuple[str, ...] = (),
) -> tuple[Effect, ...]:  # fmt: skip
    """`contact.compliance`, `contact.friction`, and `PAIR.friction` of every named pair.

    Args:
        shows: topics.
        solref: MuJoCo's numbers of all that may touch, (n, 2): none may become too stiff or too quick for the step.
        dt: that step [s].
        geoms: whether geoms meet besides pairs that the model names.
        pairs: names of such pairs; "" for those without.
        needs: parts that the model must have.
    """
    pairs, (first, second) = tuple(pairs), np.array(solref, float).reshape(-1, 2).T
    direct = first <= 0.0
    stiffest = np.where(direct, 1.0 / np.maximum(-first * dt**2, 1e-9), (first * second / dt) ** 2).min()
    fastest = np.where(direct, 1.0 / np.maximum(-second * dt, 1e-9), first / (ROOM * dt)).min()
    compliance = Effect(
        id="contact.compliance", summary="contacts of another stiffness or damping",
        equation="(stiffness k r + damping b dr/dt) where bodies touch",
        parameters=(
            factor("stiffness", SOFTEST, float(np.clip(stiffest, 1.0, HARDEST)), 1.0, SOURCE),
            factor("damping", SOFTEST, float(np.clip(fastest, 1.0, DEADEST)), 1.0, SOURCE),
        ),
        stage=Stage.CONSTANT, apply=apply_compliance, shows=shows, needs=needs, follows="position", touching=True,
        writes=("geom_solref",) * geoms + ("pair_solref",) * bool(pairs),
    )  # fmt: skip
    # |F_t| ≤ gain μ N (Coulomb); of two geoms that touch, the larger μ counts.
    rubbing, gain = "gain μ N where bodies slide on each other", factor("gain", 0.0, 5.0, 0.25, TABLES)
    found = [compliance]
    if geoms:
        found.append(Effect(
            "contact.friction", "another sliding friction of contacts", rubbing, (gain,), Stage.CONSTANT,
            multiply(("geom_friction", ..., 0)), shows, needs=needs, touching=True,
        ))  # fmt: skip
    either_way = multiply(("pair_friction", "pair", 0), ("pair_friction", "pair", 1))
    found += [
        Effect(f"{pair}.friction", f"another sliding friction of the pair {pair}", rubbing, (gain,), Stage.CONSTANT,
               either_way, shows, target=pair, needs=needs, touching=True)
        for pair in pairs if pair and f"{pair}.friction" != found[-1].id
    ]  # fmt: skip
    return tuple(found)
