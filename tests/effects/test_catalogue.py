"""What holds for every effect: an effect that joins the catalogue is tested here without another line.

The drone is flown through the whole cascade and replayed under blade pitches; the generic effects act on a cart with
a pendulum and a motor.
"""

from __future__ import annotations

import io
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from tests.effects.rigs import (
    CONTROL,
    START,
    Rig,
    Track,
    Values,
    bare,
    companions,
    enlarge,
    large_values,
    off_values,
    switch_off,
    switch_on,
)
from vpptwin.effects import Effect, Stage
from vpptwin.twin import TwinState


def assert_same(first: Track, second: Track) -> None:
    """Bit-equal in everything that evolves."""
    for a, b in zip(first.states, second.states, strict=True):
        others = b.arrays()
        for name, values in a.arrays().items():
            if not np.array_equal(values, others[name], equal_nan=values.dtype.kind == "f"):  # which is quick
                np.testing.assert_array_equal(values, others[name], err_msg=name)


def save(state: TwinState) -> bytes:
    """A state as the bytes of an .npz file."""
    file = io.BytesIO()
    np.savez(file, **state.arrays())  # type: ignore[arg-type]
    return file.getvalue()


def restore(content: bytes) -> TwinState:
    """The state in the bytes of an .npz file."""
    return TwinState.from_arrays(dict(np.load(io.BytesIO(content))))


def shown(rig: Rig, effect_id: str) -> list[str]:
    """Topics that an effect names, as far as this rig has them."""
    return [t for t in rig.effect(effect_id).shows if (t == "/joint_states") != rig.drone]


def test_off_is_bit_equal_to_absent(rig: Rig, effect_id: str) -> None:
    """At its off value an effect changes no bit of a rollout, nor of what the sensors show of it."""
    without, off = bare(rig, 3, effect_id), switch_off(rig, 3, effect_id)
    first, second = rig.roll(without, rig.start(without, 1)), rig.roll(off, rig.start(off, 1))
    assert_same(first, second)
    for topic in shown(rig, effect_id):
        np.testing.assert_array_equal(first.show(topic), second.show(topic), err_msg=topic)


def test_all_off_is_bit_equal_to_nothing(rig: Rig) -> None:
    """With every effect at its off value a rollout is bit-equal to one of the bare rig."""
    without, off = rig.twin(3), rig.twin(3, {e.id: {} for e in rig.spec.catalogue})
    assert_same(rig.roll(without, rig.start(without, 1)), rig.roll(off, rig.start(off, 1)))


def test_large_value_moves_a_signal_it_names(rig: Rig, effect_id: str) -> None:
    """At five times its size an effect moves at least one signal that it names by more than three sensor sigmas."""
    off, large = switch_off(rig, 4, effect_id), switch_on(rig, 4, effect_id)
    before, after = (rig.roll(twin, rig.start(twin, 2), count=40) for twin in (off, large))
    moved = {topic: np.abs(after.show(topic) - before.show(topic)).max() for topic in shown(rig, effect_id)}
    assert max(moved.values()) > 3.0, moved


def test_row_of_a_batch_equals_the_single_run(rig: Rig, effect_id: str) -> None:
    """Each of four simulations, one at the off value, evolves bit for bit as it does alone."""
    times = np.array([0.0, 2.0, 5.0, 8.0])
    together = switch_on(rig, 4, effect_id, times)
    batch = rig.roll(together, rig.start(together, 5))
    for i in (0, 2):
        alone = switch_on(rig, 1, effect_id, times[i])
        single = rig.roll(alone, rig.start(alone, 5, total=4, first=i))
        assert_same(single, Track(together, [s.take(np.array([i])) for s in batch.states]))


def test_leaves_no_trace(rig: Rig, effect_id: str) -> None:
    """Set, flown and set back, its rows reset, an effect leaves a twin bit-equal to one that never flew."""
    fresh, used = switch_off(rig, 3, effect_id), switch_on(rig, 3, effect_id)
    state = rig.roll(used, rig.start(used, 9)).last
    for name, value in off_values(rig, effect_id)[effect_id].items():
        used.set_parameter(effect_id, name, value)
    ids = np.arange(3)
    state.write_rows(ids, rig.start(used, 1))
    assert_same(rig.roll(fresh, rig.start(fresh, 1)), rig.roll(used, state))


