"""The twin against the paper's equations, integrated independently: agreement within the step error, and its order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.effects.rigs import Rig
from tests.twin.reference import Paper
from vpptwin.twin import Twin, TwinSpec, load_twin

HOLD = 0.05
"""Random commands are held for this long [s]; a whole number of every step used here."""
NOMINAL = load_twin().vehicle
assert NOMINAL is not None
RIG_MASS = (
    NOMINAL.airframe.mass + NOMINAL.rig.slider_mass + NOMINAL.rig.carriage_mass,
    NOMINAL.airframe.mass + NOMINAL.rig.slider_mass,
)
MASSES = {"vpp_planar": (NOMINAL.airframe.mass,) * 2, "rail_rig": RIG_MASS}

Effects = Mapping[str, Mapping[str, float]]
EFFECTS: dict[str, Effects] = {
    "none": {},
    "viscous": {"rail_x.viscous": {"damping": 0.8}, "rail_z.viscous": {"damping": 0.4}},
    "bias": {"rail_x.bias": {"force": 0.4}, "rail_z.bias": {"force": -0.6}},
    "drag": {"air.drag": {"k_d": 0.2}},
    "gain": {"rotor.thrust_gain": {"gain": 1.15}},
    "asymmetry": {"rotor.asymmetry": {"fraction": 0.03}},
    "delay": {"command.delay": {"delay": 0.013}},
    "lag": {"servo.lag": {"time_constant": 0.035}},
    "mass": {"airframe.mass": {"mass": 0.08}},
    "inertia": {"airframe.inertia": {"inertia": 0.0015}},
}
EFFECTS["all"] = {effect_id: values for effects in EFFECTS.values() for effect_id, values in effects.items()}


def write_paper(model: str, effects: Effects) -> Paper:
    """The paper's equations with the numbers of the vehicle and these effects."""
    assert NOMINAL is not None

    def value(effect_id: str, parameter: str, off: float = 0.0) -> float:
        return effects.get(effect_id, {}).get(parameter, off)

    mass_x, mass_z = MASSES[model]
    added = value("airframe.mass", "mass")
    return Paper(
        mass=(mass_x + added, mass_z + added),
        inertia=NOMINAL.airframe.inertia + value("airframe.inertia", "inertia"),
        arm=NOMINAL.airframe.half_length,
        gravity=NOMINAL.gravity,
        k_t=NOMINAL.rotor.k_t,
        time_constant=value("servo.lag", "time_constant", NOMINAL.servo.time_constant),
        delay=value("command.delay", "delay"),
        gain=value("rotor.thrust_gain", "gain", 1.0),
        fraction=value("rotor.asymmetry", "fraction"),
        bias=(value("rail_x.bias", "force"), value("rail_z.bias", "force")),
        damping=(value("rail_x.viscous", "damping"), value("rail_z.viscous", "damping")),
        drag=value("air.drag", "k_d"),
    )


@dataclass(frozen=True)
class Flights:
    """K random flights: pose and velocity at the start (K, 3), commands (K, M, 2), rotor speed (K, 2)."""

    pose: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    speed: np.ndarray

    @classmethod
    def draw(cls, count: int, seconds: float, seed: int) -> Flights:
        """Any attitude, up to 1 m/s and 5 rad/s, blades at 0.02 to 0.18 rad, rotors at 440 to 500 rad/s."""
        rng, intervals = np.random.default_rng(seed), round(seconds / HOLD)
        pose = rng.uniform([-0.2, 1.65, -np.pi], [0.2, 1.75, np.pi], (count, 3))
        velocity = rng.uniform(-1, 1, (count, 3)) * [1.0, 1.0, 5.0]
        both = rng.uniform(0.05, 0.15, (count, intervals, 1))
        command = both + rng.uniform(-0.03, 0.03, (count, intervals, 2))
        return cls(pose, velocity, command, rng.uniform(440, 500, (count, 2)))


