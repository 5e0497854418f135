"""Adaptive actuator controller (paper, section "Adaptive Actuator Controller"): real thrust follows the command.

What holds a rotor back tells its blade pitch: the load torque, of which motor current and speed are the measure, is a
known function of pitch, but for what no map knows: how much drag the rotor really has, where its linkage is zero, how
much play it has. An extended Kalman filter estimates these three from current, speed and the commands sent, and
commands are corrected for them. Once learned they stay, so there is no loop from thrust to command that a linkage with
play could make swing.

All functions are pure but for `memory`, a row of numbers of one rotor that is written in place.
"""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.blade import compute_drag_torque
from vpptwin.actuators.numbers import MotorNumbers, Number, RotorNumbers, VehicleNumbers
from vpptwin.actuators.servo import step_lag, take_up_play
from vpptwin.engine.compile import compilable

SPEED, TRIM, HALF_GAP, DRAG = range(4)
"""Estimates: rotor speed [rad/s], pitch offset of the linkage [rad], half its play [rad], drag over the map's."""
COVARIANCE = 4
"""Upper triangle of their covariance, row by row, ten numbers from here."""
HORN, BLADE, SIDE, LEAD, TARGET = range(14, 19)
"""Where the servo is believed to be, the blade without its offset, by which side of the play it was last pushed
(+1 upward), how far the command leads the blade for the play, and the last pitch asked for [rad]."""
LAST_CURRENT, LAST_THROTTLE, HELD, FAULT, COMMAND = range(19, 24)
"""The last current [A], the throttle when it last changed, for how many steps it has not, what is wrong, and the last
pitch commanded [rad]."""
KEPT = 24
"""All that was believed but for the speed when the current last changed, 13 numbers from here."""
SIZE = 37

SOUND, NO_SPEED, NO_CURRENT, STUCK_CURRENT = range(4)
"""What `memory[FAULT]` says. Anything but `SOUND` means that the map alone is used."""
FAULTS = ("", "no rotor speed", "no motor current", "motor current is stuck")
"""The same in words."""

SPREAD = (1.0, 0.015, 0.01, 0.2)
"""What the estimates may be off at first, standard deviations in their units."""
DRIFT = (0.0, 2e-3, 5e-4, 5e-3)
"""What they change by in a second."""
SPEED_NOISE = 1.0
"""Of measured speed [rad/s] (vehicle.yaml)."""
TORQUE_NOISE = 2e-3
"""Of the load torque that the map does not explain, from step to step [N m]."""
LASTING = 20.0
"""How much more than noise from step to step the part of drag counts that a straight line does not have: it lasts."""
LAG_DOUBT = 0.005
"""What the servo's lag may be off by [s]: while the blade moves, torque tells less."""
MAX_INNOVATION = 3.0
"""Standard deviations at which an innovation is cut off: a sensor that fails is not yet known to have."""
TURN = 0.004
"""How far the pitch asked for has to turn back until the command takes up the play on the other side [rad]."""
ROUND = 0.01
"""Pitch within which the kink of |α| is rounded off, for the filter's derivative [rad]."""
HALF_GAP_MAX, TRIM_MAX, DRAG_MIN, DRAG_MAX = 0.03, 0.08, 0.4, 2.5
"""What is believed of a linkage and a rotor [rad, rad, -, -]."""
STUCK_STEPS, STUCK_THROTTLE = 50, 0.01
"""A current that is the same for so many steps while the throttle changes by so much is a stuck one."""


@compilable()
def estimate_pitch(
    rotor: RotorNumbers, motor: MotorNumbers, speed: Number, current: Number, acceleration: Number, drag: Number
) -> Number:
    """Size of the blade pitch |α| [rad] that explains a motor current (paper, Eq. for α; its simplified form at ω̇ = 0).

    From I ω̇ = (i - i_0)/k_Q - c (k_D1 ω² + k_D2 ω² α² + k_D3 ω |α|): α = √(g_0 (i - i_0) + g_1) - g_2 with
    g_0 = 1/(c k_Q k_D2 ω²), g_2 = k_D3/(2 k_D2 ω), g_1 = g_2² - k_D1/k_D2 at ω̇ = 0. The paper prints g_2 under the root
    without its square.

    Args:
        rotor: map.
        motor: map.
        speed: ω [rad/s].
        current: i [A].
        acceleration: ω̇ [rad/s²].
        drag: c, of the rotor over that of the map.
    """
    torque = (current - motor.no_load_current) / motor.k_q - rotor.inertia * acceleration
    shift = rotor.k_d3 / (2.0 * rotor.k_d2 * speed)
    inside = (torque / drag - rotor.k_d1 * speed * speed) / (rotor.k_d2 * speed * speed) + shift * shift
    return np.sqrt(np.maximum(inside, shift * shift)) - shift


