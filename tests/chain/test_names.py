"""Names found on benches whose truth is known, simulated by other means than the package's.

The benches are a few of `benchmarks/benches.py`, which tries many.
"""

import pytest
from benchmarks.benches import try_one

pytest.importorskip("pyarrow")  # the benches' logs are .parquet files


@pytest.mark.parametrize(
    "case",
    [
        "null_declared",  # seven short runs, nothing missing
        "cable",  # one short run in which two effects hide each other
        "backlash",  # a geared load, an encoder on each side
        "drift",  # friction and offset differ from run to run
    ],
)
def test_names_what_is_missing_and_nothing_else(case):
    row = try_one(case, 0)
    assert "error" not in row, row["error"]
    assert row["missed"] == []
    assert row["false"] == []
    assert row["after"] <= row["before"]
