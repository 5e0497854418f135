"""The drone's catalogue: every effect of the craft on its rail rig, in the order in which they act."""

from __future__ import annotations

from dataclasses import replace

from vpptwin.effects import friction, joint, sensing
from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.body import add_mass, move_centre
from vpptwin.effects.constants import Change, add, limit, multiply, take
from vpptwin.effects.contact import effects_for_contacts
from vpptwin.effects.friction import apply_load
from vpptwin.effects.joint import JOINT_SHOWS, JointScale
from vpptwin.effects.parameter import Parameter, Prior
from vpptwin.robots.planar_drone.effects import laws

X, Z, PITCH = 0, 1, 2
"""Degrees of freedom."""
CRAFT_SHOWS = ("/mocap/pose", "/imu/data")
TURN_SHOWS = ("/imu/data", "/mocap/pose")
"""Of what shows in how the craft turns first."""
RIG = ("carriage", "slider")
"""Bodies without which nothing cocks."""
RAIL = JointScale("rail_x", "on the horizontal rail", reason="the craft weighs 4.4 N")
RAIL_SPOT = JointScale(
    "rail_x", "on the horizontal rail", tolerance=0.02, size=0.2, travel=1.0, reason="a knock in the rail"
)
GUIDE = JointScale("rail_z", "on the vertical guide", reason="the craft weighs 4.4 N")
PIVOT_FRICTION = JointScale("pitch", "in the pivot", rotary=True, scale=0.1, reason="0.5 N at a rotor")
PIVOT_DAMPING = JointScale("pitch", "in the pivot", rotary=True, scale=0.03, reason="0.36 N m at 12 rad/s")
PIVOT_TORQUE = JointScale("pitch", "in the pivot", rotary=True, scale=0.25, reason="1.25 N at a rotor")

