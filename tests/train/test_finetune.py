"""Going on from a policy in another twin: its weights, and randomization within what a diagnosis found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.conftest import TINY, tiny_config
from vpptwin.system.errors import InputError
from vpptwin.train.config import Schedule
from vpptwin.train.env.randomize import PAPER_EFFECTS, Priors, name_effects
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.evaluate.evaluate import load_policy
from vpptwin.train.learn.ppo import build_training
from vpptwin.train.main import run_train
from vpptwin.twin import load_twin

TWIN = """
model: rail_rig.xml
vehicle: vehicle.yaml
effects: {rail_x.coulomb: {force: 0.31}, command.delay: {delay: 0.012}, servo.backlash: {gap: 0.02}}
provenance:
  command: vpptwin diagnose flight.mcap
  intervals_90_percent: {rail_x.coulomb.force: [0.28, 0.34], command.delay.delay: [0.011, 0.013]}
"""


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    """A twin that a diagnosis extended by two effects; the third is the user's."""
    path = tmp_path / "twin.yaml"
    path.write_text(TWIN)
    return path


def test_draws_lie_within_what_was_identified(twin: Path) -> None:
    """Normal, with 90 % of a normal distribution within the interval, and the rest at its ends; nothing else varies."""
    env = make_env(tiny_config(f"twin={twin}", "randomize=identified", "num_envs=512"))
    env.reset()
    assert env.randomized == ("rail_x.coulomb", "command.delay")
    priors = env._priors
    drawn = priors.draw(np.random.default_rng(1), 20000)
    force = drawn[:, priors.keys.index(("rail_x.coulomb", "force"))]
    assert (force.min(), force.max()) == pytest.approx((0.28, 0.34))
    assert np.mean((force > 0.28) & (force < 0.34)) == pytest.approx(0.9, abs=0.01)
    assert np.median(force) == pytest.approx(0.31, abs=5e-4)
    inner = np.abs(force - 0.31) < 0.674 * 0.03 / 1.645  # half of a normal distribution
    assert np.mean(inner) == pytest.approx(0.5, abs=0.015)


def test_without_the_group_an_extended_twin_is_randomized_by_its_priors(twin: Path) -> None:
    """Naming an effect means its prior, wide as ever; what is not drawn stays as the file says."""
    wide = make_env(tiny_config(f"twin={twin}", "randomize=[rail_x.coulomb]", "num_envs=64"))
    force = wide._priors.draw(np.random.default_rng(2), 1000)[:, 0]
    assert force.std() > 0.1
    assert wide.twin.spec.effects["command.delay"] == {"delay": 0.012}


def test_without_difficulty_the_twin_is_flown_as_it_is(twin: Path) -> None:
    """Level 0 is the twin's own value, not that of a rig without the effect; a level between lies between."""
    spec = load_twin(twin)
    effects = [effect for effect in spec.catalogue if effect.id in ("rail_x.coulomb", "servo.lag")]
    priors = Priors.of(effects, spec.effects)
    rng = np.random.default_rng(3)
    column = {key: i for i, key in enumerate(priors.keys)}
    easy = priors.draw(rng, 50, 0.0)
    np.testing.assert_allclose(easy[:, column["rail_x.coulomb", "force"]], 0.31)
    np.testing.assert_allclose(easy[:, column["servo.lag", "time_constant"]], 0.020)
    half, whole = (priors.draw(np.random.default_rng(4), 50, level) for level in (0.5, 1.0))
    np.testing.assert_allclose(half, 0.5 * (easy + whole))


def test_a_lesson_flies_the_extended_twin_too(twin: Path) -> None:
    """The share of undisturbed episodes flies the values of the file."""
    config = tiny_config(f"twin={twin}", "randomize=identified", "curriculum.nominal=1", "num_envs=16")
    env = make_env(config, schedule=Schedule(config.curriculum, 1000))
    env.reset()
    assert np.ptp(env.episodes.drawn, axis=0).max() == 0.0
    np.testing.assert_allclose(env.episodes.drawn, 0.0, atol=1e-6)  # 0.31 and 0.012 are the middles


