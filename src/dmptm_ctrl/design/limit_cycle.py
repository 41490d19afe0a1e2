"""Limit cycles of the speed loop by harmonic balance on the kernels of mesh and friction.

Both chains move alike (no preload, equal gaps, same voltage), so the drive is pinion and ring
gear with one mesh law. Per harmonic k of an unknown frequency, with the sampled PI exactly:

    ring      jkω J_L V = 2 N2 T − F_L
    pinions   jkω J̄3 W = N1 K_d K_M U − T − F_3,   W = jkω Z + N2 V,   U = −C(e^{jkωdt}) H(jkω) V

Z, V, W are harmonics of z, of the ring's and the pinions' speed; T, F_L, F_3 those of the
kernels' torques along them (alternating frequency and time). The mean speed is zero, the
integral holds whatever mean voltage that takes. Start: the describing functions, k = 1.
Friction is taken as sliding throughout: a body that rests for long is beyond this.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import root

from dmptm_ctrl.effects.backlash import Backlash, mesh_torque
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites

POINTS = 1024  # of a period
HARMONICS = 15
DEPTHS = np.geomspace(1.005, 6.0, 60)  # amplitudes of z tried first, in half-gaps
HZ = np.geomspace(3.0, 240.0, 160)
SAME = 0.03  # relative difference in frequency below which two answers are one
BALANCED = 5e-3  # of the mesh torque, what may be left; landings fall between the points


class LimitCycle(NamedTuple):
    """A periodic solution; whether it attracts, a simulation tells.

    Attributes
    ----------
    hz : float
    amplitude : float [rad/s]
        Of the ring-gear speed, √2 times its rms.
    twist : float [rad]
        Half the peak-to-peak of z.
    start_hz : float
        What the describing functions alone say.
    """

    hz: float
    amplitude: float
    twist: float
    start_hz: float


@njit
def _torques(z, z_rate, ring, pinion, mesh, bearing, reducer, out):  # type: ignore[no-untyped-def]
    """Torques of mesh, ring and pinion along a period, rows of `out` (3, n)."""
    for i in range(z.size):
        out[0, i] = mesh_torque(z[i], z_rate[i], mesh)
        way = 1.0 if ring[i] >= 0.0 else -1.0
        out[1, i] = way * sliding_torque(ring[i], way, bearing)
        way = 1.0 if pinion[i] >= 0.0 else -1.0
        out[2, i] = way * sliding_torque(pinion[i], way, reducer)


@njit
def _along(z, z_rate, law):  # type: ignore[no-untyped-def]
    """Torque of a mesh along a motion."""
    torque = np.empty_like(z)
    for i in range(z.size):
        torque[i] = mesh_torque(z[i], z_rate[i], law)
    return torque


def mesh_describing_function(law: Backlash, amplitude: float, omega: float) -> complex:
    """First harmonic of the mesh torque over z = amplitude · sin ωt [N·m/rad]."""
    angle = 2.0 * np.pi * (np.arange(POINTS) + 0.5) / POINTS
    torque = _along(amplitude * np.sin(angle), amplitude * omega * np.cos(angle), law)
    return complex(2j * np.mean(torque * np.exp(-1j * angle)) / amplitude)


class _Balance:
    """The equations above for one drive and PI."""

    def __init__(self, model: Model, kp: float, ki: float, sample_time: float) -> None:
        sites = Sites(model)
        if abs(model.drive["gap_l"] - model.drive["gap_r"]) > 1e-9:
            raise ValueError("the two half-gaps differ; the chains then do not move alike")
        _, _, self.mesh = sites.mesh(0.0, 0.0, 0.0, 0.0, 0)
        self.reducer, self.bearing = Stribeck(*sites.laws[0]), Stribeck(*sites.laws[RING])
        self.n2, self.volt = sites.n2, sites.n1 * sites.gain
        self.pinion = sites.pinion_inertia + sites.motor_inertia
        self.ring = sites.ring_inertia
        self.kp, self.ki, self.dt = kp, ki, sample_time

    def controller(self, s: complex) -> complex:
        """Voltage over ring-gear speed at s = jkω, with the hold."""
        shift = np.exp(s * self.dt)
        hold = (1.0 - 1.0 / shift) / (s * self.dt)
        return -complex((self.kp + self.ki * self.dt * shift / (shift - 1.0)) * hold)

    def first(self, depth: float, hz: float) -> tuple[complex, complex]:
        """Left-over torque of the pinion by describing functions [N·m], and V [rad/s]."""
        omega = 2.0 * np.pi * hz
        z = depth * self.mesh.half_gap
        torque = mesh_describing_function(self.mesh, z, omega) * z
        level = 4.0 / np.pi * 0.5 * (self.bearing.coulomb_plus + self.bearing.coulomb_minus)
        viscous = 0.5 * (self.bearing.viscous_plus + self.bearing.viscous_minus)
        push = 2.0 * self.n2 * torque
        a, b = viscous**2 + (omega * self.ring) ** 2, viscous * level
        if abs(push) <= level:
            return complex(np.inf), 0j
        size = (-b + np.sqrt(b * b - a * (level**2 - abs(push) ** 2))) / a
        dry = level / size if level > 0.0 else 0.0
        ring = push / (viscous + dry + 1j * omega * self.ring)
        speed = 1j * omega * z + self.n2 * ring
        rub = 4.0 / np.pi * 0.5 * (self.reducer.coulomb_plus + self.reducer.coulomb_minus)
        rub = rub / abs(speed) + 0.5 * (self.reducer.viscous_plus + self.reducer.viscous_minus)
        left = self.volt * self.controller(1j * omega) * ring - torque
        return left - (rub + 1j * omega * self.pinion) * speed, ring

    def unpack(self, x: Floats, n: int) -> tuple[Floats, Floats, float, float]:
        """Harmonics of z and of the ring's speed, frequency [rad/s], mean voltage."""
        z, v = np.zeros(n + 1, complex), np.zeros(n + 1, complex)
        z[0], z[1] = x[0], x[1]
        z[2:] = x[2 : n + 1] + 1j * x[n + 1 : 2 * n]
        v[1:] = x[2 * n : 3 * n] + 1j * x[3 * n : 4 * n]
        return z * self.mesh.half_gap, v, float(np.exp(x[4 * n])), float(x[4 * n + 1])

    def waves(self, x: Floats, n: int) -> tuple[Floats, Floats, Floats, Floats]:
        """z, its rate, speeds of ring and pinion over one period."""
        z, v, omega, _ = self.unpack(x, n)
        turn = np.exp(2j * np.pi * np.outer(np.arange(n + 1), np.arange(POINTS)) / POINTS)
        rate = 1j * omega * np.arange(n + 1) * z
        series = [np.real(part @ turn) for part in (z, rate, v)]
        return series[0], series[1], series[2], series[1] + self.n2 * series[2]

    def residual(self, x: Floats, n: int) -> Floats:
        """Left-over torques of ring and pinion, all harmonics, over a usual torque."""
        z, v, omega, mean = self.unpack(x, n)
        out = np.empty((3, POINTS))
        _torques(*self.waves(x, n), self.mesh, self.bearing, self.reducer, out)
        mesh, held, rub = np.fft.rfft(out)[:, : n + 1] / POINTS * np.where(np.arange(n + 1), 2, 1)
        s = 1j * omega * np.arange(n + 1)
        volts = np.array([mean, *(self.controller(k) for k in s[1:])], complex)
        volts[1:] *= v[1:]
        ring = self.ring * s * v + held - 2.0 * self.n2 * mesh
        pinion = self.pinion * s * (s * z + self.n2 * v) + mesh + rub - self.volt * volts
        parts = [ring.real / self.n2, ring.imag[1:] / self.n2, pinion.real, pinion.imag[1:]]
        return np.concatenate(parts) / (self.mesh.stiffness * self.mesh.half_gap)


