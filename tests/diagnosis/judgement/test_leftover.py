"""What a twin still misses: found where a cart is pushed by what no effect explains, not where all is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.builders import guess
from tests.diagnosis.carts import load_cart, measure_cart, open_judges, open_search
from tests.diagnosis.rigs import drive_cart
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.forces import scale_twin
from vpptwin.diagnosis.judgement.leftover import FOLDS, Leftover, judge_leftover, predicted_share

COUNT = 1200
QUANTITY = np.random.default_rng(1).permutation(np.linspace(-1.0, 1.0, COUNT))
BLOCKS = np.arange(COUNT) // 30
"""40 stretches of 30 segments."""
FOLD = BLOCKS % FOLDS


@pytest.mark.parametrize("force", [np.sign(QUANTITY), np.abs(QUANTITY) > 0.5, 3.0 * np.sin(20.0 * QUANTITY)])
def test_what_a_quantity_decides_is_predicted(force: np.ndarray) -> None:
    """A step, a place, and a wave of six periods, each a function of the quantity."""
    assert predicted_share(QUANTITY, force.astype(float), FOLD) > 0.9


def test_a_step_by_hand() -> None:
    """In four bins of 300, 225 each are learnt from: means 225/226 of a force of ±1 miss by 1/226."""
    fold = np.arange(COUNT) % FOLDS
    quantity = np.repeat(np.linspace(-1.0, 1.0, COUNT // FOLDS), FOLDS) + 1e-6 * np.tile(np.arange(FOLDS), 300)
    share = predicted_share(quantity, np.where(quantity > 0.0, 1.0, -1.0), fold)
    assert share == pytest.approx(1.0 - 1.0 / 226.0**2, abs=1e-9)


def test_noise_is_not_predicted() -> None:
    """However many bins there are, none learns what does not come again; nothing at all is explained by nothing."""
    noise = np.random.default_rng(0).standard_normal(COUNT)
    assert predicted_share(QUANTITY, noise, FOLD) < 0.02
    assert predicted_share(QUANTITY, np.zeros(COUNT), FOLD) == 0.0
    assert predicted_share(np.ones(COUNT), noise, FOLD) == 0.0
    # A signal of variance 1 in noise of variance 3: a quarter, which 1200 values know to a few percent.
    noise = np.random.default_rng(0).standard_normal(COUNT)
    share = predicted_share(QUANTITY, np.sign(QUANTITY) + np.sqrt(3.0) * noise, FOLD)
    assert share == pytest.approx(0.25, abs=0.06)
    # A force drawn anew for every stretch seems to follow time, until whole stretches are left out.
    rng = np.random.default_rng(3)
    force = rng.standard_normal(40)[BLOCKS] + 0.1 * rng.standard_normal(COUNT)
    time = np.arange(COUNT, dtype=float)
    assert predicted_share(time, force, rng.integers(FOLDS, size=COUNT)) > 0.5
    assert predicted_share(time, force, FOLD) < CRITERIA.depends


def judge(folder: Path, cogging: float) -> Leftover:
    """What the plain twin of a cart leaves, before any cause is named."""
    flight = measure_cart(drive_cart(0.0, 3, cogging), 7)
    spec = scale_twin(load_cart(folder), [flight])
    search = open_search(spec, flight)
    return judge_leftover(open_judges(spec, flight), search, guess({}))


def test_a_force_that_no_effect_makes_is_found(tmp_path: Path) -> None:
    """A motor that cogs by 1.5 N every 0.4 m: significant, along the slide, and it follows the position.

    A sine of 1.5 N has 1.06 N rms, a fifth to a tenth of the 5 to 10 N with which the cart is driven.
    """
    found = judge(tmp_path, 1.5)
    assert found.unexplained.significant
    assert found.unexplained.share > 0.3
    assert found.unexplained.channel == "slide"
    assert found.unexplained.force is not None
    assert 0.05 < found.unexplained.force < 0.3
    assert found.unexplained.depends_on[0] == "slide position"
    assert found.unexplained.sigma > 0.0
    assert found.plot is not None
    assert found.plot.y_label == "missing force on slide [N]"
    assert found.plot.quantity.shape == found.plot.before.shape == found.plot.after.shape


def test_nothing_is_found_where_the_twin_is_right(tmp_path: Path) -> None:
    """A cart without friction or cogging, as its twin has it: nothing significant, no channel, no picture."""
    found = judge(tmp_path, 0.0)
    assert not found.unexplained.significant
    assert found.unexplained.force is not None
    assert found.unexplained.force < CRITERIA.noticed
    assert found.unexplained.channel is None
    assert found.unexplained.depends_on == []
    assert found.plot is None
