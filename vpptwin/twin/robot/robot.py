"""What a rig is: its model, joints, commands and signals, what disturbs it, and which effects it may have.

`Robot` is any rig with an MJCF and logged joints; `PlanarDrone` is ours. What differs between
them is asked of this object. Where a later room has to do something else for one of them (read its topics, draw it),
that function is `by_robot`, and the robot names its own: nobody asks what kind of rig it has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from pathlib import Path
from pkgutil import resolve_name
from types import MappingProxyType
from typing import ClassVar, ParamSpec, TypeVar, cast

import mujoco
import numpy as np

from vpptwin.effects import (
    Effect,
    FreeBody,
    Site,
    effects_for_ball,
    effects_for_body,
    effects_for_rig,
    generic_place,
    sensing,
)
from vpptwin.effects.actuator import list_loop_effects
from vpptwin.effects.body import MASSES
from vpptwin.effects.catalogue import GENERIC_ROOM, INPUT_ROOM, tie_alike
from vpptwin.effects.contact import effects_for_contacts
from vpptwin.effects.joint import JOINT_SHOWS
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.drives import (
    find_carrier,
    group_drives,
    group_rotors,
    is_driven,
    is_geared,
    list_followers,
    step_inertia,
)
from vpptwin.twin.robot.links import list_links
from vpptwin.twin.robot.manifold import BALL, FREE, list_attitudes
from vpptwin.twin.robot.model import (
    compile_model,
    describe_joints,
    find_floating,
    find_free,
    find_meeting,
    strongest_forces,
    tell_rotary,
    tells_mount,
    typical_forces,
)
from vpptwin.twin.robot.signals import NO_SIGNALS, Signals, Tracked, check_signals, list_tracked

P = ParamSpec("P")
T = TypeVar("T")

GUST = 0.002
"""Force that nobody modelled, as a share of the force that moves a joint about: where a fit of its strength starts."""
TURNING = ("com", "inertia", "twist")
"""Effects of a body that show as it turns."""
WAYS = ("x", "y", "z", "roll", "pitch", "yaw")
"""What a free body's degrees of freedom are called: along the world's axes, about its own; a ball joint's are three."""
GUST_TIME = 0.2
"""Time over which it stays alike [s]: slower than a bump, faster than a law that the catalogue would name."""


@dataclass(frozen=True)
class Disturbance:
    """Forces that no effect explains: gusts on the drone, whatever there may be elsewhere. Each log tells how strong.

    Attributes:
        std: of a force pulse on every degree of freedom, (nv,) N, N m.
        memory: time over which pulses stay alike [s]; 0 for pulses that have nothing in common.
        known: how logs without any effect look is known, so that evidence can be trusted. Elsewhere it is an
            assumption, and errors on held-out data have the last word.
        most: strength at most, in multiples of `std`.
    """

    std: np.ndarray
    memory: float = 0.0
    known: bool = False
    most: float = 50.0


@dataclass(frozen=True)
class Loads:
    """What logs say of a rig's scales, each degree of freedom's (nv,) and actuator's (nu,) own; all positive.

    Attributes:
        force: that drives, accelerates or weighs on it [N, N m].
        speed: that it reaches [m/s, rad/s].
        travel: half the range that it moves through [m, rad].
        middle: of that range [m, rad].
        carried: mass or moment of inertia that it moves [kg, kg m²].
        control: control inputs [ctrl].
    """

    force: np.ndarray
    speed: np.ndarray
    travel: np.ndarray
    middle: np.ndarray
    carried: np.ndarray
    control: np.ndarray


def by_robot(function: Callable[P, T]) -> Callable[P, T]:
    """Let a robot replace a function whose first argument it is, by what `Robot.hooks` names.

    Its room may import any other, as it is imported when it is needed. No other room imports it.
    """

    @wraps(function)
    def call(*given: P.args, **named: P.kwargs) -> T:
        own = cast(Robot, given[0]).hooks.get(function.__name__)
        return (function if own is None else resolve_name(own))(*given, **named)

    return call


