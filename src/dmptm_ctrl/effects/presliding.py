"""Presliding: friction is a spring before it slides.

    dF/dt = |ω| (F_s sgn ω − F)/x0,  F_s the declared friction at that speed

Dahl's equation; at x0 → 0 it is the declared friction.
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class Presliding(NamedTuple):
    """Parameters."""

    reducer_distance: float  # rad, x0 of both reducers
    ring_distance: float  # rad, x0 of the ring gear


@njit
def relaxation_distance(body, p):
    """Distance over which friction builds up [rad]."""
    return p.ring_distance if body == 2 else p.reducer_distance


PRESLIDING = Effect(
    name="presliding",
    site="presliding",
    kernel=relaxation_distance,
    parameters=(
        Parameter("reducer_distance", "rad", 0.0, 0.02, 5e-4),
        Parameter("ring_distance", "rad", 0.0, 0.005, 1e-4),
    ),
    values=Presliding,
    location="bearings and reducers",
    source="Dahl 1968; Canudas de Wit et al., IEEE TAC 40 (1995) 419",
    depends_on=(
        "time_at_rest",
        "u",
    ),
    reveals="small voltages below breakaway, and slow reversals",
)
