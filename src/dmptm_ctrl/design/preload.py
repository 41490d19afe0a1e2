"""Preload: how much keeps both meshes closed, and what it costs."""

import numpy as np

from dmptm_ctrl.design.duty import Duty
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
    """
    sites = Sites(model)
    worst = float(np.abs(load_torque_along(model, duty, theta_L)).max())
    return worst / (2.0 * sites.n2 * sites.n1 * sites.gain)
