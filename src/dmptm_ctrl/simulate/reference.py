"""The slow, plain reference: SciPy's DOP853 at tight tolerance, every switch located.

The drive is a hybrid system. Its *mode* says in which region of Eq. 21 each mesh is, and
whether each body sticks (0) or which way it slides (±1). Within a mode the right-hand side
is smooth; after each step the mode is checked along the step's interpolant, and where it
ends the run is cut there, by bisection, and continued in the mode that follows. Every jump
of the held voltage, also a delayed one, is a restart.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853

from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites, mesh_region, region_torque

# Angles of pinions and ring gear, their speeds; motors seen at the pinion, their speeds;
# lagged voltages; presliding torques; ages of the contacts.
STATES = 18
ANGLE, SPEED, MOTOR, MOTOR_SPEED, LAGGED, BRISTLE, AGE = 0, 3, 6, 8, 10, 12, 15
Hold = tuple[float, float, tuple[float, float]]  # start, end [s], voltages [V]
ATOL = 1e-14  # rad, rad/s: 4e-10 N·m in the mesh
EVENT_TIME = 1e-12  # s, to which a switch is located
CHECKS = (0.25, 0.5, 0.75, 1.0)  # of a step, where the mode is checked
MAX_SWITCHES = 1000  # in one hold of the voltage; beyond, the mode chatters


class _Hybrid:
    """Right-hand side of the drive in its current mode, and the rules that change it."""

    def __init__(self, model: Model) -> None:
        self.sites = Sites(model)
        self.region = [0.0, 0.0]
        self.motion = [0.0, 0.0, 0.0]
        self.u = (0.0, 0.0)

    def start(self, x0: Floats) -> Floats:
        y = np.zeros(STATES)
        y[:6] = x0
        y[MOTOR : MOTOR + 2] = x0[:2]
        y[MOTOR_SPEED : MOTOR_SPEED + 2] = x0[3:5]
        return y

    def mesh(self, y, side: int):
        return self.sites.mesh(y[side], y[SPEED + side], y[RING], y[SPEED + RING], side)

    def mesh_torques(self, y) -> tuple[float, float]:
        left, right = self.mesh(y, 0), self.mesh(y, 1)
        return (
            region_torque(left[0], left[1], self.region[0], left[2]),
            region_torque(right[0], right[1], self.region[1], right[2]),
        )

    def net_torques(self, t: float, y) -> tuple[list[float], list[float], list[float]]:
        """Torques on the bodies without friction, of the meshes, and on the motors."""
        sites = self.sites
        meshes = self.mesh_torques(y)
        net, motors = [], []
        for side in (0, 1):
            voltage = y[LAGGED + side] if sites.lag > 0.0 else self.voltage(t, side)
            theta, omega = y[MOTOR + side], y[MOTOR_SPEED + side]
            torque = sites.motor_torque(voltage, sites.n1 * theta, sites.n1 * omega, t, side)
            shaft = torque
            if sites.compliance > 0.0:
                shaft = (theta - y[side]) / sites.compliance
                shaft += sites.shaft_damping * (omega - y[SPEED + side])
            motors.append(torque - shaft)
            net.append(shaft - meshes[side])
        load = sites.load_torque(y[RING], y[SPEED + RING], t)
        net.append(sites.n2 * (meshes[0] + meshes[1]) + load)
        carried = [meshes[0], meshes[1], abs(meshes[0]) + abs(meshes[1])]
        return net, carried, motors

    def voltage(self, t: float, side: int) -> float:
        return self.sites.drive_voltage(self.u[side], t, side)

    def __call__(self, t: float, state: Floats) -> list[float]:
        y = state.tolist()
        sites = self.sites
        net, carried, motors = self.net_torques(t, y)
        rate = [0.0] * STATES
        rigid = sites.compliance <= 0.0
        for body in range(3):
            omega, motion = y[SPEED + body], self.motion[body]
            age = y[AGE + body]
            inertia = sites.ring_inertia
            if body != RING:
                inertia = sites.pinion_inertia + (sites.motor_inertia if rigid else 0.0)
            if sites.renewals[body] > 0.0:
                rate[AGE + body] = sites.ageing(body, omega, age)
            if sites.distances[body] > 0.0:
                given = motion, y[body], omega, t, carried[body], age
                at_once = motion * sites.at_once(body, *given)
                friction = y[BRISTLE + body] + at_once
                level = motion * sites.sliding(body, *given) - at_once
                built_up = sites.build_up(body, omega, level, y[BRISTLE + body])
                rate[BRISTLE + body] = built_up
                friction += sites.bristle_damping(body, motion, omega, inertia, built_up)
            elif motion == 0.0:
                continue
            else:
                level = sites.sliding(body, motion, y[body], omega, t, carried[body], age)
                friction = motion * level
            rate[body] = omega
            rate[SPEED + body] = (net[body] - friction) / inertia
        for side in (0, 1):
            if rigid:
                rate[MOTOR + side], rate[MOTOR_SPEED + side] = rate[side], rate[SPEED + side]
            else:
                rate[MOTOR + side] = y[MOTOR_SPEED + side]
                rate[MOTOR_SPEED + side] = motors[side] / sites.motor_inertia
            if sites.lag > 0.0:
                aim = self.voltage(t, side)
                rate[LAGGED + side] = sites.lag_rate(y[LAGGED + side], aim, side)
        return rate

    def holds(self, t: float, state: Floats) -> bool:
        """Whether the mode is still the one that the kernels ask for."""
        y = state.tolist()
        for side in (0, 1):
            if mesh_region(*self.mesh(y, side)) != self.region[side]:
                return False
        if any(self.motion[body] * y[SPEED + body] < 0.0 for body in range(3)):
            return False
        if 0.0 in self.motion:
            net, carried, _ = self.net_torques(t, y)
            for body in range(3):
                if self.motion[body] == 0.0 and self.breaks(t, y, body, net, carried):
                    return False
        return True

    def breaks(self, t: float, y, body: int, net, carried) -> bool:
        """Whether the net torque on a body at rest is more than friction holds."""
        direction = 1.0 if net[body] > 0.0 else -1.0
        age = y[AGE + body]
        most = self.sites.holding(body, direction, y[body], 0.0, t, carried[body], age)
        return abs(net[body]) > most

    def switch(self, t: float, state: Floats) -> None:
        """Set the mode that the kernels ask for; a body that turns back is stopped first."""
        for body in range(3):
            if self.motion[body] * state[SPEED + body] < 0.0:
                state[SPEED + body] = 0.0
                if body != RING and self.sites.compliance <= 0.0:
                    state[MOTOR_SPEED + body] = 0.0
        y = state.tolist()
        for side in (0, 1):
            self.region[side] = mesh_region(*self.mesh(y, side))
        net, carried, _ = self.net_torques(t, y)
        for body in range(3):
            omega = y[SPEED + body]
            if omega != 0.0:
                self.motion[body] = 1.0 if omega > 0.0 else -1.0
            elif self.sites.distances[body] > 0.0:
                self.motion[body] = 1.0 if net[body] >= y[BRISTLE + body] else -1.0
            elif self.breaks(t, y, body, net, carried):
                self.motion[body] = 1.0 if net[body] > 0.0 else -1.0
            else:
                self.motion[body] = 0.0


def _holds(u: Floats, dt: float, delay: float) -> Iterator[Hold]:
    """Yield (start, end, voltages) of each stretch of constant voltage; zero before the log."""
    n = u.shape[1]
    starts = np.arange(n) * dt + delay
    end = (n - 1) * dt
    if delay > 0.0:
        yield 0.0, min(delay, end), (0.0, 0.0)
    first = 0
    for i in range(1, n + 1):
        if i == n or u[0, i] != u[0, first] or u[1, i] != u[1, first]:
            stop = end if i == n else min(starts[i], end)
            if stop > starts[first]:
                yield float(starts[first]), float(stop), (u[0, first], u[1, first])
            first = i


class _Recorder:
    """Rows of the output, filled as the run passes their times."""

    def __init__(self, hybrid: _Hybrid, n: int, dt: float) -> None:
        self.hybrid, self.dt = hybrid, dt
        self.out = np.empty((n, 8))
        self.late = np.empty(n)
        self.next_row = 0
        self.next_late = 0

    def _row(self, i: int, y: Floats) -> None:
        sites, theta = self.hybrid.sites, y[RING]
        z = y[0] - sites.n2 * theta, y[1] - sites.n2 * theta
        torques = [sites.mesh_torque(y[s], y[SPEED + s], theta, y[SPEED + RING], s) for s in (0, 1)]
        motors = sites.n1 * y[MOTOR], sites.n1 * y[MOTOR + 1]
        self.out[i] = theta, y[SPEED + RING], *motors, *torques, *z

    def first(self, y: Floats) -> None:
        self._row(0, y)
        self.next_row = 1
        while self.next_late * self.dt <= self.hybrid.sites.speed_delay:
            if self.next_late == self.late.size:
                break
            self.late[self.next_late] = y[SPEED + RING]
            self.next_late += 1

    def passed(self, t: float, at) -> None:
        """Take the rows up to time `t` from the interpolant `at`."""
        slack = 1e-9 * self.dt  # rounding of i·dt
        while self.next_row < len(self.out) and self.next_row * self.dt <= t + slack:
            self._row(self.next_row, at(min(self.next_row * self.dt, t)))
            self.next_row += 1
        delay = self.hybrid.sites.speed_delay
        while self.next_late < self.late.size and self.next_late * self.dt - delay <= t + slack:
            self.late[self.next_late] = at(min(self.next_late * self.dt - delay, t))[SPEED + RING]
            self.next_late += 1

    def readings(self) -> Floats:
        """Return the rows as the sensors give them."""
        for i, row in enumerate(self.out):
            row[0], row[1] = self.hybrid.sites.reading(row[0], self.late[i], i * self.dt)
        return self.out


def simulate(
    model: Model, u: ArrayLike, x0: ArrayLike, dt: float, *, rtol: float = 1e-10
) -> Floats:
    """Run the plant open loop, slowly and exactly.

    Parameters
    ----------
    model : Model
    u : (2, n) array [V]
        Held from each sample to the next.
    x0 : (6,) array
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; motors turn with their pinions.
    dt : float
        Sample time [s].
    rtol : float
        Relative tolerance of the integrator.

    Returns
    -------
    (n, 8) array
        Columns :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`, SI.

    Raises
    ------
    RuntimeError
        The integrator gave up, or the mode changes without end.
    """
    volts = np.array(u, float, ndmin=2)
    hybrid = _Hybrid(model)
    y = hybrid.start(np.asarray(x0, float))
    recorder = _Recorder(hybrid, volts.shape[1], dt)
    recorder.first(y)
    for begin, end, held in _holds(volts, dt, hybrid.sites.voltage_delay):
        hybrid.u = held
        y = _through_hold(hybrid, begin, end, y, dt, rtol, recorder)
    return recorder.readings()


def _through_hold(
    hybrid: _Hybrid, t: float, end: float, y: Floats, dt: float, rtol: float, recorder: _Recorder
) -> Floats:
    """Run over one stretch of constant voltage; return the state at its end."""
    switches = 0
    hybrid.switch(t, y)
    solver = _solver(hybrid, t, y, end, dt, rtol)
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed":
            raise RuntimeError(f"the reference failed at t = {solver.t:.9f} s: {message}")
        at = solver.dense_output()
        cut = _end_of_mode(hybrid, solver.t_old, solver.t, at)
        if cut is None:
            recorder.passed(solver.t, at)
            y = solver.y
            continue
        switches += 1
        if switches > MAX_SWITCHES * (1.0 + (end - t) / dt):
            raise RuntimeError(f"the mode chatters at t = {cut:.9f} s")
        recorder.passed(cut, at)
        y = at(cut)
        hybrid.switch(cut, y)
        if cut >= end:
            break
        solver = _solver(hybrid, cut, y, end, dt, rtol)
    return y


def _solver(hybrid: _Hybrid, t: float, y: Floats, end: float, dt: float, rtol: float) -> DOP853:
    return DOP853(hybrid, t, y, end, max_step=dt, rtol=rtol, atol=ATOL)


def _end_of_mode(hybrid: _Hybrid, start: float, end: float, at) -> float | None:
    """Time just after the mode ends within a step, None when it holds throughout."""
    good = start
    for fraction in CHECKS:
        bad = start + fraction * (end - start)
        if hybrid.holds(bad, at(bad)):
            good = bad
            continue
        while bad - good > EVENT_TIME:
            middle = 0.5 * (good + bad)
            if not good < middle < bad:
                break
            if hybrid.holds(middle, at(middle)):
                good = middle
            else:
                bad = middle
        return bad
    return None
