"""A table's value, and the same as a sum over its knots."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import KNOTS, looked_up, summed

TABLE = CATALOGUE["unknown_voltage"].values
NUMBERS = st.floats(-10.0, 10.0)


@settings(deadline=None)  # the first call compiles
@given(NUMBERS, NUMBERS, NUMBERS, st.integers(0, 2**32 - 1))
def test_both_ways_to_look_up_interpolate(x, low, high, seed):
    """Linear between the knots and constant beyond; of the first knot if the ends are swapped."""
    assume(abs(high - low) > 1e-3)
    knots = np.random.default_rng(seed).standard_normal(KNOTS)
    p = TABLE(0.0, low, high, *knots)
    ends = np.linspace(low, high, KNOTS)
    expected = np.interp(x, ends, knots) if high > low else knots[0]
    for one in (looked_up, summed):
        np.testing.assert_allclose(one(x, p), expected, rtol=0.0, atol=1e-10)


def test_neighbours_of_a_knot_add_nothing_there():
    """At a knot the value is its own."""
    p = TABLE(0.0, 0.0, KNOTS - 1.0, *(float(k * k) for k in range(KNOTS)))
    for k in range(KNOTS):
        assert summed(float(k), p) == looked_up(float(k), p) == k * k
