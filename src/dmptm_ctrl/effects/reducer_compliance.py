"""Reducer compliance: the reducer winds up between motor and pinion.

    torque = (θm/N1 − θ3)/C + D (θ̇m/N1 − θ̇3)

C is the compliance at the pinion; D gives the damping ratio ζ in the reducer's own mode.
"""

from math import sqrt

from numba import njit

from dmptm_ctrl.contract import MOTOR_ENCODERS, Effect, Parameter

# Damping ratio of steel gearing: lower end of Eq. 24's range, a third of it and three times it.
ZETA = (0.01, 0.03, 0.1)


@njit
def shaft_compliance(inertia, p):
    """Compliance [rad/(N·m)] and damping [N·m·s/rad]; `inertia` is the reduced one [kg·m²]."""
    if p.compliance <= 0.0:
        return 0.0, 0.0
    return p.compliance, 2.0 * p.damping * sqrt(inertia / p.compliance)


REDUCER_COMPLIANCE = Effect(
    name="reducer_compliance",
    site="shaft",
    kernel=shaft_compliance,
    parameters=(
        Parameter("compliance", "rad/(N·m)", 0.0, 2e-3, 2e-5),  # C
        Parameter("damping", "", 0.0, 0.3, 0.01, ZETA),  # ratio ζ, 1 is critical
    ),
    location="reducers",
    source="torsional stiffness of planetary reducers, manufacturers' data",
    depends_on=("mesh_torque",),
    reveals="steps of torque with motor encoders, or a sweep up to the second resonance",
    seen_by=MOTOR_ENCODERS,
    ringing=("damping",),
)
