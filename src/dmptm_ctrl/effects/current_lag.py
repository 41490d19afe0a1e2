"""Current lag: the current loop follows its command as a first-order lag.

τ du_e/dt = u − u_e
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def lag_target(u, side, p):
    """Where the effective voltage relaxes to [V], and how fast [s]."""
    return u, p.time_constant


CURRENT_LAG = Effect(
    name="current_lag",
    site="lag",
    kernel=lag_target,
    parameters=(Parameter("time_constant", "s", 0.0, 0.05, 0.002),),  # τ
    location="drives",
    source="bandwidth of the current controller",
    depends_on=("u", "du_dt"),
    reveals="fast changes of the signal (multisine, chirp)",
    starts=(("time_constant", 1.0), ("time_constant", 3.0)),
    kink=0.05,
)
