"""What the kernels say about a dual-motor drive, in plain Python: for its blocks."""

from typing import TYPE_CHECKING

from dmptm_ctrl.effects import presliding
from dmptm_ctrl.effects.backlash import Backlash, mesh_torque
from dmptm_ctrl.simulate.dual import MOTORS, PINIONS, RING, dual_plant
from dmptm_ctrl.simulate.parts import Parts, uncompiled

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

_build_up_distance = uncompiled(presliding.build_up_distance)
_fading = uncompiled(presliding.fading)


class Sites:
    """Voltages, torques and readings of a model, by side 0 or 1, and by body 0, 1 or RING."""

    def __init__(self, model: "Model") -> None:
        plant = dual_plant(model.arrays())
        self.parts, drive = Parts(plant), model.drive
        self.n1, self.n2 = drive["N_1"], drive["N_2"]
        self.gain = drive["K_d"] * drive["K_M"]  # N·m/V at the motor
        self.pinion_inertia, self.ring_inertia = drive["J_2"], drive["J_L"]
        self.motor_inertia = self.n1**2 * drive["J_m"]  # seen at the pinion
        self.voltage_delay = float(plant.input_values[0, 1])  # s
        self.speed_delay = float(plant.sensor_delay[1])  # s
        self.lag = self.parts.lag(0, 0.0)[1]  # s
        self.compliance, self.shaft_damping = 0.0, 0.0  # of the reducers, at the pinion
        if plant.link_gap.size > len(PINIONS):
            _, stiffness, damping = plant.link_values[len(PINIONS), :3].tolist()
            self.compliance, self.shaft_damping = 1.0 / (stiffness * self.n1**2), damping
            self.shaft_damping *= self.n1**2
        bodies = (*PINIONS, RING)
        self.distances = tuple(float(plant.bristles[b, 0]) for b in bodies)
        self.renewals = tuple(self.parts.ageing(b, 0.0)[1] for b in bodies)

    def drive_voltage(self, u: float, t: float, side: int) -> float:
        """Voltage after the drive's effects [V]."""
        return self.parts.signal(side, u, t)

    def lag_rate(self, state: float, u: float, side: int) -> float:
        """Rate of the lagged voltage [V/s]."""
        aim, tau = self.parts.lag(side, u)
        return (aim - state) / tau

    def motor_torque(
        self, voltage: float, theta_m: float, omega_m: float, t: float, side: int
    ) -> float:
        """Torque on the motor's shaft, seen at the pinion [N·m]."""
        own = self.parts.torque(MOTORS[side], voltage, theta_m, omega_m, t)
        return self.n1 * (self.gain * voltage + own)

    def mesh(
        self, theta_p: float, omega_p: float, theta_L: float, omega_L: float, side: int
    ) -> tuple[float, float, Backlash]:
        """Relative angle z [rad], its rate [rad/s] and the :class:`Backlash` of the mesh."""
        z, rate, law = self.parts.twist(side, theta_p, omega_p, theta_L, omega_L)
        return z, rate, law

    def mesh_torque(
        self, theta_p: float, omega_p: float, theta_L: float, omega_L: float, side: int
    ) -> float:
        """Torque of the mesh [N·m], positive drives the ring gear."""
        return float(mesh_torque(*self.mesh(theta_p, omega_p, theta_L, omega_L, side)))

    def ageing(self, body: int, omega: float, age: float) -> float:
        """Rate of the age of a contact [s/s]."""
        return 1.0 - abs(omega) * age / self.renewals[body]

    def holding(
        self, body: int, direction: float, theta: float, t: float, mesh: float, age: float = 0.0
    ) -> float:
        """Largest friction at rest against motion in `direction` [N·m]."""
        return self.parts.holding(body, direction, theta, t, mesh, age)

    def sliding(
        self, body: int, direction: float, theta: float, omega: float, t: float, mesh: float,
        age: float = 0.0,
    ) -> float:  # fmt: skip
        """Magnitude of friction in motion [N·m]."""
        return self.parts.sliding(body, direction, theta, omega, t, mesh, age)[0]

    def at_once(
        self, body: int, direction: float, theta: float, omega: float, t: float, mesh: float,
        age: float = 0.0,
    ) -> float:  # fmt: skip
        """Part of `sliding` that presliding does not hold back [N·m], a magnitude."""
        share = float(self.parts.plant.bristles[body, 1])
        return share * self.parts.sliding(body, direction, theta, omega, t, mesh, age)[1]

    def build_up(self, body: int, omega: float, level: float, friction: float) -> float:
        """Rate [N·m/s] of presliding torque `friction` towards `level`, both signed."""
        distance = _build_up_distance(self.distances[body], level, self.parts.laws[body])
        return abs(omega) * (level - friction) / float(distance)

    def bristle_damping(self, body: int, direction: float, omega: float, rate: float) -> float:
        """Friction [N·m] of bristles whose torque changes at `rate` [N·m/s]."""
        lag = self.parts.bristle(body)[2]
        return lag * float(_fading(omega, direction, self.parts.laws[body])) * rate

    def load_torque(self, theta_L: float, omega_L: float, t: float) -> float:
        """Torque of the load's effects on the ring gear [N·m]."""
        return self.parts.torque(RING, 0.0, theta_L, omega_L, t)

    def reading(self, theta_L: float, omega_L: float, t: float) -> tuple[float, float]:
        """What the sensors read: ring-gear angle [rad] and speed [rad/s]."""
        angle, speed = (self.parts.reading(i, theta_L, omega_L, t) for i in (0, 1))
        return angle, speed


__all__ = ["RING", "Sites"]
