"""Thermal drift: friction falls as the lubricant warms, at first fast, then slowly.

    friction × (1 + α exp(−t/τ)),
    of the ring gear (friction + b (t/T − ½) |ω|) × (1 + (α + β) exp(−t/τ))

Viscosity may go on falling while dry friction stays: b is what viscous friction alone, of the
ring gear, changes by over a log of length T, about its mean. t is the time since the log began.
"""

from math import exp

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def thermal_factor(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction and added friction torque."""
    rise = p.rise + p.ring_extra if body == 2 else p.rise
    change = p.viscous_change if body == 2 else 0.0
    return 1.0 + rise * exp(-t / p.time_constant), change * (t / p.log_length - 0.5) * abs(omega)


THERMAL_DRIFT = Effect(
    name="thermal_drift",
    site="friction",
    kernel=thermal_factor,
    parameters=(
        Parameter("rise", "", -0.5, 1.5, 0.05),  # relative, α
        Parameter("ring_extra", "", -1.5, 1.5, 0.05),  # relative, β: lubricants differ
        Parameter("viscous_change", "N·m·s/rad", -50.0, 50.0, 1.0),  # b
        Parameter("time_constant", "s", 0.5, 60.0, 1.0, (0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0)),
        Parameter("log_length", "s", 0.1, 1e5, 10.0, (10.0,), fixed=True),  # T
    ),
    location="all bearings and reducers",
    source="exponential warm-up of viscosity",
    depends_on=("time",),
    reveals="the same motion early and late in a long log from cold",
)
