"""A new effect costs one recompile, and that is said."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.effects import CATALOGUE, register
from dmptm_ctrl.simulate import compose
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model


@pytest.fixture
def own_effect():
    """An effect of a user's, as a notebook would register it; taken back afterwards."""

    @njit
    def spring(theta_L, omega_L, t, p):
        return -p.stiffness * theta_L

    class Spring(NamedTuple):
        stiffness: float

    yield Effect(
        name="own_spring",
        site="load",
        kernel=spring,
        parameters=(Parameter("stiffness", "N·m/rad", 0.0, 1e3, 1.0),),
        values=Spring,
        location="",
        source="",
        depends_on=("theta_L",),
        reveals="",
    )
    CATALOGUE.pop("own_spring", None)


def test_an_effect_changes_the_engine_s_name_and_taking_it_back_restores_it(own_effect):
    before = compose._key(compose.source())
    register(own_effect)
    assert compose._key(compose.source()) != before
    del CATALOGUE["own_spring"]
    assert compose._key(compose.source()) == before


def test_says_once_that_it_compiles(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DMPTM_CACHE_DIR", str(tmp_path))
    for expected in ("Compiling the simulator for", ""):
        compose._loaded.cache_clear()
        module = compose._load("test_of_the_message", "answer = 42\n")
        assert module.answer == 42
        said = capsys.readouterr().err
        assert said.startswith(expected)
        assert bool(said) == bool(expected)


def test_same_engine_while_the_catalogue_is_the_same():
    model = Model()
    march(model.arrays(), np.zeros((2, 3)), rest(model, 0.0), 1e-3)
    assert compose.engine() is compose.engine()
