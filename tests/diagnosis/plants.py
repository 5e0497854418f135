"""One joint of any size under laws of our own, simulated without MuJoCo: light or heavy, driven or let go."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from tests.diagnosis.rigs import BOB, LENGTH, LOG_EVERY, STEP, UNDRIVEN, Case, Track

WIDTH = 0.05
"""Speed of Stribeck's curve [m/s]."""
PUSHES, ALIKE = 0.002, 0.3
"""What pushes besides, as a share of the drive's force, 1 sigma, and over which time it is alike [s]."""
SLIDE = """<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{mass:g}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" gear="1"/></actuator>
</mujoco>"""


@dataclass(frozen=True)
class Plant:
    """A joint and what its twin leaves out."""

    mass: float  # or moment of inertia [kg, kg m²]
    viscous: float = 0.0  # damping [N s/m]
    coulomb: float = 0.0  # dry friction when it slides [N]
    breakaway: float = 0.0  # by which dry friction is larger at rest [N]
    bias: float = 0.0  # constant force [N]
    hum: float = 0.0  # amplitude of a force of 0.8 Hz, which no effect of the catalogue is [N]
    weight: float = 0.0  # torque of gravity at a right angle [N m]
    drive: float = 0.0  # force of its motor at most [N]; 0 for none
    reach: float = 0.5  # of its references [m]
    duration: float = 24.0  # of its log [s]


@cache
def move(plant: Plant, seed: int, start: float = 0.0) -> Track:
    """A plant after steps of its reference every 1.2 s, or let go from a start, under slight pushes.

    Dry friction is Karnopp's: at rest it stays exactly at rest below breakaway, and where the velocity would cross zero
    it stops first.
    """
    rng = np.random.default_rng(seed)
    count = round(plant.duration / STEP / LOG_EVERY)
    goals = np.repeat(rng.uniform(-plant.reach, plant.reach, count // 240 + 1), 240)[:count]
    keep = math.exp(-LOG_EVERY * STEP / ALIKE)
    spread = PUSHES * (plant.drive or plant.weight) * math.sqrt(1.0 - keep**2)
    log, x, v, pushed = np.empty((count, 3)), start, 0.0, 0.0
    m, b, sliding, more, w = plant.mass, plant.viscous, plant.coulomb, plant.breakaway, plant.weight
    for i, noise in enumerate(rng.standard_normal(count)):
        control = 25.0 * m * (goals[i] - x) - 9.0 * m * v if plant.drive else 0.0
        control = min(max(control, -plant.drive), plant.drive)
        pushed = keep * pushed + spread * noise
        log[i] = x, v, control
        held = control + pushed + plant.bias + plant.hum * math.sin(2.0 * math.pi * 0.8 * i * LOG_EVERY * STEP)
        for _ in range(LOG_EVERY):
            push = held - b * v
            if w:
                push -= w * math.sin(x)
            rubs = sliding + more * math.exp(-((v / WIDTH) ** 2)) if more else sliding
            if v == 0.0 and abs(push) <= rubs:
                continue
            ahead = v + STEP * (push - math.copysign(rubs, v if v else push)) / m
            if v * ahead < 0.0:
                x, v = x + 0.5 * STEP * v, 0.0
            else:
                x, v = x + 0.5 * STEP * (v + ahead), ahead
    return log[:, 0], log[:, 1], log[:, 2]


def slider(plant: Plant, noise: tuple[float, float] = (3e-4, 3e-3)) -> Case:
    """A case of `rigs.record` of a plant that slides; sensors' noise in m and m/s."""
    return Case(SLIDE.format(mass=plant.mass), "slide", lambda _, seed: move(plant, seed), noise)


def let_go(coulomb: float) -> Case:
    """The bob of `rigs` let go from 1.2 rad, with dry friction [N m] in its pivot."""
    plant = Plant(BOB * LENGTH**2, coulomb=coulomb, weight=BOB * 9.81 * LENGTH, duration=12.0)

    def swing(_: float, seed: int) -> Track:
        angle, rate, torque = move(plant, seed, 1.2)
        return angle, rate, torque[:, None][:, :0]

    return Case(UNDRIVEN, "swing", swing, (1e-3, 1e-2))