@dataclass(frozen=True)
class Robot:
    """Any rig, from its MJCF and the topics of its joints and actuators.

    Attributes:
        name: of its twin, for messages.
        model: the compiled MJCF.
        signals: topics of joints and actuators.
        loads: what logs say of its scales; None before one was read, when weights must do.
        window: length of a fitted window [s]: long enough for an effect to show in what is logged there.
        is_short: whether windows were cut for short logs.
        shortest_window, shortest_log: to which they may be cut for those, and the shortest of those [s].
        warm_up: past inputs that run through its actuators before a window, so that they start where they were [s].
        controllers: ways in which its firmware may drive the actuators.
        step: name of its inner step in `vpptwin.twin.stepping.step`.
        adapt: what is written into the MJCF's specification before it is compiled.
        rotorcraft: numbers of the rotors that it flies by; None where there are none.
        attitude: degree of freedom by which it may be upside down; None where that means nothing.
        followed: name of the body that cameras and trails follow, "" for none.
        pictures: folder, as the docs' pages see it, of pictures of its effects; "" for none.
        hooks: what it does otherwise: name of a function that is `by_robot` -> `module:function` of its own.
    """

    name: str
    model: mujoco.MjModel = field(repr=False)
    signals: Signals = NO_SIGNALS
    window: float = 1.0
    is_short: bool = False
    loads: Loads | None = field(default=None, repr=False)
    shortest_window: ClassVar[float] = 0.4
    shortest_log: ClassVar[float] = 4.0
    warm_up: ClassVar[float] = 1.5  # a slow rate limit is that far behind
    controllers: ClassVar[tuple[str, ...]] = ("map",)
    step: ClassVar[str] = "step_rig"
    rotorcraft: ClassVar[Vehicle | None] = None
    attitude: ClassVar[int | None] = None
    followed: ClassVar[str] = ""
    pictures: ClassVar[str] = ""
    hooks: ClassVar[Mapping[str, str]] = MappingProxyType({})

    @staticmethod
    def load(name: str, path: Path, signals: Signals | None) -> Robot:
        """Read a rig.

        Raises:
            InputError: if the MJCF is none that a twin can step, or the signals don't fit it.
        """
        model = compile_model(path)
        check_signals(name, model, signals)
        return Robot(name, model, signals or NO_SIGNALS)

    @property
    def adapt(self) -> Callable[[mujoco.MjSpec, Path], None]:
        """Nothing is written into somebody's MJCF."""
        return lambda spec, path: None

    @property
    def vehicle(self) -> Vehicle:
        """Nominal numbers of the drone.

        Raises:
            InputError: on any other rig.
        """
        if self.rotorcraft is None:
            found, action = f"twin {self.name} is not the drone", "name `nominal` or such a twin"
            raise InputError(found, "a twin that names a vehicle", action)
        return self.rotorcraft

    @cached_property
    def tracked(self) -> list[Tracked]:
        """What its signals tell the motion of."""
        return list_tracked(self.model, self.signals)

    @cached_property
    def driven(self) -> np.ndarray:
        """Degrees of freedom that follow their log, (D,)."""
        led = [each.joint for each in self.tracked if each.led]
        turned = [each.joint for each in self.tracked if each.posed and each.name in self.signals.turned]
        turns = [int(self.model.jnt_dofadr[joint]) + 3 + axis for joint in turned for axis in range(3)]
        return np.union1d(np.flatnonzero(np.isin(self.model.dof_jntid, led)), turns).astype(int)

    @property
    def numbers(self) -> np.ndarray:
        """What its inner step believes of it, (1,) records or numbers."""
        return np.zeros(1)

    @property
    def servo_lag(self) -> float:
        """Nominal time constant of its actuators [s]."""
        return 0.0

    @property
    def rotor_speed(self) -> float:
        """At which rotors are governed [rad/s]; 0 where there are none."""
        return 0.0

    @property
    def start_pose(self) -> np.ndarray:
        """Where it starts unless somebody says, (nq,) m, rad."""
        return np.array(self.model.qpos0)

    @cached_property
    def rotary(self) -> np.ndarray:
        """Which degrees of freedom are angles, (nv,) bool."""
        return tell_rotary(self.model)

    @cached_property
    def disturbance(self) -> Disturbance:
        """What pushes it besides its effects: an assumption."""
        return Disturbance(GUST * self.forces, GUST_TIME, most=1.0 / GUST)

    @cached_property
    def forces(self) -> np.ndarray:
        """Typical force or torque on every degree of freedom, (nv,) N, N m: the logs', or its weight's."""
        return typical_forces(self.model) if self.loads is None else self.loads.force

    @cached_property
    def exposure(self) -> np.ndarray:
        """What pushes are measured by, (nv,) N, N m: the forces on a joint, on a free body's turns its weight's moment.

        What turns a craft that hovers is next to nothing, and a gust that pushes it pushes off its centre.
        """
        force = np.array(self.forces)
        for joint, free in self.list_free().items():
            if self.model.jnt_type[joint] == FREE:
                turns = slice(int(self.model.jnt_dofadr[joint]) + 3, int(self.model.jnt_dofadr[joint]) + 6)
                force[turns] = np.maximum(force[turns], free.force * free.size)
        return force

    @cached_property
    def afloat(self) -> list[int]:
        """First degrees of freedom of the free joints that do not follow their log."""
        first = [int(self.model.jnt_dofadr[joint]) for joint in find_free(self.model)]
        return [dof for dof in first if dof not in self.driven]

    def scale(self, loads: Loads) -> Robot:
        """The same rig with sizes, bounds and disturbances that suit what logs say of its scales."""
        return replace(self, loads=loads)

    @property
    def limits(self) -> dict[str, tuple[int, float]]:
        """Name of an actuator with a limited command → its index and the limit."""
        model = self.model
        limited = [i for i in range(model.nu) if model.actuator_ctrllimited[i]]
        return {model.actuator(i).name: (i, float(np.abs(model.actuator_ctrlrange[i]).max())) for i in limited}

    @property
    def body(self) -> int:
        """Index of the body that effects without a target act on; -1 where none is."""
        return -1

    @property
    def carriage(self) -> int:
        """Index of the body that carries a guide, on whose load sliders jam; -1 without one."""
        return -1

    def list_effects(self) -> tuple[Effect, ...]:
        """Every effect that it can have, off values bound to its nominal numbers."""
        model, loads = self.model, self.loads
        names = [model.actuator(i).name for i in range(model.nu)]
        stepped = None if loads is None else step_inertia(model)
        places = []
        for name, rotary, _ in describe_joints(model):
            if name in self.signals.driven:
                continue
            dof, known = self.find_dof(name), dict[str, float]()
            if loads is not None and stepped is not None:
                known = {key: float(getattr(loads, key)[dof]) for key in ("speed", "travel", "middle", "carried")}
                known["stepped"] = float(stepped[dof])
            places.append(generic_place(
                name, rotary, float(self.forces[dof]), "the log" if loads else "", self.find_room(dof),
                is_geared(model, name), dof, **known,
            ))  # fmt: skip
        free = self.list_free()
        apart = {body.name for body in free.values()}
        gain, bias, limited = model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcelimited
        found = effects_for_rig(
            places, {name: float(loads.control[i]) if loads else 1.0 for i, name in enumerate(names) if name},
            1.0 if loads else INPUT_ROOM,
            loops={
                name: list_loop_effects(float(gain[i, 0]), float(bias[i, 1]), float(bias[i, 2]), bool(limited[i]))
                for i, name in enumerate(names)
            },
            groups=group_rotors(model),
            links=list_links(model, self.forces, self.driven, apart, 1.0 if loads else MASSES),
            mounted=tells_mount(model), contacts=self.list_contacts(),
            whole=tuple(name for name in names if name in self.signals.actuators), drives=group_drives(model),
        )  # fmt: skip
        of_bodies = [effect for joint, body in free.items() for effect in self.list_of_body(joint, body)]
        return self.tie_signals((*found, *of_bodies, *self.list_misread()))

    def hides(self, effect: Effect) -> bool:
        """Whether an effect cannot show: nothing touches in what is compared, bodies that are `turned` turn anyhow.

        Then their gyros tell nothing, nor do rotors that are alike one by one. What brakes or pushes a joint that
        follows another by an equality cannot be told from the same there.
        """
        sensed = effect.writes and all(name.startswith(("pose.", "rate.")) for name in effect.writes)
        if not sensed and effect.target in list_followers(self.model):
            return True
        if effect.touching or not self.signals.turned:
            return effect.touching
        bodies = {self.model.body(name).id for name in self.signals.turned}
        sites = [name for name in self.signals.sites if self.model.site(name).bodyid[0] in bodies]
        groups = [group for group in group_rotors(self.model) if find_carrier(self.model, group[0]) in bodies]
        if effect.target in self.signals.turned:
            return effect.id.rsplit(".", 1)[1] in (*TURNING, "misalignment")
        return effect.target in sites or any(effect.target in group for group in groups)

    def find_room(self, dof: int) -> float:
        """Factor on the bounds of effects on a degree of freedom: 1 once logs tell how large they may be."""
        return 1.0 if self.loads else GENERIC_ROOM * float(self.strongest[dof] / self.forces[dof])

    @cached_property
    def strongest(self) -> np.ndarray:
        """Largest force that anything like a degree of freedom may bear, (nv,) N, N m."""
        return strongest_forces(self.model)

    def find_dof(self, joint: str) -> int:
        """Degree of freedom of a joint."""
        return int(self.model.joint(joint).dofadr[0])

    def list_misread(self) -> list[Effect]:
        """Errors of the signals of bodies that turn any way, and of joints that are logged on topics of their own."""
        model, signals = self.model, self.signals
        found: list[Effect] = []
        for joint in self.list_free():
            body, dof = model.body(int(model.jnt_bodyid[joint])), int(model.jnt_dofadr[joint])
            gyros = [name for name in signals.sites if model.site(name).bodyid[0] == body.id]
            free = bool(model.jnt_type[joint] == FREE)
            found += sensing.effects_for_pose(body.name, dof, gyros[0] if gyros else "", free)
        topics: dict[str, list[int]] = {}
        for name, topic in signals.joints.items():
            topics.setdefault(topic, []).append(self.find_dof(name))
        if len(topics) + len(signals.bodies) > 1:  # else it is a delay of what drives them
            for topic, dofs in topics.items():
                if topic not in signals.actuators.values():
                    name, shown = topic.strip("/").replace("/", "_"), tuple(dofs)
                    found += sensing.effects_for_clock(sensing.Sensor(name, f"joints on {topic}", shown, shown))
        for topic in topics:
            names = [name for name, its in signals.joints.items() if its == topic]
            late = [name for name in names if not is_driven(model, name)]  # else it is a delay of what drives it
            known = len(late) < len(names) or topic in signals.driven.values()
            if len(names) > 1 and known:  # else nothing tells later than what
                found += [sensing.late_joint(name, self.find_dof(name)) for name in late]
        return found

    def tie_signals(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """The effects, of which errors of signals look like what they are the errors of."""
        ids = {effect.id: effect for effect in effects}
        # A joint that is late beside others is not what drives them.
        late = [e.id for e in effects if "pose.delay" in e.writes and e.target not in self.signals.joints]
        whole = ["+".join(group) for group in group_rotors(self.model)] or [*self.signals.actuators]
        every = set(self.signals.actuators)
        whole += [
            e.id.removesuffix(".gain") for e in effects if e.id.endswith(".gain") and set(e.members) == every != set()
        ]
        tied = tie_alike(effects, late, [f"{name}.{kind}" for name in whole for kind in ("delay", "lag")
                                         if f"{name}.{kind}" in ids and late])  # fmt: skip
        for body in self.signals.bodies:
            gyros = [n for n in self.signals.sites if f"{n}.scale" in ids]
            for some, others in (
                ([f"{body}.misalignment"], [f"{body}.wind", f"{body}.com"]), ([f"{body}.scale"], [f"{body}.mass"]),
                ([f"{body}.mass"], [f"{name}.gain" for name in whole]),
                ([f"{n}.scale" for n in gyros], [f"{body}.inertia"]),
            ):  # fmt: skip
                tied = tie_alike(tied, some, others)
        return tuple(tied)

    def list_contacts(self) -> tuple[Effect, ...]:
        """What contacts may have, of geoms that can touch and of pairs."""
        model = self.model
        kinds = np.stack([model.body_weldid[model.geom_bodyid], model.geom_contype, model.geom_conaffinity], axis=1)
        _, some, kind = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        meets = np.asarray(find_meeting(model, some).any(axis=1))[kind.ravel()]
        if not meets.any() and not model.npair:
            return ()
        solref = np.concatenate([model.geom_solref[meets], model.pair_solref])
        pairs = [model.pair(i).name for i in range(model.npair)]
        return effects_for_contacts(JOINT_SHOWS, solref, float(model.opt.timestep), bool(meets.any()), pairs)

    def list_free(self) -> dict[int, FreeBody]:
        """The bodies that fly or turn freely and are simulated, by their joint, with what is typical of them."""
        model, loads, force, found = self.model, self.loads, self.forces, {}
        for _, turn in list_attitudes(model):
            joint = int(model.dof_jntid[turn])
            body, dof = int(model.jnt_bodyid[joint]), int(model.jnt_dofadr[joint])
            name, mass = model.body(body).name, float(model.body_mass[body])
            if dof in self.driven or not name or not mass:
                continue
            speed = 1.0 if loads is None else float(loads.speed[dof : dof + 3].max())
            size = float(np.sqrt(model.body_inertia[body].max() / mass))
            push, twist = (float(force[part].max()) for part in (slice(dof, dof + 3), slice(turn, turn + 3)))
            inertia = tuple(map(float, model.body_inertia[body]))
            weight = mass * float(np.linalg.norm(model.opt.gravity))
            hangs = model.jnt_type[joint] != FREE and weight > 0.0  # its weight turns it, were it not balanced
            shift = min(0.05 * size, 0.02 * twist / weight) if hangs else 0.0
            found[joint] = FreeBody(name, mass, inertia, size, push, twist, speed, shift, self.find_room(turn))
        return found

    def list_of_body(self, joint: int, body: FreeBody) -> list[Effect]:
        """What a free body may have, or one on a ball joint: friction there, and what no force on the joint undoes."""
        model, effects = self.model, effects_for_body(body)
        if model.jnt_type[joint] == FREE:
            return list(effects)
        held = [effect for effect in effects if effect.id.rsplit(".", 1)[1] in TURNING]
        name, dof = model.joint(joint).name, int(model.jnt_dofadr[joint])
        if not name:
            return held
        speed = 1.0 if self.loads is None else float(self.loads.speed[dof : dof + 3].max())
        place = generic_place(name, True, body.torque, "the log" if self.loads else "", body.room, speed=speed)
        return [*effects_for_ball(place, tuple(self.name_dof(dof + i) for i in range(3))), *held]

    def name_dof(self, dof: int) -> str:
        """What a degree of freedom is called: its joint's name, or which way a body goes or turns."""
        model, joint = self.model, int(self.model.dof_jntid[dof])
        name, body = str(model.joint(joint).name), str(model.body(int(model.jnt_bodyid[joint])).name)
        way, kind = dof - int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        return f"{body} {WAYS[way]}" if kind == FREE else f"{name or body} {WAYS[3 + way]}" if kind == BALL else name

    def nominal(self, key: str) -> float:
        """Its nominal number at a dotted key of a vehicle file; KeyError where it has none."""
        raise KeyError(key)

    def list_sites(self, effect: Effect) -> list[Site]:
        """Every place where an effect acts: several for actuators that are alike."""
        return [self.locate(replace(effect, target=name)) for name in effect.places]

    def locate(self, effect: Effect) -> Site:
        """Indices of the place in the model where an effect acts."""
        model = self.model
        joints = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt)}
        joints |= {name: int(model.jnt_dofadr[i]) for name, i in find_floating(model).items()}
        joints |= {self.name_dof(turn + i): turn + i for _, turn in list_attitudes(model) for i in range(3)}
        actuators = {model.actuator(i).name: i for i in range(model.nu)}
        bodies = {model.body(i).name: i for i in range(model.nbody)}
        places = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)}
        pairs = {model.pair(i).name: i for i in range(model.npair)}
        return Site(
            dof=joints.get(effect.target, -1),
            place=places.get(effect.target, -1),
            actuator=actuators.get(effect.target, -1),
            body=bodies.get(effect.target, self.body),
            pair=pairs.get(effect.target, -1),
        )

    def weigh_commands(self, effect: Effect, dof: int) -> tuple[np.ndarray, str]:
        """The command that a force on degree of freedom `dof` follows: shares of the actuators' (nu,), and its name.

        That of the actuator which the effect acts on, or else of those which act on the joint, or else of all.
        """
        model = self.model
        names = [model.actuator(i).name for i in range(model.nu)]
        joint = mujoco.mjtTrn.mjTRN_JOINT
        acting = [i for i, name in enumerate(names) if name in effect.places] or [
            i for i in range(model.nu) if model.actuator_trntype[i] == joint
            and model.actuator_trnid[i, 0] == model.dof_jntid[dof]
        ]  # fmt: skip
        shares = np.zeros(model.nu)
        shares[acting or slice(None)] = 1.0 / max(len(acting) or model.nu, 1)
        return shares, f"command of {names[acting[0]]}" if len(acting) == 1 else "mean command"
