"""The kernels of a model chained by site, in plain Python: for the blocks and the reference.

The same chains as :mod:`~dmptm_ctrl.simulate.compose` writes for the compiled loop, in the
same order, over the kernels' uncompiled functions.
"""

from collections.abc import Callable
from math import cos
from typing import Any

from dmptm_ctrl.contract import SITES
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects import backlash as mesh_kernels
from dmptm_ctrl.effects import presliding as bristle_kernels
from dmptm_ctrl.effects import stribeck as friction_kernels
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.effects.stribeck import stribeck_law
from dmptm_ctrl.simulate.compose import layout
from dmptm_ctrl.simulate.model import BASE, Model

RING = 2  # `body` of the ring gear; 0 and 1 are the reducers


def uncompiled(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the plain Python function of a numba kernel."""
    return getattr(kernel, "py_func", kernel)


region_torque = uncompiled(mesh_kernels.region_torque)
mesh_region = mesh_kernels.mesh_region
mesh_torque = mesh_kernels.mesh_torque
_breakaway = uncompiled(friction_kernels.breakaway_torque)
_sliding = uncompiled(friction_kernels.sliding_torque)
_viscous = uncompiled(friction_kernels.viscous_torque)
_bristle_lag = uncompiled(bristle_kernels.bristle_lag)
_build_up_distance = uncompiled(bristle_kernels.build_up_distance)
_fading = uncompiled(bristle_kernels.fading)


class Sites:
    """What the kernels say about a model: voltages, torques and readings at each site."""

    def __init__(self, model: Model) -> None:
        base, on, values = model.arrays()
        drive = dict(zip(BASE, (float(x) for x in base), strict=True))
        self.n1, self.n2 = drive["N_1"], drive["N_2"]
        self.gain = drive["K_d"] * drive["K_M"]  # N·m/V at the motor
        self.pinion_inertia, self.ring_inertia = drive["J_2"], drive["J_L"]
        self.motor_inertia = self.n1**2 * drive["J_m"]  # seen at the pinion
        self._drive = drive
        self._gaps = drive["gap_l"], drive["gap_r"]
        first = BASE.index("T3s_plus")
        reducer = stribeck_law(*(float(x) for x in base[first : first + 9]))
        self.laws = reducer, reducer, stribeck_law(*(float(x) for x in base[first + 9 :]))
        self._chains: dict[str, list[tuple[Callable[..., Any], Any]]] = {s: [] for s in SITES}
        for name, (index, slot) in layout().items():
            effect = CATALOGUE[name]
            if on[index]:
                numbers = (float(x) for x in values[slot : slot + len(effect.parameters)])
                pair = uncompiled(effect.kernel), effect.values(*numbers)
                self._chains[effect.site].append(pair)
        self.voltage_delay = sum(kernel(0, p) for kernel, p in self._chains["delay"])  # s
        self.speed_delay = sum(kernel(p) for kernel, p in self._chains["sensor_delay"])  # s
        self.lag = max((k(0.0, 0, p)[1] for k, p in self._chains["lag"]), default=0.0)  # s
        self.compliance, self.shaft_damping = 0.0, 0.0
        reduced = (
            self.motor_inertia * self.pinion_inertia / (self.motor_inertia + self.pinion_inertia)
        )
        for kernel, p in self._chains["shaft"]:
            self.compliance, self.shaft_damping = kernel(reduced, p)
        bristles = [
            [kernel(body, p) for kernel, p in self._chains["presliding"]] for body in range(3)
        ]
        self.distances = tuple(sum(law[0] for law in laws) for laws in bristles)
        self._at_once = [max((law[1] for law in laws), default=0.0) for laws in bristles]
        self._dampings = [max((law[2] for law in laws), default=0.0) for laws in bristles]
        self.renewals = tuple(self.aged_friction(body, 0.0)[1] for body in range(3))

    def has(self, site: str) -> bool:
        """Whether an effect acts at `site`."""
        return bool(self._chains[site])

    def drive_voltage(self, u: float, t: float, side: int) -> float:
        """Voltage after the drive's effects [V]."""
        for kernel, p in self._chains["drive"]:
            u = kernel(u, t, side, p)
        return u

    def lag_rate(self, state: float, u: float, side: int) -> float:
        """Rate of the lagged voltage [V/s]."""
        tau = 0.0
        for kernel, p in self._chains["lag"]:
            u, tau = kernel(u, side, p)
        return (u - state) / tau

    def motor_torque(self, voltage: float, theta_m: float, omega_m: float, t: float, side: int):
        """Torque on the motor's shaft, seen at the pinion [N·m]."""
        torque = self.gain * voltage
        for kernel, p in self._chains["motor"]:
            torque += kernel(voltage, theta_m, omega_m, t, side, p)
        return self.n1 * torque

    def mesh(self, theta_p: float, omega_p: float, theta_L: float, omega_L: float, side: int):
        """Relative angle z [rad], its rate [rad/s] and the :class:`Backlash` of the mesh."""
        drive = self._drive
        z, z_rate = theta_p - self.n2 * theta_L, omega_p - self.n2 * omega_L
        gap, stiffness = self._gaps[side], drive["k_m"]
        for kernel, p in self._chains["mesh"]:
            shift = kernel(theta_p, omega_p, theta_L, omega_L, side, p)
            z, z_rate = z + shift[0], z_rate + shift[1]
            gap, stiffness = gap + shift[2], stiffness + shift[3]
        if drive["k_a"] != 0.0:  # Eq. 23 with the mesh angle as phase
            stiffness += drive["k_a"] * cos(drive["z_3"] * theta_p + drive["phi_r"])
        return z, z_rate, Backlash(stiffness, drive["c"], drive["c_f"], max(gap, 0.0))

    def mesh_torque(
        self, theta_p: float, omega_p: float, theta_L: float, omega_L: float, side: int
    ):
        """Torque of the mesh [N·m], positive drives the ring gear."""
        return mesh_torque(*self.mesh(theta_p, omega_p, theta_L, omega_L, side))

    def aged_friction(self, body: int, age: float) -> tuple[float, float]:
        """Coulomb torque added [N·m] at the age of a contact, slip that makes it new [rad]."""
        added, slip = 0.0, 0.0
        for kernel, p in self._chains["ageing"]:
            torque, distance = kernel(age, body, p)
            added, slip = added + torque, max(slip, distance)
        return added, slip

    def ageing(self, body: int, omega: float, age: float) -> float:
        """Rate of the age of a contact [s/s]."""
        return 1.0 - abs(omega) * age / self.renewals[body]

    def _friction(self, body: int, theta: float, omega: float, t: float, mesh: float, age: float):
        scale, added = 1.0, self.aged_friction(body, age)[0]
        for kernel, p in self._chains["friction"]:
            factor, coulomb = kernel(theta, omega, t, mesh, body, p)
            scale, added = scale * factor, added + coulomb
        return scale, added

    def holding(
        self,
        body: int,
        direction: float,
        theta: float,
        omega: float,
        t: float,
        mesh: float,
        age: float = 0.0,
    ):
        """Largest friction at rest against motion in `direction` [N·m]."""
        scale, added = self._friction(body, theta, omega, t, mesh, age)
        return max(scale * _breakaway(direction, self.laws[body]) + added, 0.0)

    def sliding(
        self,
        body: int,
        direction: float,
        theta: float,
        omega: float,
        t: float,
        mesh: float,
        age: float = 0.0,
    ):
        """Magnitude of friction in motion [N·m]."""
        scale, added = self._friction(body, theta, omega, t, mesh, age)
        return max(scale * _sliding(omega, direction, self.laws[body]) + added, 0.0)

    def at_once(
        self, body: int, direction: float, theta: float, omega: float, t: float, *mesh_age: float
    ) -> float:
        """Part of `sliding` that presliding does not hold back [N·m], a magnitude."""
        if self._at_once[body] == 0.0:
            return 0.0
        mesh, age = (*mesh_age, 0.0)[:2]
        scale, _ = self._friction(body, theta, omega, t, mesh, age)
        return self._at_once[body] * scale * _viscous(omega, direction, self.laws[body])

    def build_up(self, body: int, omega: float, level: float, friction: float) -> float:
        """Rate [N·m/s] of presliding torque `friction` towards `level`, both signed."""
        distance = _build_up_distance(self.distances[body], level, self.laws[body])
        return abs(omega) * (level - friction) / distance

    def bristle_damping(
        self, body: int, direction: float, omega: float, inertia: float, rate: float
    ) -> float:
        """Friction [N·m] of bristles whose torque changes at `rate` [N·m/s]."""
        if self._dampings[body] == 0.0:
            return 0.0
        law = self.laws[body]
        lag = _bristle_lag(self.distances[body], self._dampings[body], inertia, law)
        return lag * _fading(omega, direction, law) * rate

    def load_torque(self, theta_L: float, omega_L: float, t: float) -> float:
        """Torque of the load's effects on the ring gear [N·m]."""
        torque = 0.0
        for kernel, p in self._chains["load"]:
            torque += kernel(theta_L, omega_L, t, p)
        return torque

    def reading(self, theta_L: float, omega_L: float, t: float) -> tuple[float, float]:
        """What the sensors read: ring-gear angle [rad] and speed [rad/s]."""
        for kernel, p in self._chains["sensor"]:
            theta_L, omega_L = kernel(theta_L, omega_L, t, p)
        return theta_L, omega_L