def test_an_interval_without_width_is_no_division_by_zero(tmp_path: Path) -> None:
    """A parameter known exactly is told to the critic as 0."""
    path = tmp_path / "sure.yaml"
    path.write_text(TWIN.replace("[0.28, 0.34]", "[0.31, 0.31]"))
    spec = load_twin(path)
    priors = Priors.of([e for e in spec.catalogue if e.id == "rail_x.coulomb"], spec.effects, spec.intervals)
    drawn = priors.draw(np.random.default_rng(5), 10)
    np.testing.assert_allclose(drawn, 0.31)
    np.testing.assert_allclose(priors.standardize(drawn), 0.0, atol=1e-12)


def test_groups_are_named_together(twin: Path) -> None:
    """The paper's effects and the identified ones, each once."""
    spec = load_twin(twin)
    both = name_effects(["paper", "identified"], spec.catalogue, spec.intervals)
    assert set(both) == {*PAPER_EFFECTS}  # both identified ones are among them
    assert name_effects(["identified", "air.ground_effect"], spec.catalogue, spec.intervals) == [
        effect.id for effect in spec.catalogue if effect.id in {"rail_x.coulomb", "command.delay", "air.ground_effect"}
    ]


def test_nothing_identified_is_said(tmp_path: Path) -> None:
    """The nominal twin has no intervals; the line says where they come from."""
    with pytest.raises(InputError, match=r"no intervals; expected the twin\.yaml of a diagnosis"):
        run_train([*TINY, "preset=finetune", "total_steps=128", f"out={tmp_path / 'run'}"])
    assert not (tmp_path / "run" / "checkpoint.pt").exists()


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("rail_x.coulomb.force", "rail_x.coulomb.mu", "interval rail_x.coulomb.mu"),
        ("[0.28, 0.34]", "[0.34, 0.28]", "from 0.34 to 0.28"),
        ("[0.28, 0.34]", "[0.34]", "provenance.intervals_90_percent"),
    ],
)
def test_intervals_that_make_no_sense_are_refused(tmp_path: Path, old: str, new: str, found: str) -> None:
    """Of what the catalogue lacks, from high to low, or with one end."""
    path = tmp_path / "twin.yaml"
    path.write_text(TWIN.replace(old, new))
    with pytest.raises(InputError, match=found):
        make_env(tiny_config(f"twin={path}", "randomize=identified"))


def test_training_starts_from_the_given_policy(tiny_run: Path, twin: Path, tmp_path: Path) -> None:
    """Before the first update it is the old policy; after training it no longer is."""
    options = [f"init_from={tiny_run}", f"twin={twin}", "randomize=identified", "lipschitz=8"]
    config = tiny_config("preset=finetune", *options, "total_steps=256", f"out={tmp_path / 'run'}")
    config.exam_every = 0
    old = load_policy(tiny_run)
    training = build_training(config, tmp_path)
    seen = torch.randn(50, 11)
    with torch.no_grad():
        torch.testing.assert_close(training.policy(seen), old(seen))
    training.trainer.collector.shutdown()
    run = run_train([*TINY, "preset=finetune", *options, "total_steps=256", f"out={tmp_path / 'run'}", "exam_every=0"])
    with torch.no_grad():
        assert not torch.allclose(load_policy(run)(seen), old(seen))


def test_another_network_is_refused(tiny_run: Path, tmp_path: Path) -> None:
    """Other inputs or layers, and a file that is none."""
    for option in ("setup=VA", "hidden=[32,32]", "paper_inputs=true"):
        with pytest.raises(InputError, match=r"init_from=.+ has setup=All"):
            run_train([*TINY, f"init_from={tiny_run}", option, "total_steps=128", f"out={tmp_path / 'run'}"])
    with pytest.raises(InputError, match="no checkpoint nowhere"):
        run_train([*TINY, "init_from=nowhere", "total_steps=128", f"out={tmp_path / 'run'}"])
