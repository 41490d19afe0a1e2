"""Derivatives by every effect of the catalogue against differences of whole runs."""

import pytest
from tests.engine.test_sensitivity import derivatives_are_differences

from dmptm_ctrl.effects import CATALOGUE


@pytest.mark.parametrize("name", CATALOGUE)
def test_derivatives_by_every_effect_are_differences_of_whole_runs(name):
    derivatives_are_differences(CATALOGUE[name])
