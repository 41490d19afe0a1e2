"""Sensors of one point against each other: which reads late, and by how much."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import csd, welch

from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.identify.chain_motion import derivative
from dmptm_ctrl.signals import Log

SEGMENT = 1024  # samples of a cross-spectrum
COHERENT = 0.6  # squared coherence below which a frequency says nothing
SURE = 6.0  # standard errors
LEAST = 0.3  # sample times; less is the sampling itself


class Lateness(NamedTuple):
    """How late a speed sensor reads against the position of the same encoder.

    Attributes
    ----------
    delay, se : float [s]
    before, after : float
        rms between the two speeds in the band where they agree, as logged and with the delay
        undone [rad/s or m/s].
    """

    sensor: str
    delay: float
    se: float
    before: float
    after: float


def late_sensors(rig: Rig, logs: Sequence[Log]) -> dict[str, Lateness]:
    """Find speed sensors that read later than the derivative of a position on the same body."""
    found = {}
    for speed in (s for s in rig.sensors if s.measures == "speed"):
        for position in rig.sensors:
            if position.body == speed.body and position.measures == "position":
                result = _compare(position, speed, logs)
                if result is not None:
                    found[speed.name] = result
                break
    return found


def _compare(position: Sensor, speed: Sensor, logs: Sequence[Log]) -> Lateness | None:
    slopes, weights, before, after = [], [], 0.0, 0.0
    for log in logs:
        dt = log.sample_time
        one, other = derivative(log[position.channel], dt), log[speed.channel]
        length = min(SEGMENT, one.size // 8)
        f, cross = csd(one, other, 1 / dt, nperseg=length)
        _, p1 = welch(one, 1 / dt, nperseg=length)
        _, p2 = welch(other, 1 / dt, nperseg=length)
        coherence = np.abs(cross) ** 2 / np.maximum(p1 * p2, 1e-300)
        use = (coherence > COHERENT) & (f > 0) & (f < 0.25 / dt)
        if use.sum() < 3:
            continue
        omega = 2 * np.pi * f[use]
        # phase slope weighted by its precision (Hannan & Thomson, Biometrika 60 (1973) 469)
        weight = coherence[use] / (1 - np.minimum(coherence[use], 0.9999)) * one.size / length
        total = float(np.sum(weight * omega**2))
        delay = -float(np.sum(weight * omega * np.angle(cross[use]))) / total
        spread = np.angle(cross[use] * np.exp(1j * omega * delay))
        slopes.append(delay)
        weights.append(total / max(float(np.sum(weight * spread**2)) / use.sum(), 1.0))
        level = np.abs(cross[use])
        before += float(np.sum(level * np.abs(np.exp(-1j * omega * delay) - 1) ** 2))
        after += float(np.sum(level * np.abs(np.exp(1j * spread) - 1) ** 2))
    if not slopes:
        return None
    d, w = np.array(slopes), np.array(weights)
    mean = float(np.sum(w * d) / np.sum(w))
    # logs differ by more than their own errors where a sensor's filter is no pure delay
    between = float(np.sum(w * (d - mean) ** 2) / np.sum(w)) if d.size > 1 else 0.0
    se = float(np.sqrt(1 / np.sum(w) + between / d.size))
    if abs(mean) < max(SURE * se, LEAST * logs[0].sample_time) or mean <= 0:
        return None
    return Lateness(speed.name, mean, se, before**0.5, after**0.5)
