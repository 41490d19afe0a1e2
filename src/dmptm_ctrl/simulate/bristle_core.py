"""A step of presliding in all bodies at once, as a vector, with what changes in it.

The loop of `tangent_site_core` takes it. What a number of presliding changes goes by slopes, what a
number of the friction law or a mass changes by the step with these. No physics is written here.
"""

from numba import njit

from dmptm_ctrl.effects.stribeck import Stribeck
from dmptm_ctrl.simulate.row_step_core import (
    D_HIDDEN,
    F_BRISTLES,
    F_MOB3,
    F_MOBL,
    F_RENEW,
    HIDDEN,
    grow,
    law_of,
)
from dmptm_ctrl.simulate.slope_sites import preslide_own_slopes, preslide_slopes
from dmptm_ctrl.simulate.tangent_core import CHANGES

# Rows behind those of the state: what numbers change by themselves in a step, of the speeds and
# presliding frictions of the bodies; how a change moves what presliding knows.
D_N0, D_N1, D_N2, D_R0, D_R1, D_R2, D_BRISTLED = range(
    D_HIDDEN + HIDDEN * CHANGES, D_HIDDEN + (HIDDEN + 7) * CHANGES, CHANGES
)
BY_SLOPES, BY_STEP = 1.0, 2.0
# Rows of the three bodies, and of none, as a vector: what presliding knows and makes of it.
LANES_OF_BODIES = 4
W_V = D_BRISTLED + CHANGES
W_MID, W_FORCE, W_LEVEL, W_ADDED, W_BRISTLE, W_SLOPES = range(
    W_V + LANES_OF_BODIES, W_V + 7 * LANES_OF_BODIES, LANES_OF_BODIES
)
W_OWN = W_SLOPES + 12 * LANES_OF_BODIES  # slopes by distance, share and lag
W_SURE = W_OWN + 6 * LANES_OF_BODIES
# Of the run, of the change that is looked at, of each: h/J, friction law, bristles; speed and
# presliding friction.
W_NUMBERS = W_SURE + LANES_OF_BODIES
N_LAW, N_BRISTLES, N_NEW, N_AFTER, N_SIZE = (k * LANES_OF_BODIES for k in (1, 12, 15, 16, 17))
W_OTHER = W_NUMBERS + N_SIZE
SIZE_WITH_BRISTLES = W_OTHER + (CHANGES + 1) * N_SIZE


@njit
def bristle_numbers(s, row, bases, fixed):
    """Put numbers of presliding where the vector finds them; its last body stands for none."""
    to = W_OTHER + row * N_SIZE if row > 0 else W_NUMBERS
    for lane in range(LANES_OF_BODIES):
        body = min(lane, 2)
        mobility, first = (F_MOBL, 24) if body == 2 else (F_MOB3, 15)
        s[to + lane] = fixed[row, mobility]
        law = law_of(bases, row, first)
        for k in range(11):
            s[to + N_LAW + k * LANES_OF_BODIES + lane] = law[k]
        for k in range(3):
            number = fixed[row, F_BRISTLES + 3 * body + k]
            s[to + N_BRISTLES + k * LANES_OF_BODIES + lane] = number


@njit
def law_in(s, at):
    """Friction law of a body in the vector; exponents are 1 along with slopes."""
    n = LANES_OF_BODIES
    return Stribeck(
        *(s[at], s[at + n], s[at + 2 * n], s[at + 3 * n], s[at + 4 * n], s[at + 5 * n]),
        *(s[at + 6 * n], s[at + 7 * n], 1.0, s[at + 9 * n], s[at + 10 * n]),
    )


@njit
def keep_along(s, lane, both, d, sure):
    """Keep what the step of a body makes, and slopes of it."""
    n, at, to = LANES_OF_BODIES, W_NUMBERS + lane, W_SLOPES + lane
    s[at + N_NEW], s[at + N_AFTER] = both
    s[to], s[to + n], s[to + 2 * n], s[to + 3 * n] = d[0], d[1], d[2], d[3]
    s[to + 4 * n], s[to + 5 * n], s[to + 6 * n], s[to + 7 * n] = d[4], d[5], d[6], d[7]
    s[to + 8 * n], s[to + 9 * n], s[to + 10 * n], s[to + 11 * n] = d[8], d[9], d[10], d[11]
    s[W_SURE + lane] = 1.0 if sure else 0.0


@njit
def bristles_along(s, h):
    """Step of all bodies that preslide: speeds, presliding frictions, slopes of both."""
    n = LANES_OF_BODIES
    for k in range(LANES_OF_BODIES):
        at = W_NUMBERS + k
        bristles = s[at + N_BRISTLES], s[at + N_BRISTLES + n], s[at + N_BRISTLES + 2 * n]
        both, d, _, _, _, sure = preslide_slopes(
            *(s[W_V + k], s[W_MID + k], s[W_FORCE + k], s[at], h, law_in(s, at + N_LAW)),
            *(s[W_LEVEL + k], s[W_ADDED + k], bristles, s[W_BRISTLE + k]),
        )
        keep_along(s, k, both, d, sure)


