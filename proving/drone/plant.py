"""Mechanics of the true rig: planar craft on carriage and slider, stepped at 0.25 ms by the explicit midpoint rule.

The midpoint velocity is predicted with the previous substep's acceleration, so each substep evaluates the forces
once and is still of second order. Dry friction is solved exactly for the push of the substep (friction.py).
"""

from __future__ import annotations

import numpy as np

from .contact import Contact
from .foreign import Foreign
from .friction import DryFriction, advance_velocity, settle
from .rig import PITCH, Rig, X, Z
from .rotor import STEP, SUBSTEPS

_UNEVEN_WAVE = 2 * np.pi / 0.6  # rad/m, of the rail's small unevenness


class Plant:
    """Positions and velocities of a batch of flights, and the forces on them."""

    def __init__(self, rig: Rig, position: np.ndarray, velocity: np.ndarray, step: float = STEP) -> None:
        """Start a batch.

        Args:
            rig: The true rigs.
            position: x m, z m, theta rad. (3, flights).
            velocity: Its rate. (3, flights).
            step: s by which `advance` advances.
        """
        self.rig, self.step = rig, step
        self.position, self.velocity = position.copy(), velocity.copy()
        self.accel = np.zeros_like(position)
        self.friction, self.contact = DryFriction(rig), Contact(rig)
        self.side_load = np.zeros(rig.count) if self.friction.jamming else None
        hidden = rig.hidden
        self.viscous, self.dragged = bool(rig.damping.any()), bool(rig.drag.any())
        self.unbalanced = bool(rig.com.any())
        self.spring = [hidden.get("rail_x.spring", name) for name in ("stiffness", "rest")]
        self.sprung = hidden.any("rail_x.spring")
        self.ground = [hidden.get("air.ground_effect", name) for name in ("gain", "height")]
        self.grounded = hidden.any("air.ground_effect")
        self.inflow, self.in_plane = hidden.get("rotor.inflow", "damping"), hidden.get("rotor.in_plane", "damping")
        self.blown = hidden.any("rotor.inflow", "rotor.in_plane")
        self.foreign = Foreign(rig)
        self.uneven = bool(rig.uneven.any())
        drop = hidden.any("alien.mass_drop")
        self.drop_mass = hidden.get("alien.mass_drop", "mass") if drop else None
        self.drop_time = hidden.get("alien.mass_drop", "time")
        self._set_constant_force()

    def _set_constant_force(self) -> None:
        rig = self.rig
        self.constant = rig.bias.copy()
        self.constant[X] -= rig.mass_x * rig.gravity * rig.tilt_sine
        self.constant[Z] -= rig.mass_z * rig.gravity
        self.on_carriage = rig.bias[X] - rig.carriage_mass * rig.gravity * rig.tilt_sine  # what of it acts there

    def drop_ballast(self, time: float) -> None:
        """Lose mass once its time (s after the start of the log) has come."""
        if self.drop_mass is None:
            return
        due = (time >= self.drop_time) & (self.drop_mass > 0.0)
        if due.any():
            self.rig.craft_mass = self.rig.craft_mass - np.where(due, self.drop_mass, 0.0)
            self.rig.update_mass()
            self.drop_mass = np.where(due, 0.0, self.drop_mass)
            self._set_constant_force()

    def compute_push(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        thrust: np.ndarray,
        speed: np.ndarray,
        gust: np.ndarray,
        touching: bool,
    ) -> np.ndarray:
        """Acceleration by everything but dry friction.

        Args:
            position: x m, z m, theta rad. (3, flights).
            velocity: Its rate. (3, flights).
            thrust: Of each rotor in still air, N. (2, flights).
            speed: Of each rotor, rad/s. (2, flights).
            gust: Force N along x and z, moment N m. (3, flights).
            touching: Whether contact is possible.

        Returns:
            m/s^2 and rad/s^2. (3, flights).
        """
        rig = self.rig
        sine, cosine = np.sin(position[PITCH]), np.cos(position[PITCH])
        along_arm = None
        if self.blown:
            along_arm = velocity[X] * cosine + velocity[Z] * sine
            along_axis = velocity[Z] * cosine - velocity[X] * sine
            spin = rig.half_length * velocity[PITCH]
            at_rotors = np.stack([along_axis - spin, along_axis + spin])
            thrust = thrust - self.inflow * speed * at_rotors
        if self.grounded:
            gain, height = self.ground
            thrust = thrust * (1 + gain * np.exp(-position[Z] / height))
        thrust = self.foreign.lift(thrust, position)
        total = thrust[0] + thrust[1]
        force = self.constant + gust
        force[X] -= total * sine
        force[Z] += total * cosine
        force[PITCH] += (thrust[1] - thrust[0]) * rig.half_length
        if self.dragged:
            force[:PITCH] -= rig.drag * np.hypot(velocity[X], velocity[Z]) * velocity[:PITCH]
        if along_arm is not None:
            hub_force = self.in_plane * (speed[0] + speed[1]) * along_arm
            force[X] -= hub_force * cosine
            force[Z] -= hub_force * sine
        self.foreign.push_craft(force, velocity, thrust, sine, cosine)
        if touching:
            self.contact.add_to_tips(force, position, velocity, sine, cosine)
        if self.unbalanced:
            self._couple(force, velocity, sine, cosine)
        if self.side_load is not None:
            # What slider and craft need for their acceleration and nothing else gives them comes from the guide.
            self.side_load = rig.mass_z * self.accel[X] - (force[X] - self.on_carriage)
        self._add_joint_forces(force, position, velocity, touching)
        return force * rig.inverse

    def _add_joint_forces(self, force: np.ndarray, position: np.ndarray, velocity: np.ndarray, touching: bool) -> None:
        """Add what acts in the joints to `force`: along x it acts on the carriage, so the guide does not carry it."""
        if self.viscous:
            force -= self.rig.damping * velocity
        if self.sprung:
            force[X] -= self.spring[0] * (position[X] - self.spring[1])
        self.foreign.push_joints(force, position, velocity)
        if self.uneven:
            force[X] -= self.rig.uneven * np.sin(_UNEVEN_WAVE * position[X])
        if touching:
            force[:PITCH] += self.contact.push_slides(position, velocity)

    def _couple(self, force: np.ndarray, velocity: np.ndarray, sine: np.ndarray, cosine: np.ndarray) -> None:
        """Add the coupling by a centre of mass off the hinge.

        The other joints' accelerations are those of the substep before: the coupling ratio is below 5 %.
        """
        rig, accel = self.rig, self.accel
        across, along = rig.com[0] * cosine - rig.com[1] * sine, rig.com[0] * sine + rig.com[1] * cosine
        whirl = velocity[PITCH] ** 2
        force[X] += rig.craft_mass * (along * accel[PITCH] + across * whirl)
        force[Z] -= rig.craft_mass * (across * accel[PITCH] - along * whirl)
        leak = rig.gravity * rig.tilt_sine
        force[PITCH] -= rig.craft_mass * (across * (accel[Z] + rig.gravity) - along * (accel[X] + leak))

    def compute_acceleration(self, thrust: np.ndarray, speed: np.ndarray, gust: np.ndarray) -> np.ndarray:
        """True acceleration at the present instant, dry friction included. Arguments as in compute_push."""
        touching = not self.rig.free and self.contact.is_near(self.position)
        push = self.compute_push(self.position, self.velocity, thrust, speed, gust, touching)
        if not self.friction.active:
            return push
        sliding, breakaway, direction = self._friction_levels(self.position, self.velocity, push)
        return np.where(direction == 0.0, settle(push, breakaway), push - direction * sliding)

    def _friction_levels(self, position: np.ndarray, velocity: np.ndarray, push: np.ndarray) -> tuple:
        """Sliding and breakaway friction over mass, and the sense of motion. Each (3, flights)."""
        friction, inverse = self.friction, self.rig.inverse
        sliding, breakaway = friction.compute_levels(position, velocity, self.side_load)
        direction = np.sign(velocity)
        if friction.lopsided:
            tendency = np.where(direction == 0.0, np.sign(push), direction)
            sliding, breakaway = friction.orient(sliding, tendency), friction.orient(breakaway, tendency)
        sliding = sliding * inverse
        return sliding, sliding if breakaway is sliding else breakaway * inverse, direction

    def advance(self, thrust: np.ndarray, speed: np.ndarray, gusts: np.ndarray) -> None:
        """Advance one step, a millisecond unless told otherwise at the start.

        Args:
            thrust: At rotor.NODES of the step, N. (nodes, 2, flights).
            speed: There too, rad/s. (nodes, 2, flights).
            gusts: At the substeps' midpoints, N and N m. (substeps, 3, flights).
        """
        step, half = self.step / SUBSTEPS, 0.5 * self.step / SUBSTEPS
        touching = not self.rig.free and self.contact.is_near(self.position)
        for node in range(SUBSTEPS):
            velocity = self.velocity
            middle = self.position + half * velocity
            halfway = velocity + half * self.accel
            push = self.compute_push(middle, halfway, thrust[node], speed[node], gusts[node], touching)
            if self.friction.active:
                sliding, breakaway, _ = self._friction_levels(middle, velocity, push)
                after = advance_velocity(velocity, push, sliding, breakaway, step)
            else:
                after = velocity + step * push
            self.accel = (after - velocity) / step
            self.position = self.position + half * (velocity + after)
            self.velocity = after
            self.foreign.advance(after, self.accel, step)
