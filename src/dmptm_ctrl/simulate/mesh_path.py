"""One mesh along a prescribed motion: Eq. 21 beside the two-state original it stands for.

Eq. 21 has no memory: it takes the position in the gap as if ż had been what it is now since
the teeth parted. The original has the position as a state. They agree while ż is constant in
the gap and part where it changes within the relaxation time (c + c_f)/k.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.effects.backlash import Backlash, gap_rate, mesh_torque, twist_torque

Floats = NDArray[np.float64]
STEPS = 50  # per relaxation time; classical Runge–Kutta, error below 1e-8 of it


class MeshPath(NamedTuple):
    """Torques [N·m] and position in the gap [rad] over time [s], (n,) arrays."""

    time: Floats
    z: Floats
    memoryless: Floats
    two_state: Floats
    position: Floats


def along_path(
    z: Callable[[float], float],
    z_rate: Callable[[float], float],
    duration: float,
    p: Backlash,
    *,
    position: float = 0.0,
) -> MeshPath:
    """Lead one mesh along z(t) and return both torques.

    `z` and `z_rate` are functions of time [s], the relative angle [rad] and its rate; `p` is the
    law; `position` [rad] is that in the gap at the start. ValueError without any damping.
    """
    relaxation = (p.damping + p.gap_damping) / p.stiffness
    if relaxation <= 0.0:
        raise ValueError("c + c_f is 0: an undamped tooth has no place in its gap")
    n = int(np.ceil(duration / relaxation * STEPS))
    h = duration / n
    time = np.asarray(h * np.arange(n + 1), float)
    place = np.empty(n + 1)
    place[0] = position
    for i, t in enumerate(time[:-1]):
        x = place[i]
        k1 = gap_rate(x, z(t), z_rate(t), p)
        k2 = gap_rate(x + 0.5 * h * k1, z(t + 0.5 * h), z_rate(t + 0.5 * h), p)
        k3 = gap_rate(x + 0.5 * h * k2, z(t + 0.5 * h), z_rate(t + 0.5 * h), p)
        k4 = gap_rate(x + h * k3, z(t + h), z_rate(t + h), p)
        new = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        place[i + 1] = min(max(new, -p.half_gap), p.half_gap)  # a flank stops it
    angle, rate = np.array([z(t) for t in time]), np.array([z_rate(t) for t in time])
    pairs = list(zip(angle.tolist(), rate.tolist(), strict=True))
    return MeshPath(
        time,
        angle,
        np.array([mesh_torque(a, b, p) for a, b in pairs]),
        np.array([twist_torque(x, a, b, p) for x, (a, b) in zip(place, pairs, strict=True)]),
        place,
    )