@njit
def bristles_along_with_own(s, h):
    """The same, with slopes by what presliding itself is."""
    n = LANES_OF_BODIES
    for k in range(LANES_OF_BODIES):
        at, to = W_NUMBERS + k, W_OWN + k
        bristles = s[at + N_BRISTLES], s[at + N_BRISTLES + n], s[at + N_BRISTLES + 2 * n]
        both, d, own, _, _, sure = preslide_own_slopes(
            *(s[W_V + k], s[W_MID + k], s[W_FORCE + k], s[at], h, law_in(s, at + N_LAW)),
            *(s[W_LEVEL + k], s[W_ADDED + k], bristles, s[W_BRISTLE + k]),
        )
        keep_along(s, k, both, d, sure)
        s[to], s[to + n], s[to + 2 * n] = own[0], own[1], own[2]
        s[to + 3 * n], s[to + 4 * n], s[to + 5 * n] = own[3], own[4], own[5]


@njit
def bristles_with(s, row, h):
    """Step of the run with the numbers of a change."""
    n = LANES_OF_BODIES
    for k in range(N_NEW):  # to where the compiler sees that nothing else is: else no vector
        s[W_OTHER + k] = s[W_OTHER + row * N_SIZE + k]
    for k in range(LANES_OF_BODIES):
        at = W_OTHER + k
        bristles = s[at + N_BRISTLES], s[at + N_BRISTLES + n], s[at + N_BRISTLES + 2 * n]
        both = (
            preslide_slopes(  # to the last digit as of the run, and what is not used costs nothing
                *(s[W_V + k], s[W_MID + k], s[W_FORCE + k], s[at], h, law_in(s, at + N_LAW)),
                *(s[W_LEVEL + k], s[W_ADDED + k], bristles, s[W_BRISTLE + k]),
            )[0]
        )
        s[at + N_NEW], s[at + N_AFTER] = both


@njit
def own_by_slopes(s, to, first, row, body):
    """What a change of presliding's own numbers changes by itself; `first` of its slopes."""
    change, at = 0.0, N_BRISTLES + body
    for k in range(0, 3 * LANES_OF_BODIES, LANES_OF_BODIES):
        moved = s[W_OTHER + row * N_SIZE + at + k] - s[W_NUMBERS + at + k]
        change += s[first + body + k] * moved
    s[to] = change


@njit
def bristles_own(s, h, p, width):
    """Put into the same rows what numbers that presliding knows change."""
    for j in range(p):
        if s[D_BRISTLED + j] == BY_STEP:
            bristles_with(s, 1 + j, h)
        for body in range(3):
            to = body * CHANGES + j
            if s[D_BRISTLED + j] == 0.0 or s[W_NUMBERS + N_BRISTLES + body] <= 0.0:
                continue
            if s[D_BRISTLED + j] == BY_SLOPES:
                own_by_slopes(s, D_N0 + to, W_OWN, 1 + j, body)
                own_by_slopes(s, D_R0 + to, W_OWN + 3 * LANES_OF_BODIES, 1 + j, body)
            else:
                s[D_N0 + to] = s[W_OTHER + N_NEW + body] - s[W_NUMBERS + N_NEW + body]
                s[D_R0 + to] = s[W_OTHER + N_AFTER + body] - s[W_NUMBERS + N_AFTER + body]
    if width > p:
        grow(s, D_N0, 6, p)


@njit
def bristled(s, p, bases, fixed):
    """Mark the changes that move what presliding knows; whether any does, and any by slopes."""
    found, sloped = False, False
    for j in range(p):
        row = 1 + j
        moves, others = False, False
        for k in range(F_BRISTLES, F_RENEW):
            moves = moves or fixed[row, k] != fixed[0, k]
        for k in (F_MOB3, F_MOBL):
            others = others or fixed[row, k] != fixed[0, k]
        for k in range(15, 33):
            others = others or bases[row, k] != bases[0, k]
        s[D_BRISTLED + j] = BY_STEP if others else BY_SLOPES if moves else 0.0
        found, sloped = found or moves or others, sloped or (moves and not others)
    return found, sloped


@njit
def bristling(s, body):
    """Speed and presliding friction of a body after a step, slopes of both as of `sliding`."""
    n, to = LANES_OF_BODIES, W_SLOPES + body
    speed = (s[to], s[to + n], s[to + 2 * n], s[to + 3 * n], s[to + 4 * n], s[to + 5 * n])
    to += 6 * n
    friction = (s[to], s[to + n], s[to + 2 * n], s[to + 3 * n], s[to + 4 * n], s[to + 5 * n])
    at = W_NUMBERS + body
    return s[at + N_NEW], s[at + N_AFTER], speed, friction, s[W_SURE + body] > 0.0


@njit
def bristle_change(by, v, v_mid, force, x, load, older, bristle):
    """Change of a presliding friction over a step; `by` as of `with_level`."""
    change = by[0] * v + by[1] * v_mid + by[2] * force + by[6] * bristle
    return change + (by[3] * x + by[4] * load + by[5] * older)
