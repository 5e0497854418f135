"""Cogging of a toothed belt: a force that comes and goes with every tooth. The catalogue has nothing like it."""

import numpy as np

from vpptwin.effects import Effect, Motion, Parameter, Prior, Stage

TOOTH = 0.30
"""From tooth to tooth on the belt [m]: measured with a ruler, so it is no parameter."""


def apply_cogging(motion: Motion, /, force: float, place: float) -> float:
    """Force along the rail [N] that pulls towards the nearest gap between teeth; one of them is at `place` [m]."""
    return -force * np.sin(2.0 * np.pi * (motion.position - place) / TOOTH)


COGGING = Effect(
    id="rail_x.cogging",
    summary="cogging of the belt on the horizontal rail",
    equation="-force sin(2π (x - place)/0.30 m)",
    parameters=(
        Parameter(name="force", unit="N", off=0.0, low=0.0, high=2.0, prior=Prior("halfnormal", 0.0, 0.2), size=0.1,
                  tolerance=0.012, source="assumption: some 0.2 N, as felt by hand"),
        Parameter(name="place", unit="m", off=0.0, low=-0.15, high=0.15, prior=Prior("uniform", -0.15, 0.15), size=0.02,
                  tolerance=0.15, source="half a tooth either way, by the ruler"),
    ),
    stage=Stage.FORCE,
    apply=apply_cogging,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.spring", "rail_x.tight_spot"),
    target="rail_x",
    follows="position",
)  # fmt: skip
