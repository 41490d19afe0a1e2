"""Unknown breakaway: friction that grows with the time at rest, without a name.

    friction += rise log(1 + age/time)
    d(age)/dt = 1 − |ω| age/slip

The age of the ring gear's contact is its time at rest; slip makes it new.
"""

from math import log

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def aged_friction(age, body, p):
    """Coulomb torque added [N·m] at an age of the contact [s]; slip that makes it new [rad]."""
    if body != 2 or p.rise == 0.0:
        return 0.0, 0.0
    return p.rise * log(1.0 + age / p.time), p.slip


UNKNOWN_BREAKAWAY = Effect(
    name="unknown_breakaway",
    site="dwell",
    kernel=aged_friction,
    parameters=(
        Parameter("rise", "N·m", 0.0, 60.0, 2.0),
        Parameter("time", "s", 1e-3, 1.0, 0.01, (0.01,)),
        Parameter("slip", "rad", 1e-5, 0.01, 1e-4, (2e-4,)),
    ),
    location="ring-gear bearing",
    source="Dieterich, J. Geophys. Res. 84 (1979) 2161; Ruina, ibid. 88 (1983) 10359",
    depends_on=("time_at_rest",),
    reveals="breaking away after rests of different length",
)
