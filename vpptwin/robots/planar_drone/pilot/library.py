"""The library of manoeuvres, each made to show some effects and safe within the bounds of its settings."""

from __future__ import annotations

from functools import partial

from vpptwin.robots.planar_drone.pilot import choreography as fly
from vpptwin.robots.planar_drone.pilot.manoeuvre import Manoeuvre, Setting


def altitude(low: float, high: float) -> Setting:
    """The height at which a manoeuvre is flown."""
    return Setting("height", "m", 1.3, low, high, "height of the hinge above the floor")


LIBRARY: tuple[Manoeuvre, ...] = (
    Manoeuvre(
        "hover", "stand still in the air", ("servo.trim", "rail_z.bias", "pitch.bias", "gyro.bias"),
        (altitude(0.5, 2.0),), fly.hover,
    ),
    Manoeuvre(
        "x_steps", "jump along the rail from side to side",
        ("rail_x.coulomb", "servo.lag", "command.delay", "carriage.mass"),
        (Setting("amplitude", "m", 0.6, 0.05, 1.0, "half of the jump"),
         Setting("period", "s", 2.0, 1.2, 6.0, "between jumps"),
         altitude(0.7, 1.9)),
        partial(fly.steps, axis="x"),
    ),
    Manoeuvre(
        "z_steps", "jump up and down", ("rail_z.coulomb", "rail_z.viscous", "rotor.stall", "rotor.inflow"),
        (Setting("amplitude", "m", 0.3, 0.05, 0.5, "half of the jump"),
         Setting("period", "s", 1.6, 1.0, 6.0, "between jumps"),
         altitude(1.1, 1.7)),
        partial(fly.steps, axis="z"),
    ),
    Manoeuvre(
        "low_pass", "come down, pass near the floor, climb", ("air.ground_effect",),
        (Setting("height", "m", 0.36, 0.33, 1.0, "height of the hinge while passing"),
         Setting("amplitude", "m", 0.6, 0.2, 1.0, "half of the way along the rail"),
         Setting("period", "s", 2.5, 2.0, 8.0, "of a pass")),
        fly.low_pass,
    ),
    Manoeuvre(
        "aggressive_x", "large jumps and doublets, as fast as the craft leans",
        ("rail_x.jamming", "rail_z.jamming", "rail_x.viscous", "air.drag", "rotor.in_plane", "airframe.com_height"),
        (Setting("amplitude", "m", 0.85, 0.3, 1.0, "half of the jump along x"),
         Setting("climb", "m", 0.3, 0.0, 0.4, "half of the jump along z"),
         Setting("period", "s", 1.2, 1.0, 3.0, "between jumps")),
        fly.aggressive_x,
    ),
    Manoeuvre(
        "light_glide", "cruise in hops, light at their tops",
        ("rail_x.viscous", "air.drag", "rotor.in_plane", "rail_x.bias"),
        (Setting("speed", "m/s", 0.9, 0.3, 1.3, "along the rail"),
         Setting("lightness", "", 0.7, 0.2, 0.8, "share of the weight that the rotors let go"),
         Setting("amplitude", "m", 0.8, 0.4, 0.9, "half of the way, about")),
        fly.light_glide,
    ),
    Manoeuvre(
        "x_sweep", "swing along the rail, ever faster",
        ("rail_x.spring", "carriage.mass", "servo.lag", "command.delay"),
        (Setting("acceleration", "m/s²", 4.0, 1.0, 5.0, "of every swing"),
         Setting("slow", "Hz", 0.5, 0.5, 1.0, "first"),
         Setting("fast", "Hz", 2.5, 1.5, 4.0, "last")),
        partial(fly.sweep, axis=0),
    ),
    Manoeuvre(
        "thrust_sweep", "swing up and down, ever faster",
        ("airframe.mass", "rotor.thrust_gain", "rotor.stall", "servo.rate_limit"),
        (Setting("acceleration", "m/s²", 5.0, 1.0, 6.0, "of every swing"),
         Setting("slow", "Hz", 0.7, 0.6, 1.0, "first"),
         Setting("fast", "Hz", 3.0, 1.5, 5.0, "last")),
        partial(fly.sweep, axis=1),
    ),
    Manoeuvre(
        "pitch_doublets", "lean one way and the other",
        ("airframe.inertia", "gyro.scale", "rotor.thrust_gain", "servo.lag", "pitch.viscous", "pitch.coulomb"),
        (Setting("angle", "rad", 0.45, 0.1, 0.6, "of the lean"),
         Setting("width", "s", 0.14, 0.08, 0.2, "of either half"),
         Setting("period", "s", 0.9, 0.7, 3.0, "of rest between doublets")),
        fly.pitch_doublets,
    ),
    Manoeuvre(
        "inverted", "jumps upside down and upright",
        ("rotor.negative_thrust", "servo.trim", "mocap.misalignment", "airframe.com"),
        (Setting("amplitude", "m", 0.4, 0.0, 0.7, "of the jumps along x"),
         Setting("height", "m", 1.4, 1.3, 1.6, "of the hinge above the floor"),
         Setting("period", "s", 1.5, 1.2, 4.0, "between jumps")),
        fly.inverted,
    ),
    Manoeuvre(
        "flip", "half turns and whole ones",
        ("rotor.negative_thrust", "airframe.com", "airframe.com_height", "mocap.misalignment"),
        (Setting("period", "s", 2.0, 1.6, 5.0, "of rest between turns"),
         Setting("height", "m", 1.45, 1.4, 1.6, "of the hinge above the floor")),
        fly.flip,
    ),
    Manoeuvre(
        "rail_sweep", "creep from end to end", ("rail_x.tight_spot", "rail_x.spring", "rail.tilt", "rail_x.stiction"),
        (Setting("speed", "m/s", 0.3, 0.05, 0.8, "along the rail"),
         Setting("amplitude", "m", 1.2, 0.2, 1.25, "half of the way"),
         altitude(0.6, 2.0)),
        fly.rail_sweep,
    ),
    Manoeuvre(
        "figure", "a lying eight", ("rail_x.viscous", "rail_z.viscous", "air.drag", "mocap.delay", "mocap.scale"),
        (Setting("width", "m", 0.7, 0.2, 1.0, "half of it along x"),
         Setting("height", "m", 0.3, 0.1, 0.45, "half of it along z"),
         Setting("period", "s", 3.2, 2.6, 8.0, "of one eight")),
        fly.figure,
    ),
)  # fmt: skip
"""Every manoeuvre, tame ones first."""