def start_memory(speed: float) -> np.ndarray:
    """The memory of a rotor before anything is learned, blade at zero, rotor at `speed` [rad/s], (`SIZE`,)."""
    memory = np.zeros(SIZE)
    memory[SPEED], memory[DRAG] = speed, 1.0
    memory[COVARIANCE] = SPREAD[0] * SPREAD[0]
    memory[COVARIANCE + 4] = SPREAD[1] * SPREAD[1]
    memory[COVARIANCE + 7] = SPREAD[2] * SPREAD[2]
    memory[COVARIANCE + 9] = SPREAD[3] * SPREAD[3]
    memory[KEPT : KEPT + 13] = memory[TRIM : COVARIANCE + 10]
    return memory


@compilable()
def find_fault(memory: np.ndarray, speed: float, current: float, throttle: float) -> None:
    """Look at a measurement of speed [rad/s] and current [A], and at the throttle that made it; write `memory[FAULT]`.

    A fault stays while its cause does; that of a stuck current ends with the first that differs.
    """
    if current == memory[LAST_CURRENT]:
        memory[HELD] += 1.0
    else:
        memory[HELD] = 0.0
        memory[LAST_THROTTLE] = throttle
        for i in range(13):
            memory[KEPT + i] = memory[TRIM + i]
    stuck = memory[HELD] >= STUCK_STEPS and np.abs(throttle - memory[LAST_THROTTLE]) > STUCK_THROTTLE
    stuck = stuck or (memory[FAULT] == STUCK_CURRENT and memory[HELD] > 0.0)
    memory[LAST_CURRENT] = current
    if not speed > 0.0 or speed > 1e4:  # a number that is none included
        memory[FAULT] = NO_SPEED
    elif not np.abs(current) < 1e3:
        memory[FAULT] = NO_CURRENT
    elif stuck:
        memory[FAULT] = STUCK_CURRENT
        for i in range(13):
            memory[TRIM + i] = memory[KEPT + i]  # what it has told meanwhile was nothing
    else:
        memory[FAULT] = SOUND


@compilable()
def learn(
    vehicle: VehicleNumbers, memory: np.ndarray, speed: float, current: float, throttle: float, dt: float
) -> None:
    """One step of the Kalman filter: what happened in the last `dt` [s].

    Args:
        vehicle: the believed one.
        memory: of the rotor.
        speed: measured at the end [rad/s].
        current: measured there [A].
        throttle: that was commanded, 0..1.
        dt: inner step [s].
    """
    find_fault(memory, speed, current, throttle)
    moved = follow_linkage(vehicle, memory, dt)
    known_speed = memory[SPEED] > 0.0
    if memory[FAULT] != SOUND or not known_speed:
        memory[SPEED] = 0.0 if memory[FAULT] == NO_SPEED else speed
        return
    rotor, motor, drag = vehicle.rotor, vehicle.motor, memory[DRAG]
    pitch = memory[BLADE] + memory[TRIM]
    known = compute_drag_torque(rotor, memory[SPEED], pitch)
    step = dt / rotor.inertia
    # I ω̇ = (i - i_0)/k_Q - c M(ω, α), as in `estimate_pitch`: the next speed is the one thing that is predicted.
    torque = (current - motor.no_load_current) / motor.k_q - drag * known
    # Slope and half the curvature of the map's torque over pitch, its |α| rounded off.
    size = np.sqrt(pitch * pitch + ROUND * ROUND)
    slope = 2.0 * rotor.k_d2 * speed * speed * pitch + rotor.k_d3 * speed * pitch / size
    bend = rotor.k_d2 * speed * speed + 0.5 * rotor.k_d3 * speed * ROUND * ROUND / (size * size * size)
    # Derivative of the next speed by each estimate: the first row of F, the others being those of the identity.
    a = 1.0 - step * drag * 2.0 * rotor.k_d1 * speed
    b = -step * drag * slope
    c = -b * memory[SIDE]
    d = -step * known
    doubt = b * moved / dt * LAG_DOUBT
    # What the straight line leaves out, by the spread of pitch and drag: second-order terms, as noise.
    p = memory[COVARIANCE : COVARIANCE + 10]
    bent = drag * bend * (p[4] + p[7]) + np.abs(slope) * np.sqrt(p[4] * p[9])
    noise = step * (TORQUE_NOISE + LASTING * bent)
    update(memory, speed, memory[SPEED] + step * torque, (a, b, c, d), noise, doubt, dt)


