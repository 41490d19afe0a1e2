"""Inertias, mesh stiffness and damping from shaken turns (frequency response under preload).

Under preload, turning steadily, both meshes stay closed and no friction changes its sign: the
drive is the 3-DOF linear model with the slope of friction as damping. Sampled with held
voltages its response at the lines of a multisine is known exactly, so the parameters follow
by weighted least squares on the complex responses of all angles.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.drive.three_dof import three_dof_train
from dmptm_ctrl.identify.experiments import Estimate
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats

ANGLES = ("theta_ml", "theta_mr", "theta_L")
SPEEDS = ("omega_ml", "omega_mr", "omega_L")
FITTED = {"J_2": "kg·m²", "J_L": "kg·m²", "k_m": "N·m/rad", "c": "N·m·s/rad"}
SLOPES = {"B3": "N·m·s/rad", "BL": "N·m·s/rad"}
MIN_PERIODS = 4
PASSES = 2  # of noise estimate and fit
STARTS = (0.0, -0.1, 0.1)  # relative, of the stiffness
_START_INERTIA = 2.0  # J_2 is half of J̄3, which goes with the stiffness along the lower mode


@dataclass(frozen=True, eq=False)
class _Lines:
    """Spectra of one log at its excited lines.

    u (2, k) [V]; y (3, k) [rad], mean over periods; se (3,) of each complex part [rad].
    """

    omega: Floats
    u: NDArray[np.complex128]
    y: NDArray[np.complex128]
    se: Floats
    dt: float


def shaken_turns(
    drive: Drive, logs: Iterable[Log], *, period: float, lines: Sequence[float]
) -> dict[str, Estimate]:
    """Fit J_2, J_L, k_m, c and the derivatives of friction to turns shaken by multisines.

    Parameters
    ----------
    drive : Drive
        Start values; K_d, K_M, N1, N2 and J_m are taken as exact. What is found as J_2 is
        J̄3 − N1² Jm: no experiment on the whole drive splits J̄3.
    logs : iterable of Log
        Open loop, preloaded, turning one way, whole periods in steady state, with motor and
        ring-gear angles. Common and differential shaking together identify all parameters.
    period : float [s]
        Of the multisine.
    lines : sequence of float [Hz]
        Excited, whole multiples of 1/period.

    Returns
    -------
    dict of str to Estimate
        J_2, J_L, k_m, c, and B3, BL: the derivatives of friction at the turning speed.

    Raises
    ------
    ValueError
        Fewer than four whole periods, or lines that are no multiples of 1/period.
    """
    data = [_spectra(log, period, lines) for log in logs]
    names = (*FITTED, *SLOPES)
    start = {**{n: drive[n] for n in FITTED}, "B3": drive["B3_plus"], "BL": drive["BL_plus"]}

    def misses(q: Floats) -> list[NDArray[np.complex128]]:
        values = {n: start[n] * (1.0 + float(x)) for n, x in zip(names, q, strict=True)}
        return [d.y - _predict(drive, values, d) for d in data]

    # The scatter over periods misses rounding that repeats in every period; what the fit
    # leaves in a channel of a log does not. So the noise is taken from there, and again.
    sigma = [d.se for d in data]

    def solve(q: Floats) -> OptimizeResult:
        return least_squares(
            lambda q, w=tuple(sigma): _stack(misses(q), w),
            q,
            bounds=(-0.95, np.inf),
            x_scale="jac",
            diff_step=1e-4,
        )

    # A sharp resonance that starts beside the measured one may settle there: several starts.
    tries = [solve(np.array([_START_INERTIA * x, 0.0, x, 0.0, 0.0, 0.0])) for x in STARTS]
    fit = min(tries, key=lambda r: r.cost)
    for _ in range(PASSES):
        freedom = 1.0 - len(names) / fit.fun.size
        left = misses(fit.x)
        sigma = [np.sqrt(np.mean(np.abs(m) ** 2, axis=1) / 2.0 / freedom) for m in left]
        fit = solve(fit.x)
    q = fit.x
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    units = {**FITTED, **SLOPES}
    found = {}
    for i, name in enumerate(names):
        value = start[name] * (1.0 + float(q[i]))
        se = start[name] * float(np.sqrt(covariance[i, i]))
        found[name] = Estimate(value, se, units[name])
    return found


def _stack(misses: Sequence[NDArray[np.complex128]], sigma: Sequence[Floats]) -> Floats:
    scaled = [(m / s[:, None]).ravel() for m, s in zip(misses, sigma, strict=True)]
    return np.concatenate([part for m in scaled for part in (m.real, m.imag)])


def _spectra(log: Log, period: float, lines: Sequence[float]) -> _Lines:
    dt = log.sample_time
    n = round(period / dt)
    count = (len(log) - 1) // n
    if count < MIN_PERIODS:
        raise ValueError(
            f"{log.name}: {count} whole periods of {period:g} s, it needs {MIN_PERIODS}"
        )
    cycles = np.asarray(lines, float) * n * dt
    bins = np.round(cycles).astype(int)
    if np.abs(cycles - bins).max() > 1e-6:
        raise ValueError(f"lines must be whole multiples of {1 / period:g} Hz")
    omega = 2.0 * np.pi * bins / (n * dt)
    u = np.array([_line(log[c][: count * n], n, bins) for c in ("u_left", "u_right")])
    # Steps instead of angles: a steady turn is then a constant, which no line sees.
    steps = [np.diff(log[c][: count * n + 1]) for c in ANGLES]
    y = np.array([_line(s, n, bins) for s in steps]) / (np.exp(1j * omega * dt) - 1.0)
    mean_u, mean_y = u.mean(axis=1), y.mean(axis=1)
    scatter = np.sum(np.abs(y - mean_y[:, None]) ** 2, axis=1) / (count - 1)
    se = np.sqrt(scatter.mean(axis=1) / count / 2.0)
    return _Lines(omega, mean_u, mean_y, se, dt)


def _line(signal: Floats, n: int, bins: NDArray[np.int_]) -> NDArray[np.complex128]:
    """Fourier coefficients per period at the lines, (periods, k)."""
    return np.asarray(np.fft.rfft(signal.reshape(-1, n), axis=1)[:, bins] * 2.0 / n)


def _predict(drive: Drive, values: dict[str, float], d: _Lines) -> NDArray[np.complex128]:
    """Angles (3, k) [rad] of the sampled linear model for the lines of u.

    In modal coordinates ẋ = λ x + b u, θ̇ = c x, both integrated exactly over a sample with
    held u. The rigid angle stays out of x, so that no λ is zero.
    """
    changed = drive.with_values(
        **{name: values[name] for name in FITTED},
        **{f"{b}_{s}": values[b] for b in SLOPES for s in ("plus", "minus")},
    )
    a, b, c = three_dof_train(changed).matrices(outputs=SPEEDS)
    poles, vectors = np.linalg.eig(a)
    pushed = np.linalg.solve(vectors, b) @ d.u  # (states, k)
    kept = np.exp(poles * d.dt)
    gain = (kept - 1.0) / poles
    drift = (gain - d.dt) / poles
    z = np.exp(1j * d.omega * d.dt)
    x = gain[:, None] * pushed / (z - kept[:, None])
    steps = (c @ vectors) @ (gain[:, None] * x + drift[:, None] * pushed)
    return steps / (z - 1.0)
