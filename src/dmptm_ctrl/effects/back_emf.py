"""Back-EMF: a voltage-driven motor is braked by its own speed.

torque = −K_e ω_m on the motor's shaft
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def back_emf_torque(u, theta_m, omega_m, t, side, p):
    """Torque on the motor's shaft [N·m]."""
    return -p.damping * omega_m


BACK_EMF = Effect(
    name="back_emf",
    site="motor",
    kernel=back_emf_torque,
    parameters=(Parameter("damping", "N·m·s/rad", 0.0, 0.01, 0.0002),),  # K_e
    location="motors",
    source="K_t K_e / R of a voltage-fed motor",
    depends_on=("omega_m",),
    reveals="constant speeds over the whole range; only a coefficient beyond its declared range "
    "separates it from viscous friction",
)