JAMMING_X = Effect(
    "rail_x.jamming", "a carriage that jams on the horizontal rail under load",
    "-mu |N (z - rail_height)|/bearing_spacing sgn(v)",
    (Parameter(name="mu", unit="", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.005), size=0.005,
               tolerance=0.0005, source="assumption: the paper tells of stuck sliders, no numbers"),),
    Stage.FRICTION, laws.apply_jamming, JOINT_SHOWS, look_alikes=("rail_x.coulomb",), target="rail_x",
    needs=RIG, dissipative=True,
)  # fmt: skip
JAMMING_Z = Effect(
    "rail_z.jamming", "a slider that jams on the vertical guide under load", "-mu |N| sgn(v)",
    (Parameter(name="mu", unit="", off=0.0, low=0.0, high=1.0, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
               tolerance=0.005, source="assumption: the paper tells of stuck sliders, no numbers"),),
    Stage.FRICTION, apply_load, JOINT_SHOWS, look_alikes=("rail_z.coulomb",), target="rail_z",
    needs=RIG, dissipative=True,
)  # fmt: skip
RAIL_TILT = Effect(
    "rail.tilt", "a horizontal rail that is not level", "-m_x g sin(angle)",
    (Parameter(name="angle", unit="rad", off=0.0, low=-0.3, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.02,
               tolerance=0.002, source="assumption: levelled by hand to 0.6 degrees"),),
    Stage.CONSTANT, laws.apply_tilt, CRAFT_SHOWS,
    look_alikes=("rail_x.bias", "mocap.misalignment", "rail_x.asymmetry"), writes=("opt.gravity",), follows="position",
)  # fmt: skip
CARRIAGE_MASS = Effect(
    "carriage.mass", "a wrong mass of the carriage", "m_carriage + mass",
    (Parameter(name="mass", unit="kg", off=0.0, low=-0.06, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.03,
               tolerance=0.0015, source="assumption: 0.080 kg (vehicle.yaml) within 10 g"),),
    Stage.CONSTANT, add_mass, CRAFT_SHOWS,
    target="carriage", look_alikes=("rail_x.spring", "rail_x.elastic"), needs=("carriage",), follows="command",
)  # fmt: skip
MASS = Effect(
    "airframe.mass", "a wrong mass of the craft", "m + mass",
    (Parameter(name="mass", unit="kg", off=0.0, low=-0.09, high=0.15, prior=Prior("normal", 0.0, 0.02), size=0.02,
               tolerance=0.0018, source="assumption: 0.450 kg (vehicle.yaml) within 20 g"),),
    Stage.CONSTANT, add_mass, CRAFT_SHOWS,
    look_alikes=("rotor.thrust_gain", "rail_z.bias", "servo.trim"), follows="command",
)  # fmt: skip
INERTIA = Effect(
    "airframe.inertia", "a wrong moment of inertia of the craft", "I + inertia",
    (Parameter(name="inertia", unit="kg m^2", off=0.0, low=-0.003, high=0.006, prior=Prior("normal", 0.0, 0.0004),
               size=0.0004, tolerance=0.00008, source="assumption: 0.0060 kg m^2 (vehicle.yaml) within 7 %"),),
    Stage.CONSTANT, add(("body_inertia", "body", 1)), TURN_SHOWS,
    look_alikes=("rotor.thrust_gain", "gyro.scale", "servo.lag"), follows="command",
)  # fmt: skip
COM = Effect(
    "airframe.com", "a centre of mass beside the hinge", "c_arm = offset, I + m offset²",
    (Parameter(name="offset", unit="m", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.005,
               tolerance=0.0005, source="assumption: balanced by hand to 3 mm"),),
    Stage.CONSTANT, move_centre("x"), TURN_SHOWS,
    look_alikes=("rotor.asymmetry", "servo.trim", "pitch.bias"), follows="position",
)  # fmt: skip
COM_HEIGHT = Effect(
    "airframe.com_height", "a centre of mass above or below the hinge", "c_up = offset, I + m offset²",
    (Parameter(name="offset", unit="m", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.005,
               tolerance=0.0005, source="assumption: built to 3 mm of the drawing"),),
    Stage.CONSTANT, move_centre("z"), TURN_SHOWS, follows="position",
)  # fmt: skip
DRAG = Effect(
    "air.drag", "aerodynamic drag on the craft", "-k_d |v| v",
    (Parameter(name="k_d", unit="N s^2/m^2", off=0.0, low=0.0, high=1.0, prior=Prior("halfnormal", 0.0, 0.08),
               size=0.05, tolerance=0.006, source="assumption: the paper fits k_d and prints no value"),),
    Stage.FORCE, laws.apply_drag, CRAFT_SHOWS,
    look_alikes=("rail_x.viscous", "rail_z.viscous", "rotor.in_plane"), dissipative=True,
)  # fmt: skip
THRUST_GAIN = Effect(
    "rotor.thrust_gain", "a wrong thrust constant of the rotors", "T × gain",
    (Parameter(name="gain", unit="", off=1.0, low=0.5, high=1.5, prior=Prior("normal", 1.0, 0.05), size=0.04,
               tolerance=0.004, source="assumption: k_t (vehicle.yaml) within 5 %"),),
    Stage.THRUST, laws.apply_thrust_gain, CRAFT_SHOWS,
    look_alikes=("airframe.mass", "rail_z.bias", "airframe.inertia", "gyro.scale", "servo.trim",
                 "rotor.negative_thrust", "rotor.stall", "air.ground_effect"), follows="command",
)  # fmt: skip
ASYMMETRY = Effect(
    "rotor.asymmetry", "rotors of unequal thrust", "T_1 × (1 + fraction), T_2 × (1 - fraction)",
    (Parameter(name="fraction", unit="", off=0.0, low=-0.5, high=0.5, prior=Prior("normal", 0.0, 0.02), size=0.02,
               tolerance=0.003, source="assumption: rotors of one make differ by 2 %"),),
    Stage.THRUST, laws.apply_asymmetry, TURN_SHOWS,
    look_alikes=("pitch.bias", "airframe.com", "servo.trim"), follows="command",
)  # fmt: skip
NEGATIVE_THRUST = Effect(
    "rotor.negative_thrust", "less thrust at negative blade pitch", "T × (1 - loss) where α < 0",
    (Parameter(name="loss", unit="", off=0.0, low=0.0, high=0.9, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
               tolerance=0.005, source="assumption: nearly symmetric blades, some 5 %"),),
    Stage.THRUST, laws.apply_negative_thrust, CRAFT_SHOWS, look_alikes=("rotor.thrust_gain",), follows="command",
)  # fmt: skip
STALL = Effect(
    "rotor.stall", "blades that stall at large pitch", "α beyond ±onset counts a quarter",
    (Parameter(name="onset", unit="rad", off=0.5, low=0.05, high=0.5, prior=Prior("uniform", 0.15, 0.25), size=0.36,
               tolerance=0.005, source="assumption: typical 0.15 rad; no blade is pitched to 0.5"),),
    Stage.THRUST, laws.apply_stall, CRAFT_SHOWS, look_alikes=("rotor.thrust_gain",), follows="command",
)  # fmt: skip
INFLOW = Effect(
    "rotor.inflow", "thrust lost to the air that flows through the rotors", "T - damping ω v_axis",
    (Parameter(name="damping", unit="N s/(m rad)", off=0.0, low=0.0, high=0.005,
               prior=Prior("halfnormal", 0.0, 3e-4), size=2e-4, tolerance=2e-5,
               source="assumption: of the order of k_t/(speed × radius)"),),
    Stage.THRUST, laws.apply_inflow, CRAFT_SHOWS, look_alikes=("rail_z.viscous", "pitch.viscous"), dissipative=True,
)  # fmt: skip
GROUND_EFFECT = Effect(
    "air.ground_effect", "more thrust near the floor", "T × (1 + gain exp(-z/height))",
    (
        Parameter(name="gain", unit="", off=0.0, low=0.0, high=2.0, prior=Prior("halfnormal", 0.0, 0.1), size=0.1,
                  tolerance=0.02, source="assumption: some 10 % more at the floor"),
        Parameter(name="height", unit="m", off=0.3, low=0.05, high=2.0, prior=Prior("normal", 0.3, 0.05), size=0.1,
                  tolerance=2.0, source="assumption: fades within some 0.3 m"),
    ),
    Stage.THRUST, laws.apply_ground_effect, CRAFT_SHOWS,
    look_alikes=("rotor.thrust_gain",), fades_along="rail_z", follows="position",
)  # fmt: skip
IN_PLANE = Effect(
    "rotor.in_plane", "drag of the rotors along the arm", "-damping (ω_1 + ω_2) v_arm",
    (Parameter(name="damping", unit="N s/(m rad)", off=0.0, low=0.0, high=0.005,
               prior=Prior("halfnormal", 0.0, 2e-4), size=1e-4, tolerance=1e-5,
               source="assumption: somewhat less than rotor.inflow"),),
    Stage.FORCE, laws.apply_in_plane, CRAFT_SHOWS, look_alikes=("rail_x.viscous", "air.drag"), dissipative=True,
)  # fmt: skip
DRAG_TORQUE = Effect(
    "rotor.drag", "a wrong drag torque of the rotors", "D × gain",
    (Parameter(name="gain", unit="", off=1.0, low=0.3, high=3.0, prior=Prior("normal", 1.0, 0.1), size=0.1,
               tolerance=0.01, source="assumption: k_d1 to k_d3 (vehicle.yaml) within 10 %"),),
    Stage.CONSTANT, multiply(("rotor.drag_gain",)), ("/rotor/state",), look_alikes=("battery.sag",), follows="command",
)  # fmt: skip
SAG = Effect(
    "battery.sag", "a battery whose voltage falls", "U × (1 - rate t)",
    (Parameter(name="rate", unit="1/s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.002),
               size=0.004, tolerance=0.0004, source="assumption: a small pack loses some 0.2 % a second"),),
    Stage.CONSTANT, add(("battery.sag",)), ("/rotor/state",), look_alikes=("rotor.drag",), follows="command",
)  # fmt: skip
LAG = Effect(
    "servo.lag", "a wrong time constant of the pitch servos", "α̇ = (α_cmd - α)/time_constant",
    (Parameter(name="time_constant", unit="s", off=0.020, low=0.001, high=0.2, prior=Prior("normal", 0.020, 0.003),
               size=0.004, tolerance=0.0006, nominal="servo.time_constant",
               source="vehicle.yaml; spread (15 %, built to 3 %): assumption"),),
    Stage.CONSTANT, Change(take, (("actuator.time_constant",),)), TURN_SHOWS,
    look_alikes=("command.delay", "servo.rate_limit", "airframe.inertia"),
    follows="command change",
)  # fmt: skip
RATE_LIMIT = Effect(
    "servo.rate_limit", "pitch servos of limited rate", "|α̇| ≤ rate",
    (Parameter(name="rate", unit="rad/s", off=1000.0, low=0.5, high=1000.0, prior=Prior("uniform", 4.0, 20.0),
               size=998.0, tolerance=1.0, source="assumption: hobby servos, typically 2 to 10 rad/s"),),
    Stage.CONSTANT, limit(("actuator.rate_limit",)), TURN_SHOWS, look_alikes=("servo.lag",), follows="command change",
)  # fmt: skip
BACKLASH = Effect(
    "servo.backlash", "play between servo horns and blades", "α within ±gap/2 of the horn",
    (Parameter(name="gap", unit="rad", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.003), size=0.005,
               tolerance=0.0005, source="assumption: the paper tells of gaps, no numbers"),),
    Stage.CONSTANT, add(("actuator.gap",)), TURN_SHOWS, look_alikes=("command.delay",), follows="command change",
)  # fmt: skip
TRIM = Effect(
    "servo.trim", "blades that are not trimmed", "α_1 + offset_1, α_2 + offset_2",
    tuple(
        Parameter(name=name, unit="rad", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.004,
                  tolerance=0.0004, source="assumption: trimmed by hand to 0.2 degrees")
        for name in ("offset_1", "offset_2")
    ),
    Stage.CONSTANT, add(("actuator.trim", 0), ("actuator.trim", 1)), TURN_SHOWS,
    look_alikes=("rotor.asymmetry", "airframe.com", "pitch.bias", "airframe.mass", "rotor.thrust_gain"),
    follows="command",
)  # fmt: skip
DELAY = Effect(
    "command.delay", "a delay from command to servo", "α_cmd(t - delay)",
    (Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.005),
               size=0.003, tolerance=0.0005, source="assumption: most within a policy step of 10 ms"),),
    Stage.CONSTANT, add(("actuator.delay",)), TURN_SHOWS,
    look_alikes=("servo.lag", "servo.backlash"), follows="command change",
)  # fmt: skip
MOCAP = sensing.Sensor("mocap", "motion capture poses", (X, Z, PITCH), shows=("/mocap/pose",))
CLOCK = replace(MOCAP, name="clock")
GYRO = sensing.Sensor("gyro", "the gyro", rate=(PITCH,), shows=("/imu/data",))
SENSORS = (
    sensing.delay(MOCAP, ("clock.drift",)),
    sensing.drift(CLOCK, ("mocap.delay",)),
    sensing.misalignment(MOCAP, (PITCH,), ("rail_x.bias", "rail.tilt")),
    sensing.length_scale(MOCAP, (X, Z)),
    sensing.rate_bias(GYRO),
    sensing.rate_scale(GYRO, ("airframe.inertia", "rotor.thrust_gain")),
)

