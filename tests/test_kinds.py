"""Kinds of logs that people bring: drawn the same for a seed, integrated rightly, and what is said to be wrong is."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pytest

from proving.kinds import KINDS, Kind, write_kind
from proving.short_chains import Chain, Control, Encoder, H, Joint, ride, swing
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.windows import cut_windows, fly_windows
from vpptwin.logs.read import read_flight
from vpptwin.twin import Twin, TwinSpec, load_twin

FINE = Encoder(1e-9)
CLOSER = {"step": 5.0, "two_steps": 5.0, "two_zeros": 10.0, "load": 50.0, "wrist": 50.0, "relay": 10.0}
"""How many times closer at least a twin comes that is told the truth; kinds with noise or a small effect: 1.5."""

UNTOLD = ("nothing", "current", "noisy")
"""Has no truth; torque over current is past the bounds of a gain; noise hides what a second ahead shows."""


def find_stated(kind: str, folder: Path) -> Kind:
    """The case of the first seed that has a twin YAML."""
    for seed in count():
        case = write_kind(kind, seed, folder / f"{kind}_{seed}")
        if case.twin:
            return case
    raise AssertionError


def measure_error(spec: TwinSpec, case: Kind) -> float:
    """Root mean square error of a twin at the owner's horizon, over all logs of a case, from smoothed starts."""
    off = []
    for log in case.logs:
        measured = read_measurements(spec, read_flight(log, signals=spec.robot.signals.entries))
        end = min(series.time[-1] for series in measured.positions.values())
        starts = np.arange(0.3, end - case.horizon_s - 0.2, 0.25)
        windows = cut_windows(spec, measured, starts, case.horizon_s, causal=False)
        found = fly_windows(Twin(spec, len(windows)), windows).pose[:, -1]
        series = [measured.positions[joint] for joint in sorted(measured.positions)]
        off += list(found - np.stack([np.interp(starts + case.horizon_s, s.time, s.value) for s in series], axis=1))
    return float(np.sqrt(np.mean(np.square(off))))


@pytest.mark.parametrize("kind", KINDS)
def test_a_twin_that_is_told_the_truth_follows(kind: str, tmp_path: Path) -> None:
    """MuJoCo's step and ours agree; all ids of a case are of its rig's catalogue, and values within its bounds."""
    case = find_stated(kind, tmp_path)
    assert case.twin is not None
    spec = load_twin(case.twin)
    assert set(case.truth) <= {f"{effect.id}.{p.name}" for effect in spec.catalogue for p in effect.parameters}
    assert case.effects <= case.right
    assert case.right | case.also <= {effect.id for effect in spec.catalogue}
    if kind in UNTOLD:
        return
    hidden: dict[str, dict[str, float]] = {}
    for name, value in case.truth.items():
        effect, parameter = name.rsplit(".", 1)
        hidden.setdefault(effect, {})[parameter] = value
    told = spec.with_effects({**spec.effects, **hidden})
    assert measure_error(spec, case) > CLOSER.get(kind, 1.5) * measure_error(told, case)


@pytest.mark.parametrize("kind", KINDS)
def test_one_seed_makes_the_same_bytes(kind: str, tmp_path: Path) -> None:
    """And another seed makes others."""
    first, again, other = (write_kind(kind, seed, tmp_path / name) for name, seed in (("a", 7), ("b", 7), ("c", 8)))
    assert [path.read_bytes() for path in (first.model, *first.logs)] == [
        path.read_bytes() for path in (again.model, *again.logs)
    ]
    assert first.truth == again.truth
    assert first.logs[0].read_bytes() != other.logs[0].read_bytes()


def test_a_chain_without_friction_keeps_its_energy() -> None:
    """A double pendulum let go at 1 and -0.5 rad: the energy of its closed form, to 1e-3 of its swing in 5 s."""
    chain, rest = Chain((1.0, 0.5), (0.2, 0.15), (0.01, 0.004), 0.3, load=0.2, place=0.25), np.zeros((1000, 2))
    start = np.array([1.0, -0.5])
    log = swing(np.random.default_rng(1), chain, Control(rest, rest), 0.005, FINE, start)
    # by hand from masses and places, the load a third mass
    parts = ((1.0, 0.0, 0.2), (0.5, 0.3, 0.15), (0.2, 0.3, 0.25))
    one, two = log.position.T
    rate, both = swing_rates(log.position, log.period)
    energy = 0.5 * 0.01 * rate**2 + 0.5 * 0.004 * both**2 - parts[0][0] * 9.81 * parts[0][2] * np.cos(one)
    energy += 0.5 * parts[0][0] * (parts[0][2] * rate) ** 2
    for mass, first, second in parts[1:]:
        x = first * np.cos(one) * rate + second * np.cos(one + two) * both
        z = first * np.sin(one) * rate + second * np.sin(one + two) * both
        energy += 0.5 * mass * (x**2 + z**2) - mass * 9.81 * (first * np.cos(one) + second * np.cos(one + two))
    inner = energy[5:-5]
    assert np.ptp(inner) < 5e-3 * np.ptp(9.81 * np.cos(one))


def swing_rates(position: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Rates of both links in the world [rad/s], by central differences of fourth order."""
    p = position
    slope = np.gradient(p, period, axis=0)
    slope[2:-2] = (8.0 * (p[3:-1] - p[1:-3]) - (p[4:] - p[:-4])) / (12.0 * period)
    return slope[:, 0], slope.sum(axis=1)


def test_a_cart_settles_as_its_law_says() -> None:
    """Force F on mass m with damping c from rest: v = F/c (1 - exp(-c t / m)); half a step of 0.1 ms off."""
    push = np.full((400, 1), 2.0)
    cart = Joint(True, 1.5, gear=3.0, viscous=4.0)
    log = ride(np.random.default_rng(1), cart, Control(push, 0.0 * push), 0.005, FINE)
    time = log.period * np.arange(len(push))
    expected = 6.0 / 4.0 * (time - 1.5 / 4.0 * -np.expm1(-4.0 * time / 1.5))
    assert np.abs(log.position[:, 0] - expected).max() < 6.0 / 4.0 * H


def test_dry_friction_holds_what_is_weaker() -> None:
    """A cart under less force than its dry friction does not move; under more it accelerates by the difference."""
    push = np.full((200, 1), 1.0)
    for dry, moved in ((1.1, 0.0), (0.6, 0.5 * 0.4 * 1.99**2)):
        log = ride(np.random.default_rng(1), Joint(True, 1.0, dry=dry), Control(push, 0.0 * push), 0.01, FINE)
        assert log.position[-1, 0] == pytest.approx(moved, rel=1e-3, abs=1e-9)
