"""Effects on what signals say of the motion: late, by another clock, shifted, turned, off by a factor.

One kind each, for whatever `signals` names: poses of a body, its gyro, velocities of a joint, joints on a topic of
their own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.body import AXES, BODY_SHOWS
from vpptwin.effects.constants import add, multiply
from vpptwin.effects.joint import JointLaw, JointScale
from vpptwin.effects.parameter import Parameter, Prior

LINEAR, ANGULAR = (0, 1, 2), (3, 4, 5)
"""Degrees of freedom of a free body, from its first on."""
SLIGHT = 0.001
"""Zero error of logged velocities that a well-built sensor may have, as a share of what they reach."""
LATEST = 0.15
"""Delay of a camera's pictures at most [s]."""

Dofs = tuple[int, ...]
"""Degrees of freedom that a signal shows."""


@dataclass(frozen=True)
class Sensor:
    """What says where something is, or how fast it goes.

    Attributes:
        name: that ids begin with.
        what: it says, e.g. "poses of quad".
        pose, rate: degrees of freedom whose position, whose velocity it shows.
        shows: topics.
        target: joint, body or site, "" for the craft.
    """

    name: str
    what: str
    pose: Dofs = ()
    rate: Dofs = ()
    shows: tuple[str, ...] = ("/joint_states",)
    target: str = ""

    def misread(
        self, kind: str, summary: str, equation: str, parameters: Iterable[Parameter],
        places: tuple[tuple[str, Dofs], ...], alike: tuple[str, ...] = (), follows: str = "velocity",
    ) -> Effect:  # fmt: skip
        """An effect on this sensor, that of a `scale` a factor: each degree of freedom has a parameter, or all one."""
        law = (multiply if kind.endswith("scale") else add)(*((name, dof) for name, dofs in places for dof in dofs))
        return Effect(
            f"{self.name}.{kind}", summary, equation, tuple(parameters), Stage.CONSTANT, law, self.shows, alike,
            target=self.target, follows=follows,
        )  # fmt: skip


def delay(sensor: Sensor, alike: tuple[str, ...] = ()) -> Effect:
    """Readings older than their stamps."""
    parameter = Parameter(
        name="delay", unit="s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.005), size=0.004,
        tolerance=0.0005, source="assumption: most within a period of 10 ms",
    )  # fmt: skip
    places = ("pose.delay", sensor.pose), ("rate.delay", sensor.rate)
    return sensor.misread(
        "delay", f"{sensor.what} older than their stamps", "pose(t - delay)", [parameter], places, alike
    )


def drift(sensor: Sensor, alike: tuple[str, ...] = ()) -> Effect:
    """A clock of its own, which gains so much on the one that stamps the rest [s/s]."""
    parameter = Parameter(
        name="drift", unit="s/s", off=0.0, low=-0.01, high=0.01, prior=Prior("normal", 0.0, 2e-4), size=1e-3,
        tolerance=2e-5, source="assumption: free-running clocks, 200 ppm apart",
    )  # fmt: skip
    places = ("pose.drift", sensor.pose), ("rate.drift", sensor.rate)
    summary = f"{sensor.what} by a clock that runs fast or slow"
    return sensor.misread("drift", summary, "pose(t - drift t)", [parameter], places, alike)


def misalignment(sensor: Sensor, dofs: Dofs, alike: tuple[str, ...] = ()) -> Effect:
    """A marker body, or a gyro, that is not aligned with what carries it: turned about one axis or the body's three."""
    names = ("angle",) if len(dofs) == 1 else AXES
    equation = "θ + angle" if len(dofs) == 1 else "attitude turned by (x, y, z)"
    parameters = [
        Parameter(name=name, unit="rad", off=0.0, low=-0.3, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.02,
                  tolerance=0.002, source="assumption: set by hand to 0.6 degrees")
        for name in names
    ]  # fmt: skip
    if not sensor.pose:
        summary, about = f"{sensor.what} that is not aligned", "rates about axes turned by (x, y, z)"
        return sensor.misread("misalignment", summary, about, parameters, (("rate.turn", dofs),), alike)
    summary, places = f"{sensor.what} of a marker body that is not aligned", (("pose.offset", dofs),)
    return sensor.misread("misalignment", summary, equation, parameters, places, alike, follows="position")


def length_scale(sensor: Sensor, lengths: Dofs, rates: Dofs = (), alike: tuple[str, ...] = ()) -> Effect:
    """Lengths that are off by a factor, and velocities that come with them."""
    parameter = Parameter(
        name="scale", unit="", off=1.0, low=0.8, high=1.2, prior=Prior("normal", 1.0, 0.005), size=0.02,
        tolerance=0.001, source="assumption: calibrated to half a percent",
    )  # fmt: skip
    places, summary = (("pose.scale", lengths), ("rate.scale", rates)), f"a wrong length scale of {sensor.what}"
    return sensor.misread("scale", summary, "lengths × scale", [parameter], places, alike, follows="position")


