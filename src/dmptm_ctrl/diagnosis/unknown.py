"""What no catalogue effect explains: which variable the missing torque depends on.

Curves without a name, of the ring-gear angle, the speed, the voltage, the time …, are fitted
to what is left of the balances; a variable whose curve predicts the held-out logs is one that
the missing effect depends on. Bursts too short and too large for the robust loss are looked
at for themselves: when, where and at which voltage they come.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from dmptm_ctrl.diagnosis.predict import speeds
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.slip import SLIP, wanders
from dmptm_ctrl.identify.balance import Balance, columns, loss, scatter, surprise
from dmptm_ctrl.identify.motion import Motion, first_difference, smooth
from dmptm_ctrl.identify.windows import CARRIED_SECONDS, STIFFNESS, carried, evened, frictions
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats, Model

RING_RATIO = 8.25  # N2, Table 1
# Of the motor's turn, of a torque in proportion to the voltage; the first of them of one that is
# not: beyond, that is cogging.
ORDERS, PLAIN = range(1, 13), 6
KNOT = 1e-3  # rad, unit of a knot of a curve of the twist
RIDGE = 10.0  # N·m, what a knot of a curve may be before the data speak
CURVE = 60.0  # evidence of a curve; well above the best of all curves on rigs without any
HELD = 8.0  # of it on the held-out logs: a curve has many knots
# What a named effect leaves because its form is only nearly right is small beside it.
CURVE_SHARE = 0.1
ALIKE = 0.7  # share of the best curve's evidence from which another is named with it
# The same for one that predicts held-out logs so many times as well: most of the evidence is
# of the fitted logs, on which a curve may bend as it likes.
ALIKE_HELD, BETTER_HELD = 0.5, 2.0
BURST = 12.0  # standard deviations of a window that no curve has to explain
FAINT = 6.0  # the same, if such windows come by the clock
BURSTS = 0.004  # share of windows that are bursts; rattle alone gives less
MEMORIES = (0.3, 1.0, 3.0)  # s, of what the last seconds of motion leave behind
LAGS = (0.04, 0.08, 0.12, 0.18, 0.26, 0.36, 0.5, 0.7, 0.95, 1.25)  # s, of a loose mass
PERIODS = np.geomspace(0.25, 5.0, 1500)  # s, tried for bursts at fixed intervals
WHOLE = 0.8  # of the greatest regularity, at which a longer interval counts as well
FINE, FINER = 0.004, 101  # share about a period in which it is looked for once more, trials
REGULAR = 0.9  # |mean exp(2πi t/T)| of what comes by the clock; excitations differ from log to log
RAYLEIGH = 12.0  # n R² of burst onsets folded on a period: p below 1e-5 per period tried
FAR = 0.1  # share of the samples of free runs that count as far off
ONSET_GAP = 0.1  # s between bursts that count as two


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve without a name.

    Attributes
    ----------
    variables : tuple of str
        What it depends on.
    evidence : float
        Fall of the loss on fitted and held-out logs, less twice the curve's parameters.
    """

    variables: tuple[str, ...]
    evidence: float
    held_gain: float


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
    """Mesh torque of each chain [N·m], (2, n), of the model that the motion was prepared with."""
    base, _, _ = mo.declared.arrays()
    return evened(carried(base, mo.rec.u, frictions(mo, base)), mo.rec.dt, CARRIED_SECONDS)


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


def direction(mo: Motion) -> Floats:
    """Sign of the ring gear's speed."""
    return np.asarray(np.sign(mo.run[:, 1]))


def signed(rows: Floats, mo: Motion) -> Floats:
    """Rows as they are, and times the direction of motion."""
    return np.vstack([rows, rows * direction(mo)])


def faded(signal: Floats, tau: float, dt: float) -> Floats:
    """First-order memory of a signal."""
    a = np.exp(-dt / tau)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], signal))


def delayed(signal: Floats, n: int) -> Floats:
    """Signal n samples ago; zero before the log."""
    return np.concatenate([np.zeros(n), signal[: signal.size - n]])


