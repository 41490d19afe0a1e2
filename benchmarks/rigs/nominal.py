"""The paper's tables, corrected, and how far a rig may lie from them.

Corrections: Table 2 prints T3s+ below T3c+, they are swapped here; Table 1's J2 is
read as what stays on the pinion side beside N1^2 Jm; Table 1's gaps are half-gaps
at the pinion; the mesh damping c is uncertain, 1 to 10 N·m·s/rad (Eq. 24).
"""

import math

DEG = math.pi / 180
ARCMIN = DEG / 60

REDUCER_RATIO = 25.0  # N1, Table 1
RING_RATIO = 8.25  # N2 = 165/20 teeth, Table 1
PINION_TEETH, RING_TEETH = 20, 165  # z3 and its partner, Table 1
TORQUE_PER_VOLT = 3.0 * 0.13  # K_d K_M, N·m/V at one motor, Table 1
MOTOR_INERTIA = REDUCER_RATIO**2 * 2e-4  # N1^2 Jm, kg·m² at the pinion, Table 1
PINION_INERTIA = MOTOR_INERTIA + 0.125  # kg·m², Table 1
RING_INERTIA = 2.5  # kg·m², Table 1
MESH_STIFFNESS = 3.6e4  # N·m/rad at the pinion, Table 1
MESH_DAMPING = (1.0, 10.0)  # N·m·s/rad, drawn on a log scale
GAP_DAMPING = (0.02, 0.5)  # c_f, N·m·s/rad; adjustable in the paper
HALF_GAPS = (14 * ARCMIN, 10 * ARCMIN)  # left, right
PINION_SPACING = 120 * DEG  # between the pinions, on the ring gear

# Table 2: (positive, negative) magnitudes; N·m, and speeds turned into rad/s.
REDUCER_FRICTION = {
    "static": (2.8, 2.0),
    "coulomb": (2.5, 1.8),
    "stribeck": (2 * DEG, 2 * DEG),
    "viscous": (0.01 / DEG, 0.008 / DEG),
}
RING_FRICTION = {
    "static": (23.0, 20.0),
    "coulomb": (20.0, 17.0),
    "stribeck": (1 * DEG, 1 * DEG),
    "viscous": (1.2 / DEG, 1.0 / DEG),
}

# Half-widths of the uniform draws about the tables, relative.
SPREAD = {"friction": 0.12, "gap": 0.12, "inertia": 0.06, "stiffness": 0.10}