def bias_of_rates(name: str, tolerance: float, unit: str, source: str) -> Parameter:
    """What a rate may read at rest, which a well-built sensor keeps within `tolerance`."""
    return Parameter(
        name=name, unit=unit, off=0.0, low=-125.0 * tolerance, high=125.0 * tolerance,
        prior=Prior("normal", 0.0, 5.0 * tolerance), size=10.0 * tolerance, tolerance=tolerance,
        source=f"assumption: {source}",
    )  # fmt: skip


def rate_bias(sensor: Sensor) -> Effect:
    """Rates of a gyro that are not zero at rest, about one axis or three."""
    names = ("bias",) if len(sensor.rate) == 1 else AXES
    parameters = [bias_of_rates(name, 0.004, "rad/s", "a MEMS gyro, some 1 degree/s") for name in names]
    equation = "q + bias" if len(names) == 1 else "rates + (x, y, z)"
    return sensor.misread("bias", f"a bias of {sensor.what}", equation, parameters, (("rate.bias", sensor.rate),))


RATE_SCALE = Parameter(
    name="scale", unit="", off=1.0, low=0.7, high=1.3, prior=Prior("normal", 1.0, 0.02), size=0.04, tolerance=0.004,
    source="assumption: a MEMS gyro, scale within 2 %",
)  # fmt: skip


def rate_scale(sensor: Sensor, alike: tuple[str, ...] = ()) -> Effect:
    """Rates that are off by a factor."""
    places = (("rate.scale", sensor.rate),)
    return sensor.misread("scale", f"a wrong scale of {sensor.what}", "q × scale", [RATE_SCALE], places, alike)


def list_velocity_bias(place: JointScale) -> tuple[Parameter, ...]:
    """What logged velocities of a joint may read at rest."""
    bias = bias_of_rates("bias", SLIGHT * place.speed, f"{place.length}/s", "half a percent of what it reaches")
    return (replace(bias, low=place.room * bias.low, high=place.room * bias.high),)


velocity_bias = JointLaw(
    "rate_bias", "a bias of logged velocities {where}", "q + bias", Stage.CONSTANT, add(("rate.bias", "dof")),
    list_velocity_bias, shows=("/joint_states",),
)  # fmt: skip
velocity_scale = JointLaw(
    "rate_scale", "a wrong scale of logged velocities {where}", "q × scale", Stage.CONSTANT,
    multiply(("rate.scale", "dof")), lambda place: (RATE_SCALE,), shows=("/joint_states",),
)  # fmt: skip


def late_joint(joint: str, dof: int) -> Effect:
    """`JOINT.delay`: a joint that nothing drives, seen later than the others: by a camera, or through a filter."""
    late = delay(Sensor(joint, f"readings of joint {joint}", (dof,), (dof,), target=joint))
    (parameter,) = late.parameters
    return replace(late, parameters=(replace(parameter, high=LATEST, source="assumption: a camera, some 50 ms"),))


def effects_for_pose(body: str, dof: int, gyro: str, free: bool = True) -> list[Effect]:
    """`BODY.delay`, `.drift`, `.misalignment`, `.scale` of a free body's poses; `GYRO.bias`, `.scale`, `.misalignment`.

    Rates that no gyro tells come with the poses. A body that hangs by a ball joint has an attitude alone.
    """
    moved, turned = (tuple(dof + i for i in part) for part in (LINEAR, ANGULAR if free else LINEAR))
    moved = moved if free else ()
    rates = moved if gyro else (*moved, *turned)
    poses = Sensor(body, f"poses of {body}", (*moved, *turned), rates, BODY_SHOWS[:1], body)
    other = (f"{gyro}.misalignment",) if gyro else ()
    found = [*effects_for_clock(poses), misalignment(poses, turned, other)]
    found += [length_scale(poses, moved, moved)] if free else []
    if not gyro:
        return found
    sensor = Sensor(gyro, f"the gyro {gyro}", rate=turned, shows=BODY_SHOWS[1:], target=gyro)
    aside = misalignment(sensor, turned, (f"{body}.misalignment",))
    return [*found, rate_bias(sensor), rate_scale(sensor), aside]


def effects_for_clock(sensor: Sensor) -> list[Effect]:
    """`NAME.delay` and `NAME.drift` of what is stamped elsewhere than the commands."""
    return [delay(sensor, (f"{sensor.name}.drift",)), drift(sensor, (f"{sensor.name}.delay",))]
