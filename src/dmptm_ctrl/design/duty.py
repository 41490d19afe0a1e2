"""Setpoints that a controller is tuned for and evaluated on."""

from typing import NamedTuple

import numpy as np

from dmptm_ctrl.simulate.model import Floats

DEG = np.pi / 180.0
SETTLING = 0.4  # s, until the pinions have bounced onto their flanks


class Duty(NamedTuple):
    """A setpoint of the ring-gear speed over time."""

    reference: Floats  # (n,) [rad/s]
    sample_time: float = 1e-3  # s
    settling: float = 0.0  # s at the start, not counted: the preload closes the gaps after power-on

    @property
    def time(self) -> Floats:
        """Sample times [s]."""
        return np.asarray(np.arange(self.reference.size) * self.sample_time, float)

    @property
    def acceleration(self) -> Floats:
        """Of the setpoint, backwards [rad/s²]."""
        change = np.diff(self.reference, prepend=self.reference[0])
        return np.asarray(change / self.sample_time, float)


def sine(amplitude: float, hz: float, periods: float, sample_time: float = 1e-3) -> Floats:
    """Return a sine [rad/s] from 0 on."""
    n = round(periods / hz / sample_time)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * hz * np.arange(n) * sample_time), float)


def there_and_back(
    speed: float, acceleration: float, hold: float, sample_time: float = 1e-3
) -> Floats:
    """Return a trapezoid forth, one back, at `speed` [rad/s] for `hold` [s] each."""
    ramp = speed / acceleration
    corners = np.cumsum([0.0, ramp, hold, 2.0 * ramp, hold, ramp])
    time = np.arange(round(corners[-1] / sample_time)) * sample_time
    levels = speed * np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    return np.asarray(np.interp(time, corners, levels), float)


FASTEST = 15 * DEG  # rad/s, of the usual duty


def usual_duty(sample_time: float = 1e-3, speed: float = FASTEST) -> Duty:
    """Return what controllers are tuned for by default, 9 s.

    A rest that does not count, the paper's closed-loop sines (10 deg/s at 0.5 Hz, 15 deg/s at
    1 Hz), a slow trapezoid, a rest and a start of a slow sine. With another `speed` [rad/s or m/s]
    as the largest all are larger or smaller alike.
    """
    parts = (
        np.zeros(round(SETTLING / sample_time)),
        sine(10 * DEG, 0.5, 1.5, sample_time),
        sine(15 * DEG, 1.0, 2.0, sample_time),
        there_and_back(6 * DEG, 30 * DEG, 0.6, sample_time),
        np.zeros(round(0.5 / sample_time)),
        sine(2 * DEG, 1.0, 0.9, sample_time)[: round(0.5 / sample_time)],
    )
    return Duty(speed / FASTEST * np.concatenate(parts), sample_time, SETTLING)