def bases(mo: Motion, s: Scale) -> Iterator[tuple[tuple[str, ...], Floats, Floats, Floats]]:
    """Curves to try: (variables, torques per pinion (2, k, n), on the ring (k, n), shifts).

    Rows that do not act are of zero size.
    """
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

    yield ("theta_L",), *ring(signed(round_hats(theta, 36), mo))
    yield ("theta_L",), *ring(round_hats(theta, 180))
    yield ("theta_L", "u"), *ring(round_hats(theta, 24) * np.abs(mean))
    yield ("theta_L", "omega_L"), *ring(round_hats(theta, 24) * omega)
    knots = s.omega * np.linspace(-1.0, 1.0, 13)
    yield ("omega_L",), *ring(hats(omega, knots))
    knots = s.volts * np.linspace(-1.0, 1.0, 13)
    yield ("u",), *pinions(hats(u[0], knots), hats(u[1], knots))
    knots = s.volts * np.linspace(-1.0, 1.0, 81)
    yield ("u",), *ring(hats(u[0], knots) + hats(u[1], knots))
    rate = slew(mo)
    knots = s.slew * np.array([-1.0, -0.5, -0.2, -0.05, 0.05, 0.2, 0.5, 1.0])
    yield ("du_dt", "u"), *pinions(hats(rate[0], knots), hats(rate[1], knots))
    turn = mo.run[:, 2:4].T
    waves = [
        np.array(
            [f(k * a) * w for k in ORDERS for f in (np.cos, np.sin)]
            + [f(k * a) for k in ORDERS[:PLAIN] for f in (np.cos, np.sin)]
        )
        for a, w in zip(turn, u, strict=True)
    ]
    yield ("theta_m", "u"), *pinions(*waves)
    braking = [np.vstack([v * (v * omega < 0.0), v * np.abs(omega)]) for v in u]
    yield ("omega_m", "u"), *pinions(*braking)
    load = load_of(mo)
    knots = s.torque * np.linspace(-1.0, 1.0, 9)
    yield ("mesh_torque",), *pinions(*(hats(x, knots) for x in load))
    lapse = hats(t, np.linspace(0.0, s.time, 20))
    yield ("time",), *ring(signed(lapse, mo))
    yield ("time", "u"), *pinions(lapse * u[0], lapse * u[1])
    heat = np.array([faded(np.abs(omega), tau, dt) for tau in MEMORIES])
    yield ("omega_L", "time"), *ring(signed(heat, mo)[3:])
    past = np.array([delayed(omega, round(lag / dt)) - omega for lag in LAGS])
    yield ("omega_L",), *ring(past)
    if mo.rec.twist is not None:
        yield ("mesh_torque",), *shifts(*(hats(x, knots) for x in load))
        yield ("theta_L",), *shifts(round_hats(theta, 24), round_hats(theta, 24))


