"""Thrust-stand runs of the independent simulation as logs (docs/logs.md).

One rotor, steps of pitch at several speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from proving.drone.control import Firmware
from proving.drone.effects import Effects
from proving.drone.rig import load_nominal
from proving.drone.rotor import STEP
from proving.drone.thrust_stand import ThrustStand
from vpptwin.logs.flight import Stream
from vpptwin.logs.write import write_flight

THRUST_STD, TORQUE_STD = 0.02, 5e-4  # N, N m: noise of the stand's load cell
PITCHES = (0.0, 0.05, -0.05, 0.1, -0.1, 0.15, -0.15, 0.2, -0.2, 0.075, -0.075, 0.125, -0.125, 0.025, -0.025)
"""What is commanded in turn [rad]."""


def write_bench(
    path: Path,
    effects: Effects,
    seed: int,
    *,
    speeds: Sequence[float] = (420.0, 471.2, 520.0),
    pitches: Sequence[float] = PITCHES,
    hold: float = 0.6,
    curve: Callable[[np.ndarray], np.ndarray] | None = None,
    torque: bool = False,
    leave_out: str = "",
    jitter: bool = False,
) -> Path:
    """Drive rotor 1 through all pitches at each speed, rotor 2 at rest, and write what a stand's computer records.

    Args:
        path: Log to write.
        effects: Hidden.
        seed: Of noise.
        speeds: Held by the governor, rad/s.
        pitches: Commanded in turn at each speed, rad.
        hold: s at each.
        curve: See `ThrustStand`.
        torque: Whether the stand measures torque too.
        leave_out: A topic that is not recorded.
        jitter: Whether the actuator differs from nominal within tolerance.
    """
    plan = [(speed, pitch) for speed in speeds for pitch in pitches]
    each = round(hold / STEP)
    steps = each * len(plan)
    stand = ThrustStand([effects], seed, steps, jitter=jitter, curve=curve)
    governor = Firmware(load_nominal(), 1)
    names = ("pitch", "throttle", "speed", "current")
    rows: dict[str, np.ndarray] = {name: np.zeros((steps, 2)) for name in names}
    thrust, load = np.zeros(steps), np.zeros(steps)
    for k in range(steps):
        governor.speed, wanted = plan[k // each]
        now = stand.read()
        pitch = np.array([[wanted], [0.0]])
        throttle = governor._govern(pitch, now.speed)
        throttle[1] = 0.0  # rotor 2 is not driven
        stand.advance(pitch, throttle)
        rows["pitch"][k], rows["throttle"][k] = pitch[:, 0], throttle[:, 0]
        rows["speed"][k] = now.speed[0, 0], 0.0
        rows["current"][k] = now.current[0, 0], 0.0
        thrust[k] = now.thrust[0, 0]
        load[k] = (stand.motor.compute_current()[0, 0] - stand.motor.no_load) / stand.motor.k_q
    random = np.random.default_rng([seed, 9])
    time = np.arange(steps) * STEP
    wrench = {"force_z": thrust + THRUST_STD * random.standard_normal(steps)}
    if torque:
        wrench["torque_z"] = -load + TORQUE_STD * random.standard_normal(steps)
    every = slice(None, None, 2)  # a load cell at 500 Hz
    streams = {
        "/rotor/command": Stream(time, {"blade_pitch": rows["pitch"], "throttle": rows["throttle"]}),
        "/rotor/state": Stream(time, {"speed": rows["speed"], "current": rows["current"]}),
        "/thrust_stand/wrench": Stream(time[every], {name: values[every] for name, values in wrench.items()}),
    }
    write_flight(path, {topic: stream for topic, stream in streams.items() if topic != leave_out})
    return path
