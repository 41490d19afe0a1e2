"""Drive delay: the voltage command reaches the motor late.

u_e(t) = u(t − T_d)
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def delay_time(side, p):
    """Dead time [s]."""
    return p.delay


DRIVE_DELAY = Effect(
    name="drive_delay",
    site="delay",
    kernel=delay_time,
    parameters=(Parameter("delay", "s", 0.0, 0.03, 0.002),),  # T_d
    location="drives",
    source="bus and computation time",
    depends_on=("u", "du_dt"),
    reveals="fast changes of the signal (multisine, chirp, square)",
    starts=(("delay", 1.0), ("delay", 3.0)),
    kink=0.05,
)
