"""One inner step of one simulation, from command to forces, as it runs inside MuJoCo's step.

`step_drone` and `step_rig` read as the pipeline they are. numba compiles them, with the effects of a catalogue
(vpptwin.twin.stepping.pipeline), and they run in plain Python too, which is what the compiled ones are tested against.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.actuators.layer import (
    command_from_policy,
    limit_control,
    move_actuator,
    push_commands,
    spin_rotor,
    weaken_control,
)
from vpptwin.actuators.numbers import Number, VehicleNumbers
from vpptwin.engine.compile import compilable
from vpptwin.engine.view import View, find_idle, foresee_actuators
from vpptwin.robots.planar_drone.effects.laws import Craft, Rotor
from vpptwin.twin.stepping.friction import expand_inertia, rub

X, Z, PITCH = 0, 1, 2
"""Degrees of freedom of the planar craft."""


class Row(NamedTuple):
    """What a simulation has of its own besides MuJoCo's state."""

    layer: Any  # state of the actuators, a record of `layer_dtype`
    constants: Any  # a record of `constants_dtype`
    parameters: np.ndarray  # of the effects that act every step, (P,)
    # of the last step the force on the carriage [N], the number of constraints, their forces, (2 + nv,)
    memory: np.ndarray
    effects: np.ndarray  # what evolves of the effects, (S,)
    scratch: np.ndarray  # room for forces, friction levels, friction, loads and inertia, (7 + 2 nv, nv)


class Tape(NamedTuple):
    """Inputs of one simulation over a call of many steps."""

    # whether `command` is that of a policy (thrust N, rate rad/s), held throughout, instead of one per step
    policy: bool
    command: np.ndarray  # (1, 2) or (steps, nu)
    speed: np.ndarray  # measured rotor speed, which thrust goes by, (steps, nu) rad/s; no rows when it is simulated
    throttle: np.ndarray  # by which motors are simulated, (steps, nu) 0..1; no rows when there is none
    push: np.ndarray  # generalized force added, (segments, nv) N, N m; no rows for none
    lead: np.ndarray  # velocities of driven joints in each step, (steps, nv); no rows when none is driven
    driven: np.ndarray  # inertia by which each joint is driven, (nv,); 0 for free ones
    steps: int  # number of steps of the call


class Rig(NamedTuple):
    """What all simulations of a twin share."""

    active: np.ndarray  # which effects are switched on, (E,) by their place in the catalogue
    dry: np.ndarray  # friction that the joints have without any effect, (nv,) N, N m
    carriage: int  # index of the carriage's body, -1 without one


class PastStep(NamedTuple):
    """What is known of a past step: as in `View`."""

    time: float
    timestep: float
    qpos: np.ndarray
    qvel: np.ndarray
    inertia: np.ndarray


# The four functions that follow are a catalogue without effects; `pipeline` puts others in their place.


@compilable(forceinline=True)
def shape_thrust(
    active: np.ndarray, parameters: np.ndarray, states: np.ndarray, thrust: Number, rotor: Rotor, dt: float
) -> Number:
    """Thrust of a rotor [N] after the THRUST effects that are switched on."""
    return thrust


@compilable(forceinline=True)
def push_craft(
    active: np.ndarray, parameters: np.ndarray, states: np.ndarray, craft: Craft, dt: float
) -> tuple[Number, Number, Number]:
    """Force of the FORCE effects on the craft: along x and z [N], moment about the hinge [N m]."""
    return 0.0, 0.0, 0.0


@compilable(forceinline=True)
def push_joints(
    active: np.ndarray, parameters: np.ndarray, states: np.ndarray, view: View | PastStep, load: np.ndarray,
    lever: float, force: np.ndarray,
) -> None:  # fmt: skip
    """Add the FORCE effects on joints to `force`, (nv,) [N, N m]."""


