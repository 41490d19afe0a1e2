"""What the paper misprints, in one place: corrected by default, as printed on request.

The proofs are in docs/errata.md, and a test per row shows what goes wrong with the printed form.
"""

from math import cos
from typing import NamedTuple


class Erratum(NamedTuple):
    """One row: where, what is printed, what it must be, how it is seen."""

    where: str
    printed: str
    corrected: str
    proof: str


ERRATA = {
    "J3_bar": Erratum(
        "below Eq. 16",
        "J̄3 = N1² Jm + J1 + J2 + J3",
        "J̄3 = N1² (Jm + J1) + J2 + J3",
        "J1 turns with the motor; the 9-DOF modes converge to the 3-DOF's only with this",
    ),
    "gap_exponent": Erratum(
        "Eq. 21, exponent",
        "(z + b)/(ż + k)",
        "(z + Δ)/ż + c/k",
        "printed, a speed is added to a stiffness; corrected, it is the two-state mesh",
    ),
    "tooth": Erratum(
        "Eq. 22",
        "J(x) polar moment, x from the tooth's base",
        "second moment b s(x)³/12, x from the point of load",
        "closed form of a tapered cantilever",
    ),
    "mesh_phase": Erratum(
        "Eq. 23",
        "cos(ω_z t + φ)",
        "cos(z3 θ3 + φ)",
        "ω_z = z3 θ̇3 is a constant at constant speed only; at rest the teeth do not pass",
    ),
    "mesh_damping": Erratum(
        "Eq. 24",
        "R3² R_L² J3 J_L/(R3² J3 + R_L² J_L) under the root",
        "c = 2ζ √(k J̄3 J_L/(J_L + N2² J̄3))",
        "printed, c depends on the unit of the radii; corrected, ζ is the mode's own",
    ),
    "c": Erratum(
        "Table 1, c",
        "c = 1 N·m·s/rad",
        "uncertain, 1…10 N·m·s/rad",
        "c = 1 is a damping ratio of 0.015, outside Eq. 24's own 0.03…0.17",
    ),
    "T3s_plus": Erratum(
        "Table 2, T3s⁺ and T3c⁺",
        "T3s⁺ = 2.5, T3c⁺ = 2.8 N·m",
        "T3s⁺ = 2.8, T3c⁺ = 2.5 N·m",
        "static friction below Coulomb, alone of four pairs in the table: swapped",
    ),
    "J2": Erratum(
        "Table 1, J2",
        "J2 = 0.125 kg·m², equal to N1² Jm exactly",
        "what stays on the pinion side beside N1² Jm, so J̄3 = 0.25 kg·m²",
        "25² · 2e-4 = 0.125; open, so the resonances are shown for both readings",
    ),
    "F_34t": Erratum(
        "Eq. 15",
        "F_l34r",
        "F_l34t",
        "action and reaction: only with the pinion's own force is K symmetric",
    ),
    "R_L": Erratum(
        "Appendix",
        "R4",
        "R_L",
        "two names for one radius: only R4 = N2 R3 lets all bodies turn freely together",
    ),
    "rest_friction": Erratum(
        "Eq. 25, at rest",
        "T_f = T_m",
        "T_f = the net torque on the body from all but its friction",
        "the motor's torque does not reach the ring gear directly",
    ),
    "half_gap": Erratum(
        "Table 1, Δ1 and Δ2",
        "backlash",
        "half-gaps: Eq. 21 and Figure 11 make 2Δ the backlash",
        "free play between both contacts of Eq. 21 is 2Δ",
    ),
}
"""Row name → :class:`Erratum`."""


def gap_exponent(
    z: float,
    rate: float,
    half_gap: float,
    stiffness: float,
    damping: float,
    *,
    as_printed: bool = False,
) -> float:
    """Return what Eq. 21 multiplies by −k/(c + c_f) in A⁺: the time since contact was left [s].

    `z` [rad] is the twist, `rate` [rad/s] its rate, `half_gap` in rad, `stiffness` in N·m/rad,
    `damping` in N·m·s/rad. Printed (z + b)/(ż + k) adds rad/s to N·m/rad; its value depends on the
    unit of torque.
    """
    if as_printed:
        return (z + half_gap) / (rate + stiffness)
    return (z + half_gap) / rate + damping / stiffness


def mesh_stiffness(
    mean: float,
    amplitude: float,
    teeth: float,
    theta_3: float,
    *,
    phase: float = 0.0,
    as_printed: tuple[float, float] | None = None,
) -> float:
    """Return the mesh stiffness k(θ3) [N·m/rad], Eq. 23.

    `mean` k_m and `amplitude` k_a are in N·m/rad, `teeth` is z3, `theta_3` the pinion's angle and
    `phase` φ_r in rad. `as_printed` (time [s], pinion speed [rad/s]) uses ω_z t with ω_z = z3 θ̇3
    in place of the mesh angle.
    """
    angle = teeth * theta_3 if as_printed is None else teeth * as_printed[1] * as_printed[0]
    return mean + amplitude * cos(angle + phase)


def friction_at_rest(
    static_minus: float,
    static_plus: float,
    *,
    net_torque: float,
    motor_torque: float,
    as_printed: bool = False,
) -> float:
    """Return the friction [N·m] of a body at rest, Eq. 25: it opposes `net_torque` if it can.

    Bounds are `static_minus` < 0 < `static_plus`. `net_torque` is that on the body from everything
    but its friction, in whose place Eq. 25 prints `motor_torque`; all in N·m.
    """
    torque = motor_torque if as_printed else net_torque
    return min(max(torque, static_minus), static_plus)
