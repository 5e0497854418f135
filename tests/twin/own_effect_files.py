"""Text of Python files with effects of a user's own, and a small rig that they act on."""

from __future__ import annotations

from pathlib import Path

SLIDE = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
<body name="cart"><joint name="slide" type="slide" damping="0.5"/><geom size="0.1" mass="2"/>
<body name="arm"><joint name="lift" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></body></worldbody>
<actuator><motor name="motor" joint="slide"/></actuator></mujoco>"""
TWIN = """model: slide.xml
signals: {joints: {slide: /joint_states}, driven: {lift: /joint_states}, actuators: {motor: /actuator_command}}
"""

HEAD = """import numpy as np
from vpptwin.effects import Effect, Parameter, Prior, Stage

FORCE = Parameter(name="force", unit="N", off=0.0, low=0.0, high=2.0, prior=Prior("halfnormal", 0.0, 0.2), size=0.1)
"""
FUNCTION = """
def pull(motion, /, force):
    return -force * np.sin(10.0 * motion.position)
"""
EFFECT = """
OWN = Effect(
    id="slide.wave", summary="a wavy rail", equation="-force sin(10 x)", parameters=(FORCE,), stage=Stage.FORCE,
    apply=pull, shows=("/joint_states",), target="slide",
)
"""
WAVE = HEAD + FUNCTION + EFFECT
WARM = (
    WAVE.replace("Stage\n", "Stage, State\n")
    .replace("motion, /, force):", "motion, /, heat, dt, force):")
    .replace("position)\n", "position) * heat, heat + dt * abs(motion.velocity)\n")
    .replace('target="slide"', 'target="slide", states=(State("heat", "m", "position"),)')
)
"""A wave that grows with the way from where the cart started."""


def write_rig(folder: Path, more: str = "") -> Path:
    """The rig's model and twin in a folder; `more` is added to the twin's YAML."""
    (folder / "slide.xml").write_text(SLIDE)
    (folder / "twin.yaml").write_text(TWIN + more)
    return folder / "twin.yaml"


def write_effects(folder: Path, text: str = WAVE, name: str = "own.py") -> Path:
    """A file with effects."""
    (folder / name).write_text(text)
    return folder / name
