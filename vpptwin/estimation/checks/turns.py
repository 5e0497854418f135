"""Positions and targets that were logged within one turn, of an encoder or a counter: where they jump they go on."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vpptwin.estimation.noise import COUNTED
from vpptwin.estimation.outliers import drop_rows
from vpptwin.logs.flight import Stream

TURN = 2.0 * np.pi
WIDE, SLIGHT, FASTER = 0.08, 0.02, 4.0
"""By how much of a turn a jump may differ from one at most; at rest; and by how many times the motion around it."""
AROUND = 4
"""Steps on either side of a jump that tell that motion."""
SPREAD = 3
"""Steps over which filters and resampling spread one jump at most."""
RARE = 0.005
"""Share of samples that may be half a turn from the one before, before a joint's unit is doubted."""
MOSTLY = 0.75
"""Share of the jumps that must be by a turn: else none is of an encoder."""
OUTSIDE = 0.01
"""Share of a position that may lie beyond the limits of its joint."""
GOES_ON = "{}: {} jumps by a turn {} times, as angles of one turn do: it goes on{}"
TAKEN = "{}: {} lies a turn beyond what the joint can do, and is taken a turn nearer"


def unwrap_turns(
    stream: Stream, label: str, limits: np.ndarray | None = None, rotary: bool = True
) -> tuple[Stream, list[str]]:
    """A joint's stream whose position goes on where it was logged within one turn, and a warning that says so.

    What jumps by less, as a belt that slips, is left as it is; samples within a jump, as filters make them, go.

    Args:
        stream: of the joint, positions in rad or m.
        label: of the joint.
        limits: between which it can be, (2,); they tell which turn it is on.
        rotary: whether it is a hinge. A slide's counter shows its turn by jumps from end to end.
    """
    position = stream.values.get("position", np.zeros(0))
    turn = TURN if rotary else measure_counter(stream.time, position)
    if len(position) < 2 or not turn:
        return stream, []
    far = np.abs(np.diff(position)) > 0.5 * turn
    if far.mean() > RARE and np.ptp(position) > (1.0 + WIDE) * turn:
        warning = (
            f"{label}: position moves {np.count_nonzero(far)} times by more than half a turn from sample to sample"
        )
        return stream, [f"{warning}; if these are degrees, say `unit: deg`"] if rotary else []
    kept = drop_rows(stream, find_between(stream.time, position, turn))
    wraps = find_wraps(kept.time, kept["position"], turn)
    number = int(np.count_nonzero(wraps))
    if number < MOSTLY * np.count_nonzero(np.abs(np.diff(kept["position"])) > 0.5 * turn) or not number:
        kept, number, wraps = stream, 0, np.zeros(len(position) - 1)
    position = kept["position"] - turn * np.append(0.0, np.cumsum(wraps))
    shift = 0.0 if limits is None else turn * choose_turn(position, limits, turn, bool(number))
    if not number and not shift:
        return stream, []
    among = f"; {len(stream) - len(kept)} samples within a jump are left out" if len(kept) < len(stream) else ""
    line = GOES_ON.format(label, "position", number, among) if number else TAKEN.format(label, "position")
    return Stream(kept.time, kept.values | {"position": position + shift}), [line]


def allow(time: np.ndarray, position: np.ndarray, turn: float) -> np.ndarray:
    """By how much each step (n - 1,) may differ from a turn, by the motion around it."""
    lasting = np.maximum(np.diff(time), 1e-9)
    speed = np.abs(np.diff(position)) / lasting
    around = np.pad(speed, AROUND, mode="edge")
    usual = np.median(sliding_window_view(around, 2 * AROUND + 1), axis=1) * lasting
    bound = max(WIDE * turn, FASTER * float(np.median(np.abs(np.diff(position)))))
    return np.minimum(np.maximum(SLIGHT * turn, FASTER * usual), bound)


def find_wraps(time: np.ndarray, position: np.ndarray, turn: float) -> np.ndarray:
    """Steps by a turn, +1 up and -1 down, 0 for all others, (n - 1,)."""
    steps = np.diff(position)
    if np.ptp(position) < (1.0 - WIDE) * turn:
        return np.zeros(len(steps))
    near = np.abs(np.abs(steps) - turn) <= allow(time, position, turn)
    return np.where(near, np.sign(steps), 0.0)


