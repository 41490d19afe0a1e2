"""Where things are: the record of a rig's parameters and the state vector.

A record of zeros has no effects: every effect is off while its fields are zero.
"""

import numpy as np

from rigs.nominal import PINION_TEETH, RING_TEETH

LEFT, RIGHT, RING = 0, 1, 2

# "stribeck" is Karnopp's sticking with another exponent in the Stribeck curve.
KARNOPP, LUGRE, TANH, SLIP_ELEMENTS = 0, 1, 2, 3
FRICTION_LAWS = {
    "karnopp": KARNOPP,
    "lugre": LUGRE,
    "tanh": TANH,
    "gms": SLIP_ELEMENTS,
    "stribeck": KARNOPP,
}

EQ21, TWO_STATE, KELVIN_VOIGT, HUNT_CROSSLEY, QUADRATIC = 0, 1, 2, 3, 4
CONTACT_LAWS = {
    "eq21": EQ21,
    "two_state": TWO_STATE,
    "kelvin_voigt": KELVIN_VOIGT,
    "hunt_crossley": HUNT_CROSSLEY,
    "quadratic": QUADRATIC,
}

# State vector: three bodies first; the rest stays zero unless its physics is on.
ANGLE = 0  # left pinion side, right pinion side, ring gear [rad]
SPEED = 3  # the same bodies [rad/s]
GAP = 6  # position in the gap, left, right [rad] (two_state)
BRISTLE = 8  # deflection per body [rad] (lugre, presliding)
CURRENT = 11  # lagged voltage, left, right [V]
MOTOR_ANGLE = 13  # left, right, referred to the pinion [rad] (reducer compliance)
MOTOR_SPEED = 15
SLOSH_ANGLE = 17  # loose mass on the ring gear [rad]
SLOSH_SPEED = 18
STATES = 19

# Memory: what changes once per fine step and is not integrated.
REST_TIME = 0  # s, per body
SLIP = 3  # rad since the last rest, per body
HEAT = 6  # J kept in the ring gear's bearing
SLEWED = 7  # V, output of the rate limit, left, right
SAG_UNTIL = 9  # s, the supply stays down until then
GRABBED = 10  # 1 while the high-speed brake holds
HOOKED = 11  # 1 while the hook is engaged
SLIPPED = 12  # rad that the pinion turned on its hub, left, right
TOOTH = 14  # N·m, mesh torque at the start of the step, left, right
PLAYED = 16  # V, output of the play in the drive, left, right
AGE = 18  # share of the log that is over
ANCHOR = 19  # rad, where the springs of the slip elements are held, per body and element
ELEMENTS = 5
MEMORY = ANCHOR + 3 * ELEMENTS

DETENTS = 24

