"""What windows are linearised about: a force that stays is no part of it."""

from __future__ import annotations

import numpy as np

from vpptwin.diagnosis.evidence.bench import Track


def test_the_steady_part_of_the_pulses_goes() -> None:
    """Per flight and degree of freedom their mean is 0 afterwards, what varies stays, and so do starts."""
    rng = np.random.default_rng(0)
    flight = np.array([0, 0, 1, 1, 1])
    varying = rng.standard_normal((5, 3, 2))
    steady = np.array([[0.5, -2.0], [3.0, 0.0]])[flight][:, None]
    pose, velocity = rng.standard_normal((2, 5, 2))
    track = Track(pose, velocity, varying + steady).without_steady(flight)
    for name in (0, 1):
        rows = flight == name
        np.testing.assert_allclose(track.push[rows].mean(axis=(0, 1)), 0.0, atol=1e-12)
        np.testing.assert_allclose(track.push[rows], varying[rows] - varying[rows].mean(axis=(0, 1)), atol=1e-12)
    np.testing.assert_array_equal(track.pose, pose)
    np.testing.assert_array_equal(track.velocity, velocity)