@compilable(forceinline=True)
def muster_friction(
    active: np.ndarray, parameters: np.ndarray, states: np.ndarray, dry: np.ndarray, view: View | PastStep,
    load: np.ndarray, lever: float, forward: np.ndarray, backward: np.ndarray, force: np.ndarray,
) -> bool:  # fmt: skip
    """Write the friction levels against motion forward and backward, (nv,) [N, N m]; tell whether any rubs.

    Where a SLIP effect says how a joint's friction acts, it goes to `force`, (nv,), and no level is left.
    """
    forward[:] = dry
    backward[:] = dry
    return forward.max() > 0.0


@compilable(forceinline=True)
def step_drone(vehicle: VehicleNumbers, rig: Rig, view: View, row: Row, tape: Tape, k: int) -> None:
    """Step k of a drone: command, servos, rotors, thrust, forces, friction; writes `view.ctrl` and `qfrc_applied`."""
    dt = view.timestep
    layer, constants = row.layer, row.constants
    if tape.policy:
        pitch_1, pitch_2 = command_from_policy(
            vehicle, layer, constants, tape.command[0, 0], tape.command[0, 1], view.qvel[PITCH], view.time, dt
        )
    else:
        pitch_1, pitch_2 = tape.command[k, 0], tape.command[k, 1]
    push_commands(layer)
    move_actuator(layer, constants, 0, pitch_1, dt)
    move_actuator(layer, constants, 1, pitch_2, dt)
    for i in range(2):
        if len(tape.throttle) > 0:
            layer.throttle[i] = tape.throttle[k, i]
        elif len(tape.speed) > 0:
            layer.rotor_speed[i] = tape.speed[k, i]
        if len(tape.throttle) > 0 or tape.policy:
            spin_rotor(vehicle, layer, constants, i, view.time, dt)
        else:
            layer.mean_speed[i] = layer.rotor_speed[i]
        if len(tape.speed) > 0:
            layer.mean_speed[i] = tape.speed[k, i]

    craft = Craft(
        view.qpos[X], view.qpos[Z], view.qvel[X], view.qvel[Z], view.qvel[PITCH],
        np.sin(view.qpos[PITCH]), np.cos(view.qpos[PITCH]), vehicle.airframe.half_length,
        layer.mean_speed[0], layer.mean_speed[1], view.time,
    )  # fmt: skip
    # How fast the hinge moves along the thrust; a rotor has that and, by its side, what the rotation makes of the arm.
    climb = craft.v_z * craft.cosine - craft.v_x * craft.sine
    for i in range(2):
        side = 2.0 * i - 1.0
        rotor = Rotor(side, layer.mean_speed[i], layer["mean"][i], craft.z, climb + side * craft.arm * craft.rate)
        thrust = compute_thrust(vehicle.rotor, rotor.speed, rotor.pitch)
        thrust = shape_thrust(rig.active, row.parameters, row.effects, thrust, rotor, dt)
        view.ctrl[i] = limit_control(constants, i, thrust)

    # What the carriage hands on to its slider: its other forces less m a, of the last step, as this one's is not known.
    load = row.scratch[6]
    load[:] = 0.0
    if rig.carriage >= 0:
        carried = row.memory[0] - view.body_mass[rig.carriage] * view.qacc_warmstart[X]
        if not view.colliding:  # then it is an end stop of the rail that holds, which acts on the carriage
            carried += last_constraint(view, row, k, X)
        load[:] = carried
    lever = (craft.z - vehicle.rig.rail_height) / vehicle.rig.bearing_spacing
    force = row.scratch[0]
    force[:] = 0.0
    push_joints(rig.active, row.parameters, row.effects, view, load, lever, force)
    on_rail = force[X] - view.dof_damping[X] * view.qvel[X]
    if rig.carriage >= 0:
        on_rail += view.body_mass[rig.carriage] * view.gravity[X]
    f_x, f_z, moment = push_craft(rig.active, row.parameters, row.effects, craft, dt)
    force[X] += f_x
    force[Z] += f_z
    force[PITCH] += moment
    drive(view, tape, k, force)
    others = force[X]
    rubs = muster_friction(
        rig.active, row.parameters, row.effects, rig.dry, view, load, lever, row.scratch[1], row.scratch[2], force
    )
    on_rail += force[X] - others
    if rubs:
        foresee_actuators(view, row.scratch[5])
    resist(rubs, view, row, k)
    row.memory[0] = on_rail + row.scratch[3, X]