def test_value_counts_not_history(rig: Rig, effect_id: str) -> None:
    """Parameters set twice, row by row, act as if set once: they start from nominal, not from the last draw."""
    once, often = switch_on(rig, 3, effect_id, np.array([1.0, 3.0, 5.0])), switch_on(rig, 3, effect_id, 8.0)
    rig.roll(often, rig.start(often, 9), count=5)
    for p in rig.effect(effect_id).parameters:
        often.set_parameter(effect_id, p.name, enlarge(p, 3.0), ids=np.array([1]))
        often.set_parameter(effect_id, p.name, np.array([enlarge(p, 1.0), enlarge(p, 5.0)]), ids=np.array([0, 2]))
    assert_same(rig.roll(once, rig.start(once, 1)), rig.roll(often, rig.start(often, 1)))


def test_saved_and_restored_continues_bit_equal(rig: Rig, effect_id: str) -> None:
    """Saved to a file in the middle of a command and put into another twin, a state continues bit-equal."""
    twin, other = switch_on(rig, 3, effect_id), switch_on(rig, 3, effect_id)
    middle = rig.advance(twin, rig.roll(twin, rig.start(twin, 10), count=6).last, 6, duration=0.004)
    saved = save(middle)
    rest = rig.roll(twin, middle, first=7, count=8)
    rig.roll(other, rig.start(other, 11), count=3)
    assert_same(rest, rig.roll(other, restore(saved), first=7, count=8))
    assert_same(rest, rig.roll(twin, middle.copy(), first=7, count=8))
    assert rest.last.time == pytest.approx(START + 0.144)


def draw_values(rig: Rig, num_sims: int) -> Values:
    """Every effect of a rig, parameters drawn from their priors, some at off."""
    rng = np.random.default_rng(12)
    return {
        effect.id: {
            p.name: np.where(rng.random(num_sims) < 0.2, p.off, p.draw(rng, num_sims)) for p in effect.parameters
        }
        for effect in rig.spec.catalogue
    }


def test_everything_at_once(rig: Rig) -> None:
    """With all effects on at random values rows equal single runs, and saved mid-flight they continue bit-equal."""
    values = draw_values(rig, 4)
    twin, other = rig.twin(4, values), rig.twin(4, values)
    track = rig.roll(twin, rig.start(twin, 5), count=20)
    middle = rig.advance(twin, track.last, 20, duration=0.007)
    saved, rest = save(middle), rig.roll(twin, middle, first=21)
    rig.roll(other, rig.start(other, 11), count=3)
    assert_same(rest, rig.roll(other, restore(saved), first=21))
    for i in range(4):
        alone = rig.twin(1, {e: {p: v[i] for p, v in given.items()} for e, given in values.items()})
        single = rig.roll(alone, rig.start(alone, 5, total=4, first=i), count=20)
        assert_same(single, Track(twin, [s.take(np.array([i])) for s in track.states]))


@pytest.mark.concerns("replayed")
def test_saved_while_stuck_in_play_and_delayed(rig: Rig) -> None:
    """Saved with sliders stuck, blades in the play of their horns and commands on their way, all goes on bit-equal."""
    values: Values = {
        "rail_x.coulomb": {"force": np.array(1.0)}, "rail_z.stiction": {"force": np.array(2.0)},
        "command.delay": {"delay": np.array(0.0153)}, "servo.backlash": {"gap": np.array(0.02)},
    }  # fmt: skip
    twin, other = rig.twin(2, values), rig.twin(2, values)
    start = twin.initial_state(time=START)
    for name in ("horn", "blade", "output", "mean", "history"):
        start.actuators[name] = 0.10  # rad: carries the craft, near enough
    calm = replace(rig, drives=(0.005, 0.005), trim=(0.10, 0.10))
    middle = calm.advance(twin, calm.roll(twin, start, count=3).last, 3, duration=0.004)
    layer = middle.actuators
    np.testing.assert_allclose(middle.qvel[:, :2], 0.0, atol=1e-12)
    np.testing.assert_array_equal(middle.qpos[:, :2], start.qpos[:, :2])
    assert (np.abs(layer["horn"] - layer["blade"]) < 0.01).any()  # strictly within the play
    assert len(np.unique(layer["history"][0, :, 0])) >= 3  # the start's and two commands
    rest = rig.roll(twin, middle, first=4)  # strong commands: the craft breaks loose
    assert_same(rest, rig.roll(other, restore(save(middle)), first=4))
    assert np.abs(rest.last.qpos[:, 1] - start.qpos[:, 1]).min() > 1e-3


