"""Preload: how much keeps both meshes closed, and what it costs."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import Duty, sine
from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.compiled import close_loop
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites


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
    """

    open_share: float
    error: float
    torque: float
    friction: float


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
    )


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
