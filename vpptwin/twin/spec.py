"""A twin on disk: a YAML file that names an MJCF, a vehicle, effects and, for other rigs, the signals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any, Literal, cast, get_args

import mujoco
import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from vpptwin.actuators.file import equip, load_actuator
from vpptwin.effects import CATALOGUE, Effect, find_effect
from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS, PlanarDrone
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle, strengthen
from vpptwin.system.errors import InputError, suggest
from vpptwin.system.fields import SignalEntry
from vpptwin.system.installed import locate_effects
from vpptwin.system.plain import read_yaml
from vpptwin.system.resources import find_model_file, models_dir
from vpptwin.system.trust import check_trusted
from vpptwin.twin.robot.actuation import list_noted
from vpptwin.twin.robot.losses import read_losses
from vpptwin.twin.robot.robot import Robot, Signals
from vpptwin.twin.robot.signals import SIGNAL_TOPICS
from vpptwin.twin.stepping.stepped import strip_model

EffectValues = dict[str, dict[str, float]]
Controller = Literal["map", "adaptive"]
"""How the drone's firmware turns thrust into blade pitch: by the vehicle's map, or learning what the map gets wrong."""

SHIPPED = ("nominal", "typical", "strong")
"""Twins that ship, by name: every effect off; the MJCF's own friction, damping and drag; wall-backtrack's rotors."""


def refuse_bool(value: object) -> object:
    """Refuse what YAML reads from `yes` and `on`, which would otherwise count as 1."""
    if isinstance(value, bool):
        raise ValueError("a number, not yes or no")
    return value


# A key with nothing after it is read as null: somebody commented all effects out.
FileEffects = Annotated[
    dict[str, dict[str, Annotated[float, BeforeValidator(refuse_bool)]]],
    BeforeValidator(lambda value: {} if value is None else value),
]


class Origin(BaseModel):
    """Where the values of a twin YAML come from; whoever wrote it may say more."""

    model_config = ConfigDict(frozen=True, extra="allow")
    intervals_90_percent: dict[str, tuple[float, float]] = {}


class TwinFile(BaseModel):
    """The keys of a twin YAML (docs/twin.md)."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    model: str
    vehicle: str | None = None
    effects: FileEffects = {}
    effects_from: list[str] = []
    priors: dict[str, Annotated[float, Field(ge=0.0, lt=1.0)]] = {}
    signals: Signals | None = None
    controller: Controller = "map"
    actuator: str | None = None
    losses: Literal["none", "mjcf"] = "none"
    thrust_to_weight: Annotated[float, Field(gt=1.0, le=10.0)] | None = None
    provenance: Origin = Origin()


