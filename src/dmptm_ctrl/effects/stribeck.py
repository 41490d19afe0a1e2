"""Stribeck friction with real sticking, asymmetric in direction.

    moving:   Tc + (Ts − Tc) exp(−(|ω|/Ω)^δ) + B |ω|, against the motion
    at rest:  any value in [−Ts⁻, Ts⁺], as much as it takes to stay

Magnitudes are positive, the sign is the speed's.
Source: paper Eq. 25; at rest the balance is of the net torque on the body, not of the
motor's (erratum).
"""

from math import exp, pow
from typing import NamedTuple

from numba import njit


class Stribeck(NamedTuple):
    """Friction of one body."""

    static_plus: float  # N·m, Ts⁺
    coulomb_plus: float  # N·m, Tc⁺
    speed_plus: float  # rad/s, Ω⁺
    viscous_plus: float  # N·m·s/rad, B⁺
    static_minus: float
    coulomb_minus: float
    speed_minus: float
    viscous_minus: float
    exponent: float  # δ
    steepness_plus: float  # s/rad, 1/Ω⁺
    steepness_minus: float


@njit(error_model="numpy")
def stribeck_law(
    static_plus,
    coulomb_plus,
    speed_plus,
    viscous_plus,
    static_minus,
    coulomb_minus,
    speed_minus,
    viscous_minus,
    exponent,
):
    """Friction of one body; quotients are taken here, and a loop's steps need not wait for them."""
    return Stribeck(
        static_plus,
        coulomb_plus,
        speed_plus,
        viscous_plus,
        static_minus,
        coulomb_minus,
        speed_minus,
        viscous_minus,
        exponent,
        1.0 / speed_plus,
        1.0 / speed_minus,
    )


@njit
def breakaway_torque(direction, p):
    """Largest holding torque [N·m] against motion in `direction` (sign counts)."""
    return p.static_plus if direction > 0.0 else p.static_minus


@njit
def viscous_torque(omega, direction, p):
    """Magnitude of the part of friction that grows with speed [N·m]; as `sliding_torque`."""
    viscous = p.viscous_plus if direction > 0.0 else p.viscous_minus
    return viscous * max(omega * direction, 0.0)


@njit
def sliding_torque(omega, direction, p):
    """Magnitude of friction [N·m] at speed `omega` [rad/s], branch chosen by `direction`."""
    if direction > 0.0:
        static, coulomb = p.static_plus, p.coulomb_plus
        steepness, viscous = p.steepness_plus, p.viscous_plus
    else:
        static, coulomb = p.static_minus, p.coulomb_minus
        steepness, viscous = p.steepness_minus, p.viscous_minus
    speed = omega * direction
    if speed < 0.0:
        speed = 0.0
    ratio = speed * steepness
    if p.exponent != 1.0:
        ratio = pow(ratio, p.exponent)
    return (coulomb + viscous * speed) + (static - coulomb) * exp(-ratio)
