"""Where in the plane of the gains a loop hammers, and where a linear model would say so."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.control.pi import outside_poles, sampled_drive, sampled_pi
from dmptm_ctrl.design.duty import DEG
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.model import Floats, Model

SECONDS = 5.0
WATCHED = 0.4  # of the run, at its end
LIMIT = 10.0  # V


class StabilityMap(NamedTuple):
    """Oscillation of the loop over its gains."""

    kp: Floats  # (m,) [V/(rad/s)]
    ki: Floats  # (n,) [V/rad]
    amplitude: Floats  # (m, n): √2 times the rms of the speed while it should be steady [rad/s]
    linear: Floats  # (m, n): whether the linearised, sampled loop is stable


def stability_map(
    model: Model,
    kp: ArrayLike,
    ki: ArrayLike,
    *,
    speed: float = 10.0 * DEG,
    preload: float = 0.0,
    sample_time: float = 1e-3,
    n_jobs: int = -1,
) -> StabilityMap:
    """Step the setpoint [rad/s] of the PI loop for every pair of gains, and see what lasts.

    `kp` is (m,) [V/(rad/s)], `ki` (n,) [V/rad], `preload` in V; `n_jobs` as for `simulate_batch`.
    """
    kps, kis = np.asarray(kp, float), np.asarray(ki, float)
    time = np.arange(round(SECONDS / sample_time)) * sample_time
    target = np.full(time.size, speed)  # a step: what can hammer is set off
    loops = [Loop(p, i, LIMIT, preload, -preload) for p in kps for i in kis]
    runs = simulate_batch(
        [model] * len(loops), time, target, loop=loops, outputs=["omega_L"], n_jobs=n_jobs
    )
    end = runs.outputs[:, 0, round((1.0 - WATCHED) * time.size) :]
    held = sampled_drive(linear_plant(model), sample_time)
    stable = [
        outside_poles(held * sampled_pi(loop.kp, loop.ki, sample_time)).size == 0 for loop in loops
    ]
    shape = kps.size, kis.size
    return StabilityMap(
        kps, kis, np.sqrt(2.0) * end.std(axis=1).reshape(shape), np.array(stable).reshape(shape)
    )
