"""Harmonic balance of the speed loop on the kernels of mesh and friction.

Per harmonic k of a frequency ω, with the sampled PI C, its hold H and the loop's delays exactly:

    ring      jkω J_L V = (2/m) N2 Σ T_s − F_L
    pinion s  jkω J̄3 W_s = N1 K_d K_M (U + B_s) − T_s − F_s,   s = 1 … m
              W_s = jkω Z_s + N2 V,   U = −C(e^{jkωdt}) H(jkω) V

V, Z_s, W_s are harmonics of the ring's speed, of z_s and of the pinions' speed under a
setpoint of 0; T_s, F_s, F_L those of the kernels' torques along them (alternating frequency
and time), B_s the preload. The integral holds the mean error at zero with whatever mean voltage
that takes. Where both sides are alike m = 1 stands for both.

Dry friction is set-valued at rest. With p the torque that the other terms ask of it,
F = min(p + r ω, level) (and its mirror image) says both "rests: F = p" and "slides: F = level"
for any r > 0; p is taken from the balance itself (dynamic Lagrangian frequency-time method,
Nacivet et al., J. Sound Vib. 265 (2003) 201).
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import root

from dmptm_ctrl.contract import SITES
from dmptm_ctrl.design.harmonics import Basis, Cycle, block, packed_first, rate_at_begin, widened
from dmptm_ctrl.design.preload import volt_at_pinion
from dmptm_ctrl.drive import pinion_inertia
from dmptm_ctrl.effects.backlash import Backlash, impact_step, mesh_region, region_torque
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque
from dmptm_ctrl.simulate.dual import RING
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts

SAME_GAP = 1e-9  # rad
PRESS = 1e3  # 1/s, r above over the body's inertia; any positive number has the same solutions
TINY = 1e-9  # rad/s, for the slope of friction
STEP = 1e-6  # of the frequency, for the derivative of the controller
LOWEST_HZ = 0.5  # of a search, which would else wander to rest
SHORTEST = 1e-4  # rad, scale of z where there is no gap
STOP = 1e-8  # relative change of unknowns or torques that ends a search
EVALUATIONS = 60
MANY = 20  # harmonics, beyond which only half as many are worth their time
# Delays and lags join the controller; what else an effect does depends on angle or time.
LINEAR_SITES = ("delay", "lag", "sensor_delay")


@njit
def mesh_along(z, z_rate, law, step, out):  # type: ignore[no-untyped-def]
    """Torque of a mesh along a period, its derivatives by z, ż and log ω, rows of `out` (4, n).

    Points are means over `step` seconds: where a flank is reached between two of them the jump
    counts for as long as it has acted. So the torque moves with the impact, not in steps of
    a point, and its derivatives know that an impact moves.
    """
    before = mesh_region(z[-1], z_rate[-1], law)
    for i in range(z.size):
        region = mesh_region(z[i], z_rate[i], law)
        out[0, i] = region_torque(z[i], z_rate[i], region, law)
        out[1, i] = 0.0 if region == 0.0 else law.stiffness
        out[2, i] = law.gap_damping if region == 0.0 else law.damping
        out[3, i] = 0.0
        if region != before and region * z_rate[i] > 0.0:
            age, jump = impact_step(z[i], z_rate[i], law)
            share = age / step
            if 0.0 <= share <= 1.0:
                flight = region * z[i] - law.half_gap
                out[0, i] += (share - 0.5) * jump
                out[1, i] += law.damping / step
                out[2, i] += law.damping * (share - 0.5 - flight / (abs(z_rate[i]) * step))
                out[3, i] = share * jump
        before = region


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
    """The equations above for one drive, PI and preload [V], added left and taken off right.

    ValueError for what depends on angle or time: such effects, a stiffness that varies.
    """

    def __init__(
        self, model: Model, kp: float, ki: float, sample_time: float, preload: float = 0.0
    ) -> None:
        acts = model.sites
        other = [s for s in SITES if s in acts and s not in LINEAR_SITES]
        if other or model.drive["k_a"] != 0.0:
            raise ValueError(
                "harmonic balance knows delays and lags only; the model has effects on "
                + ", ".join(other or ["mesh stiffness"])
            )
        plant, drive = model.plant(), model.drive
        parts = Parts(plant)
        laws = [parts.twist(side, 0.0, 0.0, 0.0, 0.0)[2] for side in range(2)]
        alike = abs(laws[0].half_gap - laws[1].half_gap) < SAME_GAP and preload == 0.0
        self.meshes: list[Backlash] = laws[: 1 if alike else 2]
        self._bias = (preload, -preload)
        self._share = 2.0 / len(self.meshes)  # sides that each of them stands for
        self._reducer, self._bearing = parts.laws[0], parts.laws[RING]
        self._n2, self._volt = drive["N_2"], volt_at_pinion(drive)
        self._pinion, self._ring = pinion_inertia(drive), drive["J_L"]
        self.model, self.kp, self.ki, self.preload = model, kp, ki, preload
        self.sample_time = sample_time
        self._delays = float(plant.input_values[0, 1]), float(plant.sensor_delay[1])
        self._lag = parts.lag(0, 0.0)[1]
        self.length = max(max(law.half_gap for law in self.meshes), SHORTEST)  # scale of z
        self._torque = self.meshes[0].stiffness * self.length  # N·m, scale of what is left over

    @property
    def sides(self) -> int:
        """Chains that differ, 1 or 2."""
        return len(self.meshes)

    def _frequency(self, log_omega: float) -> float:
        """Frequency [rad/s] inside what the sampled loop can separate."""
        low, high = np.log(2.0 * np.pi * LOWEST_HZ), np.log(np.pi / self.sample_time)
        return float(np.exp(min(max(log_omega, low), high)))

    def _forward(self, omega: float, n: int) -> Floats:
        """Matrix from packed error to packed voltage, all but the mean; with the hold."""
        s = 1j * omega * np.arange(1, n + 1)
        shift = np.exp(s * self.sample_time)
        hold = (1.0 - 1.0 / shift) / (s * self.sample_time)
        pi = self.kp + self.ki * self.sample_time * shift / (shift - 1.0)
        late = np.exp(-s * sum(self._delays)) / (1.0 + s * self._lag)
        return block(np.append(0.0, pi * hold * late))

    def equations(self, x: Floats, n: int) -> tuple[Floats, Floats]:
        """Return left-over torques over a usual torque, and their derivatives.

        x: z of each side over `length`, ring speed without its mean, mean voltage, log ω; the
        phase is fixed by the first sine part of the first z.
        """
        size, sides = 2 * n + 1, self.sides
        w = self._frequency(x[-1])
        rates = block(1j * w * np.arange(n + 1))

        def unknown(first: int, count: int, scale: float, skip: int) -> _Dual:
            value, slope = np.zeros(size), np.zeros((size, x.size))
            value[skip : skip + count] = scale * x[first : first + count]
            slope[skip : skip + count, first : first + count] = scale * np.eye(count)
            return _Dual(value, slope)

        def rate_of(part: _Dual) -> _Dual:
            rate = part.times(rates)
            rate.slope[:, -1] += rate.value
            return rate

        ring = unknown(sides * size, 2 * n, 1.0, 1)
        volts = self._volts(ring, w, n) + unknown(sides * size + 2 * n, 1, 1.0, 0)
        ring_rate = rate_of(ring)
        load = ring_rate.times(-self._ring)
        left = []
        for i, law in enumerate(self.meshes):
            z = unknown(i * size, size, self.length, 0)
            rate = rate_of(z)
            mesh = _mesh(z, rate, law, w, n)
            load = load + mesh.times(self._share * self._n2)
            speed = rate + ring.times(self._n2)
            force = volts.times(self._volt) - mesh - rate_of(speed).times(self._pinion)
            force.value[0] += self._volt * self._bias[i]
            left.append(_less_friction(force, speed, self._pinion, self._reducer, n))
        left.append(_less_friction(load, ring, self._ring, self._bearing, n).times(1.0 / self._n2))
        out = np.concatenate([part.value for part in left]) / self._torque
        jacobian = np.vstack([part.slope for part in left]) / self._torque
        phase = np.zeros(x.size)
        phase[n + 1] = 1.0
        return np.append(out, x[n + 1]), np.vstack([jacobian, phase])

    def guess(self, z: complex, omega: float, ring: Floats) -> Cycle:
        """Return a start: each z [rad] at its first harmonic, no mean; `ring` is packed."""
        return Cycle(omega, np.tile(packed_first(z), (self.sides, 1)), ring, 0.0, 1.0)

    def free_ring(self, amplitude: float, omega: float) -> Floats:
        """Return the ring's speed, packed, for z = amplitude · cos ωt and no dry friction."""
        basis, rate = Basis.of(1), 1j * omega * amplitude
        kernel = np.empty((4, basis.points))
        wave = (basis.wave(packed_first(part)) for part in (amplitude, rate))
        mesh_along(*wave, self.meshes[0], basis.step(omega), kernel)
        _, cosine, sine = basis.analyse(kernel[0])
        viscous = 0.5 * (self._bearing.viscous_plus + self._bearing.viscous_minus)
        push = 2.0 * self._n2 * (cosine + 1j * sine)
        return packed_first(push / (viscous + 1j * omega * self._ring))

    def _volts(self, ring: _Dual, w: float, n: int) -> _Dual:
        """Voltage but for its mean."""
        loop = self._forward(w, n)
        volts = ring.times(-loop)
        more = self._forward(w * (1.0 + STEP), n) - loop
        volts.slope[:, -1] -= more @ ring.value / STEP
        return volts

    def state(self, cycle: Cycle) -> tuple[Floats, float]:
        """Return where a motion is at the begin of its period, for the simulator.

        Angles [rad] and speeds [rad/s] of pinions and ring gear, whose angle is 0, (6,); and what
        the integral holds before the first sample [V]; no dead time or lag is remembered.
        """
        n, dt = cycle.ring.size // 2, self.sample_time
        z = np.broadcast_to(cycle.z[:, : n + 1].sum(axis=1), 2)
        rates = np.broadcast_to([rate_at_begin(part, cycle.omega) for part in cycle.z], 2)
        speed = cycle.ring[: n + 1].sum()
        shift = np.exp(1j * cycle.omega * dt * np.arange(1, n + 1))
        harmonics = cycle.ring[1 : n + 1] + 1j * cycle.ring[n + 1 :]
        summed = float(-dt * (harmonics / (shift - 1.0)).real.sum())  # of the errors before
        state = np.array([*z, 0.0, *(rates + self._n2 * speed), speed])
        return state, float(cycle.volts + self.ki * summed)

    def solve(self, start: Cycle, n: int) -> Cycle:
        """Solve with n harmonics from a start, which may have fewer."""
        z = np.array([widened(part, n) for part in start.z])
        rest = start.volts, np.log(start.omega)
        x = np.concatenate([(z / self.length).ravel(), widened(start.ring, n)[1:], rest])
        most = EVALUATIONS if n <= MANY else EVALUATIONS // 2
        limits = {"maxiter": most, "ftol": STOP, "xtol": STOP, "gtol": STOP}
        options = {**limits, "diag": np.ones(x.size)}
        found = root(self.equations, x, (n,), "lm", jac=True, options=options)
        size, m = 2 * n + 1, self.sides
        z = found.x[: m * size].reshape(m, size) * self.length
        ring = np.append(0.0, found.x[m * size : m * size + 2 * n])
        w = self._frequency(found.x[-1])
        left = float(np.abs(found.fun).max()) * self._torque / self._largest(z, w, n)
        moved = _newton(self.equations(found.x, n)[1], found.fun)
        there = slice(m * size, m * size + 2 * n)
        size_there = max(float(np.linalg.norm(found.x[there])), TINY)
        doubt = float(np.linalg.norm(moved[there])) / size_there
        doubt = max(doubt, abs(float(moved[-1])))
        return Cycle(w, z, ring, float(found.x[m * size + 2 * n]), left, doubt)

    def _largest(self, z: Floats, w: float, n: int) -> float:
        """Largest torque of a mesh [N·m]."""
        basis, rates = Basis.of(n), block(1j * w * np.arange(n + 1))
        kernel, largest = np.empty((4, basis.points)), 1e-12
        for part, law in zip(z, self.meshes, strict=True):
            mesh_along(basis.wave(part), basis.wave(rates @ part), law, basis.step(w), kernel)
            largest = max(largest, float(np.abs(kernel[0]).max()))
        return largest


