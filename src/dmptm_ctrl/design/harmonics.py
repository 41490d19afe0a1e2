"""Periodic motions as packed harmonics: mean, cosine and minus-sine coefficients."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.simulate.model import Floats

POINTS = 1024  # of a period, at least
PER_HARMONIC = 64  # points of the highest harmonic


class Basis:
    """Packed harmonics to samples of one period and back."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.points = max(POINTS, 1 << (PER_HARMONIC * n - 1).bit_length())
        k = np.arange(1, n + 1)
        self._less, self._more = np.subtract.outer(k, k), np.add.outer(k, k)

    @staticmethod
    @cache
    def of(n: int) -> "Basis":
        """Return it, made once per number of harmonics."""
        return Basis(n)

    def step(self, omega: float) -> float:
        """Return the time between two points [s]."""
        return 2.0 * np.pi / (omega * self.points)

    def wave(self, packed: Floats) -> Floats:
        """Return the samples of a period."""
        n, spectrum = self.n, np.zeros(self.points // 2 + 1, complex)
        spectrum[0] = packed[0]
        spectrum[1 : n + 1] = 0.5 * (packed[1 : n + 1] + 1j * packed[n + 1 :])
        return np.asarray(np.fft.irfft(spectrum * self.points, self.points), float)

    def analyse(self, wave: Floats) -> Floats:
        """Return the packed harmonics of samples."""
        spectrum = np.fft.rfft(wave)[: self.n + 1] / self.points
        above = 2.0 * spectrum[1:]
        return np.concatenate([spectrum[:1].real, above.real, above.imag])

    def through(self, slope: Floats) -> Floats:
        """Matrix from packed input to packed output of a slope that varies along the period."""
        n, spectrum = self.n, np.fft.fft(slope) / self.points
        # a cosine and a minus-sine part of order l, at the orders k: the sums and differences
        same, other = spectrum[self._less], spectrum[self._more]
        even, odd = same + other, 1j * (same - other)
        ahead = spectrum[1 : n + 1]
        out = np.empty((2 * n + 1, 2 * n + 1))
        out[0, 0] = spectrum[0].real
        out[0, 1 : n + 1], out[0, n + 1 :] = ahead.real, ahead.imag
        out[1 : n + 1, 0], out[n + 1 :, 0] = 2.0 * ahead.real, 2.0 * ahead.imag
        out[1 : n + 1, 1 : n + 1], out[1 : n + 1, n + 1 :] = even.real, odd.real
        out[n + 1 :, 1 : n + 1], out[n + 1 :, n + 1 :] = even.imag, odd.imag
        return out


class Cycle(NamedTuple):
    """A periodic motion in packed harmonics: mean, cosine and minus-sine coefficients.

    Near a fold, where a cycle that attracts meets one that repels, little left over is much doubt.
    """

    omega: float  # rad/s
    z: Floats  # (m, 2n + 1) [rad]
    ring: Floats  # (2n + 1,) [rad/s]
    volts: float  # mean of the controller's output
    left: float  # largest torque left over, over the largest torque of a mesh
    doubt: float = np.inf  # share by which a Newton step would still move frequency or speed

    @property
    def speed(self) -> Floats:
        """Ring-gear speed along a period [rad/s]."""
        return Basis.of(self.ring.size // 2).wave(self.ring)

    @property
    def twist(self) -> float:
        """Half the peak-to-peak of z, the largest of the sides [rad]."""
        waves = [Basis.of(part.size // 2).wave(part) for part in self.z]
        return float(max(0.5 * np.ptp(wave) for wave in waves))


def block(factors: Any) -> Floats:
    """Multiplication of packed harmonics by a complex number each (of the mean its real part)."""
    factors = np.asarray(factors, complex)
    n = factors.size - 1
    real, imag = np.diag(factors.real[1:]), np.diag(factors.imag[1:])
    out = np.zeros((2 * n + 1, 2 * n + 1))
    out[0, 0] = factors[0].real
    out[1 : n + 1, 1 : n + 1], out[1 : n + 1, n + 1 :] = real, -imag
    out[n + 1 :, 1 : n + 1], out[n + 1 :, n + 1 :] = imag, real
    return out


def packed_first(first: complex) -> Floats:
    """Packed first harmonic."""
    return np.array([0.0, complex(first).real, complex(first).imag])


def rate_at_begin(packed: Floats, omega: float) -> float:
    """Rate of packed harmonics at the begin of the period."""
    n = packed.size // 2
    return float(-omega * np.sum(np.arange(1, n + 1) * packed[n + 1 :]))


def shifted(cycle: Cycle) -> Cycle:
    """Return a motion that begins where the first sine part of the first z is 0."""
    n = cycle.ring.size // 2
    back = np.angle(cycle.z[0, 1] + 1j * cycle.z[0, n + 1])
    turn = block(np.exp(-1j * back * np.arange(n + 1)))
    return cycle._replace(z=cycle.z @ turn.T, ring=turn @ cycle.ring)


def widened(packed: Floats, n: int) -> Floats:
    """Packed harmonics with zeros for the missing ones, or without those beyond n."""
    old = (packed.size - 1) // 2
    kept = min(old, n)
    out = np.zeros(2 * n + 1)
    out[: kept + 1] = packed[: kept + 1]
    out[n + 1 : n + 1 + kept] = packed[old + 1 : old + 1 + kept]
    return out
