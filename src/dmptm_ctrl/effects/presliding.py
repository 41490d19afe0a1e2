"""Presliding: friction is a spring before it slides.

    dF/dt = σ |ω| (sgn ω − F/F_s),  σ = Tc/x0,  friction F + τ dF/dt + v B ω
    F_s the declared friction at that speed less v B |ω|,  B ω its viscous part
    τ = 2 ζ √(J x0/Tc) / (1 + |ω|/Ω),  J the body's inertia, Tc and Ω of its friction law

Dahl's equation for all of friction (v = 0), or for what does not grow with speed, with the
viscous part acting at once as in the LuGre law (v = 1); at x0 → 0 it is the declared friction.
The bristles' stiffness σ is the same at any speed; Tc is the mean of both directions. τ is the
damping of the bristles, σ1/σ0 of that law: at small motion the body swings on them with the
damping ratio ζ. It fades as friction slides, or it would no longer be passive.
"""

from numba import njit

from dmptm_ctrl.contract import RUNS, Effect, Parameter

LEAST = 1e-9  # of Tc: friction of no size is there at once, without a division by zero


@njit
def relaxation(body, p):
    """Distance [rad] over which friction builds up, viscous share that need not, damping ratio."""
    distance = p.ring_distance if body == 2 else p.reducer_distance
    return distance, p.viscous_at_once, p.damping


@njit
def build_up_distance(distance, level, p):
    """Distance [rad] over which friction of `level` [N·m] builds up by friction law p."""
    coulomb = 0.5 * (p.coulomb_plus + p.coulomb_minus)
    return distance * max(abs(level) / coulomb, LEAST) if coulomb > 0.0 else distance


@njit
def bristle_lag(distance, damping, inertia, p):
    """Time τ at rest [s] of the bristles of a body with friction law p."""
    coulomb = 0.5 * (p.coulomb_plus + p.coulomb_minus)
    return 2.0 * damping * (inertia * distance / coulomb) ** 0.5 if coulomb > 0.0 else 0.0


@njit
def fading(omega, direction, p):
    """Share of the bristles' damping that is left at speed `omega`."""
    return 1.0 / (1.0 + abs(omega) * (p.steepness_plus if direction > 0.0 else p.steepness_minus))


PRESLIDING = Effect(
    name="presliding",
    site="presliding",
    kernel=relaxation,
    parameters=(
        Parameter("reducer_distance", "rad", 0.0, 0.02, 5e-4),  # x0 of both reducers
        Parameter("ring_distance", "rad", 0.0, 0.005, 1e-4),  # x0 of the ring gear
        Parameter("viscous_at_once", "", 0.0, 1.0, 0.5, (0.0, 1.0), fixed=True),  # v
        Parameter("damping", "", 0.0, 2.0, 0.1),  # ratio ζ, 1 is critical
    ),
    location="bearings and reducers",
    source="Dahl 1968; Canudas de Wit et al., IEEE TAC 40 (1995) 419; fading: Olsson 1996",
    depends_on=("time_at_rest", "u"),
    reveals="torque below breakaway, with an encoder that resolves the creep",
    seen_by=RUNS,
    starts=(("ring_distance", 0.5), ("reducer_distance", 0.5)),
)
