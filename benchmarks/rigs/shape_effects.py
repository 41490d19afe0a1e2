"""What the rig files of :mod:`rigs.shapes` may lack: effects, their sizes and places."""

import math
from typing import NamedTuple

import numpy as np

SHAPES = ("rotor", "shaft", "gear", "axis", "gimbal")
TURNING = ("rotor", "shaft", "gear", "gimbal")
DEG = math.pi / 180


class Scale(NamedTuple):
    """What is usual for a machine."""

    torque: float
    speed: float
    signal: float
    slow: float  # s, mechanical time constant
    coulomb: float


# name -> (shapes, fields of the machine from (rng, size, scale), what the label says of them)
def _one(field, share, per="torque", signed=False, **more):
    """An effect of one field, a share of what is usual."""

    def draw(rng, size, s):
        value = share * size * rng.uniform(0.8, 1.25) * getattr(s, per, 1.0)
        value *= rng.choice([-1, 1]) if signed else 1
        return {field: value} | {k: f(rng, s) for k, f in more.items()}

    return draw


def _phase(rng, s):
    return rng.uniform(-np.pi, np.pi)


def _unbalance(rng, size, s):
    amplitude, at = 0.3 * size * s.torque, rng.uniform(-np.pi, np.pi)
    return {"unbalance_cos": amplitude * math.cos(at), "unbalance_sin": amplitude * math.sin(at)}


def _quadratic(rng, size, s):
    return {"quadratic": 0.3 * size * s.torque / s.speed**2}


def _cable(rng, size, s):
    return {"cable": 0.3 * size * s.torque / (2 * s.speed * s.slow)}


EFFECTS = {
    "coulomb_friction": (SHAPES, None),
    "friction_asymmetry": (SHAPES, _one("asymmetry", 0.2, "", signed=True)),
    "stribeck_friction": (
        SHAPES,
        _one("rise_at_rest", 0.12, stribeck_speed=lambda rng, s: 0.05 * s.speed),
    ),
    "shaft_compliance": (("shaft",), None),
    "backlash": (("shaft", "gear"), _one("half_gap", 1e-3, "speed")),
    "load_dependent_friction": (("gear",), _one("load_friction", 0.15, "")),
    "position_dependent_friction": (
        ("rotor", "gimbal"),
        _one("position_friction", 0.5, "coulomb", position_phase=_phase,
             position_order=lambda rng, s: float(rng.integers(1, 4))),
    ),
    "local_spot": (
        ("rotor", "gimbal"),
        _one("spot", 0.3, spot_place=_phase,
             spot_width=lambda rng, s: rng.uniform(4, 12) * DEG),
    ),
    "thermal_drift": (SHAPES, _one("warm", 0.3, "", warm_time=lambda rng, s: rng.uniform(1.5, 5))),
    "unbalance": (("rotor", "gimbal", "gear"), _unbalance),
    "cable_spring": (("rotor", "gimbal", "axis"), _cable),
    "cogging": (
        ("rotor", "shaft"),
        _one("cogging", 0.08, cogging_phase=_phase,
             cogging_order=lambda rng, s: float(rng.choice([7, 12, 24, 36]))),
    ),
    "quadratic_drag": (SHAPES, _quadratic),
    "base_vibration": (
        ("gimbal", "axis"),
        _one("vibration", 0.08, vibration_phase=_phase,
             vibration_rate=lambda rng, s: 2 * np.pi * rng.uniform(1, 8)),
    ),
    "current_lag": (SHAPES, _one("lag", 8e-3, "")),
    "drive_delay": (SHAPES, _one("delay", 6e-3, "")),
    "drive_dead_band": (SHAPES, _one("dead_band", 0.06, "signal")),
    "drive_saturation": (SHAPES, lambda rng, size, s: {"limit": 0.6 * s.signal / size**0.35}),
    "drive_offset": (SHAPES, _one("offset", 0.04, "signal", signed=True)),
    "sensor_gain": (("gimbal",), _one("gain_error", 0.04, "", signed=True)),
    "sensor_delay": (("gimbal",), _one("sensor_delay", 6e-3, "")),
    "encoder_eccentricity": (
        ("gimbal",), _one("eccentricity", 0.02, "", eccentricity_phase=_phase)
    ),
}  # fmt: skip
UNKNOWN = {  # name -> (shapes, fields, variables of which a diagnosis should find one)
    "sector": (
        ("rotor", "gimbal"),
        _one("sector", 0.15, sector_place=_phase,
             sector_half=lambda rng, s: rng.uniform(20, 50) * DEG),
        ("angle", "position", "theta"),
    ),
    "gain_schedule": (
        SHAPES,
        _one("schedule", 0.2, "", schedule_time=lambda rng, s: rng.uniform(3, 6)),
        ("drive", "input", "t", "time", "u"),
    ),
    "dropout": (
        SHAPES,
        _one("dropout", 0.05, "", dropout_period=lambda rng, s: rng.uniform(0.6, 1.2)),
        ("drive", "input", "t", "time", "u"),
    ),
    "hysteresis": (
        SHAPES, _one("command_play", 0.08, "signal"),
        ("drive", "input", "u", "du_dt"),
    ),
    "sensor_play": (
        ("gear", "shaft"), _one("sensor_play", 2e-3, "speed"),
        ("theta", "omega", "angle", "position", "speed"),
    ),
}  # fmt: skip
ALIKE = (
    {"cogging", "position_dependent_friction", "local_spot", "encoder_eccentricity"},
    {"current_lag", "drive_delay", "sensor_delay"},
    {"shaft_compliance", "backlash"},
    {"base_vibration", "thermal_drift"},
    {"drive_offset", "friction_asymmetry"},
    {"drive_saturation", "sensor_gain", "quadratic_drag"},
    {"coulomb_friction", "stribeck_friction", "drive_dead_band"},
)
WAVES = {"cogging", "position_dependent_friction", "local_spot", "sector"}
LATE = {"current_lag", "drive_delay", "sensor_delay", "shaft_compliance"}