def limit_cycles(
    model: Model,
    kp: float,
    ki: float,
    *,
    sample_time: float = 1e-3,
    harmonics: int = HARMONICS,
) -> list[LimitCycle]:
    """Return the limit cycles about rest that harmonic balance finds, largest first.

    Parameters
    ----------
    model : Model
        With equal half-gaps and without dead times or lags.
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    sample_time : float [s]
    harmonics : int

    Raises
    ------
    ValueError
        Half-gaps that differ.
    """
    balance = _Balance(model, kp, ki, sample_time)
    left = np.array([[balance.first(d, hz)[0] for hz in HZ] for d in DEPTHS])
    found: list[LimitCycle] = []
    for i, j in _crossings(left):
        start = root(_pair, [np.log(DEPTHS[i]), np.log(HZ[j])], args=(balance,))
        depth, hz = np.exp(start.x)
        value, ring = balance.first(depth, hz)
        if not np.isfinite(value) or depth < 1.0 or not HZ[0] < hz < 1.2 * HZ[-1]:
            continue
        cycle = _refined(balance, depth, hz, ring, harmonics)
        if cycle is not None and all(abs(cycle.hz / c.hz - 1.0) > SAME for c in found):
            found.append(cycle)
    return sorted(found, key=lambda c: -c.amplitude)


def _pair(x: Floats, balance: _Balance) -> Floats:
    value, _ = balance.first(float(np.exp(x[0])), float(np.exp(x[1])))
    if not np.isfinite(value):
        return np.array([1e3, 1e3])
    return np.array([value.real, value.imag])


def _crossings(left: Floats) -> list[tuple[int, int]]:
    """Cells of the grid in whose corners both parts of the left-over torque change sign."""
    cells = []
    for i in range(left.shape[0] - 1):
        for j in range(left.shape[1] - 1):
            corner = left[i : i + 2, j : j + 2]
            if np.all(np.isfinite(corner)) and all(
                part.min() < 0.0 < part.max() for part in (corner.real, corner.imag)
            ):
                cells.append((i, j))
    return cells


def _refined(
    balance: _Balance, depth: float, hz: float, ring: complex, harmonics: int
) -> LimitCycle | None:
    """Add harmonics to a solution of the describing functions, a few at a time."""
    x, n = np.array([0.0, depth, ring.real, ring.imag, np.log(2.0 * np.pi * hz), 0.0]), 1
    solved = root(balance.residual, x, args=(1,))
    x = solved.x if solved.success else x
    while n < harmonics:
        more = min(n + 2, harmonics)
        z, v, omega, mean = balance.unpack(x, n)
        z, v = (np.append(part, np.zeros(more - n)) for part in (z / balance.mesh.half_gap, v))
        wide = [z[0].real, z[1].real, *z[2:].real, *z[2:].imag, *v[1:].real, *v[1:].imag]
        n = more
        solved = root(balance.residual, [*wide, np.log(omega), mean], args=(n,), method="hybr")
        x = solved.x
    z, rate, speed, _ = balance.waves(x, n)
    scale = np.abs(_along(z, rate, balance.mesh)).max()
    unit = balance.mesh.stiffness * balance.mesh.half_gap
    if np.abs(balance.residual(x, n)).max() * unit > BALANCED * scale:
        return None
    found_hz = float(np.exp(x[4 * n]) / (2.0 * np.pi))
    return LimitCycle(
        found_hz, float(np.sqrt(2.0) * speed.std()), float(0.5 * np.ptp(z)), float(hz)
    )