def replay(spec: TwinSpec, flights: Flights) -> tuple[np.ndarray, np.ndarray]:
    """Poses and velocities of the twin at 0, HOLD/5, 2 HOLD/5, ..., (T, K, 3)."""
    twin = Twin(spec, len(flights.pose), num_threads=1)
    per = round(HOLD / twin.dt)
    start = twin.initial_state(qpos=twin.pose_for_engine(flights.pose, flights.velocity), qvel=flights.velocity)
    commands = np.repeat(flights.command, per, axis=1)
    _, qpos, qvel, _ = twin.replay_commands(
        start, commands, np.repeat(flights.speed[:, None], commands.shape[1], axis=1)
    )
    every = slice(per // 5 - 1, None, per // 5)
    pose = np.concatenate([flights.pose[:, None], twin.pose_at_time(qpos, qvel)[:, every]], axis=1)
    velocity = np.concatenate([flights.velocity[:, None], qvel[:, every]], axis=1)
    return pose.swapaxes(0, 1), velocity.swapaxes(0, 1)


def bound_error(
    paper: Paper, velocity: np.ndarray, acceleration: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """What one may blame on the step: bounds of the errors of pose and velocity, (T, K, 3), from the reference.

    Rate is exact, as the mean torque is. The angle is a trapezoid sum of it, off by dt²/12 times the change of q̇.
    Position and velocity follow a mean thrust in the direction of the angle at the middle of the step. That angle is
    off by dt² q̇/8 besides, and the mean of f sin θ differs from the product by dt²/24 (f (q̇ + q²) + 2 ḟ q). Damping
    and drag act with the velocity at one end of the step: dt/2 times their rate of change.
    """
    step = HOLD / 5
    total = paper.gain * 2 * paper.k_t * 500.0 * 0.18  # N, of both rotors
    growth = total / paper.time_constant  # N/s, after the largest step of the command
    rate, turn = np.abs(velocity[..., 2]), np.abs(acceleration[..., 2]).max(axis=0)  # turn jumps with the rotor speed
    angle = dt**2 / 6 * turn * np.ones_like(rate)
    slack = total * (angle + dt**2 / 8 * turn) + dt**2 / 24 * (total * (turn + rate**2) + 2 * growth * rate)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    pose, moved = np.empty_like(velocity), np.empty_like(velocity)
    for i in range(2):
        accel = np.abs(acceleration[..., i]).max(axis=0) + np.abs(acceleration[..., 1 - i]).max(axis=0)
        wrong = slack + 0.5 * dt * (paper.damping[i] + 2 * paper.drag * speed) * accel
        moved[..., i] = np.cumsum(wrong, axis=0) * step / paper.mass[i]
        pose[..., i] = np.cumsum(moved[..., i], axis=0) * step + dt**2 / 6 * accel
    pose[..., 2], moved[..., 2] = angle, 1e-9
    return pose + 1e-9, moved + 1e-9  # what scipy leaves


@pytest.fixture(scope="module")
def specs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, TwinSpec]:
    """The free craft and the rig, both with the nominal vehicle."""
    folder: Path = tmp_path_factory.mktemp("specs")
    for model in MASSES:
        (folder / f"{model}.yaml").write_text(f"model: {model}.xml\nvehicle: vehicle.yaml\n")
    return {model: load_twin(folder / f"{model}.yaml") for model in MASSES}


@pytest.mark.parametrize(
    ("model", "count", "seconds", "effects"),
    [
        ("vpp_planar", 100, 1.0, "none"),
        ("vpp_planar", 100, 1.0, "all"),
        *(("vpp_planar", 40, 0.4, effects) for effects in EFFECTS if effects not in ("none", "all")),
        *(("rail_rig", 40, 0.25, effects) for effects in EFFECTS),
    ],
)
def test_twin_agrees_with_the_paper(
    specs: dict[str, TwinSpec], model: str, count: int, seconds: float, effects: str
) -> None:
    """From random states under random commands the twin stays within its step error of the paper's equations."""
    paper, flights = write_paper(model, EFFECTS[effects]), Flights.draw(count, seconds, seed=11)
    true_pose, true_velocity, acceleration = paper.fly(
        flights.pose, flights.velocity, flights.command, flights.speed, HOLD
    )
    spec = specs[model].with_effects(EFFECTS[effects])
    pose, velocity = replay(spec, flights)
    pose_bound, velocity_bound = bound_error(paper, true_velocity, acceleration, dt=0.001)
    assert (np.abs(pose - true_pose) <= pose_bound).all()
    assert (np.abs(velocity - true_velocity) <= velocity_bound).all()
    assert pose_bound[..., :2].max() < 0.05 * seconds**2  # m, of metres flown at up to 20 m/s


@pytest.mark.parametrize("effects", [*EFFECTS, "delay by a fraction"])
def test_error_shrinks_with_the_step(specs: dict[str, TwinSpec], effects: str) -> None:
    """Half the step leaves a quarter of the error, or half of it where forces depend on velocity."""
    switched_on = EFFECTS.get(effects, {"command.delay": {"delay": 0.0137}})  # 13.7 steps, then 27.4
    paper, flights = write_paper("vpp_planar", switched_on), Flights.draw(20, 0.4, seed=12)
    true_pose, true_velocity, _ = paper.fly(flights.pose, flights.velocity, flights.command, flights.speed, HOLD)
    rig = Rig("replayed", specs["vpp_planar"].with_effects(switched_on), (), (), (), ())
    errors = []
    for dt in (0.001, 0.0005):
        pose, velocity = replay(rig.with_step(dt).spec, flights)
        errors.append(np.sqrt([np.mean((pose - true_pose) ** 2), np.mean((velocity - true_velocity)[..., :2] ** 2)]))
    order = 1 if effects in ("viscous", "drag", "all") else 2
    np.testing.assert_allclose(errors[0] / errors[1], 2.0**order, rtol=0.15)


def test_a_wrong_equation_would_show(specs: dict[str, TwinSpec]) -> None:
    """The bound is tight enough to tell half a millisecond of delay or 0.2 % of inertia from nothing."""
    flights = Flights.draw(20, 0.4, seed=13)
    right = write_paper("vpp_planar", {})
    truth, velocity, acceleration = right.fly(flights.pose, flights.velocity, flights.command, flights.speed, HOLD)
    bound, _ = bound_error(right, velocity, acceleration, dt=0.001)
    for wrong in (replace(right, delay=0.0005), replace(right, inertia=1.002 * right.inertia)):
        other, _, _ = wrong.fly(flights.pose, flights.velocity, flights.command, flights.speed, HOLD)
        assert (np.abs(other - truth) > bound).any(axis=(0, 2)).mean() > 0.9  # nearly every flight shows it
    spec = specs["vpp_planar"]
    assert (np.abs(replay(spec, flights)[0] - truth) <= bound).all()
