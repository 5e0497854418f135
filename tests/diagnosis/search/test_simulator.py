"""A bench as the inference sees it: windows along a path of starting states and pulses."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.rigs import CARTS, write_rig
from vpptwin.diagnosis.evidence.flights import build_bench
from vpptwin.diagnosis.search.simulator import BenchSimulator
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.spec import load_twin


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> BenchSimulator:
    """Five windows of 0.4 s of a cart that coasts at 0.3 m/s."""
    spec, time = load_twin(write_rig(CARTS, tmp_path_factory.mktemp("cart"))), np.arange(0.0, 6.0, 0.005)
    position = Series("slide", "m", time, 0.3 * time, 1e-3, white=False)
    velocity = Series("slide rate", "m/s", time, np.full_like(time, 0.3), 1e-2, white=False)
    command = Series("control", "", time, np.zeros((len(time), 1)), 0.0)
    flight = Measurements("coasting", {0: position}, {0: velocity}, None, command, None, (), 0.0, time[-1])
    return BenchSimulator(build_bench(spec, [flight], [0.5 + np.arange(5)], 0.4, False))


def test_a_path_moves_windows_as_responses_foretell(simulator: BenchSimulator) -> None:
    """A cart without friction is linear: what is missed along any path, and what that does, are missed about none."""
    nuisance = simulator.respond({})
    path = 0.5 * np.random.default_rng(1).normal(size=(5, nuisance.columns.shape[2]))
    about_none = simulator.residuals([{}], {})[0]
    along = simulator.residuals([{}], {}, path)[0]
    assert np.abs((along - about_none) / simulator.bench.std).max() > 1.0
    moved = (nuisance.columns @ path[..., None])[..., 0] * simulator.bench.std
    np.testing.assert_allclose(along + moved, about_none, atol=1e-6)
    np.testing.assert_allclose(simulator.respond({}, path).columns, nuisance.columns, atol=1e-3)
    np.testing.assert_array_equal(simulator.residuals([{}], {}, np.zeros_like(path))[0], about_none)
