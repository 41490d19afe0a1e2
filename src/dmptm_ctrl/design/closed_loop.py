"""Closed-loop response of the nonlinear drive to a sine, by harmonic balance.

What it is for: switch a mechanism off (gap, dry friction) and see what it does to a resonance.
"""

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.design.harmonic_balance import Balance
from dmptm_ctrl.design.harmonics import Cycle
from dmptm_ctrl.simulate.model import Floats, Model

SAMPLE_TIME = 1e-3  # s
HARMONICS = 1  # describing functions; more do not settle where pinions rattle at each reversal
BALANCED = 1e-6  # of the mesh torque, what may be left
DEPTH = 1.1  # z tried first, in half-gaps
PHASES = (1.0, 1j, -1j, -1.0)  # its cosine and minus-sine part


def closed_loop_gain(model: Model, kp: float, ki: float, hz: ArrayLike, amplitude: float) -> Floats:
    """Return the first harmonic of the ring-gear speed over that of the setpoint, (n,) complex.

    Each frequency starts from the one before; NaN where no periodic motion is found. The amplitude
    is the setpoint's [rad/s]; the model may have delays and lags as its only effects.
    """
    balance = Balance(model, kp, ki, SAMPLE_TIME)
    setpoint = np.array([0.0, amplitude, 0.0])
    gains = []
    last: Cycle | None = None
    for frequency in np.asarray(hz, float):
        omega = 2.0 * np.pi * frequency
        starts = [last._replace(omega=omega)] if last is not None else []
        starts += [balance.guess(DEPTH * balance.length * p, omega, setpoint) for p in PHASES]
        best: Cycle | None = None
        for start in starts:
            found = balance.solve(start, HARMONICS, free=False, setpoint=setpoint)
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
