"""The effects that have a name: what one unit of strength is, and the draw of the rest.

Each function writes its fields into the record and returns what it drew for the
label. Amplitudes grow with `strength`, zero switches the effect off exactly; order,
phase, place and time constant are drawn and do not depend on the strength. One unit
of strength is typical: clearly visible, not huge (table in rigs/README.md).
"""

import math

import numpy as np

from rigs.layout import LUGRE, RING
from rigs.nominal import ARCMIN, DEG, MOTOR_INERTIA, REDUCER_RATIO, RING_RATIO

MOTORS = ("left", "right", "both")


def phase(rng, *shape):
    return rng.uniform(-np.pi, np.pi, shape or None)


def sign(rng):
    return 1.0 if rng.random() < 0.5 else -1.0


def mask(location):
    """Which of (left, right) a location names."""
    return np.array([location in ("left", "both"), location in ("right", "both")], float)


# Torque of the motor


def cogging(p, rng, strength):
    location, order = str(rng.choice(MOTORS)), int(rng.integers(4, 49))
    amplitude, phases = 0.02 * strength * rng.uniform(0.8, 1.25), phase(rng, 2)
    p.cog_amplitude, p.cog_order, p.cog_phase = amplitude * mask(location), order, phases
    return {"location": location, "amplitude_N_m": amplitude, "order": order}


def current_lag(p, rng, strength):
    p.lag = 6e-3 * strength * rng.uniform(0.8, 1.25)
    return {"time_constant_s": p.lag}


def drive_delay(p, rng, strength):
    # A whole number of the finest step in use, so that the delay is exact.
    p.delay = round(6e-3 * strength * rng.uniform(0.8, 1.25) / 5e-5) * 5e-5
    return {"delay_s": p.delay}


def drive_offset(p, rng, strength):
    location = str(rng.choice(MOTORS))
    offset = 0.05 * strength * rng.uniform(0.8, 1.25) * sign(rng)
    p.offset = offset * mask(location)
    return {"location": location, "offset_V": offset}


def torque_constant_mismatch(p, rng, strength):
    share = 0.06 * strength * rng.uniform(0.8, 1.25) * sign(rng)
    p.gain_error = np.array([share, -share])
    return {"left_share": share, "right_share": -share}


# Ring gear


def unbalance(p, rng, strength):
    amplitude, angle = 3.0 * strength * rng.uniform(0.8, 1.25), phase(rng)
    p.unbalance_cos, p.unbalance_sin = amplitude * math.cos(angle), amplitude * math.sin(angle)
    return {"cos_N_m": p.unbalance_cos, "sin_N_m": p.unbalance_sin}


def cable_spring(p, rng, strength):
    p.cable_stiffness = 6.0 * strength * rng.uniform(0.8, 1.25)
    p.cable_rest = rng.uniform(-20, 20) * DEG
    return {"stiffness_N_m_rad": p.cable_stiffness, "rest_deg": p.cable_rest / DEG}


def base_vibration(p, rng, strength):
    frequency = math.exp(rng.uniform(math.log(1.5), math.log(15.0)))
    p.vibration = 3.0 * strength * rng.uniform(0.8, 1.25)
    p.vibration_rate, p.vibration_phase = 2 * np.pi * frequency, phase(rng)
    return {"amplitude_N_m": p.vibration, "frequency_Hz": frequency, "phase_rad": p.vibration_phase}


def thermal_drift(p, rng, strength):
    location = str(rng.choice(["ring_gear", "reducers", "all"]))
    rise = 0.2 * strength * rng.uniform(0.8, 1.25)
    p.warm_ring = rise if location != "reducers" else 0.0
    p.warm_reducer = rise if location != "ring_gear" else 0.0
    p.warm_time = math.exp(rng.uniform(math.log(2.0), math.log(15.0)))
    return {"location": location, "rise": rise, "time_constant_s": p.warm_time}


KNOWN = {
    f.__name__: f
    for f in (
        cogging,
        current_lag,
        drive_delay,
        drive_offset,
        torque_constant_mismatch,
        unbalance,
        cable_spring,
        base_vibration,
        thermal_drift,
    )
}
