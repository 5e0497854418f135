"""Actuators that are more than a force: their lags, delays, integrators and motors as what a twin has for them."""

from __future__ import annotations

import mujoco
import numpy as np

LAG, DELAY, INTEGRATES, LOW, HIGH, SLOWEST, FASTEST = range(7)
"""What was taken out of an actuator, and where in its `dynprm`, by which nothing goes any more, that is noted: time
constant [s], delay [s], whether it integrates its input, between which bounds, and which input it is limited to."""
GAINS = {int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)}
BIASES = {int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)}
"""Actuators whose force the compiled step foresees, as friction answers to it."""
FILTERS = mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT
JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
JOINTS = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
FREE = [-np.inf, np.inf]


def simplify_actuators(spec: mujoco.MjSpec) -> None:
    """Take out of a specification's actuators what a twin does itself, and note it; `check_engine` refuses the rest."""
    for actuator in spec.actuators:
        linearise_motor(actuator)
        if int(actuator.gaintype) not in GAINS or int(actuator.biastype) not in BIASES or actuator.plugin.active:
            continue
        noted, kind = np.zeros(len(actuator.dynprm)), actuator.dyntype
        bounded = is_limited(actuator.actlimited, actuator.actrange)
        if kind in FILTERS and not bounded:
            noted[LAG] = actuator.dynprm[0]
        elif kind == mujoco.mjtDyn.mjDYN_INTEGRATOR and actuator.trntype in JOINTS and actuator.biasprm[1]:
            asked = is_limited(actuator.ctrllimited, actuator.ctrlrange)
            noted[INTEGRATES], noted[LOW : HIGH + 1] = 1.0, actuator.actrange if bounded else FREE
            noted[SLOWEST : FASTEST + 1] = actuator.ctrlrange if asked else FREE
            actuator.actlimited = actuator.ctrllimited = False
            actuator.actrange = actuator.ctrlrange = np.zeros(2)
        elif kind != mujoco.mjtDyn.mjDYN_NONE:
            continue
        if actuator.delay:
            noted[DELAY], actuator.delay, actuator.nsample = actuator.delay, 0.0, 0
        actuator.dyntype, actuator.dynprm = mujoco.mjtDyn.mjDYN_NONE, noted


def linearise_motor(actuator: mujoco.MjsActuator) -> None:
    """A DC motor of resistance and motor constant alone is a gain K/R and a damping K²/R."""
    motor = int(actuator.gaintype) == int(mujoco.mjtGain.mjGAIN_DCMOTOR)
    if not motor or any(np.any(part) for part in (actuator.gainprm[2:], actuator.biasprm, actuator.dynprm)):
        return
    resistance, constant = actuator.gainprm[:2]
    gain, bias = np.zeros((2, len(actuator.gainprm)))
    gain[0], bias[2] = constant / resistance, -(constant**2) / resistance
    actuator.gaintype, actuator.gainprm = mujoco.mjtGain.mjGAIN_FIXED, gain
    actuator.biastype, actuator.biasprm = mujoco.mjtBias.mjBIAS_AFFINE, bias
    actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE


def is_limited(flag: int, bounds: np.ndarray) -> bool:
    """Whether a limit holds, which may be left to whether there are bounds."""
    return bool(
        flag == mujoco.mjtLimited.mjLIMITED_TRUE or (flag == mujoco.mjtLimited.mjLIMITED_AUTO and np.any(bounds))
    )


def tell_control(model: mujoco.MjModel, actuator: int) -> str:
    """Which quantity an actuator's control input is: position or velocity of what it moves, or effort."""
    stiffness, damping = model.actuator_biasprm[actuator, 1:3]
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
    if affine and stiffness:
        return "velocity" if model.actuator_dynprm[actuator, INTEGRATES] else "position"
    return "velocity" if affine and damping and damping == -model.actuator_gainprm[actuator, 0] else "effort"


def list_noted(model: mujoco.MjModel) -> dict[str, dict[str, float]]:
    """Lags and delays that the MJCF has, as effects of its actuators: id → parameter → value."""
    found = {}
    for name, noted in ((model.actuator(i).name, model.actuator_dynprm[i]) for i in range(model.nu)):
        if name and noted[LAG]:
            found[f"{name}.lag"] = {"time_constant": float(noted[LAG])}
        if name and noted[DELAY]:
            found[f"{name}.delay"] = {"delay": float(noted[DELAY])}
    return found


def integrate_input(noted: np.ndarray, time: np.ndarray, value: np.ndarray, start: float) -> np.ndarray:
    """What an integrator makes of inputs held from `time` (n,) on [s], mean until the next; it begins at `start`."""
    steps = np.clip(value, *noted[SLOWEST : FASTEST + 1]) * np.diff(time, append=time[-1])
    at, held = start, np.empty(len(time))
    for k, step in enumerate(steps):
        after = min(max(at + step, noted[LOW]), noted[HIGH])
        held[k], at = 0.5 * (at + after), after
    return held
