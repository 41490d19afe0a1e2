"""Limit cycles too long for CI: ``python -m pytest benchmarks/long``."""

from tests.design.test_limit_cycle import GAP, predicted_is_simulated


def test_the_ring_sticks_at_times():
    predicted_is_simulated(GAP, 1.0, 8.0, 6000.0)
