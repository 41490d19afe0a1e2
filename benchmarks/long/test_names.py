"""Drives by rig files too long for CI: ``python -m pytest benchmarks/long``."""

import pytest
from tests.rig_files.test_names import names_what_is_missing


@pytest.mark.parametrize(
    ("seed", "names"),
    [(1, ()), (2, ("coulomb_friction", "cable_spring")), (8, ("backlash",))],
)
def test_names_what_is_missing_and_nothing_else(seed, names, tmp_path):
    names_what_is_missing(seed, names, tmp_path)
