"""What holds for every effect: an effect that joins the catalogue is tested here without another line.

The drone is flown through the whole cascade and replayed under blade pitches; the generic effects act on a cart with
a pendulum and a motor.
"""

from __future__ import annotations

import io
from dataclasses import fields
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from tests.effects.rigs import CONTROL, Rig, Track, enlarge, switch_on
from vpptwin.actuators.layer import ActuatorState
from vpptwin.effects import Stage
from vpptwin.effects.base import Plant
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.constants import nominal_constants
from vpptwin.twin.model import locate_effect

LAYER = tuple(f.name for f in fields(ActuatorState) if f.name != "history")  # as deep as an effect needs it


def assert_same(first: Track, second: Track) -> None:
    """Bit-equal in everything that evolves."""
    for a, b in zip(first.states, second.states, strict=True):
        for name in ("time", "qpos", "qvel", "warmstart"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        for name in LAYER:
            np.testing.assert_array_equal(getattr(a.actuators, name), getattr(b.actuators, name), err_msg=name)


def save(state: TwinState) -> bytes:
    """A state as the bytes of an .npz file."""
    top = {f.name: getattr(state, f.name) for f in fields(state) if f.name != "actuators"}
    layer = {f"actuators.{f.name}": getattr(state.actuators, f.name) for f in fields(state.actuators)}
    file = io.BytesIO()
    np.savez(file, **top, **layer)
    return file.getvalue()


def restore(content: bytes) -> TwinState:
    """The state in the bytes of an .npz file."""
    arrays = dict(np.load(io.BytesIO(content)))
    layer = {f.name: arrays.pop(f"actuators.{f.name}") for f in fields(ActuatorState)}
    return TwinState(**arrays, actuators=ActuatorState(**layer))


def model_arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Every array of floats in a model, by name."""
    named = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {k: v for k, v in named.items() if isinstance(v, np.ndarray) and v.dtype == float and v.size}


def test_off_is_bit_equal_to_absent(rig: Rig, effect_id: str) -> None:
    """At its off value an effect changes no bit of a rollout."""
    without, off = Twin(rig.spec, 3, num_threads=1), Twin(rig.spec, 3, active=[effect_id], num_threads=1)
    assert_same(rig.roll(without, rig.start(without, 1)), rig.roll(off, rig.start(off, 1)))


def test_all_off_is_bit_equal_to_nothing(rig: Rig) -> None:
    """With every effect at its off value a rollout is bit-equal to one of the bare rig."""
    without = Twin(rig.spec, 3, num_threads=1)
    off = Twin(rig.spec, 3, active=[e.id for e in rig.spec.catalogue], num_threads=1)
    assert_same(rig.roll(without, rig.start(without, 1)), rig.roll(off, rig.start(off, 1)))


def test_large_value_moves_a_signal_it_names(rig: Rig, effect_id: str) -> None:
    """At five times its size an effect moves at least one signal that it names by more than three sensor sigmas."""
    off, large = Twin(rig.spec, 4, active=[effect_id], num_threads=1), switch_on(rig, 4, effect_id)
    before, after = (rig.roll(twin, rig.start(twin, 2), count=40) for twin in (off, large))
    moved = {topic: np.abs(after.show(topic) - before.show(topic)).max() for topic in shown(rig, effect_id)}
    assert max(moved.values()) > 3.0, moved


def shown(rig: Rig, effect_id: str) -> list[str]:
    """Topics that an effect names, as far as this rig has them."""
    drone = rig.spec.vehicle is not None
    return [t for t in rig.effect(effect_id).shows if (t == "/joint_states") != drone]


@pytest.mark.concerns("replayed", "cart")
def test_shorter_steps_converge(rig: Rig, effect_id: str) -> None:
    """Quartering the time step twice brings rollouts together as fast as the order of the scheme allows."""
    tracks = []
    for dt in (0.002, 0.0005, 0.000125):
        finer = rig.with_step(dt)
        twin = switch_on(finer, 32, effect_id)  # many, as the instant at which one sticks is a matter of luck
        tracks.append(rig.roll(twin, rig.start(twin, 3), count=20).pose)
    coarse, fine = (np.sqrt(np.mean((b - a) ** 2)) for a, b in pairwise(tracks))
    # Forces that depend on time and position are means over the step, second order: 16 times closer. What depends on
    # velocity enters at one end of the step, first order: 4 times closer; so do the pendulum's centrifugal forces, and
    # the instants at which dry friction sticks.
    first_order = rig.effect(effect_id).dissipative or rig.name == "cart"
    assert coarse / fine > (2.0 if first_order else 14.0)
    assert 1e-12 < coarse < 1e-3  # m, rad, of some 0.1: and what it converges to is near


@pytest.mark.concerns("replayed", "cart", only=lambda effect: effect.dissipative)
def test_dissipative_effects_never_add_energy(rig: Rig, effect_id: str) -> None:
    """Moving freely, a rig never has more energy than 10 ms before, and ends with less than without the effect."""
    bare, braked = Twin(rig.spec, 24, num_threads=1), switch_on(rig, 24, effect_id)
    free, damped = (energy(rig, rig.roll(twin, rig.start(twin, 4), count=25, powered=False)) for twin in (bare, braked))
    # Free flight conserves energy to rounding, a pendulum's first-order scheme only about; friction may change sign
    # within a step, by b (g dt)² dt < 1e-6 J.
    drift = np.abs(np.diff(free, axis=0)).max() + 1e-6
    assert drift < (2e-6 if rig.name == "replayed" else 5e-3)
    assert np.diff(damped, axis=0).max() < drift
    assert (damped[-1] < free[-1] + drift).all()
    assert np.median(damped[-1] - free[-1]) < -3 * drift


def energy(rig: Rig, track: Track) -> np.ndarray:
    """Kinetic and potential energy, (T, N) J."""
    model, data = rig.spec.model, mujoco.MjData(rig.spec.model)
    total = np.empty(track.pose.shape[:2])
    for (k, i), _ in np.ndenumerate(total):
        data.qpos[:], data.qvel[:] = track.pose[k, i], track.velocity[k, i]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        total[k, i] = data.energy.sum()
    return total


def test_row_of_a_batch_equals_the_single_run(rig: Rig, effect_id: str) -> None:
    """Each of four simulations, one at the off value, evolves bit for bit as it does alone."""
    times = np.array([0.0, 2.0, 5.0, 8.0])
    together = switch_on(rig, 4, effect_id, times)
    batch = rig.roll(together, rig.start(together, 5))
    for i in range(4):
        alone = switch_on(rig, 1, effect_id, times[i])
        single = rig.roll(alone, rig.start(alone, 5, total=4, first=i))
        row = Track(together, [s.take(np.array([i])) for s in batch.states])
        assert_same(single, row)


def test_declares_what_it_writes(rig: Rig, effect_id: str) -> None:
    """An effect changes exactly the constants that it declares, and neither its parameters nor the rig's model."""
    effect, model = rig.effect(effect_id), rig.spec.model
    before = {k: v.copy() for k, v in model_arrays(model).items()}
    nominal = {k: np.repeat(v[None], 3, axis=0) for k, v in before.items()} | nominal_constants(rig.spec, 3)
    table = {k: v.copy() for k, v in nominal.items()}
    site = locate_effect(model, effect, rig.spec.vehicle is not None)
    parameters = {p.name: np.full(3, enlarge(p)) for p in effect.parameters}
    for value in parameters.values():
        value.flags.writeable = False
    if effect.stage is Stage.CONSTANT:
        effect.apply(table, site, **parameters)
    changed = {name for name in table if not np.array_equal(table[name], nominal[name], equal_nan=True)}
    assert changed == set(effect.writes)
    twin = switch_on(rig, 3, effect_id)
    rig.roll(twin, rig.start(twin, 6), count=2)
    for name, value in model_arrays(model).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


@pytest.mark.concerns(only=lambda effect: effect.stage is not Stage.CONSTANT)
def test_per_step_effects_are_pure(rig: Rig, effect_id: str) -> None:
    """An effect that acts every step returns a new array, the same for the same arguments, and writes to none."""
    effect = rig.effect(effect_id)
    model, rng = rig.spec.model, np.random.default_rng(8)
    width = model.nu if effect.stage is Stage.THRUST else model.nv
    total, plant = rng.normal(size=(3, width)), Plant(*(rng.normal(size=(3, n)) for n in (model.nq, model.nv, 2, 2)))
    parameters = {p.name: np.full(3, enlarge(p)) for p in effect.parameters}
    for array in (total, plant.qpos, plant.qvel, plant.rotor_speed, plant.blade_pitch, *parameters.values()):
        array.flags.writeable = False  # writing would raise
    site = locate_effect(model, effect, rig.spec.vehicle is not None)
    first, second = (effect.apply_step(total, plant, site, parameters) for _ in range(2))
    assert first.shape == total.shape
    assert not np.shares_memory(first, total)
    assert not np.array_equal(first, total)
    np.testing.assert_array_equal(first, second)


def test_leaves_no_trace(rig: Rig, effect_id: str) -> None:
    """Set, flown and set back, an effect leaves a twin bit-equal to one that never had it."""
    fresh, used = Twin(rig.spec, 3, num_threads=1), switch_on(rig, 3, effect_id)
    rig.roll(used, rig.start(used, 9))
    for p in rig.effect(effect_id).parameters:
        used.set_parameter(effect_id, p.name, p.off)
    assert_same(rig.roll(fresh, rig.start(fresh, 1)), rig.roll(used, rig.start(used, 1)))


def test_value_counts_not_history(rig: Rig, effect_id: str) -> None:
    """Parameters set twice, row by row, act as if set once: they start from nominal, not from the last draw."""
    once, often = switch_on(rig, 3, effect_id, np.array([1.0, 3.0, 5.0])), switch_on(rig, 3, effect_id, 8.0)
    rig.roll(often, rig.start(often, 9), count=5)
    for p in rig.effect(effect_id).parameters:
        often.set_parameter(effect_id, p.name, enlarge(p, 3.0), ids=np.array([1]))
        often.set_parameter(effect_id, p.name, np.array([enlarge(p, 1.0), enlarge(p, 5.0)]), ids=np.array([0, 2]))
    assert_same(rig.roll(once, rig.start(once, 1)), rig.roll(often, rig.start(often, 1)))


def test_saved_and_restored_continues_bit_equal(rig: Rig, effect_id: str) -> None:
    """Saved to a file mid-flight and put into another twin, a state continues bit-equal, history included."""
    twin, other = switch_on(rig, 3, effect_id), switch_on(rig, 3, effect_id)
    middle = rig.roll(twin, rig.start(twin, 10), count=12).last
    saved = save(middle)
    rest = rig.roll(twin, middle, first=12, count=12)
    rig.roll(other, rig.start(other, 11), count=3)
    resumed = rig.roll(other, restore(saved), first=12, count=12)
    assert_same(rest, resumed)
    np.testing.assert_array_equal(rest.last.actuators.history, resumed.last.actuators.history)
    assert resumed.last.time == pytest.approx(24 * CONTROL)
