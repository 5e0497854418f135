"""`mujoco.sysid` on the base parameters of the rig; the largest change in its own standard errors is blamed."""

# mypy: disable-error-code="attr-defined,name-defined"
# (of mujoco only sysid is typed, which hides the rest)

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout

import mujoco
import numpy as np
from absl import logging
from mujoco import sysid

from proving.runner.baselines.track import VEHICLE, Track, prepare_track
from vpptwin.logs.flight import Flight
from vpptwin.system.resources import models_dir
from vpptwin.twin.robot.losses import take_out_losses

LENGTH, EVERY = 0.5, 1.0
"""Of a sequence, and from one to the next [s]."""
ITERATIONS = 5
LEAST = 4.0
"""Standard errors by which a parameter must change to be blamed."""
JOINTS = ("rail_x", "rail_z", "pitch")


def name_by_sysid(flights: Sequence[Flight]) -> str:
    """The effect whose parameter leaves its nominal by most standard errors."""
    logging.set_verbosity(logging.ERROR)  # it warns of every window that the model has no sensors
    spec = mujoco.MjSpec.from_file(str(models_dir() / "rail_rig.xml"))
    take_out_losses(spec, JOINTS)
    model = spec.compile()
    sequences = [s for flight in flights for s in cut_sequences(prepare_track(flight), model)]
    starts, controls, measured = zip(*sequences)
    names = [f"window {i}" for i in range(len(starts))]
    group = sysid.ModelSequences("rig", spec, names, starts, controls, measured, allow_missing_sensors=True)
    threads = len(os.sched_getaffinity(0))
    residual = sysid.build_residual_fn(models_sequences=[group], modify_residual=weigh, n_threads=threads)
    parameters = list_parameters()
    begin = parameters.copy().move_off_bounds()
    with redirect_stdout(io.StringIO()):  # it prints every iteration
        fitted, result = sysid.optimize(begin, residual, verbose=False, max_iters=ITERATIONS, x_scale="jac")
    misses, _, _ = residual(result.x, fitted)
    covariance, _ = sysid.calculate_intervals([np.ravel(m) for m in misses], result.jac)
    change = (fitted.as_vector() - parameters.as_nominal_vector()) / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    change = np.where(np.isfinite(change), np.abs(change), 0.0)
    return list(parameters.keys())[int(np.argmax(change))] if change.max() > LEAST else ""


def cut_sequences(track: Track, model: mujoco.MjModel) -> list[tuple[np.ndarray, sysid.TimeSeries, sysid.TimeSeries]]:
    """Start state, thrust of the nominal rotors and measured pose of each window."""
    sequences = []
    for begin in np.arange(30, len(track.time) - round(100 * LENGTH) - 2, round(100 * EVERY)):
        start = track.time[begin]
        run = slice(*np.searchsorted(track.fast, (start - 1e-9, start + LENGTH + 1e-9)))
        control = sysid.TimeSeries.from_control_names(track.fast[run] - start, track.thrust[run], model)
        seen = slice(begin + 1, begin + round(100 * LENGTH))
        joints = [(f"{joint}_qpos", sysid.SignalType.MjStateQPos) for joint in JOINTS]
        pose = sysid.TimeSeries.from_names(track.time[seen] - start, track.pose[seen], model, joints)
        state = sysid.create_initial_state(model, track.smooth[begin], track.velocity[begin])
        sequences.append((state, control, pose))
    return sequences


def weigh(
    params: sysid.ParameterDict,
    predicted: sysid.TimeSeries,
    measured: sysid.TimeSeries,
    model: mujoco.MjModel,
    return_all: bool,
    state: np.ndarray,
    **_: object,
) -> tuple[np.ndarray, sysid.TimeSeries, sysid.TimeSeries]:
    """Misses over sensor noise; sysid's own division by each window's norm would weigh windows by where they are."""
    mocap = VEHICLE.sensors.mocap
    flown = np.stack([np.interp(measured.times, state[:, 0], state[:, 1 + i]) for i in range(3)], axis=1)
    noise = np.array([mocap.position_std, mocap.position_std, mocap.angle_std])
    return (flown - measured.data) / noise, measured, measured


def list_parameters() -> sysid.ParameterDict:
    """Masses, inertia, friction, damping, thrust gain and asymmetry, each under the id of its effect."""
    found = sysid.ParameterDict()

    def add(
        effect: str, nominal: float, low: float, high: float, change: Callable[[mujoco.MjSpec, float], None]
    ) -> None:
        def modify(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
            change(spec, float(parameter.value[0]))

        found.add(sysid.Parameter(effect, nominal, low, high, modifier=modify))

    def set_joint(joint: str, name: str) -> Callable[[mujoco.MjSpec, float], None]:
        def change(spec: mujoco.MjSpec, value: float) -> None:
            now = getattr(spec.joint(joint), name)  # damping is a polynomial of speed
            setattr(spec.joint(joint), name, value if np.ndim(now) == 0 else np.array([value, 0.0, 0.0]))

        return change

    def set_mass(body: str) -> Callable[[mujoco.MjSpec, float], None]:
        return lambda spec, value: setattr(spec.body(body), "mass", value)

    def set_inertia(spec: mujoco.MjSpec, value: float) -> None:
        now = np.array(spec.body("craft").inertia)
        spec.body("craft").inertia = now * value / now[1]  # all three, as a body's must fit together

    def set_gain(spec: mujoco.MjSpec, value: float) -> None:
        for name in ("thrust_1", "thrust_2"):
            spec.actuator(name).gainprm[0] = value

    def set_asymmetry(spec: mujoco.MjSpec, value: float) -> None:
        for name, sign in (("thrust_1", 1.0), ("thrust_2", -1.0)):
            spec.actuator(name).gainprm[0] *= 1.0 + sign * value

    airframe, rig = VEHICLE.airframe, VEHICLE.rig
    add("airframe.mass", airframe.mass, 0.3, 0.6, set_mass("craft"))
    add("airframe.inertia", airframe.inertia, 0.003, 0.009, set_inertia)
    add("carriage.mass", rig.carriage_mass, 0.02, 0.3, set_mass("carriage"))
    for joint, most in (("rail_x", 2.0), ("rail_z", 2.0), ("pitch", 0.2)):
        add(f"{joint}.coulomb", 0.0, 0.0, most, set_joint(joint, "frictionloss"))
        add(f"{joint}.viscous", 0.0, 0.0, most, set_joint(joint, "damping"))
    add("rotor.thrust_gain", 1.0, 0.7, 1.3, set_gain)
    add("rotor.asymmetry", 0.0, -0.2, 0.2, set_asymmetry)
    return found