FIELDS = [
    # plant
    ("pinion_inertia", "f8"), ("motor_inertia", "f8"), ("ring_inertia", "f8"),
    ("torque_per_volt", "f8"), ("stiffness", "f8"), ("damping", "f8"),
    ("gap_damping", "f8"), ("half_gap", "f8", 2), ("contact", "i8"),
    # friction, per body: [body, direction], direction 0 forward, 1 backward
    ("static", "f8", (3, 2)), ("coulomb", "f8", (3, 2)), ("stribeck", "f8", (3, 2)),
    ("viscous", "f8", (3, 2)), ("law", "i8", 3), ("bristle", "f8", 3), ("smooth", "f8", 3),
    # drive
    ("cog_amplitude", "f8", 2), ("cog_order", "f8"), ("cog_phase", "f8", 2),
    ("lag", "f8"), ("delay", "f8"), ("offset", "f8", 2), ("gain_error", "f8", 2),
    ("saturation", "f8"), ("dead_band", "f8"), ("back_emf", "f8"),
    # reducers and mesh
    ("reducer_stiffness", "f8"), ("reducer_damping", "f8"), ("load_friction", "f8"),
    ("runout", "f8", 2), ("runout_phase", "f8", 2), ("eccentricity", "f8"),
    ("eccentricity_phase", "f8"), ("tooth_error", "f8"), ("tooth_phase", "f8", 2),
    ("gap_variation", "f8"), ("gap_phase", "f8"), ("gap_order", "f8"),
    # ring gear
    ("unbalance_cos", "f8"), ("unbalance_sin", "f8"), ("cable_stiffness", "f8"),
    ("cable_rest", "f8"), ("vibration", "f8"), ("vibration_rate", "f8"),
    ("vibration_phase", "f8"), ("quadratic", "f8"),
    ("warm_ring", "f8"), ("warm_reducer", "f8"), ("warm_time", "f8"),
    ("position_friction", "f8"), ("position_order", "f8"), ("position_phase", "f8"),
    ("spot", "f8"), ("spot_place", "f8"), ("spot_width", "f8"),
    # sensors
    ("gyro_gain_error", "f8"), ("gyro_delay", "f8"),
    ("encoder_eccentricity", "f8"), ("encoder_phase", "f8"),
    # ordinary imperfections, see ordinary.py
    ("exponent", "f8"), ("loop_lag", "f8"), ("viscous_drift", "f8"),
    ("usual_cogging", "f8"), ("usual_cogging_phase", "f8", (2, 2)),
    ("pinion_pitch", "f8", (2, PINION_TEETH)), ("ring_pitch", "f8", RING_TEETH),
    ("stiffness_ripple", "f8"), ("stiffness_phase", "f8", 2),
    ("gyro_bandwidth", "f8"), ("gyro_bias", "f8"),
    ("interpolation", "f8"), ("interpolation_phase", "f8"),
    # on nobody's list, see unknowns.py
    ("cut_period", "f8"), ("cut_length", "f8"), ("cut_start", "f8"), ("cut_motor", "i8"),
    ("dwell_rise", "f8"), ("dwell_time", "f8"),
    ("ripple", "f8"), ("ripple_order", "f8"), ("ripple_phase", "f8"),
    ("detent", "f8"), ("detent_width", "f8"), ("detent_place", "f8", DETENTS),
    ("soft_tooth", "f8"), ("command_step", "f8"),
    ("flash_rise", "f8"), ("flash_heat", "f8"), ("flash_time", "f8"),
    ("sector_brake", "f8"), ("sector_place", "f8"), ("sector_half", "f8"),
    ("slosh_inertia", "f8"), ("slosh_rate", "f8"), ("slosh_damping", "f8"),
    ("slew", "f8"),
    ("grab", "f8"), ("grab_on", "f8"), ("grab_off", "f8"),
    ("sag", "f8"), ("sag_voltage", "f8"), ("sag_time", "f8"),
    ("dead_sector", "f8"), ("dead_sector_place", "f8"), ("dead_sector_half", "f8"),
    ("regeneration", "f8"),
    ("slip_torque", "f8"), ("slip_damping", "f8"),
    ("hook", "f8"), ("hook_on", "f8"), ("hook_off", "f8"),
    ("howl", "f8"), ("howl_order", "f8"), ("howl_phase", "f8"), ("howl_speed", "f8"),
    ("howl_width", "f8"),
    ("knock", "f8"), ("knock_period", "f8"), ("knock_length", "f8"), ("knock_start", "f8"),
    ("fade", "f8"), ("fade_time", "f8"), ("polarity", "f8"), ("play", "f8"),
    ("torque_ripple", "f8"), ("torque_ripple_order", "f8"), ("torque_ripple_phase", "f8", 2),
    ("bump", "f8"), ("bump_speed", "f8"), ("bump_width", "f8"),
    ("wall", "f8"), ("wall_place", "f8"), ("late_brake", "f8"), ("late_brake_time", "f8"),
]  # fmt: skip
RECORD = np.dtype(FIELDS)
