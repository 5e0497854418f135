"""Causes that prediction asks for and inverse dynamics of the same logs does not see: one of the two is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.probe import Shares, share_forces
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.effects import Stage, find_effect
from vpptwin.estimation.measurements import Measurements
from vpptwin.twin.spec import TwinSpec

BLOCK = 0.5
"""Stretches of log whose errors count as one [s]: estimated accelerations are alike over a tenth of a second."""
FEW = 8
"""Blocks below which no scatter is known."""
NONE = 1e-3
"""Share of a joint's typical force up to which a cause does not act there."""
UNUSUAL = 1.5
"""Scatter beyond which an instant counts less."""
LARGEST = 98.0
"""Percentile that is called the largest force: the very largest are reversals and gaps."""


@dataclass(frozen=True)
class Seen:
    """What inverse dynamics sees of a cause, on the joint where that makes the most of what drives it.

    Attributes:
        effect: the cause.
        joint: there.
        share: of its force as prediction has it: 1 agrees, 0 is nothing.
        std: its standard error, nan where inverse dynamics has no say.
        asked: its largest force over the largest that inputs, inertia and weight in the logs balance; 0 for inertia,
            which is no force and which springs that the twin lacks may drive.
    """

    effect: str
    joint: str
    share: float
    std: float
    asked: float

    def contradicts(self, criteria: Criteria) -> bool:
        """Whether this cannot be."""
        return self.denies(criteria) or self.asked > criteria.unbalanced

    def denies(self, criteria: Criteria) -> bool:
        """Whether far less or far more of it is seen, beyond what inverse dynamics may be wrong by."""
        if not self.std < criteria.has_a_say:
            return False
        reach = criteria.sigmas_denied * self.std
        return self.share + reach < criteria.least_seen or self.share - reach > criteria.most_seen

    def tell(self, criteria: Criteria) -> str:
        """Both sides in words."""
        parts = []
        if self.denies(criteria):
            parts.append(
                f"inverse dynamics of the same logs finds {self.share:.2f} ± {self.std:.2f} times the force of the "
                "fit (1 would agree)"
            )
        if self.asked > criteria.unbalanced:
            parts.append(
                f"it needs {self.asked:.2g} times the largest force that inputs, inertia and weight in the logs "
                "can balance"
            )
        return f"{self.effect} is doubted: on joint {self.joint} {', and '.join(parts)}"


def weigh_causes(
    spec: TwinSpec, measurements: Sequence[Measurements], values: Mapping[Key, float], criteria: Criteria
) -> list[Seen]:
    """What inverse dynamics sees of each cause of the fitted twin.

    Nothing is said where one has a memory of its own, which a single step cannot tell.
    """
    causes = sorted({effect for effect, _ in values})
    laws = [find_effect(spec.catalogue, cause) for cause in causes]
    if not causes or any(law.states or law.stage is Stage.SLIP for law in laws):
        return []
    shares, loads = share_forces(spec, measurements, values, causes), spec.robot.loads
    assert loads is not None
    size = {cause: np.sqrt((force**2).mean(axis=0)) / loads.force for cause, force in shares.made.items()}
    found = []
    for cause, law in zip(causes, laws, strict=True):
        dof = int(np.argmax(size[cause]))
        if size[cause][dof] > NONE:
            acting = [cause, *(other for other in causes if other != cause and size[other][dof] > NONE)]
            joint = spec.robot.name_dof(dof)
            share, std = fit_share(shares, acting, dof, criteria)
            asked = 0.0 if "dof_armature" in law.writes else ask(shares, cause, dof)
            found.append(Seen(cause, joint, share, std, asked))
    return found


def fit_share(shares: Shares, acting: Sequence[str], dof: int, criteria: Criteria) -> tuple[float, float]:
    """Share of the first cause's force that is seen beside the others, and its standard error; nan without a say.

    Robust least squares; errors are those of blocks of log, and of accelerations that are late or too small or large.
    """
    forces, left = shares.forces, shares.left[:, dof]
    block = np.unique(np.stack([forces.flight, forces.time // BLOCK]), axis=1, return_inverse=True)[1].ravel()
    count = int(block.max(initial=-1)) + 1
    if count < max(FEW, 2 * len(acting)) or shares.steady[acting[0]][dof] < criteria.blurred:
        return 1.0, np.nan
    made = np.stack([shares.made[cause][:, dof] for cause in acting], axis=1)
    weight, found = np.ones(len(left)), np.zeros(len(acting))
    for _ in range(8):
        found = np.linalg.lstsq(made * np.sqrt(weight)[:, None], left * np.sqrt(weight), rcond=None)[0]
        missed = left - made @ found
        usual = UNUSUAL * 1.48 * float(np.median(np.abs(missed)))
        weight = np.minimum(1.0, usual / np.maximum(np.abs(missed), 1e-300))
    project = np.linalg.pinv(made * np.sqrt(weight)[:, None]) * np.sqrt(weight)
    scatter = np.zeros(count)
    np.add.at(scatter, block, project[0] * missed)
    wrong = [criteria.late * shares.changing[:, dof], criteria.distorted * shares.moved[:, dof]]
    spread = (scatter**2).sum() * count / (count - len(acting)) + sum((project[0] @ part) ** 2 for part in wrong)
    return 1.0 + float(found[0]), float(np.sqrt(spread))


def ask(shares: Shares, cause: str, dof: int) -> float:
    """The largest force of a cause over the largest that inputs, inertia and weight balance."""
    forces = shares.forces
    inertial, driving, missing = (part[:, dof] for part in (forces.inertial, forces.actuator, forces.missing))
    balance = np.abs(inertial) + np.abs(driving) + np.abs(missing + driving - inertial)
    largest = float(np.percentile(balance, LARGEST))
    return float(np.percentile(np.abs(shares.made[cause][:, dof]), LARGEST)) / max(largest, 1e-300)
