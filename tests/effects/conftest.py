"""Every effect of the catalogue, and every generic one, becomes a case of every property that concerns it."""

from __future__ import annotations

import pytest

from tests.effects.rigs import EFFECTS, Rig, load_rigs

SWEPT = "flown"
"""The drone under policy commands has the effects of the replayed one: each alone is `slow`, all at once are not."""


@pytest.fixture(scope="session")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rig]:
    """The rigs by name, loaded once."""
    return load_rigs(tmp_path_factory.mktemp("rigs"))


@pytest.fixture
def rig(request: pytest.FixtureRequest, rigs: dict[str, Rig]) -> Rig:
    """The rig of this case, driven so that the effect of this case can be seen."""
    name, effect_id = request.param
    return rigs[name].for_effect(effect_id) if effect_id else rigs[name]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give a test with `rig` and `effect_id` every effect, one with `rig` alone every rig; leave the others alone.

    The marker `concerns(*rigs, only=predicate)` narrows this down to some rigs, and to effects of which
    `predicate(effect)` holds.
    """
    if "rig" not in metafunc.fixturenames:
        return
    marker = metafunc.definition.get_closest_marker("concerns")
    names, only = (marker.args or tuple(EFFECTS), marker.kwargs.get("only")) if marker else (tuple(EFFECTS), None)
    if "effect_id" in metafunc.fixturenames:
        cases = [(name, effect.id) for name in names for effect in EFFECTS[name] if only is None or only(effect)]
        given = [
            pytest.param((name, effect_id), effect_id, id=f"{name}-{effect_id}", marks=[pytest.mark.slow] * (
                name == SWEPT and len(names) > 1))
            for name, effect_id in cases
        ]  # fmt: skip
        metafunc.parametrize(("rig", "effect_id"), given, indirect=["rig"])
    else:
        metafunc.parametrize("rig", [(name, "") for name in names], indirect=True, ids=names)


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", "concerns(*rigs, only): rigs and effects that a property is tested on")
