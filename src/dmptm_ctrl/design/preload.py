"""Preload: how much keeps both meshes closed, and what it costs."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import Duty, sine
from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.compiled import close_loop
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites

NEAR_REVERSAL = 0.05  # s
# schedule → common voltages, over the bias, between which it fades; equal ones keep it
SCHEDULES = {"constant": (0.0, 0.0), "fades late": (1.0, 2.5), "fades early": (0.3, 1.0)}


def load_torque_along(model: Model, duty: Duty, theta_L: float = 0.0) -> Floats:
    """Return the torque that the ring gear takes along a duty [N·m], (n,).

    Inertia, friction with its effects, and the load's effects; of the kernels.
    """
    sites = Sites(model)
    angle = theta_L + np.cumsum(duty.reference) * duty.sample_time
    rate = duty.acceleration
    torque = np.empty(duty.reference.size)
    for i, (theta, omega) in enumerate(zip(angle, duty.reference, strict=True)):
        t = i * duty.sample_time
        way = float(np.sign(omega))
        held = way * sites.sliding(RING, way, theta, omega, t, 0.0) if way else 0.0
        torque[i] = sites.ring_inertia * rate[i] + held - sites.load_torque(theta, omega, t)
    return torque


def smallest_preload(model: Model, duty: Duty, theta_L: float = 0.0) -> float:
    """Return the least preload [V] that keeps both meshes closed along a duty.

    Each mesh carries half of the load's torque; the preload has to outweigh that half in
    the mesh that would open:  u_b > max |T_load| / (2 N2 N1 K_d K_M).

    Parameters
    ----------
    model : Model
    duty : Duty
    theta_L : float [rad]
        Where it starts.

    Returns
    -------
    float [V]
    """
    sites = Sites(model)
    worst = float(np.abs(load_torque_along(model, duty, theta_L)).max())
    return worst / (2.0 * sites.n2 * sites.n1 * sites.gain)


class Preload(NamedTuple):
    """A duty under one preload.

    Attributes
    ----------
    open_share : float
        Share of the judged time in which at least one mesh carries nothing or its teeth have
        left their side.
    error : float [deg/s]
        RMS tracking error.
    torque : float [N·m]
        RMS torque of a motor.
    friction : float [N·m]
        Mean friction that the preload adds in both reducers, seen at the pinions.
    reversal_error : float [deg/s]
        RMS tracking error within :data:`NEAR_REVERSAL` of a reversal of the setpoint.
    """

    open_share: float
    error: float
    torque: float
    friction: float
    reversal_error: float


def assess_preload(model: Model, controller: Controller, duty: Duty) -> Preload:
    """Run a duty and tell whether the preload kept both meshes closed, and what it cost."""
    law = controller.law()
    u, out = close_loop(model, law, duty.reference, duty.sample_time)
    judged = slice(round(duty.settling / duty.sample_time), None)
    left, right = out[judged, 4], out[judged, 5]
    way = 1.0 if controller.preload >= 0.0 else -1.0
    opened = (way * left <= 0.0) | (way * right >= 0.0)
    miss = np.rad2deg(out[judged, 1] - duty.reference[judged])
    sites = Sites(model)
    friction = 0.0
    for side, mesh in ((0, left), (1, right)):
        mean = float(np.abs(mesh).mean())
        friction += sites.sliding(side, 1.0, 0.0, 0.0, 0.0, mean)
        friction -= sites.sliding(side, 1.0, 0.0, 0.0, 0.0, 0.0)
    return Preload(
        float(opened.mean()),
        float(np.sqrt(np.mean(miss**2))),
        float(sites.gain * np.sqrt(np.mean(u[:, judged] ** 2))),
        float(friction),
        float(np.sqrt(np.mean(miss[_reversing(duty)[judged]] ** 2))),
    )


def _reversing(duty: Duty) -> NDArray[np.bool_]:
    """Samples near a change of the setpoint's sign; all of them where there is none."""
    sign = np.sign(duty.reference)
    at = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    at = np.append(at, np.flatnonzero((sign[1:-1] == 0.0) & (sign[:-2] * sign[2:] < 0.0)))
    if at.size == 0:
        return np.ones(sign.size, bool)
    gap = np.abs(np.arange(sign.size)[:, None] - at).min(axis=1)
    return np.asarray(gap * duty.sample_time <= NEAR_REVERSAL, bool)


def schedules(
    model: Model, controller: Controller, duty: Duty, preloads: ArrayLike
) -> dict[str, list[Preload]]:
    """Compare preloads that stay with preloads that fade where the drive works hard.

    Torque-bias profiles of dual drives give full bias near rest and reversals and let it fade
    with the torque that is asked for (ref. 15 of the paper, Gawronski et al. 2000). Measured in
    the common voltage of the motors: "constant"; "fades late", between 1.0 and 2.5 times the
    bias; "fades early", between 0.3 and 1.0 times: tension at reversals only.

    Parameters
    ----------
    model : Model
    controller : Controller
        Its own preload and relief are replaced.
    duty : Duty
    preloads : (n,) array [V]

    Returns
    -------
    dict
        Name of the schedule → a :class:`Preload` per preload.
    """
    found: dict[str, list[Preload]] = {}
    for name, (begin, end) in SCHEDULES.items():
        found[name] = [
            assess_preload(
                model,
                replace(controller, preload=b, relief_from=begin * b, relief_to=end * b),
                duty,
            )
            for b in map(float, np.asarray(preloads, float))
        ]
    return found


def boundary(
    model: Model,
    controller: Controller,
    accelerations: ArrayLike,
    *,
    hz: float = 1.0,
    n_jobs: int | None = None,
) -> tuple[Floats, Floats]:
    """Return the least preload [V] for sines of these peak accelerations [rad/s²].

    Two answers: by the balance (:func:`smallest_preload`) and by bisection on the simulated
    loop, where a mesh must not open at any sample of the second period.

    Parameters
    ----------
    model : Model
    controller : Controller
    accelerations : (n,) array [rad/s²]
    hz : float
        Of the sines.
    n_jobs : int, optional
        joblib's, by default 1.

    Returns
    -------
    closed_form, simulated : (n,) arrays [V]
    """
    peaks = np.asarray(accelerations, float)
    tasks = ((model, controller, float(peak), hz) for peak in peaks)
    found = np.array(list(each(_least, tasks, n_jobs))).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _least(model: Model, controller: Controller, peak: float, hz: float) -> tuple[float, float]:
    """Least preload for one sine, by the balance and by bisection."""
    dt = controller.sample_time
    duty = Duty(sine(peak / (2.0 * np.pi * hz), hz, 2.0, dt), dt, settling=1.0 / hz)
    least = smallest_preload(model, duty)
    low, high = 0.0, 6.0 * least
    while high - low > 0.01 * least:
        middle = 0.5 * (low + high)
        tried = replace(controller, preload=middle)
        if assess_preload(model, tried, duty).open_share > 0.0:
            low = middle
        else:
            high = middle
    return least, high