def group_parts(balance: Balance, scale: Scale) -> list[tuple[tuple[str, ...], list[Floats]]]:
    """Columns (w, k) per equation of every curve."""

    def one(mo: Motion) -> list[tuple[tuple[str, ...], list[Floats]]]:
        return [
            (variables, [mo.mean(x) for x in (*pinion, ring, *shift)])
            for variables, pinion, ring, shift in bases(mo, scale)
        ]

    made = in_threads(one, balance.motions, balance.jobs)
    return [
        (made[0][g][0], [signs(e.kind, made[e.motion][g][1], e.used) for e in balance.equations])
        for g in range(len(made[0]))
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
    fitted = group_parts(left.balance, scale)
    judged = group_parts(left.held, scale)
    base = left.base
    w = base.weights
    held_parts = left.held.missing(base.model)
    known = np.concatenate(held_parts)
    held_jac = columns(left.held, base.model, base.unknowns, known)
    prior = np.array([1.0 / k.prior**2 if np.isfinite(k.prior) else 1e-6 for k in base.unknowns])
    own = w[:, None] * base.jacobian
    used = freedom(own.T @ own, prior)

    def told(group: tuple[tuple[tuple[str, ...], list[Floats]], list[Floats]]) -> Curve:
        (variables, parts), held = group
        g = np.concatenate(parts)
        both = np.hstack([base.jacobian, g])
        weighted = w[:, None] * both
        ridge = np.concatenate([prior, np.full(g.shape[1], RIDGE**-2)])
        pull = np.concatenate([prior * base.p, np.zeros(g.shape[1])])
        normal = weighted.T @ weighted
        step = np.linalg.solve(normal + np.diag(ridge), -(weighted.T @ (w * base.missing)) - pull)
        moved = split(base.missing + both @ step, base.parts)
        after = loss(moved, base.kinds, base.unknowns, base.p + step[: prior.size])
        there = known + np.hstack([held_jac, np.concatenate(held)]) @ step
        held_gain = left.held_base - surprise(split(there, held_parts), left.held.kinds)
        price = 2.0 * (freedom(normal, ridge) - used)
        return Curve(variables, base.loss - after + held_gain - price, held_gain)

    groups = [(one, held) for one, (_, held) in zip(fitted, judged, strict=True)]
    found = in_threads(told, groups, left.balance.jobs)
    return sorted(found, key=lambda c: -c.evidence)


def freedom(normal: Floats, ridge: Floats) -> float:
    """Effective number of parameters of a ridge regression."""
    return float(np.trace(np.linalg.solve(normal + np.diag(ridge), normal)))


def split(vector: Floats, like: Sequence[Floats]) -> list[Floats]:
    """Cut a vector into parts of the sizes of `like`."""
    return np.split(vector, np.cumsum([x.size for x in like])[:-1])


@dataclass(frozen=True)
class Bursts:
    """Windows far outside of what the model leaves elsewhere.

    Attributes
    ----------
    share : float
        Of all windows of the total balance.
    variables : tuple of str
        What their coming depends on, most telling first.
    period : float
        Of their coming [s]; 0 if they do not come at fixed intervals.
    """

    share: float
    variables: tuple[str, ...]
    period: float = 0.0


def bursts(left: Residual) -> Bursts:
    """Look for windows of the total balance that stand far out."""
    flags, times, values = [], [], []
    for balance in (left.balance, left.held):
        parts = balance.missing(left.base.model)
        spread = scatter(parts, balance.kinds)
        for e, part, sigma in zip(balance.equations, parts, spread, strict=True):
            if e.kind != "total":
                continue
            mo = balance.motions[e.motion]
            flags.append(np.abs(part) > BURST * sigma)
            times.append(onsets(mo.time[e.used][np.abs(part) > FAINT * sigma]))
            middle = mo.starts[e.used] + mo.window.size // 2
            values.append(
                np.array(
                    [
                        np.mod(mo.run[middle, 0], 2 * np.pi),
                        mo.run[middle, 1],
                        np.abs(mo.rec.u).mean(0)[middle],
                        np.abs(slew(mo)).max(0)[middle],
                        np.mod(mo.run[middle, 2], 2 * np.pi),
                        mo.time[e.used],
                    ]
                )
            )
    if not flags:
        return Bursts(0.0, ())
    flag = np.concatenate(flags)
    share, period = float(flag.mean()), interval(times)
    if share < BURSTS:
        return Bursts(share, (), period)
    variables = ["time"] if period > 0.0 else []
    table = np.concatenate(values, axis=1)
    names = ("theta_L", "omega_L", "u", "du_dt", "theta_m", "time")
    variables += telling(names, table, flag, 1)
    return Bursts(share, tuple(dict.fromkeys(variables)), period)


def onsets(times: Floats) -> Floats:
    """First times of groups of bursts."""
    if times.size == 0:
        return times
    return np.asarray(times[np.concatenate([[True], np.diff(times) > ONSET_GAP])])


def interval(times: Sequence[Floats]) -> float:
    """Return the interval [s] at which bursts come from a log's start; 0 if there is none."""
    all_times = np.concatenate(list(times))
    if all_times.size < 6:
        return 0.0

    def order(periods: Floats) -> Floats:
        return np.asarray(np.abs(np.exp(2j * np.pi * all_times / periods[:, None]).mean(1)))

    regular = order(PERIODS)
    if regular.max() ** 2 * all_times.size < RAYLEIGH or regular.max() < REGULAR:
        return 0.0
    # a part of the interval is as regular as the whole: the longest it is
    high = np.flatnonzero(regular > WHOLE * regular.max())
    longest = np.split(high, np.flatnonzero(np.diff(high) > 1) + 1)[-1]
    whole = PERIODS[longest[np.argmax(regular[longest])]]
    near = whole * (1.0 + np.linspace(-FINE, FINE, FINER))
    return float(near[np.argmax(order(near))])


def telling(names: Sequence[str], table: Floats, flag: np.ndarray, most: int) -> list[str]:
    """Names of the rows of a table that tell most of a flag, the best first."""
    told = [information(x, flag) for x in table]
    return [names[i] for i in np.argsort(told)[::-1][:most]]


def information(x: Floats, flag: np.ndarray, bins: int = 12) -> float:
    """Mutual information [nat] of a variable in bins and the flag, less its bias."""
    edges = np.quantile(x, np.linspace(0.0, 1.0, bins + 1)[1:-1])
    place = np.searchsorted(edges, x)
    rate = flag.mean()
    total = 0.0
    for b in range(bins):
        inside = flag[place == b]
        if inside.size == 0:
            continue
        for q, p in ((inside.mean(), rate), (1.0 - inside.mean(), 1.0 - rate)):
            if q > 0.0:
                total += inside.size / flag.size * q * np.log(q / p)
    return float(total) - (bins - 1) / (2.0 * flag.size)


def astray(model: Model, logs: Sequence[Log]) -> tuple[str, ...]:
    """Return what the largest errors of free runs depend on, the two most telling variables."""
    errors, values = [], []
    for log in logs:
        seen, run = speeds(model, log)
        errors.append(np.abs(seen - run))
        u = np.array([log["u_left"], log["u_right"]])
        rate = np.abs(np.gradient(u, log.sample_time, axis=1)).max(0)
        turn = np.mod(log["theta_L"], 2 * np.pi)
        values.append(np.array([turn, log["omega_L"], np.abs(u).mean(0), rate]))
    error, table = np.concatenate(errors), np.concatenate(values, axis=1)
    flag = error > np.quantile(error, 1.0 - FAR)
    return tuple(telling(("theta_L", "omega_L", "u", "du_dt"), table, flag, 2))


@dataclass(frozen=True)
class Unexplained:
    """What no name stands for.

    Attributes
    ----------
    variables : tuple of str
        That it depends on.
    curve : Curve or None
        The best of those that count.
    bursts : Bursts
    beyond_names : bool
        A curve explains more than the named effects do: they only stand in for it.
    slips : float
        How far a flank wanders within a log that no curve follows [N·m of twist]; 0 if it does not.
    """

    variables: tuple[str, ...]
    curve: Curve | None
    bursts: Bursts
    beyond_names: bool
    slips: float = 0.0

    @classmethod
    def without_curve(cls, variables: tuple[str, ...]) -> "Unexplained":
        """Name the variables only: the balances gave no curve."""
        return cls(variables, None, Bursts(0.0, ()), beyond_names=False)


def unexplained(
    before: Residual, after: Residual, named: float, *, leave: float = 1.0
) -> Unexplained | None:
    """Tell whether something is left that no name stands for.

    Parameters
    ----------
    before, after : Residual
        Without and with the named effects; the same where none was found.
    named : float
        Evidence of the named effects together.
    leave : float
        Factor on what may be left: more, where a named effect acts near rest, which the
        balances do not follow.
    """
    told = curves(after)
    left = significant(told, max(leave * CURVE, CURVE_SHARE * named))
    shots = bursts(after)
    by_the_clock = after is before and shots.period > 0.0
    few = left is None and shots.share < leave * BURSTS and not by_the_clock
    slips = wanders(before, after) if few else 0.0
    if few and slips == 0.0:
        return None
    beyond = False
    best = left
    if after is not before:
        bare = curves(before)
        top = significant(bare, CURVE)
        if top is not None and top.evidence > named:
            best, beyond, told = top, True, bare
        shots = bursts(before) if beyond else shots
    variables = alike(told, best) if best is not None else ()
    if shots.share >= BURSTS and (best is None or "time" in shots.variables[:1]):
        variables = (*variables, *shots.variables)
    if slips > 0.0 and best is None:
        variables = SLIP
    return Unexplained(tuple(dict.fromkeys(variables)), best, shots, beyond, slips)


def alike(found: Sequence[Curve], best: Curve) -> tuple[str, ...]:
    """Variables of the best curve, then of those that the logs hardly tell from it."""
    near = []
    for c in found:
        better = c.held_gain > BETTER_HELD * best.held_gain
        least = (ALIKE_HELD if better else ALIKE) * best.evidence
        if c.evidence > least and c.held_gain > HELD:
            near.append(c)
    names = [name for c in (best, *near) for name in c.variables]
    return tuple(dict.fromkeys(names))


def significant(found: Sequence[Curve], least: float) -> Curve | None:
    """Return the best curve with enough evidence, on the held-out logs too."""
    return next((c for c in found if c.evidence > least and c.held_gain > HELD), None)