@compilable()
def follow_linkage(vehicle: VehicleNumbers, memory: np.ndarray, dt: float) -> float:
    """Move the believed servo and blade on to the end of a step; how far the servo's horn went [rad]."""
    before = memory[HORN]
    horn, mean = step_lag(before, memory[COMMAND], vehicle.servo.time_constant, dt)
    memory[HORN] = horn
    blade = take_up_play(memory[BLADE], mean, 2.0 * memory[HALF_GAP])
    if blade != memory[BLADE]:
        memory[SIDE] = 1.0 if blade > memory[BLADE] else -1.0
    memory[BLADE] = blade
    return horn - before


@compilable()
def update(
    memory: np.ndarray, speed: float, predicted: float, row: tuple[float, float, float, float], noise: float,
    doubt: float, dt: float,
) -> None:  # fmt: skip
    """Carry the covariance on, and correct the estimates by a measured speed [rad/s] where another was predicted.

    F P Fᵀ + Q with an F that has one `row` of its own, the derivative of the prediction by each estimate, and the
    update by a single number, H = (1, 0, 0, 0), written out for the ten numbers of the triangle: the exported C does
    the same, without matrices. `noise` and `doubt` are what the prediction may be off by [rad/s], noise and lag.
    """
    a, b, c, d = row
    p = memory[COVARIANCE : COVARIANCE + 10]
    u0 = a * p[0] + b * p[1] + c * p[2] + d * p[3]
    u1 = a * p[1] + b * p[4] + c * p[5] + d * p[6]
    u2 = a * p[2] + b * p[5] + c * p[7] + d * p[8]
    u3 = a * p[3] + b * p[6] + c * p[8] + d * p[9]
    v0 = a * u0 + b * u1 + c * u2 + d * u3 + noise * noise + doubt * doubt
    variance = v0 + SPEED_NOISE * SPEED_NOISE
    # Gain K = P Hᵀ/S, S = H P Hᵀ + R; estimates grow by K y, y = z - h(x) the innovation (Särkkä 2013, section 5.2).
    largest = MAX_INNOVATION * np.sqrt(variance)
    innovation = min(max(speed - predicted, -largest), largest)
    k0, k1, k2, k3 = v0 / variance, u1 / variance, u2 / variance, u3 / variance
    memory[SPEED] = predicted + k0 * innovation
    memory[TRIM] = min(max(memory[TRIM] + k1 * innovation, -TRIM_MAX), TRIM_MAX)
    memory[HALF_GAP] = min(max(memory[HALF_GAP] + k2 * innovation, 0.0), HALF_GAP_MAX)
    memory[DRAG] = min(max(memory[DRAG] + k3 * innovation, DRAG_MIN), DRAG_MAX)
    p[0] = v0 * (1.0 - k0)
    p[1], p[2], p[3] = u1 * (1.0 - k0), u2 * (1.0 - k0), u3 * (1.0 - k0)
    p[4] += DRIFT[1] * DRIFT[1] * dt - k1 * u1
    p[5] -= k1 * u2
    p[6] -= k1 * u3
    p[7] += DRIFT[2] * DRIFT[2] * dt - k2 * u2
    p[8] -= k2 * u3
    p[9] += DRIFT[3] * DRIFT[3] * dt - k3 * u3


@compilable()
def correct_pitch(vehicle: VehicleNumbers, memory: np.ndarray, pitch: float) -> float:
    """Blade-pitch command [rad] that brings the blade to `pitch` [rad] in spite of offset and play of its linkage.

    An offset that is hardly known is hardly corrected. With a fault it is `pitch`: the map alone.
    """
    turned, half = pitch - memory[TARGET], memory[HALF_GAP]
    memory[TARGET] = pitch
    lead = memory[LEAD] + half / TURN * turned
    memory[LEAD] = min(max(lead, -half), half)
    if memory[FAULT] == SOUND:
        known = 1.0 - memory[COVARIANCE + 4] / (SPREAD[1] * SPREAD[1])
        pitch += memory[LEAD] - max(known, 0.0) * memory[TRIM]
    memory[COMMAND] = min(max(pitch, -vehicle.rotor.pitch_max), vehicle.rotor.pitch_max)
    return memory[COMMAND]
