"""Estimates from experiments, and the means over steady stretches that several rest on."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats

SUM_DIFFERENCE = np.array([[1.0, 1.0], [1.0, -1.0]])
BATCHES = 10  # of a stretch; the scatter of their means gives its standard error
SETTLE = 0.5  # s, left out at the start of a stretch
SHORTEST = 1.0  # s, of what is kept of it


class Estimate(NamedTuple):
    """A value with its standard error."""

    value: float
    se: float
    unit: str

    def __str__(self) -> str:
        digits = max(0, 1 - int(np.floor(np.log10(self.se)))) if 0 < self.se < np.inf else 6
        return f"{self.value:.{min(digits, 12)}f} ± {self.se:.2g} {self.unit}".rstrip()


class Steady(NamedTuple):
    """Means over a stretch at constant speed.

    Attributes
    ----------
    speed : float [rad/s]
        Of the ring gear.
    volts : (2,) array [V]
    twist : (2,) array [rad]
        z = θm/N1 − N2 θL of both sides.
    twist_se : (2,) array [rad]
        Of the sum and the difference of both twists: they share the ring gear's reading, so
        that their own errors are not independent, but those of sum and difference are.
    nominal : float [rad/s]
        The setpoint; stretches with the same one belong together.
    """

    speed: float
    volts: Floats
    twist: Floats
    twist_se: Floats
    nominal: float


def twists(log: Log, drive: Drive) -> Floats:
    """Return z = θm/N1 − N2 θL [rad] of both sides, (2, n).

    Raises
    ------
    MissingChannelError
        A log without motor angles.
    """
    motors = np.array([log["theta_ml"], log["theta_mr"]])
    return motors / drive["N_1"] - drive["N_2"] * log["theta_L"]


def steady_stretches(drive: Drive, logs: Iterable[Log]) -> Iterator[Steady]:
    """Yield the means over each stretch of constant, non-zero setpoint.

    Parameters
    ----------
    logs : iterable of Log
        With setpoint ``ref`` and both motor angles.

    Raises
    ------
    MissingChannelError
        A log without ``ref`` or motor angles.
    ValueError
        No such stretch in any log.
    """
    found = False
    for log in logs:
        dt, ref = log.sample_time, log["ref"]
        z = twists(log, drive)
        u = np.array([log["u_left"], log["u_right"]])
        edges = np.flatnonzero(np.diff(ref) != 0.0) + 1
        for start, stop in zip([0, *edges], [*edges, ref.size], strict=True):
            begin = start + round(SETTLE / dt)
            if ref[start] == 0.0 or (stop - begin) * dt < SHORTEST:
                continue
            found = True
            part = slice(begin, stop)
            yield Steady(
                speed=float(log["omega_L"][part].mean()),
                volts=u[:, part].mean(axis=1),
                twist=z[:, part].mean(axis=1),
                twist_se=standard_error(SUM_DIFFERENCE @ z[:, part]),
                nominal=float(ref[start]),
            )
    if not found:
        raise ValueError(f"no stretch of constant speed of {SETTLE + SHORTEST:g} s or longer")


def standard_error(signal: Floats) -> Floats:
    """Standard error of the mean over the last axis, by batch means."""
    size = signal.shape[-1] // BATCHES
    batches = signal[..., : size * BATCHES].reshape(*signal.shape[:-1], BATCHES, size).mean(-1)
    return np.asarray(batches.std(axis=-1, ddof=1) / np.sqrt(BATCHES))


def solve_weighted(matrix: Floats, values: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """Return least-squares solution and covariance.

    The covariance grows with the misfit where that exceeds `sigma`, never shrinks.
    """
    a, b = matrix / sigma[:, None], values / sigma
    solution = np.linalg.lstsq(a, b, rcond=None)[0]
    left = b - a @ solution
    spread = max(1.0, float(left @ left) / max(1, b.size - solution.size))
    covariance = spread * np.linalg.inv(a.T @ a)
    return np.asarray(solution, float), np.asarray(covariance, float)
