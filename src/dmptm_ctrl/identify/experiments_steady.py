"""Half-gaps, mesh stiffness and friction curves from runs at constant speed under preload.

At constant speed a side s with flank σ = ±1 and direction d = ±1 obeys, exactly,

    z_s = σ Δ_s + (N1 K_d K_M u_s − d T3(ω3)) / k,     Σ (N1 K_d K_M u_s − d T3) = d TL(ω_L)/N2

so that forward and reverse runs (the paper's "reverse motion", section 4.2.2) under preloads
of both signs and two sizes give Δ, k, T3(ω3) and TL(ω_L) by one linear least squares.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law
from dmptm_ctrl.identify.experiments import (
    SUM_DIFFERENCE,
    Estimate,
    Steady,
    solve_weighted,
    steady_stretches,
)
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats

MIN_SPEEDS = 5  # one more than a Stribeck branch has parameters


@dataclass(frozen=True, eq=False)
class FrictionPoints:
    """Friction of one body over speed, both directions.

    Attributes
    ----------
    body : {"3", "L"}
        Reducer with motor at the pinion, or ring gear.
    speed : (n,) array [rad/s]
        Signed, of the body.
    torque : (n,) array [N·m]
        Magnitude, against the motion.
    covariance : (n, n) array [N²·m²]
    """

    body: str
    speed: Floats
    torque: Floats
    covariance: Floats

    @property
    def se(self) -> Floats:
        """Standard errors of `torque` [N·m]."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class SteadyResult:
    """What constant-speed runs show.

    Attributes
    ----------
    estimates : mapping of str to Estimate
        gap_l, gap_r [rad], k_m [N·m/rad].
    """

    estimates: Mapping[str, Estimate]
    reducer: FrictionPoints
    ring: FrictionPoints


def constant_speed(drive: Drive, logs: Iterable[Log]) -> SteadyResult:
    """Measure half-gaps, mesh stiffness and both friction curves.

    Parameters
    ----------
    drive : Drive
        K_d, K_M, N1, N2 are used, nothing else.
    logs : iterable of Log
        Constant speeds (setpoint ``ref``) forward and backward, under preloads of both
        signs and two sizes, with motor angles. Angles of motors and ring gear share one zero.

    Returns
    -------
    SteadyResult
        ``estimates`` of gap_l, gap_r [rad] and k_m [N·m/rad]; friction over speed of ``reducer``
        and ``ring``.

    Raises
    ------
    ValueError
        Runs that leave something open: one sign or size of preload only.

    Examples
    --------
    >>> found = dm.constant_speed(dm.paper_drive(), dm.load_logs("turns"))
    >>> print(found.estimates["gap_l"])
    """
    runs = list(steady_stretches(drive, logs))
    pull = drive["N_1"] * drive["K_d"] * drive["K_M"]
    speeds = sorted({r.nominal for r in runs})
    _refuse_open(runs)
    index = {s: 3 + i for i, s in enumerate(speeds)}
    rows, values, sigma = [], [], []
    quality = _pooled_errors(runs)
    for run in runs:
        pair = np.zeros((2, 3 + len(speeds)))
        for s in (0, 1):
            pair[s, s] = np.sign(run.twist[s])
            pair[s, 2] = pull * run.volts[s]  # times 1/k
            pair[s, index[run.nominal]] = -np.sign(run.nominal)  # times T3/k
        rows += list(SUM_DIFFERENCE @ pair)
        values += list(SUM_DIFFERENCE @ run.twist)
        sigma += list(quality[abs(run.nominal)])
    scale = np.array([1e-3, 1e-3, 1e-5, *[1e-5] * len(speeds)])  # sizes of the unknowns
    x, cov = solve_weighted(np.array(rows) * scale, np.array(values), np.array(sigma))
    x, cov = x * scale, cov * np.outer(scale, scale)

    # From (1/k, T3/k) to (k, T3, TL): the derivative of each is exact.
    k = 1.0 / x[2]
    t3 = x[3:] * k
    to_t3 = np.zeros((len(speeds), x.size))
    to_t3[:, 2] = -x[3:] * k**2
    to_t3[:, 3:] = k * np.eye(len(speeds))
    cov_3 = to_t3 @ cov @ to_t3.T
    n2 = drive["N_2"]
    push, push_variance = _mean_push(runs, speeds, pull)
    ring = n2 * (push - 2.0 * t3)
    cov_ring = (2.0 * n2) ** 2 * cov_3 + n2**2 * np.diag(push_variance)
    mean_speed = np.array([np.mean([r.speed for r in runs if r.nominal == s]) for s in speeds])
    return SteadyResult(
        {
            "gap_l": Estimate(float(x[0]), float(np.sqrt(cov[0, 0])), "rad"),
            "gap_r": Estimate(float(x[1]), float(np.sqrt(cov[1, 1])), "rad"),
            "k_m": Estimate(float(k), float(k**2 * np.sqrt(cov[2, 2])), "N·m/rad"),
        },
        FrictionPoints("3", n2 * mean_speed, t3, cov_3),
        FrictionPoints("L", mean_speed, ring, cov_ring),
    )


