"""Harmonic balance of the speed loop on the kernels of mesh and friction.

Per harmonic k of a frequency ω, with the sampled PI C, its hold H and the loop's delays exactly:

    ring      jkω J_L V = (2/m) N2 Σ T_s − F_L
    pinion s  jkω J̄3 W_s = N1 K_d K_M (U + B_s) − T_s − F_s,   s = 1 … m
              W_s = jkω Z_s + N2 V,   U = C(e^{jkωdt}) H(jkω) (R − V)

V, Z_s, W_s, R are harmonics of the ring's speed, of z_s, of the pinions' speed and of the
setpoint; T_s, F_s, F_L those of the kernels' torques along them (alternating frequency and
time), B_s the preload. The integral holds the mean error at zero with whatever mean voltage
that takes. Where both chains are alike m = 1 stands for both.

Dry friction is set-valued at rest. With p the torque that the other terms ask of it,
F = min(p + r ω, level) (and its mirror image) says both "rests: F = p" and "slides: F = level"
for any r > 0; p is taken from the balance itself (dynamic Lagrangian frequency-time method,
Nacivet et al., J. Sound Vib. 265 (2003) 201).
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from dmptm_ctrl.contract import SITES
from dmptm_ctrl.effects.backlash import Backlash, mesh_region, region_torque
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites

POINTS = 4096  # of a period
SAME_GAP = 1e-9  # rad
PRESS = 100.0  # 1/s, r above over the body's inertia; any positive number has the same solutions
TINY = 1e-9  # rad/s, for the slope of friction
STEP = 1e-6  # of the frequency, for the derivative of the controller
LOWEST_HZ = 0.5  # of a search, which would else wander to rest
SHORTEST = 1e-4  # rad, scale of z where there is no gap
EVALUATIONS = 80
# Delays and lags join the controller; what else an effect does depends on angle or time.
LINEAR_SITES = ("delay", "lag", "sensor_delay")


@njit
def mesh_along(z, z_rate, law, out):  # type: ignore[no-untyped-def]
    """Torque of a mesh along a motion and its derivatives by z and ż, rows of `out` (3, n)."""
    for i in range(z.size):
        region = mesh_region(z[i], z_rate[i], law)
        out[0, i] = region_torque(z[i], z_rate[i], region, law)
        out[1, i] = 0.0 if region == 0.0 else law.stiffness
        out[2, i] = law.gap_damping if region == 0.0 else law.damping


@njit
def friction_along(asked, speed, press, law, out):  # type: ignore[no-untyped-def]
    """Friction along a motion, its derivatives by `asked` and speed, rows of `out` (3, n)."""
    for i in range(speed.size):
        wanted = asked[i] + press * speed[i]
        way = 1.0 if wanted >= 0.0 else -1.0
        level = sliding_torque(speed[i], way, law)
        if way * wanted <= level:
            out[0, i], out[1, i], out[2, i] = wanted, 1.0, press
        else:
            change = sliding_torque(speed[i] + TINY, way, law) - level
            out[0, i], out[1, i], out[2, i] = way * level, 0.0, way * change / TINY


class Cycle(NamedTuple):
    """A periodic motion in packed harmonics: mean, cosine and minus-sine coefficients.

    Attributes
    ----------
    omega : float [rad/s]
    z : (m, 2n + 1) array [rad]
    ring : (2n + 1,) array [rad/s]
    volts : float [V]
        Mean of the controller's output.
    left : float
        Largest torque left over, over the largest torque of a mesh.
    """

    omega: float
    z: Floats
    ring: Floats
    volts: float
    left: float

    @property
    def speed(self) -> Floats:
        """Ring-gear speed along a period [rad/s]."""
        return Basis.of(self.ring.size // 2).wave(self.ring)

    @property
    def twist(self) -> float:
        """Half the peak-to-peak of z, the largest of the chains [rad]."""
        waves = [Basis.of(part.size // 2).wave(part) for part in self.z]
        return float(max(0.5 * np.ptp(wave) for wave in waves))


class _Dual(NamedTuple):
    """Packed harmonics and their derivatives by the unknowns."""

    value: Floats
    slope: Floats

    def __add__(self, other: "_Dual") -> "_Dual":  # type: ignore[override]
        return _Dual(self.value + other.value, self.slope + other.slope)

    def __sub__(self, other: "_Dual") -> "_Dual":
        return _Dual(self.value - other.value, self.slope - other.slope)

    def times(self, factor: Any) -> "_Dual":
        """Multiply by a number or a matrix."""
        by = np.multiply if np.isscalar(factor) else np.matmul
        return _Dual(by(factor, self.value), by(factor, self.slope))


class Balance:
    """The equations above for one drive, PI and preload.

    Parameters
    ----------
    model : Model
        Effects other than delays and lags are refused.
    kp, ki : float [V/(rad/s)], [V/rad]
    sample_time : float [s]
    preload : float [V]
        Added left, taken off right.

    Raises
    ------
    ValueError
        What depends on angle or time: such effects, a stiffness that varies.
    """

    def __init__(
        self, model: Model, kp: float, ki: float, sample_time: float, preload: float = 0.0
    ) -> None:
        sites = Sites(model)
        other = [s for s in SITES if sites.has(s) and s not in LINEAR_SITES]
        if other or model.drive["k_a"] != 0.0:
            raise ValueError(
                "harmonic balance knows delays and lags only; the model has effects on "
                + ", ".join(other or ["mesh stiffness"])
            )
        laws = [sites.mesh(0.0, 0.0, 0.0, 0.0, side)[2] for side in range(2)]
        alike = abs(laws[0].half_gap - laws[1].half_gap) < SAME_GAP and preload == 0.0
        self.meshes: list[Backlash] = laws[: 1 if alike else 2]
        self._bias = (preload, -preload)
        self._share = 2.0 / len(self.meshes)  # chains that each of them stands for
        self._reducer, self._bearing = Stribeck(*sites.laws[0]), Stribeck(*sites.laws[RING])
        self._n2, self._volt = sites.n2, sites.n1 * sites.gain
        self._pinion = sites.pinion_inertia + sites.motor_inertia
        self._ring = sites.ring_inertia
        self._kp, self._ki, self._dt = kp, ki, sample_time
        self._delays = sites.voltage_delay, sites.speed_delay
        self._lag = sites.lag
        self.length = max(max(law.half_gap for law in self.meshes), SHORTEST)  # scale of z
        self._torque = self.meshes[0].stiffness * self.length  # N·m, scale of what is left over

    def _frequency(self, log_omega: float) -> float:
        """Frequency [rad/s] inside what the sampled loop can tell apart."""
        low, high = np.log(2.0 * np.pi * LOWEST_HZ), np.log(np.pi / self._dt)
        return float(np.exp(min(max(log_omega, low), high)))

    def _forward(self, omega: float, n: int, delay: float = 0.0) -> Floats:
        """Matrix from packed error to packed voltage, all but the mean; with the hold."""
        s = 1j * omega * np.arange(1, n + 1)
        shift = np.exp(s * self._dt)
        hold = (1.0 - 1.0 / shift) / (s * self._dt)
        pi = self._kp + self._ki * self._dt * shift / (shift - 1.0)
        late = np.exp(-s * (self._delays[0] + delay)) / (1.0 + s * self._lag)
        return _block(np.append(0.0, pi * hold * late))

    def equations(
        self, x: Floats, n: int, omega: float | None, setpoint: Floats
    ) -> tuple[Floats, Floats]:
        """Return left-over torques over a usual torque, and their derivatives.

        Parameters
        ----------
        x : array
            z of each chain over `length`, ring speed without its mean, mean voltage, and, where
            `omega` is None, log ω; the phase is then fixed by the first sine part of the first z.
        n : int
            Harmonics.
        omega : float or None [rad/s]
        setpoint : (2n + 1,) array [rad/s]
        """
        size, chains = 2 * n + 1, len(self.meshes)
        w = self._frequency(x[-1]) if omega is None else omega
        rates = _block(1j * w * np.arange(n + 1))

        def unknown(first: int, count: int, scale: float, skip: int) -> _Dual:
            value, slope = np.zeros(size), np.zeros((size, x.size))
            value[skip : skip + count] = scale * x[first : first + count]
            slope[skip : skip + count, first : first + count] = scale * np.eye(count)
            return _Dual(value, slope)

        def rate_of(part: _Dual) -> _Dual:
            rate = part.times(rates)
            if omega is None:
                rate.slope[:, -1] += rate.value
            return rate

        ring = unknown(chains * size, 2 * n, 1.0, 1)
        ring.value[0] = setpoint[0]
        volts = self._volts(ring, setpoint, w, n, free=omega is None)
        volts = volts + unknown(chains * size + 2 * n, 1, 1.0, 0)
        ring_rate = rate_of(ring)
        load = ring_rate.times(-self._ring)
        left = []
        for i, law in enumerate(self.meshes):
            z = unknown(i * size, size, self.length, 0)
            rate = rate_of(z)
            mesh = _mesh(z, rate, law, n)
            load = load + mesh.times(self._share * self._n2)
            speed = rate + ring.times(self._n2)
            force = volts.times(self._volt) - mesh - rate_of(speed).times(self._pinion)
            force.value[0] += self._volt * self._bias[i]
            left.append(_less_friction(force, speed, self._pinion, self._reducer, n))
        left.append(_less_friction(load, ring, self._ring, self._bearing, n).times(1.0 / self._n2))
        out = np.concatenate([part.value for part in left]) / self._torque
        slopes = np.vstack([part.slope for part in left]) / self._torque
        if omega is None:
            phase = np.zeros(x.size)
            phase[n + 1] = 1.0
            out, slopes = np.append(out, x[n + 1]), np.vstack([slopes, phase])
        return out, slopes

    def guess(self, z: complex, omega: float, ring: Floats) -> Cycle:
        """Return a start: each z at its first harmonic, no mean.

        Parameters
        ----------
        z : complex [rad]
            Cosine and minus-sine part.
        omega : float [rad/s]
        ring : (3,) array [rad/s]
            Speed of the ring gear, packed.
        """
        return Cycle(omega, np.tile(_packed(z), (len(self.meshes), 1)), ring, 0.0, 1.0)

    def free_ring(self, amplitude: float, omega: float) -> Floats:
        """Return the ring's speed, packed, for z = amplitude · cos ωt and no dry friction."""
        kernel, rate = np.empty((3, POINTS)), 1j * omega * amplitude
        wave = (Basis.of(1).wave(_packed(part)) for part in (amplitude, rate))
        mesh_along(*wave, self.meshes[0], kernel)
        _, cosine, sine = Basis.of(1).analyse(kernel[0])
        viscous = 0.5 * (self._bearing.viscous_plus + self._bearing.viscous_minus)
        push = 2.0 * self._n2 * (cosine + 1j * sine)
        return _packed(push / (viscous + 1j * omega * self._ring))

    def _volts(self, ring: _Dual, setpoint: Floats, w: float, n: int, *, free: bool) -> _Dual:
        """Voltage but for its mean."""
        up, down = self._forward(w, n), self._forward(w, n, self._delays[1])
        volts = ring.times(-down)
        volts.value[:] += up @ setpoint
        if free:
            more = w * (1.0 + STEP)
            d_up, d_down = (
                self._forward(more, n) - up,
                self._forward(more, n, self._delays[1]) - down,
            )
            volts.slope[:, -1] += (d_up @ setpoint - d_down @ ring.value) / STEP
        return volts

    def solve(self, start: Cycle, n: int, *, free: bool, setpoint: Floats | None = None) -> Cycle:
        """Solve with n harmonics from a start, which may have fewer.

        Parameters
        ----------
        start : Cycle
        n : int
        free : bool
            Whether the frequency is an unknown; otherwise it is that of `start`.
        setpoint : (2k + 1,) array [rad/s], optional
            Packed.
        """
        given = np.zeros(2 * n + 1) if setpoint is None else widened(setpoint, n)
        z = np.array([widened(part, n) for part in start.z])
        x = np.concatenate([(z / self.length).ravel(), widened(start.ring, n)[1:], [start.volts]])
        omega = None if free else start.omega
        if free:
            x = np.append(x, np.log(start.omega))
        found = least_squares(
            lambda y: self.equations(y, n, omega, given)[0],
            x,
            jac=lambda y: self.equations(y, n, omega, given)[1],
            method="lm",
            max_nfev=EVALUATIONS,
        )
        size, m = 2 * n + 1, len(self.meshes)
        z = found.x[: m * size].reshape(m, size) * self.length
        ring = np.append(given[0], found.x[m * size : m * size + 2 * n])
        w = self._frequency(found.x[-1]) if free else start.omega
        left = float(np.abs(found.fun).max()) * self._torque / self._largest(z, w, n)
        return Cycle(w, z, ring, float(found.x[m * size + 2 * n]), left)

    def _largest(self, z: Floats, w: float, n: int) -> float:
        """Largest torque of a mesh [N·m]."""
        basis, rates = Basis.of(n), _block(1j * w * np.arange(n + 1))
        kernel, largest = np.empty((3, POINTS)), 1e-12
        for part, law in zip(z, self.meshes, strict=True):
            mesh_along(basis.wave(part), basis.wave(rates @ part), law, kernel)
            largest = max(largest, float(np.abs(kernel[0]).max()))
        return largest


