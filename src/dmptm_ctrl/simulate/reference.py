"""The slow, plain reference: SciPy's DOP853 at tight tolerance, every switch located.

A drive is a hybrid system. Its *mode* says in which region of its contact law each mesh is, and
whether each coordinate sticks (0) or which way it slides (±1). Within a mode the right-hand side
is smooth; after each step the mode is checked along the step's interpolant, and where it
ends the run is cut there, by bisection, and continued in the mode that follows. Every jump
of the held signals, also a delayed one, is a restart.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853

from dmptm_ctrl.effects import backlash
from dmptm_ctrl.simulate.parts import Parts, mesh_region, region_torque
from dmptm_ctrl.simulate.plant import ELASTIC_IMPACT, GAP, LINEAR, TWO_STATES, Floats, Plant

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.rig_model import RigModel

Hold = tuple[float, float, list[float]]  # start, end [s], signals
ATOL = 1e-14  # rad, rad/s: 4e-10 N·m in a mesh
EVENT_TIME = 1e-12  # s, to which a switch is located
CHECKS = (0.25, 0.5, 0.75, 1.0)  # of a step, where the mode is checked
MAX_SWITCHES = 1000  # in one hold of the signals; beyond, the mode chatters


class Exact(NamedTuple):
    """Samples of a reference run; arrays as in :class:`~.run.Motion`."""

    q: Floats
    v: Floats
    links: Floats
    readings: Floats


class _Hybrid:
    """Right-hand side of a plant in its current mode, and the rules that change it."""

    def __init__(self, plant: Plant) -> None:
        self.parts = Parts(plant)
        self.plant = plant
        n, bodies, links, inputs, _ = plant.size
        self.n = n
        # behind coordinates and speeds: lags, bristles, ages, places in gaps
        self.lag, self.bristle = 2 * n, 2 * n + inputs
        self.age, self.inside = 2 * n + inputs + bodies, 2 * n + inputs + 2 * bodies
        self.size = self.inside + links
        self.region = [0.0] * links
        self.motion = [0.0] * n
        self.u = [0.0] * inputs
        self.elastic = self.parts.elastic
        self.push = [0.0] * n

    def twist(self, y, k: int):
        first, second = self.parts.ends[k]
        motion = []
        for b in (first, second):
            g, r = self.parts.group[b], self.parts.ratio[b]
            motion += [r * y[g], r * y[self.n + g]]
        return self.parts.twist(k, *motion)

    def link_torque(self, y, k: int) -> float:
        z, rate, law = self.twist(y, k)
        if self.parts.laws_of_links[k] == GAP:
            return region_torque(z, rate, self.region[k], law)
        return self.parts.link_torque(k, z, rate, law, y[self.inside + k])

    def acting(self, t: float, y, j: int) -> float:
        if self.parts.lag(j, 0.0)[1] > 0.0:
            return y[self.lag + j]
        return self.parts.signal(j, self.u[j], t)

    def torques(self, y) -> dict[int, float]:
        """Torques of links at their first bodies."""
        return {k: self.link_torque(y, k) for k in range(len(self.parts.ends))}

    def net_torques(self, t: float, y, torques: dict[int, float]) -> list[float]:
        """Torques on coordinates without friction."""
        acting = {j: self.acting(t, y, j) for j in range(len(self.u))}
        return [
            self.push[g] + self.parts.force(g, y[g], y[self.n + g], t, acting, torques)
            for g in range(self.n)
        ]

    def friction(
        self, g: int, way: float, t: float, y, torques: dict[int, float], *, moving: bool
    ) -> tuple[float, float]:
        ages = {b: y[self.age + b] for b in self.parts.bodies[g]}
        return self.parts.friction(g, way, y[g], y[self.n + g], t, torques, ages, moving=moving)

    def __call__(self, t: float, state: Floats) -> list[float]:
        y = state.tolist()
        parts, n = self.parts, self.n
        torques = self.torques(y)
        net = self.net_torques(t, y, torques)
        rate = [0.0] * self.size
        for g in range(n):
            way, omega, b = self.motion[g], y[n + g], self.elastic[g]
            for own in parts.bodies[g]:
                rate[self.age + own] = parts.ageing_rate(own, omega, y[self.age + own])
            if b is None and way == 0.0:
                continue
            slides = self.friction(g, way, t, y, torques, moving=True)
            rub = way * slides[0]
            if b is not None:
                at = self.bristle + b
                rub, rate[at] = parts.presliding(g, way, omega, slides, y[at])
            rate[g] = omega
            rate[n + g] = (net[g] - rub) / parts.inertia[g]
        for j in range(len(self.u)):
            aim, tau = parts.lag(j, parts.signal(j, self.u[j], t))
            if tau > 0.0:
                rate[self.lag + j] = (aim - y[self.lag + j]) / tau
        for k, law_kind in enumerate(parts.laws_of_links):
            if law_kind == TWO_STATES:
                z, speed, law = self.twist(y, k)
                rate[self.inside + k] = backlash.gap_rate(y[self.inside + k], z, speed, law)
        return rate

    def where(self, y, k: int) -> float:
        """Region of a link in its contact law, by which its torque is smooth."""
        z, rate, law = self.twist(y, k)
        kind = self.parts.laws_of_links[k]
        if kind == GAP:
            return float(mesh_region(z, rate, law))
        if kind == ELASTIC_IMPACT:
            return float(np.sign(z)) if abs(z) > law.half_gap else 0.0
        if kind == TWO_STATES:
            inside = y[self.inside + k]
            return float(np.sign(inside)) if abs(inside) >= law.half_gap else 0.0
        return 0.0

    def holds(self, t: float, state: Floats) -> bool:
        """Whether the mode is still the one that the kernels ask for."""
        y = state.tolist()
        for k, kind in enumerate(self.parts.laws_of_links):
            if kind != LINEAR and self.where(y, k) != self.region[k]:
                return False
        if any(self.motion[g] * y[self.n + g] < 0.0 for g in range(self.n)):
            return False
        if 0.0 in self.motion:
            torques = self.torques(y)
            net = self.net_torques(t, y, torques)
            for g in range(self.n):
                if self.motion[g] == 0.0 and self.breaks(t, y, g, net, torques):
                    return False
        return True

    def breaks(self, t: float, y, g: int, net, torques) -> bool:
        """Whether the net torque on a coordinate at rest is more than friction holds."""
        way = 1.0 if net[g] > 0.0 else -1.0
        return abs(net[g]) > self.friction(g, way, t, y, torques, moving=False)[0]

    def switch(self, t: float, state: Floats) -> None:
        """Set the mode that the kernels ask for; what turns back is stopped first."""
        n = self.n
        for g in range(n):
            if self.motion[g] * state[n + g] < 0.0:
                state[n + g] = 0.0
        y = state.tolist()
        for k in range(len(self.region)):
            self.region[k] = self.where(y, k)
        torques = self.torques(y)
        net = self.net_torques(t, y, torques)
        for g in range(n):
            omega, b = y[n + g], self.elastic[g]
            if omega != 0.0:
                self.motion[g] = 1.0 if omega > 0.0 else -1.0
            elif b is not None:
                self.motion[g] = 1.0 if net[g] >= y[self.bristle + b] else -1.0
            elif self.breaks(t, y, g, net, torques):
                self.motion[g] = 1.0 if net[g] > 0.0 else -1.0
            else:
                self.motion[g] = 0.0


def _holds(u: Floats, dt: float, delays: Floats) -> Iterator[Hold]:
    """Yield (start, end, signals) of each stretch of constant signals, which were 0 before."""
    inputs, n = u.shape
    end = (n - 1) * dt
    jumps = {0.0, end}
    for j in range(inputs):
        last = 0.0 if delays[j] > 0.0 else u[j, 0]
        for i in range(n):
            if u[j, i] != last:
                jumps.add(min(i * dt + float(delays[j]), end))
            last = u[j, i]
    times = sorted(jumps)
    for start, stop in pairwise(times):
        middle = 0.5 * (start + stop)
        held = []
        for j in range(inputs):
            i = int(np.floor((middle - delays[j]) / dt))
            held.append(float(u[j, min(i, n - 1)] if i >= 0 else 0.0))
        yield start, stop, held


class _Recorder:
    """Rows of the output, filled as the run passes their times."""

    def __init__(self, hybrid: _Hybrid, n: int, dt: float) -> None:
        self.hybrid, self.dt = hybrid, dt
        plant, count = hybrid.plant, hybrid.n
        _, _, links, _, sensors = plant.size
        self.out = Exact(
            np.empty((n, count)), np.empty((n, count)), np.empty((n, links)), np.empty((n, sensors))
        )
        self.late = np.empty((n, sensors))
        self.next_row, self.next_late = 0, [0] * sensors
        self.delays = plant.sensor_delay.tolist()

    def _sensed(self, y, i: int) -> float:
        plant, parts = self.hybrid.plant, self.hybrid.parts
        b = int(plant.sensor_body[i])
        at = parts.group[b] + (self.hybrid.n if plant.sensor_speed[i] else 0)
        return parts.ratio[b] * y[at]

    def _row(self, i: int, y: Floats) -> None:
        n, hybrid = self.hybrid.n, self.hybrid
        self.out.q[i], self.out.v[i] = y[:n], y[n : 2 * n]
        values = y.tolist()
        for k in range(self.out.links.shape[1]):
            z, rate, law = hybrid.twist(values, k)
            inside = values[hybrid.inside + k]
            self.out.links[i, k] = hybrid.parts.link_torque(k, z, rate, law, inside)

    def passed(self, t: float, at) -> None:
        """Take the rows up to time `t` from the interpolant `at`."""
        slack = 1e-9 * self.dt  # rounding of i·dt
        while self.next_row < len(self.out.q) and self.next_row * self.dt <= t + slack:
            self._row(self.next_row, at(min(self.next_row * self.dt, t)))
            self.next_row += 1
        for i, delay in enumerate(self.delays):
            while (
                self.next_late[i] < len(self.late)
                and self.next_late[i] * self.dt - delay <= t + slack
            ):
                row = self.next_late[i]
                self.late[row, i] = self._sensed(at(min(row * self.dt - delay, t)), i)
                self.next_late[i] += 1

    def readings(self) -> Exact:
        """Return the rows, readings as the sensors give them."""
        plant, parts = self.hybrid.plant, self.hybrid.parts
        for s, b in enumerate(plant.sensor_body):
            r, g = parts.ratio[b], parts.group[b]
            for i in range(len(self.late)):
                moves = [r * self.out.q[i, g], r * self.out.v[i, g]]
                moves[int(plant.sensor_speed[s])] = self.late[i, s]
                self.out.readings[i, s] = parts.reading(s, moves[0], moves[1], i * self.dt)
        return self.out


def run_exactly(
    plant: Plant, u: ArrayLike, q0: ArrayLike, v0: ArrayLike, dt: float, *, rtol: float = 1e-10
) -> Exact:
    """Run a plant open loop, slowly and exactly.

    `u` (inputs, n) and `dt` [s] are as for :func:`~.run.advance`, `q0` and `v0` (n,) the
    coordinates and speeds at the start, `rtol` is the integrator's relative tolerance.
    RuntimeError where the integrator gives up, or the mode changes without end.
    """
    signals = np.array(u, float, ndmin=2)
    hybrid = _Hybrid(plant)
    y = np.zeros(hybrid.size)
    y[: hybrid.n], y[hybrid.n : 2 * hybrid.n] = q0, v0
    recorder = _Recorder(hybrid, signals.shape[1], dt)
    recorder.passed(0.0, lambda _: y)
    for begin, end, held in _holds(signals, dt, plant.input_values[:, 1]):
        hybrid.u = held
        y = _through_hold(hybrid, begin, end, y, dt, rtol, recorder)
    return recorder.readings()


def simulate(
    model: "Model | RigModel", u: ArrayLike, x0: ArrayLike | None, dt: float, *, rtol: float = 1e-10
) -> Floats:
    """Run a drive, see `run_exactly`: (n, 8) array of :data:`~.compiled.OUTPUTS`.

    Of a rig, which has no `x0` and starts from rest, the readings of its sensors.
    """
    from dmptm_ctrl.simulate.dual import start

    plant = model.plant()
    if x0 is None:
        still = np.zeros(plant.inertia.size)
        return run_exactly(plant, u, still, still, dt, rtol=rtol).readings
    exact = run_exactly(plant, u, *start(plant, np.asarray(x0, float)), dt, rtol=rtol)
    ratio = plant.link_values[:2, 0]
    twists = exact.q[:, :2] - ratio * exact.q[:, 2:3]
    return np.hstack([exact.readings, exact.links[:, :2], twists])


def _through_hold(
    hybrid: _Hybrid, t: float, end: float, y: Floats, dt: float, rtol: float, recorder: _Recorder
) -> Floats:
    """Run over one stretch of constant signals; return the state at its end."""
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
