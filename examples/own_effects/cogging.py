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
        #         name    unit off  low  high prior                         typical size, what a good rig may show
        Parameter("force", "N", 0.0, 0.0, 2.0, Prior("halfnormal", 0.0, 0.2), 0.1, 0.012),
        Parameter("place", "m", 0.0, -0.15, 0.15, Prior("uniform", -0.15, 0.15), 0.02, 0.15),
    ),
    stage=Stage.FORCE,
    apply=apply_cogging,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.spring", "rail_x.tight_spot"),
    target="rail_x",
    follows="position",
)
