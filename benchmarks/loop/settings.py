"""What is hidden in the independent simulation: three settings, each a rig whose effects are drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from proving.drone.rig import draw_tolerances, load_nominal
from proving.policy_flights import Effects, Sky, read_drone
from vpptwin.train.env.tasks import Task

TASK = ("task=flip", "task.target.z=[0.75,1.5]")
"""What every policy trains: flips whose targets reach down to where the floor's cushion of air is felt."""
LOW = (0.75, 0.95)
"""Heights that targets have where a setting is about the floor [m]."""


@dataclass(frozen=True)
class Setting:
    """Effects that a rig has and the twin lacks."""

    name: str  # in file names and tables
    title: str  # in words
    ranges: dict[str, dict[str, tuple[float, float]]]  # effect → parameter → low and high end of what is drawn, SI
    low: bool = False  # flights stay near the floor


SETTINGS = (
    Setting(
        "stiction",
        "rail stiction, servo lag",
        {
            "rail_x.coulomb": {"force": (0.35, 0.5)},
            "rail_x.stiction": {"force": (0.3, 0.4), "velocity": (0.04, 0.08)},
            "servo.lag": {"time_constant": (0.04, 0.05)},
        },
    ),
    Setting(
        "backlash",
        "backlash, weak asymmetric rotor",
        {
            "servo.backlash": {"gap": (0.010, 0.015)},
            "rotor.thrust_gain": {"gain": (0.85, 0.9)},
            "rotor.asymmetry": {"fraction": (-0.08, -0.05)},
        },
    ),
    Setting(
        "delay",
        "delay, ground effect",
        {
            "command.delay": {"delay": (0.010, 0.015)},
            "air.ground_effect": {"gain": (0.35, 0.4), "height": (0.35, 0.4)},
        },
        low=True,
    ),
)

STUCK = Setting(
    "stuck",
    "a slider that sticks and jams",
    {
        "rail_x.stiction": {"force": (0.25, 0.4), "velocity": (0.04, 0.08)},
        "rail_x.jamming": {"mu": (0.01, 0.02)},
    },
)
"""The rig that the paper blames for its steady-state errors: the auxiliary one that gets stuck."""


@dataclass(frozen=True)
class Rig:
    """One rig."""

    setting: Setting  # it comes from
    hidden: Effects  # effect → parameter → value
    session: int  # seed of its build tolerances
    controller: str = "own"  # of its actuators, as `Sky` says

    @property
    def sky(self) -> Sky:
        """What its flights go through: gusts, noise, dropouts, its effects and tolerances."""
        return Sky(rig=self.hidden, session=self.session, controller=self.controller)

    def choose_task(self, task: Task) -> Task:
        """The task as it is flown here."""
        return replace(task, target=replace(task.target, z=LOW)) if self.setting.low else task


def draw_rig(setting: Setting, seed: int) -> Rig:
    """The rig of a setting and seed."""
    rng = np.random.default_rng([seed, *setting.name.encode()])
    hidden = {
        effect: {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}
        for effect, ranges in setting.ranges.items()
    }
    return Rig(setting, hidden, int(rng.integers(2**31)))


def tell_truth(rig: Rig) -> Effects:
    """The rig as the catalogue says it, its build tolerances included: what an oracle would train on."""
    catalogue, _ = read_drone()
    nominal, error = load_nominal(), draw_tolerances(rig.session)
    truth = {effect: dict(values) for effect, values in rig.hidden.items()}

    def add(effect: str, name: str, more: float = 0.0, factor: float = 1.0) -> None:
        values = truth.setdefault(effect, {p.name: p.off for p in catalogue[effect].parameters})
        values[name] = values[name] * factor + more

    add("airframe.mass", "mass", nominal["airframe"]["mass"] * error["mass"])
    add("airframe.inertia", "inertia", nominal["airframe"]["inertia"] * error["inertia"])
    add("rotor.thrust_gain", "gain", factor=1.0 + error["k_t"])
    add("rotor.asymmetry", "fraction", error["asymmetry"])
    if "servo.lag" not in truth:  # a hidden lag is the rig's own
        add("servo.lag", "time_constant", factor=1.0 + error["time_constant"])
    add("rail_x.coulomb", "force", error["friction_x"])
    add("rail_z.coulomb", "force", error["friction_z"])
    return truth