def _mesh(z: _Dual, rate: _Dual, law: Backlash, w: float, n: int) -> _Dual:
    """Torque of a mesh."""
    basis = Basis.of(n)
    kernel = np.empty((4, basis.points))
    mesh_along(basis.wave(z.value), basis.wave(rate.value), law, basis.step(w), kernel)
    slope = basis.through(kernel[1]) @ z.slope + basis.through(kernel[2]) @ rate.slope
    slope[:, -1] += basis.analyse(kernel[3])
    return _Dual(basis.analyse(kernel[0]), slope)


def _less_friction(force: _Dual, speed: _Dual, inertia: float, law: Stribeck, n: int) -> _Dual:
    """Force on a body less its friction."""
    basis = Basis.of(n)
    kernel = np.empty((3, basis.points))
    wave = basis.wave(force.value), basis.wave(speed.value)
    friction_along(*wave, PRESS * inertia, law, kernel)
    slope = basis.through(kernel[1]) @ force.slope + basis.through(kernel[2]) @ speed.slope
    return force - _Dual(basis.analyse(kernel[0]), slope)


def _newton(jacobian: Floats, left: Floats) -> Floats:
    """Step that would take away what is left; infinite where the equations have none."""
    try:
        return np.asarray(np.linalg.solve(jacobian, left), float)
    except np.linalg.LinAlgError:
        return np.full(left.size, np.inf)
