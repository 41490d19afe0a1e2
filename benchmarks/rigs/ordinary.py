"""What every machine has: small imperfections, each drawn from a stream of its own.

Each function adds its thing to the record, on top of what is there already. The key is the
thing in labels.json, beside it the name that a diagnosis may give it.
"""

import numpy as np

from rigs.catalogue import phase, sign
from rigs.layout import LUGRE, SLIP_ELEMENTS
from rigs.nominal import ARCMIN, DEG, PINION_TEETH, RING_RATIO, RING_TEETH


def add_wave(p, amplitude_field, phase_field, amplitude, shift):
    """Add a cosine to one of the same order; side by side for arrays."""
    there = np.asarray(p[amplitude_field]) * np.exp(1j * np.asarray(p[phase_field]))
    both = there + amplitude * np.exp(1j * np.asarray(shift))
    p[amplitude_field], p[phase_field] = np.abs(both), np.angle(both)


def teeth_and_ripple(p, rng):
    p.pinion_pitch = rng.uniform(-1, 1, (2, PINION_TEETH)) * ARCMIN
    p.ring_pitch = rng.uniform(-1, 1, RING_TEETH) * ARCMIN
    p.stiffness_ripple, p.stiffness_phase = rng.uniform(0.1, 0.2), phase(rng, 2)


def runout(p, rng):
    add_wave(p, "runout", "runout_phase", ARCMIN, phase(rng, 2))


def eccentricity(p, rng):
    add_wave(p, "eccentricity", "eccentricity_phase", 2 * ARCMIN, phase(rng))


def cogging(p, rng):
    p.usual_cogging, p.usual_cogging_phase = 5e-3, phase(rng, 2, 2)


def loop_lag(p, rng):
    p.loop_lag = 1e-3


def quantisation(p, rng):
    p.command_step = 20.0 / 2**12


def gyro_lag(p, rng):
    p.gyro_bandwidth = 80.0
    p.gyro_delay += 2e-4


def gyro_bias(p, rng):
    p.gyro_bias = 0.02 * DEG * sign(rng)


def interpolation(p, rng):
    p.interpolation, p.interpolation_phase = 2.0 / 3600 * DEG, phase(rng)


def torque_constants(p, rng):
    share = 0.005 * sign(rng)
    p.gain_error = p.gain_error + np.array([share, -share])


def viscous_drift(p, rng):
    p.viscous_drift = 0.03 * sign(rng)


ORDINARY = {
    "teeth_and_ripple": (teeth_and_ripple, "mesh_error"),
    "runout": (runout, "pinion_runout"),
    "eccentricity": (eccentricity, "ring_gear_eccentricity"),
    "cogging": (cogging, "cogging"),
    "loop_lag": (loop_lag, "current_lag"),
    "quantisation": (quantisation, None),
    "gyro_lag": (gyro_lag, "sensor_delay"),
    "gyro_bias": (gyro_bias, None),
    "interpolation": (interpolation, None),
    "K_t": (torque_constants, "torque_constant_mismatch"),
    "viscous_drift": (viscous_drift, "thermal_drift"),
}
FRICTION = ("karnopp", "lugre", "gms", "tanh", "stribeck")
CONTACT = ("kelvin_voigt", "hunt_crossley", "quadratic")
PLAIN = {"friction": "karnopp", "contact": "kelvin_voigt"}  # what a law is replaced by
LAW_NAMES = {"lugre": "presliding", "gms": "presliding"}


def laws_that_show(p, rng):
    """Bristles and slip elements as soft as those of real bearings, other Stribeck curves."""
    bend, exponent = rng.uniform(0.003, 0.008) * DEG, rng.choice([0.5, 0.7, 1.5, 2.0])
    soft = np.isin(p.law, (LUGRE, SLIP_ELEMENTS))
    reach = np.array([RING_RATIO, RING_RATIO, 1.0]) * bend
    p.bristle = np.where(soft, np.maximum(p.bristle, reach), p.bristle)
    return exponent