def find_between(time: np.ndarray, position: np.ndarray, turn: float) -> np.ndarray:
    """Samples within jumps by a turn that are spread over several steps, (n,) bool."""
    between = np.zeros(len(position), dtype=bool)
    if len(position) < 2 * AROUND or np.ptp(position) < (1.0 - WIDE) * turn:
        return between
    steps, allowed = np.diff(position), allow(time, position, turn)
    for wide in range(2, SPREAD + 1):
        parts = sliding_window_view(steps, wide)
        slack = sliding_window_view(allowed, wide).max(axis=1)
        jumps = np.abs(np.abs(parts.sum(axis=1)) - turn) <= slack
        jumps &= (np.abs(parts) > slack[:, None]).all(axis=1) & (np.abs(np.sign(parts).sum(axis=1)) == wide)
        for begin in np.flatnonzero(jumps):
            between[begin + 1 : begin + wide] = True
    return between


def measure_counter(time: np.ndarray, position: np.ndarray) -> float:
    """By how much [m] a slide's counter jumps from one end of what was logged to the other; 0 if it does not.

    Wild samples jump by as much as the slide has moved since the last one; a counter always by its turn.
    """
    if len(position) < 4 * AROUND or np.ptp(position) <= 0.0:
        return 0.0
    steps, span = np.diff(position), float(np.ptp(position))
    far = np.flatnonzero(np.abs(steps) > (1.0 - WIDE) * span)
    if len(far) < 2 or far[-1] - far[0] <= 2 * AROUND or len(far) > OUTSIDE * len(steps) + 2 * AROUND:
        return 0.0
    if np.abs(np.delete(steps, far)).max(initial=0.0) > 0.5 * span:
        return 0.0
    beside = np.interp(far, np.delete(np.arange(len(steps)), far), np.delete(steps, far))
    sizes = np.abs(steps[far] - beside)
    turn = float(np.median(sizes))
    count = float(np.abs(steps[steps != 0.0]).min())
    bits = 2.0 ** np.rint(np.log2(turn / count))
    if np.abs(steps / count - np.rint(steps / count)).max() < COUNTED and abs(turn / count - bits) < SLIGHT * bits:
        turn = bits * count
    moved = np.ptp(position - turn * np.append(0.0, np.cumsum(find_wraps(time, position, turn))))
    return turn if np.ptp(sizes) < SLIGHT * moved else 0.0


def choose_turn(position: np.ndarray, limits: np.ndarray, turn: float, mended: bool) -> int:
    """How many turns a position (n,) is to be moved by to lie within limits (2,); as logged: one at most."""

    def lie_outside(number: int) -> float:
        moved, slack = position + number * turn, OUTSIDE * float(np.ptp(limits))
        return float(np.mean((moved < limits[0] - slack) | (moved > limits[1] + slack)))

    number = round((float(np.mean(limits)) - 0.5 * float(position.min() + position.max())) / turn)
    before, after = lie_outside(0), lie_outside(number)
    wrong = abs(number) == 1 and before > 1.0 - OUTSIDE and after < OUTSIDE
    return number if (after < before if mended else wrong) else 0


def follow_turns(
    target: tuple[np.ndarray, np.ndarray], position: tuple[np.ndarray, np.ndarray], limits: np.ndarray | None,
    turn: float, mended: bool,
) -> np.ndarray:  # fmt: skip
    """Targets (n,) on the turn that the joint is on, each a whole number of turns from what was logged.

    Targets may step by any angle, so that not their own steps tell the turn but the joint's limits, or else where the
    joint has come in the end. They stay as they are unless they were logged within a turn and jump less often then.

    Args:
        target: time (n,) s, and as logged (n,).
        position: time (m,) s and where the joint was, unwrapped (m,).
        limits: of the joint, (2,); None for none.
        turn: of its encoder [rad, m].
        mended: whether the position was mended likewise.
    """
    time, logged = target
    within = limits is not None and np.ptp(limits) < turn
    last = np.append(np.flatnonzero(np.diff(logged)), len(logged) - 1)  # of every value that is held: there it arrives
    where = np.interp(time[last][np.searchsorted(last, np.arange(len(logged)))], *position)
    where = np.full(len(logged), np.mean(limits)) if limits is not None and within else where
    turns = np.rint((where - logged) / turn)
    if not turns.any() or np.ptp(logged) > (1.0 + SLIGHT) * turn:
        return logged
    followed = logged + turn * turns
    jumps = [np.count_nonzero(find_wraps(time, values, turn)) for values in (logged, followed)]
    constant = not np.ptp(turns) and np.abs(followed - np.interp(time, *position)).max() < 0.5 * turn
    return np.asarray(followed if jumps[1] < jumps[0] or mended or constant else logged)
