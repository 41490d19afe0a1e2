"""The effects that have a name: what one unit of strength is, and the draw of the rest.

Each function writes its fields into the record and returns what it drew, for the
label. Amplitudes grow with `strength`, zero switches the effect off exactly; order,
phase, place and time constant are drawn and do not depend on the strength. One unit
is typical: clearly visible, not huge. The table is in README.md beside this file.
"""

import math

import numpy as np

from rigs.layout import LUGRE, RING
from rigs.nominal import ARCMIN, DEG, RING_RATIO

MOTORS = ("left", "right", "both")
DELAY_GRID = 5e-5  # s; a whole number of fine steps, so that a delay is exact


def phase(rng, *shape):
    return rng.uniform(-np.pi, np.pi, shape or None)


def sign(rng):
    return 1.0 if rng.random() < 0.5 else -1.0


def near(rng, amplitude):
    """A typical amplitude, up to a quarter more or less."""
    return amplitude * rng.uniform(0.8, 1.25)


def between(rng, low, high):
    """Even on a log scale."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def sides(location):
    """1 for each of (left, right) that a location names."""
    return np.array([location in ("left", "both"), location in ("right", "both")], float)


# Drive: from the command to the torque of a motor


def cogging(p, rng, strength):
    location, order = str(rng.choice(MOTORS)), int(rng.integers(4, 49))
    # The speed answers with 1/order: let the torque make up for half of that.
    amplitude = near(rng, 0.008 * strength) * math.sqrt(order / 8)
    p.cog_amplitude, p.cog_order, p.cog_phase = amplitude * sides(location), order, phase(rng, 2)
    return {"location": location, "amplitude_N_m": amplitude, "order": order}


def current_lag(p, rng, strength):
    p.lag = near(rng, 2.5e-3 * strength)
    return {"time_constant_s": p.lag}


def drive_delay(p, rng, strength):
    p.delay = DELAY_GRID * round(near(rng, 2.5e-3 * strength) / DELAY_GRID)
    return {"delay_s": p.delay}


def drive_saturation(p, rng, strength):
    limit = near(rng, 1.0) * 1.4
    p.saturation = limit / strength**0.35 if strength > 0 else 0.0
    return {"limit_V": p.saturation}


def drive_dead_band(p, rng, strength):
    p.dead_band = near(rng, 0.02 * strength)
    return {"half_width_V": p.dead_band}


def drive_offset(p, rng, strength):
    location = str(rng.choice(MOTORS))
    offset = near(rng, 0.02 * strength) * sign(rng)
    p.offset = offset * sides(location)
    return {"location": location, "offset_V": offset}


def torque_constant_mismatch(p, rng, strength):
    share = near(rng, 0.04 * strength) * sign(rng)
    p.gain_error = np.array([share, -share])
    return {"left_share": share, "right_share": -share}


def back_emf(p, rng, strength):
    p.back_emf = near(rng, 1e-3 * strength)
    return {"volts_per_rad_s": p.back_emf}


# Reducers and mesh


def load_dependent_friction(p, rng, strength):
    p.load_friction = near(rng, 0.03 * strength)
    return {"coefficient": p.load_friction}


def reducer_compliance(p, rng, strength):
    stiffness = near(rng, 1.0) * 1.5e4
    p.reducer_stiffness = stiffness / strength if strength > 0 else 0.0
    # A reducer on rubber would ring for long: 5 % of critical for motor on pinion.
    p.reducer_damping = 0.05 * math.sqrt(p.reducer_stiffness * p.motor_inertia)
    return {"stiffness_N_m_rad": p.reducer_stiffness, "damping_N_m_s_rad": p.reducer_damping}


def pinion_runout(p, rng, strength):
    location, amplitude = str(rng.choice(MOTORS)), near(rng, 3.0 * strength)
    p.runout, p.runout_phase = amplitude * ARCMIN * sides(location), phase(rng, 2)
    return {"location": location, "amplitude_arcmin": amplitude}


def ring_gear_eccentricity(p, rng, strength):
    amplitude = near(rng, 8.0 * strength)
    p.eccentricity, p.eccentricity_phase = amplitude * ARCMIN, phase(rng)
    return {"amplitude_arcmin": amplitude, "phase_rad": p.eccentricity_phase}


def mesh_error(p, rng, strength):
    amplitude = near(rng, 1.0 * strength)
    p.tooth_error, p.tooth_phase = amplitude * ARCMIN, phase(rng, 2)
    return {"amplitude_arcmin": amplitude}


def backlash_variation(p, rng, strength):
    p.gap_variation = min(0.9, near(rng, 0.25 * strength))
    p.gap_phase = phase(rng)
    p.gap_order = 2.0 if p.gap_phase > 0.0 else 1.0  # an oval gear, or one off its centre
    return {"share": p.gap_variation, "phase_rad": p.gap_phase, "order": p.gap_order}


# Ring gear


def unbalance(p, rng, strength):
    amplitude, angle = near(rng, 3.0 * strength), phase(rng)
    p.unbalance_cos, p.unbalance_sin = amplitude * math.cos(angle), amplitude * math.sin(angle)
    return {"cos_N_m": p.unbalance_cos, "sin_N_m": p.unbalance_sin}


def cable_spring(p, rng, strength):
    p.cable_stiffness = near(rng, 4.0 * strength)
    p.cable_rest = rng.uniform(-20, 20) * DEG
    return {"stiffness_N_m_rad": p.cable_stiffness, "rest_deg": p.cable_rest / DEG}


def base_vibration(p, rng, strength):
    frequency = between(rng, 1.5, 15.0)
    p.vibration = near(rng, 3.0 * strength)
    p.vibration_rate, p.vibration_phase = 2 * np.pi * frequency, phase(rng)
    return {"amplitude_N_m": p.vibration, "frequency_Hz": frequency, "phase_rad": p.vibration_phase}


def quadratic_drag(p, rng, strength):
    p.quadratic = near(rng, 12.0 * strength)
    return {"coefficient_N_m_s2_rad2": p.quadratic}


# Friction


def thermal_drift(p, rng, strength):
    location = str(rng.choice(["ring_gear", "reducers", "all"]))
    rise = near(rng, 0.12 * strength)
    p.warm_ring = rise if location != "reducers" else 0.0
    p.warm_reducer = rise if location != "ring_gear" else 0.0
    p.warm_time = between(rng, 2.0, 15.0)
    return {"location": location, "rise": rise, "time_constant_s": p.warm_time}


def presliding(p, rng, strength):
    location = str(rng.choice(["ring_gear", "all"]))
    bend = near(rng, 0.02 * strength) * DEG
    if strength > 0:
        p.law[RING], p.bristle[RING] = LUGRE, max(bend, p.bristle[RING])
        if location == "all":
            p.law[:2], p.bristle[:2] = LUGRE, RING_RATIO * p.bristle[RING]
    return {"location": location, "deflection_deg": bend / DEG}


def position_dependent_friction(p, rng, strength):
    p.position_friction = near(rng, 2.5 * strength)
    p.position_order, p.position_phase = int(rng.integers(1, 4)), phase(rng)
    return {"amplitude_N_m": p.position_friction, "order": p.position_order}


def local_spot(p, rng, strength):
    p.spot = near(rng, 5.0 * strength)
    p.spot_place, p.spot_width = phase(rng), between(rng, 2.0, 7.0) * DEG
    return {
        "height_N_m": p.spot,
        "place_deg": p.spot_place / DEG,
        "sigma_deg": p.spot_width / DEG,
    }


# Sensors


def sensor_gain(p, rng, strength):
    p.gyro_gain_error = near(rng, 0.01 * strength) * sign(rng)
    return {"share": p.gyro_gain_error}


def sensor_delay(p, rng, strength):
    p.gyro_delay = DELAY_GRID * round(near(rng, 3e-3 * strength) / DELAY_GRID)
    return {"delay_s": p.gyro_delay}


def encoder_eccentricity(p, rng, strength):
    amplitude = near(rng, 0.8 * strength)
    p.encoder_eccentricity, p.encoder_phase = amplitude * ARCMIN, phase(rng)
    return {"amplitude_arcmin": amplitude, "phase_rad": p.encoder_phase}


KNOWN = {
    effect.__name__: effect
    for effect in (
        cogging,
        pinion_runout,
        ring_gear_eccentricity,
        backlash_variation,
        unbalance,
        cable_spring,
        current_lag,
        drive_delay,
        drive_saturation,
        drive_dead_band,
        drive_offset,
        torque_constant_mismatch,
        load_dependent_friction,
        presliding,
        sensor_delay,
        sensor_gain,
        thermal_drift,
        reducer_compliance,
        position_dependent_friction,
        quadratic_drag,
        base_vibration,
        back_emf,
        local_spot,
        mesh_error,
        encoder_eccentricity,
    )
}
