"""Reducer compliance: the reducer winds up between motor and pinion.

    torque = (θm/N1 − θ3)/C + D (θ̇m/N1 − θ̇3)

C is the compliance at the pinion; D gives a damping ratio of ZETA in the reducer's own mode.
"""

from math import sqrt
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter

ZETA = 0.03  # damping ratio of steel gearing, lower end of Eq. 24's range


class ReducerCompliance(NamedTuple):
    """Parameters."""

    compliance: float  # rad/(N·m), C


@njit
def shaft_compliance(inertia, p):
    """Compliance [rad/(N·m)] and damping [N·m·s/rad]; `inertia` is the reduced one [kg·m²]."""
    if p.compliance <= 0.0:
        return 0.0, 0.0
    return p.compliance, 2.0 * ZETA * sqrt(inertia / p.compliance)


REDUCER_COMPLIANCE = Effect(
    name="reducer_compliance",
    site="shaft",
    kernel=shaft_compliance,
    parameters=(Parameter("compliance", "rad/(N·m)", 0.0, 2e-3, 2e-5),),
    values=ReducerCompliance,
    location="reducers",
    source="torsional stiffness of planetary reducers, manufacturers' data",
    depends_on=("mesh_torque",),
    reveals="steps of torque with motor encoders, or a sweep up to the second resonance",
)
