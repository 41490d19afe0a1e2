"""The rigs live beside the benchmarks, not in the package; linear algebra is as in `diagnose`."""

import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture(autouse=True, scope="session")
def small_matrices():
    """One thread, or how sums are rounded depends on the cores, and where bounces lead on that."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield
