"""Curves without a name, fitted to what is left of the balances: over angle, speed, time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.identify.balance import Balance, columns, correlation_lengths, split, surprises
from dmptm_ctrl.identify.motion import Motion, first_difference, smooth
from dmptm_ctrl.identify.windows import CARRIED_SECONDS, STIFFNESS, carried, evened, frictions
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats

RING_RATIO = 8.25  # N2, Table 1
# Of the motor's turn, of a torque in proportion to the voltage; the first of them of one that is
# not: beyond, that is cogging.
ORDERS, PLAIN = range(1, 13), 6
# Of the ring gear's turn, of a torque that may act at some speeds only: fewer are curves over the
# angle, more are teeth and motors. Speeds of its knots, as shares of the range.
RING_ORDERS = range(3, 73)
AT_SPEEDS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
KNOT = 1e-3  # rad, unit of a knot of a curve of the twist
RIDGE = 10.0  # N·m, what a knot of a curve may be before the data speak
MEMORIES = (0.3, 1.0, 3.0)  # s, of what the last seconds of motion leave behind
LAGS = (0.04, 0.08, 0.12, 0.18, 0.26, 0.36, 0.5, 0.7, 0.95, 1.25)  # s, of a loose mass


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve without a name.

    Attributes
    ----------
    variables : tuple of str
        What it depends on.
    evidence : float
        Fall of the loss on fitted and held-out logs, less twice the curve's parameters.
    order : int
        Of the ring gear's turn, of a wave over it; 0 of all else.
    """

    variables: tuple[str, ...]
    evidence: float
    held_gain: float
    order: int = 0


class Group(NamedTuple):
    """A curve to try, as its knots show in the balances."""

    variables: tuple[str, ...]
    order: int
    parts: list[Floats]


class Basis(NamedTuple):
    """A curve to try.

    Attributes
    ----------
    pinions, ring, shifts : (2, k, n), (k, n), (2, k, n) array
        Torques and twists of each of its knots; those that do not act are of no size.
    order : int
        As of :class:`Curve`.
    """

    variables: tuple[str, ...]
    pinions: Floats
    ring: Floats
    shifts: Floats
    order: int = 0


@dataclass(frozen=True)
class Scale:
    """Ranges of the campaign, so that knots lie where there is motion."""

    omega: float
    volts: float
    slew: float
    torque: float
    time: float


def scale_of(motions: Sequence[Motion]) -> Scale:
    """Ranges over all logs."""
    return Scale(
        omega=max(float(np.quantile(np.abs(mo.run[:, 1]), 0.999)) for mo in motions),
        volts=max(float(np.abs(mo.rec.u).max()) for mo in motions),
        slew=max(float(np.quantile(np.abs(slew(mo)), 0.99)) for mo in motions),
        torque=max(float(np.quantile(np.abs(load_of(mo)), 0.99)) for mo in motions),
        time=max(mo.rec.theta.size * mo.rec.dt for mo in motions),
    )


def slew(mo: Motion) -> Floats:
    """Rate of each voltage [V/s], smoothed over a few samples, (2, n)."""
    return np.array([smooth(first_difference(u, mo.rec.dt), 5) for u in mo.rec.u])


def load_of(mo: Motion) -> Floats:
    """Mesh torque of each side [N·m], (2, n), of the model that the motion was prepared with."""
    plant = mo.declared.plant()
    return evened(carried(plant, mo.rec.u, frictions(mo, plant)), mo.rec.dt, CARRIED_SECONDS)


def hats(x: Floats, knots: NDArray[np.floating[Any]]) -> Floats:
    """Linear B-splines, constant beyond the ends, (k, n)."""
    table = np.eye(knots.size)
    return np.array([np.interp(x, knots, row) for row in table])


def round_hats(angle: Floats, count: int) -> Floats:
    """Periodic linear B-splines over a turn, (count, n)."""
    place = np.mod(angle, 2 * np.pi) / (2 * np.pi) * count
    before = np.floor(place)
    past = place - before
    rows, samples = np.zeros((count, angle.size)), np.arange(angle.size)
    first = before.astype(int) % count
    rows[first, samples] = 1.0 - past
    rows[(first + 1) % count, samples] = past
    return rows


def signed(rows: Floats, mo: Motion) -> Floats:
    """Rows as they are, and times the direction of motion."""
    return np.vstack([rows, rows * np.sign(mo.run[:, 1])])


def delayed(signal: Floats, n: int) -> Floats:
    """Signal n samples ago; zero before the log."""
    return np.concatenate([np.zeros(n), signal[: signal.size - n]])


def bases(mo: Motion, s: Scale) -> Iterator[Basis]:
    """Curves to try."""
    theta, omega, u, dt = mo.run[:, 0], mo.run[:, 1], mo.rec.u, mo.rec.dt
    n = theta.size
    none = np.empty((0, n))
    none2 = np.empty((2, 0, n))
    t = np.asarray(np.arange(n) * dt, np.float64)
    mean = u.mean(0)

    def ring(rows: Floats) -> tuple[Floats, Floats, Floats]:
        return none2, rows, none2

    def pinions(left: Floats, right: Floats) -> tuple[Floats, Floats, Floats]:
        return np.array([left, right]), none, none2

    def shifts(left: Floats, right: Floats) -> tuple[Floats, Floats, Floats]:
        return none2, none, np.array([left, right])

    yield Basis(("theta_L",), *ring(signed(round_hats(theta, 36), mo)))
    yield Basis(("theta_L",), *ring(round_hats(theta, 180)))
    yield Basis(("theta_L", "u"), *ring(round_hats(theta, 24) * np.abs(mean)))
    yield Basis(("theta_L", "omega_L"), *ring(round_hats(theta, 24) * omega))
    at_speeds = hats(np.abs(omega), s.omega * np.array(AT_SPEEDS))
    for k in RING_ORDERS:
        wave = np.vstack([at_speeds * np.cos(k * theta), at_speeds * np.sin(k * theta)])
        yield Basis(("theta_L", "omega_L"), *ring(wave), k)
    knots = s.omega * np.linspace(-1.0, 1.0, 13)
    yield Basis(("omega_L",), *ring(hats(omega, knots)))
    knots = s.volts * np.linspace(-1.0, 1.0, 13)
    yield Basis(("u",), *pinions(hats(u[0], knots), hats(u[1], knots)))
    knots = s.volts * np.linspace(-1.0, 1.0, 81)
    yield Basis(("u",), *ring(hats(u[0], knots) + hats(u[1], knots)))
    rate = slew(mo)
    knots = s.slew * np.array([-1.0, -0.5, -0.2, -0.05, 0.05, 0.2, 0.5, 1.0])
    yield Basis(("du_dt", "u"), *pinions(hats(rate[0], knots), hats(rate[1], knots)))
    turn = mo.run[:, 2:4].T
    waves = [
        np.array(
            [f(k * a) * w for k in ORDERS for f in (np.cos, np.sin)]
            + [f(k * a) for k in ORDERS[:PLAIN] for f in (np.cos, np.sin)]
        )
        for a, w in zip(turn, u, strict=True)
    ]
    yield Basis(("theta_m", "u"), *pinions(*waves))
    braking = [np.vstack([v * (v * omega < 0.0), v * np.abs(omega)]) for v in u]
    yield Basis(("omega_m", "u"), *pinions(*braking))
    load = load_of(mo)
    knots = s.torque * np.linspace(-1.0, 1.0, 9)
    yield Basis(("mesh_torque",), *pinions(*(hats(x, knots) for x in load)))
    lapse = hats(t, np.linspace(0.0, s.time, 20))
    yield Basis(("time",), *ring(signed(lapse, mo)))
    yield Basis(("time", "u"), *pinions(lapse * u[0], lapse * u[1]))
    keep = [np.exp(-dt / tau) for tau in MEMORIES]  # of what was, from sample to sample
    heat = np.array([lfilter([1.0 - a], [1.0, -a], np.abs(omega)) for a in keep])
    yield Basis(("omega_L", "time"), *ring(signed(heat, mo)[3:]))
    past = np.array([delayed(omega, round(lag / dt)) - omega for lag in LAGS])
    yield Basis(("omega_L",), *ring(past))
    if mo.rec.twist is not None:
        yield Basis(("mesh_torque",), *shifts(*(hats(x, knots) for x in load)))
        yield Basis(("theta_L",), *shifts(round_hats(theta, 24), round_hats(theta, 24)))


def groups_of(balance: Balance, scale: Scale) -> list[Group]:
    """Every curve with its columns (w, k) per equation."""

    def means(mo: Motion) -> list[Group]:
        return [
            Group(b.variables, b.order, [mo.mean(x) for x in (*b.pinions, b.ring, *b.shifts)])
            for b in bases(mo, scale)
        ]

    made = in_threads(means, balance.motions, balance.jobs, lambda mo: mo.rec.omega.size)
    return [
        group._replace(
            parts=[signs(e.kind, made[e.motion][g].parts, e.used) for e in balance.equations]
        )
        for g, group in enumerate(made[0])
    ]


def signs(kind: str, rows: Sequence[Floats], used: np.ndarray) -> Floats:
    """Columns (w, k) of one equation from window means of torques and shifts; no ripple."""
    if kind == "ripple":
        return np.zeros((int(used.sum()), sum(len(x) for x in rows)))
    left, right, ring, one, two = (x[:, used] for x in rows)
    if kind == "total":
        turned = [-RING_RATIO * left, -RING_RATIO * right, -ring, 0.0 * one, 0.0 * two]
    elif kind == "left":
        turned = [-left, 0.0 * right, 0.0 * ring, STIFFNESS * KNOT * one, 0.0 * two]
    else:
        turned = [0.0 * left, -right, 0.0 * ring, 0.0 * one, STIFFNESS * KNOT * two]
    return np.vstack(turned).T


def curves(left: Residual) -> list[Curve]:
    """Evidence of every curve beside the model of `left`, best first."""
    scale = scale_of(left.balance.motions)
    fitted, held = groups_of(left.balance, scale), groups_of(left.held, scale)
    base = left.base
    w = base.weights
    held_parts = left.held.missing(base.model)
    known = np.concatenate(held_parts)
    held_jac = columns(left.held, base.model, base.unknowns)
    prior = np.array([1.0 / k.prior**2 if np.isfinite(k.prior) else 1e-6 for k in base.unknowns])
    own = w[:, None] * base.jacobian
    square, slopes = own.T @ own, own.T @ (w * base.missing)
    used = freedom(square, prior)

    def curve_of(both_of: tuple[Group, Group]) -> Curve:
        group, held = both_of
        g = np.concatenate(group.parts)
        weighted = w[:, None] * g
        crossed = own.T @ weighted
        ridge = np.concatenate([prior, np.full(g.shape[1], RIDGE**-2)])
        pull = np.concatenate([prior * base.p, np.zeros(g.shape[1])])
        normal = np.block([[square, crossed], [crossed.T, weighted.T @ weighted]])
        slope = np.concatenate([slopes, weighted.T @ (w * base.missing)])
        step = np.linalg.solve(normal + np.diag(ridge), -slope - pull)
        drive, knots = step[: len(square)], step[len(square) :]
        moved = split(base.missing + base.jacobian @ drive + g @ knots, base.parts)
        there = known + held_jac @ drive + np.concatenate(held.parts) @ knots
        gain = fall(base.parts, moved, base.kinds)
        held_gain = fall(held_parts, split(there, held_parts), left.held.kinds)
        price = 2.0 * (freedom(normal, ridge) - used)
        evidence = gain + held_gain - price
        return Curve(group.variables, evidence, held_gain, group.order)

    found = in_threads(curve_of, list(zip(fitted, held, strict=True)), left.balance.jobs)
    return sorted(found, key=lambda c: -c.evidence)


def fall(before: Sequence[Floats], after: Sequence[Floats], kinds: Sequence[str]) -> float:
    """Fall of −2 log-likelihood, per independent row of what is left after."""
    change = surprises(before, kinds) - surprises(after, kinds)
    return float(np.sum(change / correlation_lengths(after, kinds)))


def freedom(normal: Floats, ridge: Floats) -> float:
    """Effective number of parameters of a ridge regression."""
    return float(np.trace(np.linalg.solve(normal + np.diag(ridge), normal)))
