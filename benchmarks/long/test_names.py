"""Drives by rig files too long for CI: ``python -m pytest benchmarks/long``.

Their truth is known: another program than the package simulates them.
`benchmarks/campaign.py --kind shapes` tries many.
"""

import pytest
from campaign import Case, examine
from scoring import score

from rigs import orders


@pytest.mark.parametrize(
    ("seed", "names"),
    [
        (1, ()),
        (2, ("coulomb_friction", "cable_spring")),
        (4, ("drive_dead_band",)),
        (8, ("backlash",)),
    ],
)
def test_names_what_is_missing_and_nothing_else(seed, names, tmp_path):
    order = orders.Order("rig", "shapes", seed, "", names)
    found = score(examine(Case("rig", order, tmp_path / "rigs" / "rig"), tmp_path, 1))
    assert found["outcome"] == "right"
    assert not found["worse"]