SECOND_ORDER, SECOND_ORDER_KINKED, FIRST_ORDER, FIRST_ORDER_KINKED = 14.0, 10.0, 3.5, 2.3
"""How many times closer rollouts come, at least, whose steps are a quarter as long: 16 or 4 in the limit.

Forces that depend on time and position are means over the step: second order, what an effect is unless ORDERS says
otherwise. What depends on velocity enters at one end of the step: first order; so do the coupling
by a centre of mass off the hinge, and the pendulum's centrifugal forces. Where a force kinks or jumps, the instant is
known to within a step and falls anywhere in it: the order holds on average over 32 rollouts, with scatter.
"""
ORDERS = {
    "viscous": FIRST_ORDER, "elastic": FIRST_ORDER, "fade": FIRST_ORDER_KINKED, "drag": FIRST_ORDER,
    "rotor.inflow": FIRST_ORDER, "rotor.in_plane": FIRST_ORDER,
    "airframe.com": FIRST_ORDER, "airframe.com_height": FIRST_ORDER,
    "contact.compliance": FIRST_ORDER_KINKED, "contact.friction": FIRST_ORDER_KINKED,
    "servo.backlash": FIRST_ORDER_KINKED, "rotor.stall": SECOND_ORDER_KINKED,
    "rotor.negative_thrust": SECOND_ORDER_KINKED,
}  # fmt: skip
"""By id, or by what comes after the joint."""
POSE = {True: "/mocap/pose", False: "/joint_states"}


def expected_ratio(rig: Rig, effect: Effect) -> float:
    """How many times closer rollouts with this effect must come."""
    if effect.stage in (Stage.FRICTION, Stage.SLIP):
        return FIRST_ORDER_KINKED
    order = ORDERS.get(effect.id, ORDERS.get(effect.id.split(".")[-1], SECOND_ORDER))
    return order if rig.drone else min(order, FIRST_ORDER)


@pytest.mark.concerns("replayed", "cart")
def test_shorter_steps_converge(rig: Rig, effect_id: str) -> None:
    """Quartering the time step twice brings rollouts together as fast as the order of the scheme allows."""
    tracks = []
    longest = CONTROL / 32 if rig.effect(effect_id).touching else 0.002  # s: a hit lasts for some 10 ms
    for dt in (longest, longest / 4, longest / 16):
        finer = rig.with_step(dt)
        twin = switch_on(finer, 32, effect_id)  # many, as the instant at which one sticks is a matter of luck
        track = rig.roll(twin, finer.start(twin, 3), count=16)
        tracks.append([track.show(topic) for topic in {*shown(rig, effect_id), POSE[rig.drone]}])
    coarse, fine = (max(np.sqrt(np.mean((b - a) ** 2)) for a, b in zip(*pair)) for pair in pairwise(tracks))
    assert coarse / fine > expected_ratio(rig, rig.effect(effect_id)), coarse / fine
    assert coarse < 1.0  # sigma of a sensor: what it converges to is near


def brakes_by_itself(effect: Effect) -> bool:
    """Whether it takes energy out of a rig that nothing drives: gears without a drive carry no load."""
    return (effect.dissipative or effect.stage is Stage.FRICTION) and not effect.id.endswith(".load")