def _refuse_open(runs: list[Steady]) -> None:
    halves = np.array([0.5 * (r.volts[0] - r.volts[1]) for r in runs])
    if not (halves.min() < 0.0 < halves.max()):
        raise ValueError("all runs have one sign of preload; runs with both are needed")
    sizes = np.abs(halves)
    if sizes.max() < 1.2 * sizes.min():
        raise ValueError("all runs have one size of preload; two are needed for gap and stiffness")
    if any(np.prod(np.sign(r.twist)) > 0 for r in runs):
        raise ValueError("a run has both pinions on the same flank; raise the preload")


def _pooled_errors(runs: list[Steady]) -> dict[float, Floats]:
    """Standard errors of the twist by speed, over all runs at that speed."""
    pooled = {}
    for speed in {abs(r.nominal) for r in runs}:
        squares = [r.twist_se**2 for r in runs if abs(r.nominal) == speed]
        pooled[speed] = np.sqrt(np.mean(squares, axis=0))
    return pooled


def _mean_push(runs: list[Steady], speeds: list[float], pull: float) -> tuple[Floats, Floats]:
    """Both motors' torque at the pinions against the motion, and variance, per speed.

    The preload cancels; what scatters from run to run is noise that the loop let through.
    """
    groups = [
        np.array([np.sign(s) * pull * r.volts.sum() for r in runs if r.nominal == s])
        for s in speeds
    ]
    freedom = sum(g.size - 1 for g in groups)
    scatter = sum(float(np.sum((g - g.mean()) ** 2)) for g in groups) / max(1, freedom)
    return np.array([g.mean() for g in groups]), np.array([scatter / g.size for g in groups])


def stribeck_fit(points: FrictionPoints) -> dict[str, Estimate]:
    """Fit both branches of Eq. 25 to friction points, with δ = 1 as in the paper.

    Returns
    -------
    dict of str to Estimate
        By the names of the drive: ``T3s_plus`` … ``BL_minus``. The static value is the
        branch's end at zero speed; ramps measure it directly.

    Raises
    ------
    ValueError
        Fewer than five speeds in a direction.
    """
    found = {}
    for sign, label in ((1.0, "plus"), (-1.0, "minus")):
        here = np.flatnonzero(np.sign(points.speed) == sign)
        here = here[np.argsort(np.abs(points.speed[here]))]
        if here.size < MIN_SPEEDS:
            raise ValueError(
                f"{here.size} speeds in direction {label}, a Stribeck branch needs {MIN_SPEEDS}"
            )
        speed, torque = np.abs(points.speed[here]), points.torque[here]
        covariance = points.covariance[np.ix_(here, here)]
        names = [f"T{points.body}s", f"T{points.body}c", f"W{points.body}", f"B{points.body}"]
        units = ("N·m", "N·m", "rad/s", "N·m·s/rad")
        values, spread = _branch(speed, torque, covariance)
        for name, unit, value, variance in zip(names, units, values, np.diag(spread), strict=True):
            found[f"{name}_{label}"] = Estimate(float(value), float(np.sqrt(variance)), unit)
    return found


def _branch(speed: Floats, torque: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Ts, Tc, Ω, B and their covariance by generalised least squares."""
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def model(q: Floats) -> Floats:
        law = stribeck_law(q[0], q[1], q[2], q[3], q[0], q[1], q[2], q[3], 1.0)
        return np.array([sliding_torque(w, 1.0, law) for w in speed])

    slope, level = np.polyfit(speed[-3:], torque[-3:], 1)
    start = np.array([max(torque[0], level), level, np.median(speed) / 2.0, max(slope, 1e-3)])
    size = np.array([level, level, start[2], start[3]])
    fit = least_squares(
        lambda q: whiten @ (model(q * size) - torque),
        start / size,
        x_scale=np.array([0.1, 0.1, 0.5, 0.5]),
        bounds=([0.0, 0.0, 1e-3, 0.0], np.inf),
    )
    left = max(1.0, 2.0 * fit.cost / max(1, speed.size - 4))
    return fit.x * size, left * np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(size, size)
