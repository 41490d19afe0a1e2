"""Names found on drives whose truth is known, simulated by another program than the package.

`benchmarks/campaign.py --kind shapes` tries many.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from campaign import Case, examine
from scoring import score

from rigs import orders


def names_what_is_missing(seed, names, tmp_path):
    order = orders.Order("rig", "shapes", seed, "", names)
    found = score(examine(Case("rig", order, tmp_path / "rigs" / "rig"), tmp_path, 1))
    assert found["outcome"] == "right"
    assert not found["worse"]


@pytest.mark.parametrize(("seed", "names"), [(4, ("drive_dead_band",))])
def test_names_what_is_missing_and_nothing_else(seed, names, tmp_path):
    names_what_is_missing(seed, names, tmp_path)
