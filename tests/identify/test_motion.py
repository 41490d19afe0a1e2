"""Window means of recorded rows."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dmptm_ctrl.identify.motion import hann, weigh


@settings(deadline=None)  # the first call compiles
@given(st.integers(2, 9), st.lists(st.integers(1, 6), min_size=1, max_size=3), st.booleans())
def test_means_are_sums_over_each_window(hop, counts, held):
    """Of several records one after another, each with its own number of windows."""
    rng, window = np.random.default_rng(hop), hann(2 * hop)
    sizes = [1 + (count + 1) * hop + rng.integers(0, hop) for count in counts]
    begins = np.cumsum([0, *sizes[:-1]])
    rows = rng.standard_normal((2, sum(sizes)))
    out = np.empty((2, sum(counts)))
    weigh(rows, window, begins, np.array(counts), held, out)
    expected = []
    for begin, count in zip(begins, counts, strict=True):
        for k in range(count):
            first = begin + 1 + k * hop
            now, before = rows[:, first : first + 2 * hop], rows[:, first - 1 : first + 2 * hop - 1]
            expected.append((0.5 * (now + before) if held else now) @ window)
    np.testing.assert_allclose(out, np.array(expected).T, rtol=1e-12, atol=1e-14)