CATALOGUE: tuple[Effect, ...] = (
    friction.coulomb(RAIL, ("rail_x.viscous", "rail_x.stiction", "rail_x.jamming", "rail_x.tight_spot")),
    friction.coulomb(GUIDE, ("rail_z.viscous", "rail_z.stiction", "rail_z.jamming")),
    friction.coulomb(PIVOT_FRICTION, ("pitch.viscous",)),
    friction.stiction(RAIL, ("rail_x.coulomb",)),
    friction.stiction(GUIDE, ("rail_z.coulomb",)),
    JAMMING_X,
    JAMMING_Z,
    friction.tight_spot(RAIL_SPOT, ("rail_x.coulomb",)),
    # These scale all dry friction of their joint, so they come after it.
    friction.asymmetry(RAIL, ("rail.tilt", "rail_x.bias")),
    friction.asymmetry(GUIDE, ("rail_z.bias",)),
    friction.lugre(RAIL, modifies=("coulomb", "stiction", "jamming", "tight_spot"), needs=RIG),
    friction.lugre(GUIDE, modifies=("coulomb", "stiction", "jamming"), needs=RIG),
    friction.lugre(PIVOT_FRICTION, modifies=("coulomb",)),
    joint.viscous(RAIL, ("rail_x.coulomb", "air.drag", "rotor.in_plane")),
    joint.viscous(GUIDE, ("rail_z.coulomb", "air.drag", "rotor.inflow")),
    joint.viscous(PIVOT_DAMPING, ("pitch.coulomb", "rotor.inflow")),
    joint.bias(RAIL, ("rail.tilt", "mocap.misalignment", "rail_x.asymmetry", "rail_x.spring")),
    joint.bias(GUIDE, ("airframe.mass", "rotor.thrust_gain", "rail_z.asymmetry")),
    joint.bias(PIVOT_TORQUE, ("rotor.asymmetry", "airframe.com", "servo.trim")),
    joint.spring(RAIL, ("rail_x.bias", "carriage.mass")),
    joint.elastic(RAIL, ("carriage.mass",), needs=RIG),
    RAIL_TILT, CARRIAGE_MASS, MASS, INERTIA, COM, COM_HEIGHT, DRAG,
    THRUST_GAIN, ASYMMETRY, NEGATIVE_THRUST, STALL, INFLOW,
    GROUND_EFFECT,  # strengthens whatever thrust the rotors are left with
    IN_PLANE, DRAG_TORQUE, SAG, LAG, RATE_LIMIT, BACKLASH, TRIM, DELAY,
    *effects_for_contacts(CRAFT_SHOWS, [(0.01, 0.3)], 0.001, needs=RIG),
    *SENSORS,
)  # fmt: skip
"""Every effect of the drone on its rail rig."""
