"""Closed-loop response of the nonlinear drive to a sine, by harmonic balance.

What it is for: switch a mechanism off (gap, dry friction) and see what it does to a resonance.
"""

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.design.harmonic_balance import Balance
from dmptm_ctrl.design.harmonics import Cycle
from dmptm_ctrl.simulate.model import Floats, Model

HARMONICS = 1  # describing functions; more do not settle where pinions rattle at each reversal
BALANCED = 1e-6  # of the mesh torque, what may be left
DEPTH = 1.1  # z tried first, in half-gaps
PHASES = (1.0, 1j, -1j, -1.0)  # its cosine and minus-sine part


def closed_loop_gain(
    model: Model,
    kp: float,
    ki: float,
    hz: ArrayLike,
    amplitude: float,
    *,
    preload: float = 0.0,
    sample_time: float = 1e-3,
    harmonics: int = HARMONICS,
) -> Floats:
    """Return the first harmonic of the ring-gear speed over that of the setpoint, (n,) complex.

    NaN where no periodic motion is found.

    Parameters
    ----------
    model : Model
        Without effects but delays and lags.
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    hz : (n,) array
        Each starts from the one before.
    amplitude : float [rad/s]
        Of the setpoint; 0 dry friction and no gap make it immaterial.
    preload : float [V]
    sample_time : float [s]
    harmonics : int
    """
    balance = Balance(model, kp, ki, sample_time, preload)
    setpoint = np.array([0.0, amplitude, 0.0])
    gains = []
    last: Cycle | None = None
    for frequency in np.asarray(hz, float):
        omega = 2.0 * np.pi * frequency
        starts = [last._replace(omega=omega)] if last is not None else []
        starts += [balance.guess(DEPTH * balance.length * p, omega, setpoint) for p in PHASES]
        best: Cycle | None = None
        for start in starts:
            found = balance.solve(start, harmonics, free=False, setpoint=setpoint)
            if best is None or found.left < best.left:
                best = found
            if best.left < BALANCED:
                break
        assert best is not None
        good = best.left < BALANCED
        last = best if good else None
        n = best.ring.size // 2
        value = (best.ring[1] + 1j * best.ring[n + 1]) / amplitude if good else np.nan
        gains.append(complex(value))
    return np.array(gains)