@dataclass(frozen=True)
class TwinSpec:
    """A validated twin: what to simulate, not yet a simulation.

    Attributes:
        name: how the user named it.
        model_file: the MJCF.
        robot: the rig.
        catalogue: every effect that it can have, off values bound to its nominal numbers.
        effects: what is switched on, id → parameter → value.
        vehicle_file: where the vehicle was read from.
        effect_files: Python files whose effects follow those of ours in the catalogue.
        controller: of the drone's actuators.
        actuator_file: whose numbers stand in `vehicle` in place of those of its file.
        thrust_to_weight: that its rotors were made stronger to; None for the vehicle's own.
        intervals: "effect.parameter" → its 90 % interval, of values that a diagnosis or identification found.
        priors: effect id → prior probability that it is there and unknown to the twin; the rest share one.
        settled: ids of effects that are no candidates: left out, or fixed at the twin's value.
    """

    name: str
    model_file: Path
    robot: Robot
    catalogue: tuple[Effect, ...] = field(repr=False)
    effects: EffectValues
    vehicle_file: Path | None = None
    effect_files: tuple[Path, ...] = ()
    controller: Controller = "map"
    actuator_file: Path | None = None
    thrust_to_weight: float | None = None
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, float] = field(default_factory=dict)
    settled: frozenset[str] = frozenset()

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of the rig."""
        return self.robot.model

    @property
    def vehicle(self) -> Vehicle:
        """Nominal numbers of the drone; InputError on any other rig."""
        return self.robot.vehicle

    @cached_property
    def stepped(self) -> mujoco.MjModel:
        """The model that simulations step: without what is only looked at, unless an effect changes some geoms."""
        some = (effect for effect in self.catalogue if not effect.touching)
        if any(name.startswith("geom_") for effect in some for name in effect.writes):
            return self.model
        return strip_model(self.model, self.model_file, self.robot.adapt)

    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> TwinSpec:
        """The same rig with other effects switched on."""
        checked = check_effects(effects, self.catalogue, self.name)
        return replace(self, effects=checked)

    def settle(self, effects: Iterable[str]) -> TwinSpec:
        """The same twin, of which these effects are no candidates: they stay as they are in it."""
        return replace(self, settled=self.settled | frozenset(effects))

    def with_robot(self, **changes: Any) -> TwinSpec:  # noqa: ANN401
        """The same twin of a rig with other fields, such as its `model` or `rotorcraft`; nothing is compiled anew."""
        return replace(self, robot=replace(self.robot, **changes))

    def with_controller(self, controller: str) -> TwinSpec:
        """The same rig under another controller of its actuators.

        Raises:
            InputError: on an unknown one, or if the rig is not the drone.
        """
        known = get_args(Controller)
        if controller not in known:
            raise InputError(f"unknown controller {controller!r}", f"one of {', '.join(known)}", "check the name")
        if controller not in self.robot.controllers:
            raise InputError(
                f"{self.name}: controller {controller!r} without vehicle", "it with our drone only", "leave it out"
            )
        return replace(self, controller=cast(Controller, controller))

    def value(self, effect: Effect, parameter: str) -> float:
        """Value of a parameter in this twin: its off value when the effect is not switched on."""
        return self.effects.get(effect.id, {}).get(parameter, effect.parameter(parameter).off)


def check_effects(
    effects: Mapping[str, Mapping[str, float]], catalogue: tuple[Effect, ...], source: str
) -> EffectValues:
    """Check ids, parameters and bounds; complete missing parameters with their off values.

    Raises:
        InputError: on an unknown id or parameter, or a value outside its physical bounds.
    """
    checked: EffectValues = {}
    for effect_id, values in effects.items():
        try:
            effect = find_effect(catalogue, effect_id)
        except KeyError as error:
            needed = [part for effect in CATALOGUE if effect.id == effect_id for part in effect.needs]
            if needed:
                raise InputError(
                    f"{source}: effect {effect_id!r} on a model without {' and '.join(needed)}",
                    "a model with a body or joint of that name, such as rail_rig.xml",
                    "name another model or leave the effect out",
                ) from error
            raise InputError(
                f"{source}: unknown effect {effect_id!r}",
                f"an id such as {error.args[0]}",
                f"{suggest(effect_id, (e.id for e in catalogue), '')} `vpptwin effects` lists all",
            ) from error
        names = [p.name for p in effect.parameters]
        for name, value in values.items():
            if name not in names:
                raise InputError(f"{source}: {effect_id} has no parameter {name!r}", ", ".join(names), "rename it")
            parameter = effect.parameter(name)
            if not parameter.low <= value <= parameter.high:
                bounds = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}"
                raise InputError(
                    f"{source}: {effect_id}.{name} = {value:g} {parameter.unit}",
                    f"{bounds} ({effect.equation}; off is {parameter.off:g})",
                    "correct the value",
                )
        checked[effect_id] = {p.name: float(values.get(p.name, p.off)) for p in effect.parameters}
    return checked


def check_priors(priors: Mapping[str, float], catalogue: tuple[Effect, ...], source: str) -> Mapping[str, float]:
    """Refuse prior probabilities of what the catalogue lacks."""
    known = [effect.id for effect in catalogue]
    for name in priors:
        if name not in known:
            found = f"{source}: a prior of unknown effect {name!r}"
            action = suggest(name, known, f"`vpptwin effects --twin {source}` lists them")
            raise InputError(found, "the id of an effect", action)
    return priors


def locate_twin(name: str) -> str:
    """The twin as it is found from any folder: the name of a shipped one, or an absolute path."""
    return name if name in SHIPPED else str(Path(name).resolve())


def load_twin(name: str | Path = "nominal", effect_files: Sequence[str | Path] = ()) -> TwinSpec:
    """Read a twin.

    Args:
        name: one of `SHIPPED` or the path of a twin YAML.
        effect_files: Python files with effects of the user's own, or names of installed ones. They are run; one that
            the YAML names is run only if it is among them, installed, or trusted (`vpptwin.system.trust`).

    Raises:
        InputError: if a file is missing or wrong, an effect is unknown or out of bounds, or code is not trusted.
    """
    path = models_dir() / f"{name}.yaml" if str(name) in SHIPPED else Path(name)
    try:
        content = read_yaml(path)
        if not isinstance(content, dict):
            raise InputError(f"{path}: no YAML mapping", "keys model, vehicle, effects, signals", "see docs/twin.md")
        file = TwinFile.model_validate(content)
        own = [locate_effects(given, path.parent) for given in file.effects_from]
        check_trusted(own, path, effect_files)
        given = [locate_effects(given) for given in effect_files]
        files: dict[Path, Path] = {}  # each once, as it was named first
        for each in map(Path, (*own, *given)):
            files.setdefault(each.resolve(), each)
        return build_twin(str(name), file, path.parent, tuple(files.values()))
    except (OSError, UnicodeDecodeError) as error:
        advice = suggest(str(name), SHIPPED, "check the path")
        raise InputError(f"no readable twin {path}", "`nominal`, `typical`, `strong` or a twin YAML", advice) from error
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not YAML ({error})", "a twin YAML", "check its syntax") from error
    except ValidationError as error:
        found, expected = describe_mistake(error)
        raise InputError(f"{path}: {found}", expected, "see docs/twin.md") from error


def describe_mistake(error: ValidationError) -> tuple[str, str]:
    """What the first mistake in a twin YAML is, the key first, and what was expected there."""
    first = error.errors()[0]
    place = [str(part) for part in first["loc"]]
    keys = "model and, if need be, vehicle, effects, signals, priors, controller, actuator, losses, thrust_to_weight"
    if place[:1] == ["signals"]:
        keys = ", ".join([*SIGNAL_TOPICS, "turned"])
    if place[:2] == ["signals", "entries"]:  # by the topic that they are read as
        place, keys = ["signals", *place[3:]], ", ".join(SignalEntry.model_fields)
    key = ".".join(place) or "the file"
    if first["type"] == "missing":
        return f"no key {key}", keys
    if first["type"] == "extra_forbidden":
        return f"unknown key {key}", keys
    expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return f"{key} = {shorten(repr(first['input']), 60)}", expected.replace("dictionary", "mapping")


def build_twin(name: str, file: TwinFile, folder: Path, effect_files: tuple[Path, ...] = ()) -> TwinSpec:
    """Resolve the files that a twin names, compile the model and check the effects."""
    model_file = find_model_file(file.model, folder)
    vehicle_file = find_model_file(file.vehicle, folder) if file.vehicle else None
    vehicle = load_vehicle(vehicle_file) if vehicle_file else None
    given = dict(file.effects)
    actuator_file = folder / file.actuator if file.actuator is not None else None
    if actuator_file is not None:
        if vehicle is None:
            raise InputError(f"{name}: actuator without vehicle", "it with our drone only", "leave it out")
        actuator = load_actuator(actuator_file)
        vehicle = equip(vehicle, actuator)
        if actuator.servo.delay > 0.0:
            given.setdefault("command.delay", {"delay": actuator.servo.delay})
    if file.thrust_to_weight is not None:
        if vehicle is None:
            raise InputError(f"{name}: thrust_to_weight without vehicle", "it with our drone only", "leave it out")
        vehicle = strengthen(vehicle, file.thrust_to_weight)
    if vehicle is not None and file.signals is not None:
        raise InputError(f"{name}: vehicle and signals", "one of them: our drone needs no signals", "remove one")
    robot = (
        Robot.load(name, model_file, file.signals)
        if vehicle is None
        else PlanarDrone.assemble(name, model_file, vehicle)
    )
    if file.losses == "mjcf":
        if vehicle is None:
            raise InputError(
                f"{name}: losses without vehicle", "it with our drone only", "leave it out: they act anyway"
            )
        given = read_losses(model_file, CRAFT_JOINTS, "craft") | given
    catalogue = robot.list_effects()
    if vehicle is None:
        given = list_noted(robot.model) | given
    if effect_files:
        from vpptwin.twin.robot.effect_file import extend_catalogue  # which brings the compiler

        catalogue = extend_catalogue(catalogue, effect_files, robot)
    effects = check_effects(given, catalogue, name)
    spec = TwinSpec(
        name, model_file, robot, catalogue, effects, vehicle_file, effect_files,
        actuator_file=actuator_file, thrust_to_weight=file.thrust_to_weight,
        intervals=file.provenance.intervals_90_percent, priors=check_priors(file.priors, catalogue, name),
        settled=frozenset(effect for effect, prior in file.priors.items() if prior == 0.0),
    )  # fmt: skip
    return spec.with_controller(file.controller)
