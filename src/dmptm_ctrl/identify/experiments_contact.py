"""Gap damping c_f by a fit to flights of the pinions from flank to flank.

The paper takes for c_f the "value with a higher degree of fitting with the measured data"
(section 4.2.2). While the ring gear rests and a pinion flies, nothing acts on it but

    J̄3 ω̇3 = N1 K_d K_M u − T3(ω3) − c_f ω3

so that flights under several voltages separate the damping from the dry friction. What else
enters is held by the standard error with which the other experiments know it; B3 above all,
since in flight only B3 + c_f is seen. (c is fitted by :mod:`.experiments_dynamic`.)
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from dmptm_ctrl.drive import Drive, pinion_inertia
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque, stribeck_law
from dmptm_ctrl.identify.experiments import Estimate, twists
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.dual import LAWS
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.model import Floats

FREE = 0.85  # of the half-gap; farther out a rounded reading may hide contact
SLOW = 0.06  # rad/s; below, the flight depends on the Stribeck drop more than on damping
SHORTEST = 15  # samples of a flight
KNOWN = (
    *("J_2", "T3s_plus", "T3c_plus", "W3_plus", "B3_plus"),
    *("T3s_minus", "T3c_minus", "W3_minus", "B3_minus"),
)


class _Flight(NamedTuple):
    """Angle [rad] of a pinion at consecutive samples, and the torque [N·m] that drives it."""

    angle: Floats
    torque: float
    speed: float  # rad/s, at its start, roughly


def gap_damping(drive: Drive, log: Log, known: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Fit c_f to a log of pinions pushed from flank to flank.

    Parameters
    ----------
    drive : Drive
        Start value of c_f, and all that is not in `known`.
    log : Log
        Voltages switched between constant levels, several levels; motor and ring-gear angles.
    known : mapping of str to Estimate
        What other experiments found; J_2 and the T3…, W3…, B3… are used.

    Returns
    -------
    dict of str to Estimate
        ``c_f`` [N·m·s/rad].

    Raises
    ------
    ValueError
        Fewer than four flights in the log.
    """
    flights = _flights(log, drive)
    if len(flights) < 4:
        raise ValueError(f"{log.name}: {len(flights)} flights through a gap, at least 4 are needed")
    dt = log.sample_time
    names = [n for n in KNOWN if n in known]
    centre = np.array([drive["c_f"], *(known[n].value for n in names)])
    scale = np.array([0.1, *(known[n].se for n in names)])
    count = np.abs(np.diff(log["theta_ml"]))
    sigma = count[count > 0.0].min() / drive["N_1"] / np.sqrt(12.0)

    def residual(q: Floats) -> Floats:
        values = dict(zip(["c_f", *names], (centre + scale * q).tolist(), strict=True))
        changed = drive.with_values(**values)
        miss = [_miss(flight, changed, dt) / sigma for flight in flights]
        return np.concatenate([*miss, q[1:]])

    fit = least_squares(residual, np.zeros(centre.size), diff_step=1e-3, x_scale=1.0)
    n = fit.fun.size - (centre.size - 1)
    spread = float(fit.fun[:n] @ fit.fun[:n]) / (n - 2 * len(flights) - 1)
    covariance = max(1.0, spread) * np.linalg.inv(fit.jac.T @ fit.jac)
    value = float(centre[0] + scale[0] * fit.x[0])
    return {"c_f": Estimate(value, float(scale[0] * np.sqrt(covariance[0, 0])), "N·m·s/rad")}


def _flights(log: Log, drive: Drive) -> list[_Flight]:
    """Stretches with a pinion in its gap, on its way, the ring gear and the voltage at rest."""
    z = twists(log, drive)
    pull = drive["N_1"] * drive["K_d"] * drive["K_M"]
    steps = np.diff(log["theta_L"], prepend=log["theta_L"][0]) != 0.0
    found = []
    for s, (u_name, angle_name) in enumerate((("u_left", "theta_ml"), ("u_right", "theta_mr"))):
        u, angle = log[u_name], log[angle_name] / drive["N_1"]
        half_gap = drive["gap_l"] if s == 0 else drive["gap_r"]
        speed = np.gradient(_smooth(angle), log.sample_time)
        ready = (np.abs(z[s]) < FREE * half_gap) & (speed * np.sign(u) > SLOW) & ~steps
        ready &= np.diff(u, prepend=u[0]) == 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[0], ready.astype(int), [0]])))
        for start, stop in edges.reshape(-1, 2):
            if stop - start >= SHORTEST:
                part = slice(start, stop)
                found.append(_Flight(angle[part], float(pull * u[start]), float(speed[start])))
    return found


def _smooth(angle: Floats) -> Floats:
    return np.convolve(np.pad(angle, 2, mode="edge"), np.ones(5) / 5, "valid")


def _miss(flight: _Flight, drive: Drive, dt: float) -> Floats:
    """Measured minus flown angle [rad], start and initial speed fitted by least squares."""
    law = stribeck_law(*(drive[name] for name in LAWS[0]))
    n, inertia, c_f = flight.angle.size, pinion_inertia(drive), drive["c_f"]
    speed = flight.speed
    for change in (0.02, 0.001):  # twice, since the flight is not quite linear in its speed
        flown = _fly(n, flight.torque, speed, law, inertia, c_f, dt)
        faster = _fly(n, flight.torque, (1.0 + change) * speed, law, inertia, c_f, dt)
        basis = np.column_stack([np.ones(n), faster - flown])
        left = flight.angle - flown
        best = np.linalg.lstsq(basis, left, rcond=None)[0]
        speed *= 1.0 + change * best[1]
    return np.asarray(left - basis @ best)


@cached()
def _fly(
    n: int, torque: float, speed: float, law: Stribeck, inertia: float, c_f: float, dt: float
) -> Floats:
    """Angle [rad] of a pinion in its gap, from 0 at `speed`, by classical Runge–Kutta."""
    way = 1.0 if torque > 0.0 else -1.0
    angle, v = np.zeros(n), speed
    slope = np.zeros(4)
    for i in range(1, n):
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            w = v + share * dt * slope[stage - 1] if stage else v
            slope[stage] = (torque - way * sliding_torque(w, way, law) - c_f * w) / inertia
        angle[i] = angle[i - 1] + dt * (v + dt * (slope[0] + slope[1] + slope[2]) / 6.0)
        v += dt * (slope[0] + 2.0 * slope[1] + 2.0 * slope[2] + slope[3]) / 6.0
    return angle