def _mesh(z: _Dual, rate: _Dual, law: Backlash, n: int) -> _Dual:
    """Torque of a mesh."""
    basis, kernel = Basis.of(n), np.empty((3, POINTS))
    mesh_along(basis.wave(z.value), basis.wave(rate.value), law, kernel)
    slope = basis.through(kernel[1]) @ z.slope + basis.through(kernel[2]) @ rate.slope
    return _Dual(basis.analyse(kernel[0]), slope)


def _less_friction(force: _Dual, speed: _Dual, inertia: float, law: Stribeck, n: int) -> _Dual:
    """Force on a body less its friction."""
    basis, kernel = Basis.of(n), np.empty((3, POINTS))
    wave = basis.wave(force.value), basis.wave(speed.value)
    friction_along(*wave, PRESS * inertia, law, kernel)
    slope = basis.through(kernel[1]) @ force.slope + basis.through(kernel[2]) @ speed.slope
    return force - _Dual(basis.analyse(kernel[0]), slope)


class Basis:
    """Packed harmonics to samples of one period and back."""

    def __init__(self, n: int) -> None:
        self.n = n
        k = np.arange(1, n + 1)
        # from packed to two-sided complex coefficients −n … n, and back
        self._split = np.zeros((2 * n + 1, 2 * n + 1), complex)
        self._split[n, 0] = 1.0
        self._split[n + k, k], self._split[n + k, n + k] = 0.5, 0.5j
        self._split[n - k, k], self._split[n - k, n + k] = 0.5, -0.5j
        self._join = np.linalg.inv(self._split)
        self._order = np.subtract.outer(np.arange(2 * n + 1), np.arange(2 * n + 1))

    @staticmethod
    @cache
    def of(n: int) -> "Basis":
        """Return it, made once per number of harmonics."""
        return Basis(n)

    def wave(self, packed: Floats) -> Floats:
        """Return the samples of a period."""
        n, spectrum = self.n, np.zeros(POINTS // 2 + 1, complex)
        spectrum[0] = packed[0]
        spectrum[1 : n + 1] = 0.5 * (packed[1 : n + 1] + 1j * packed[n + 1 :])
        return np.asarray(np.fft.irfft(spectrum * POINTS, POINTS), float)

    def analyse(self, wave: Floats) -> Floats:
        """Return the packed harmonics of samples."""
        spectrum = np.fft.rfft(wave)[: self.n + 1] / POINTS
        return np.concatenate(
            [[spectrum[0].real], 2.0 * spectrum[1:].real, 2.0 * spectrum[1:].imag]
        )

    def through(self, slope: Floats) -> Floats:
        """Matrix from packed input to packed output of a slope that varies along the period."""
        spectrum = np.fft.fft(slope) / POINTS
        product = spectrum[self._order]  # convolution; negative orders wrap around
        return np.asarray((self._join @ product @ self._split).real, float)


def _block(factors: Any) -> Floats:
    """Multiplication of packed harmonics by a complex number each (of the mean its real part)."""
    factors = np.asarray(factors, complex)
    n = factors.size - 1
    real, imag = np.diag(factors.real[1:]), np.diag(factors.imag[1:])
    out = np.zeros((2 * n + 1, 2 * n + 1))
    out[0, 0] = factors[0].real
    out[1 : n + 1, 1 : n + 1], out[1 : n + 1, n + 1 :] = real, -imag
    out[n + 1 :, 1 : n + 1], out[n + 1 :, n + 1 :] = imag, real
    return out


def _packed(first: complex) -> Floats:
    """Packed first harmonic."""
    return np.array([0.0, complex(first).real, complex(first).imag])


def widened(packed: Floats, n: int) -> Floats:
    """Packed harmonics with zeros for the missing ones, or without those beyond n."""
    old = (packed.size - 1) // 2
    kept = min(old, n)
    out = np.zeros(2 * n + 1)
    out[: kept + 1] = packed[: kept + 1]
    out[n + 1 : n + 1 + kept] = packed[old + 1 : old + 1 + kept]
    return out
