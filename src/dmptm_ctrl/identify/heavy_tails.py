"""Scale of a residual with bursts: impacts and chatter that no model predicts one by one."""

from functools import lru_cache
from math import sqrt

import numpy as np

from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.model import Floats

FREEDOM = 4.0  # of Student's t: how a row may scatter, bursts and impact chatter included
SCALE_STEPS = 12
RECENT = 256  # scales kept: of all equations of a few fits at a time


def robust_scale(e: Floats, freedom: float = FREEDOM) -> float:
    """Most likely scale about zero of Student's t."""
    return _robust_scale(e.tobytes(), freedom)


@lru_cache(RECENT)
def _robust_scale(windows: bytes, freedom: float) -> float:
    """The same; weights and loss ask for that of the same windows in turn."""
    e = np.frombuffer(windows)
    s = max(1.4826 * _median(np.abs(e)), 1e-9)
    counted = np.empty_like(e)
    for _ in range(SCALE_STEPS):  # expectation–maximisation
        _count(e, s, freedom, counted)
        s = max(sqrt(np.add.reduce(counted) / e.size), 1e-9)
    return s


@cached(nogil=True)
def _count(e: Floats, s: float, freedom: float, out: Floats) -> None:
    """Write squares, each by how much it counts at a scale."""
    for i in range(e.size):
        ratio = e[i] / s
        out[i] = (freedom + 1.0) / (ratio * ratio + freedom) * (e[i] * e[i])


def bent(rows: Floats, scale: float | Floats) -> Floats:
    """How much rows count by Student's t of a scale."""
    return (FREEDOM + 1.0) / (FREEDOM + (rows / scale) ** 2)


def tails(squares: Floats) -> Floats:
    """−2 log of Student's t at squares over the scale's, without its constant."""
    return np.asarray((FREEDOM + 1.0) * np.log1p(squares / FREEDOM))


def _median(x: Floats) -> float:
    """Median; NumPy's own takes longer to begin than to find it. Reorders x."""
    middle = x.size // 2
    if x.size % 2:
        x.partition(middle)
        return float(x[middle])
    x.partition((middle - 1, middle))
    return float(0.5 * (x[middle - 1] + x[middle]))
