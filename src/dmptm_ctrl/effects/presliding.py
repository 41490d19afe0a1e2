"""Presliding: friction is a spring before it slides.

    dF/dt = |ω| (F_s sgn ω − F)/x0,  friction F + v B ω
    F_s the declared friction at that speed less v B |ω|,  B ω its viscous part

Dahl's equation for all of friction (v = 0), or for what does not grow with speed, with the
viscous part acting at once as in the LuGre law (v = 1); at x0 → 0 it is the declared friction.
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class Presliding(NamedTuple):
    """Parameters."""

    reducer_distance: float  # rad, x0 of both reducers
    ring_distance: float  # rad, x0 of the ring gear
    viscous_at_once: float  # v, 0 or 1


@njit
def relaxation(body, p):
    """Distance over which friction builds up [rad], share of viscous friction that need not."""
    return p.ring_distance if body == 2 else p.reducer_distance, p.viscous_at_once


PRESLIDING = Effect(
    name="presliding",
    site="presliding",
    kernel=relaxation,
    parameters=(
        Parameter("reducer_distance", "rad", 0.0, 0.02, 5e-4),
        Parameter("ring_distance", "rad", 0.0, 0.005, 1e-4),
        Parameter("viscous_at_once", "", 0.0, 1.0, 0.5, (0.0, 1.0)),
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