@pytest.mark.concerns("replayed", "cart", only=brakes_by_itself)
def test_dissipative_effects_never_add_energy(rig: Rig, effect_id: str) -> None:
    """Moving freely, a rig never has more energy than 10 ms before, and ends with less than without the effect."""
    # Only what pulls at the carriage loads the guide, so that it can jam: an elastic, whose energy counts.
    elastic = {"rail_x.spring": {"stiffness": np.array(STIFFNESS)}} if rig.drone else {}
    values = elastic | companions(rig, effect_id)
    free_twin, braked = rig.twin(24, elastic), rig.twin(24, values | large_values(rig, effect_id))
    free, damped = (
        energy(rig, rig.roll(twin, rig.start(twin, 4), count=25, powered=False)) for twin in (free_twin, braked)
    )
    # Free flight keeps its energy but for the leapfrog's (k/m) dt²/8 of the elastic's, a pendulum's first-order scheme
    # only about; friction may change sign within a step, by b (g dt)² dt < 1e-6 J.
    drift = np.abs(np.diff(free, axis=0)).max() + 1e-6
    assert drift < (4e-6 if rig.drone else 5e-3)
    assert np.diff(damped, axis=0).max() < drift
    assert (damped[-1] < free[-1] + 25 * drift).all()
    assert np.median(damped[-1] - free[-1]) < -3 * drift


STIFFNESS = 5.0
"""Of the elastic between rail and carriage [N/m]."""


def energy(rig: Rig, track: Track) -> np.ndarray:
    """Kinetic and potential energy, (T, N) J."""
    model, data = rig.spec.model, mujoco.MjData(rig.spec.model)
    total = np.empty(track.pose.shape[:2])
    pose, velocity = track.pose, track.velocity
    for k, i in np.ndindex(total.shape):
        data.qpos[:], data.qvel[:] = pose[k, i], velocity[k, i]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        total[k, i] = data.energy.sum()
    return total + 0.5 * STIFFNESS * pose[..., 0] ** 2 if rig.drone else total


INERTIAL = {"dof_M0", "dof_invweight0", "body_invweight0", "actuator_acc0"}
DERIVED = {
    "body_mass": INERTIAL | {"body_subtreemass", "light_poscom0"},
    "body_inertia": INERTIAL,
    "body_ipos": INERTIAL | {"body_sameframe", "bvh_aabb", "dof_length", "light_poscom0"},
    "dof_armature": INERTIAL,
}
"""What MuJoCo derives from a field (mj_setConst): inverse inertias at rest, and where lights and boxes are."""


def read_model(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Every number of a model by name, those of `opt` and `stat` included."""
    numbers = {}
    for prefix, struct in (("", model), ("opt.", model.opt), ("stat.", model.stat), ("vis.", model.vis.map)):
        for name in dir(struct):
            value = None if name.startswith("_") else getattr(struct, name)
            if isinstance(value, (np.ndarray, int, float)):
                numbers[prefix + name] = np.array(value)
    return numbers


@pytest.mark.concerns("flown", "cart")
def test_declares_what_it_writes(rig: Rig, effect_id: str) -> None:
    """Of everything in mjModel, actuators and sensors an effect changes what it declares, and what follows from it."""
    effect, twin = rig.effect(effect_id), switch_off(rig, 3, effect_id)
    shared = read_model(rig.spec.model)

    def read(i: int) -> dict[str, np.ndarray]:
        constants = twin.constants
        names = constants.dtype.names or ()
        return read_model(twin._batch.get_model(i)) | {name: constants[name][i].copy() for name in names}

    before = read(1)
    for p in effect.parameters:
        twin.set_parameter(effect_id, p.name, enlarge(p), ids=np.array([1]))
    after = read(1)
    changed = {name for name in before if not np.array_equal(before[name], after[name], equal_nan=True)}
    declared = set(effect.writes)
    assert declared <= changed <= declared.union(*(DERIVED.get(name, set()) for name in declared))
    neighbour = read(2)
    assert [n for n in before if not np.array_equal(before[n], neighbour[n], equal_nan=True)] == []
    rig.roll(twin, rig.start(twin, 6), count=2)
    for name, value in read_model(rig.spec.model).items():
        np.testing.assert_array_equal(value, shared[name], err_msg=name)