@compilable(forceinline=True)
def step_rig(rig: Rig, view: View, row: Row, tape: Tape, k: int) -> None:
    """Step k of any other rig: command, actuators, forces, friction; writes `view.ctrl` and `view.qfrc_applied`."""
    push_commands(row.layer)
    for i in range(len(view.ctrl)):
        move_actuator(row.layer, row.constants, i, tape.command[k, i], view.timestep)
        control = limit_control(row.constants, i, row.layer["mean"][i])
        view.ctrl[i] = weaken_control(row.constants, i, control, find_idle(view, i), view.time)
    force, exerted = row.scratch[0], row.scratch[5]
    force[:] = 0.0
    foresee_actuators(view, exerted)
    push_joints(rig.active, row.parameters, row.effects, view, exerted, 0.0, force)
    drive(view, tape, k, force)
    rubs = muster_friction(
        rig.active, row.parameters, row.effects, rig.dry, view, exerted, 0.0, row.scratch[1], row.scratch[2], force
    )
    resist(rubs, view, row, k)


@compilable(forceinline=True)
def recall(
    active: np.ndarray, parameters: np.ndarray, states: np.ndarray, dry: np.ndarray, seen: PastStep, scratch: np.ndarray
) -> None:
    """Let what evolves of the effects on joints and bodies go on over a past step; `scratch` is room, (4, nv)."""
    load, forward, backward, force = scratch[0], scratch[1], scratch[2], scratch[3]
    force[:] = 0.0
    push_joints(active, parameters, states, seen, load, 0.0, force)
    muster_friction(active, parameters, states, dry, seen, load, 0.0, forward, backward, force)


@compilable(forceinline=True)
def drive(view: View, tape: Tape, k: int, force: np.ndarray) -> None:
    """Add to `force`, (nv,), the disturbance of the tape and what leads driven joints along their tracks."""
    if len(tape.push) > 0:
        force += tape.push[k * len(tape.push) // tape.steps]
    if len(tape.lead) > 0:
        for i in range(len(force)):
            if tape.driven[i] > 0.0:
                force[i] += tape.driven[i] * (tape.lead[k, i] - view.qvel[i]) / view.timestep


@compilable(forceinline=True)
def last_constraint(view: View, row: Row, k: int, i: int) -> float:
    """Force of the constraints on degree of freedom i in the step before step k [N, N m]."""
    return row.memory[2 + i] if k == 0 else view.qfrc_constraint[i]


@compilable(forceinline=True)
def resist(rubs: bool, view: View, row: Row, k: int) -> None:
    """Add dry friction, where something rubs, to the forces in `scratch[0]`, and hand them to the engine.

    What the actuators are about to exert is in `scratch[5]` then.

    Friction answers to every other force. Those of contacts, limits and equalities are known only after the engine's
    solver has run: they are taken from the step before, unless one has come or gone since. A contact that is no more
    would have friction push against nothing, and a craft that rests on two points hop from one to the other.
    """
    scratch, n = row.scratch, len(view.qvel)
    force, forward, backward, friction, push, exerted = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5],
    )  # fmt: skip
    friction[:] = 0.0
    if rubs:
        for i in range(n):
            push[i] = force[i] + exerted[i] + view.qfrc_passive[i] - view.qfrc_bias[i]
        if view.constraints > 0 and view.constraints == row.memory[1]:
            for i in range(n):
                push[i] += last_constraint(view, row, k, i)
        dense, inverse = scratch[7 : 7 + n], scratch[7 + n : 7 + 2 * n]
        coupled = expand_inertia(
            view.inertia, view.row_length, view.row_start, view.column, view.dof_damping, view.timestep, dense
        )
        rub(push, view.qvel, forward, backward, dense, inverse, coupled, view.timestep, friction)
    row.memory[1] = view.constraints
    for i in range(n):
        view.qfrc_applied[i] = force[i] + friction[i]
