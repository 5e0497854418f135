"""Rigs, as tests of effects have them."""

from tests.effects.conftest import rigs as rigs
