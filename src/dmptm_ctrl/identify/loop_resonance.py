"""PI gains that put the closed loop's resonance where it was seen.

The paper does not print its gains, only "the 5.5 Hz resonance point after the system is
closed" (section 4.3.4). That fixes one of two gains: for each kp there is one ki.
"""

from math import log
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from dmptm_ctrl.drive import pinion_inertia
from dmptm_ctrl.identify.frequency_response import stepped_sine
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.model import Model

SPAN = 1.8  # the response is measured from hz / SPAN to hz SPAN
POINTS = 13
NEAR = 1.15  # and again within this factor of the largest, for the parabola
CLOSE = 0.03  # relative; impact chatter makes the peak that rough
LIMIT = 10.0  # V, clip of the rig's voltage


class ResonantGains(NamedTuple):
    """Gains and the closed-loop resonance that they give on the nonlinear drive."""

    kp: float  # V/(rad/s)
    ki: float  # V/rad
    hz: float
    peak: float  # gain at the resonance
    amplitude: float  # rad/s, of the setpoint that it was measured with


def closed_loop_peak(
    model: Model, loop: Loop, amplitude: float, around_hz: float
) -> tuple[float, float, bool]:
    """Return frequency [Hz] and height of the closed loop's resonance, and whether there is one.

    Stepped sine of `amplitude` [rad/s] about `around_hz`, again about the largest, and a
    parabola through these in logarithms. Without a peak it is an end of the range.
    """
    grid = np.geomspace(around_hz / SPAN, around_hz * SPAN, POINTS)
    gain = np.abs(stepped_sine(model, grid, amplitude, loop=loop).values)
    top = int(gain.argmax())
    if top in (0, POINTS - 1):
        return float(grid[top]), float(gain[top]), False
    fine = np.geomspace(grid[top] / NEAR, grid[top] * NEAR, POINTS)
    measured = stepped_sine(model, fine, amplitude, loop=loop)
    x, y = np.log(measured.hz), np.log(np.abs(measured.values))
    parabola = np.polyfit(x - x.mean(), y, 2)
    at = -parabola[1] / (2.0 * parabola[0]) if parabola[0] < 0.0 else 0.0
    at = min(max(at, x[0] - x.mean()), x[-1] - x.mean())
    return float(np.exp(x.mean() + at)), float(np.exp(np.polyval(parabola, at))), True


def resonant_gains(model: Model, hz: float, kp: float, amplitude: float) -> ResonantGains:
    """Find the ki that puts the closed loop's resonance at a frequency.

    Parameters
    ----------
    model : Model
        Nonlinear: the resonance depends on the amplitude.
    kp : float [V/(rad/s)]
    amplitude : float [rad/s]
        Of the setpoint.

    Raises
    ------
    ValueError
        No such ki: the loop with this kp has no resonance there.
    """

    def miss(log_ki: float) -> float:
        loop = Loop(kp, float(np.exp(log_ki)), LIMIT)
        return closed_loop_peak(model, loop, amplitude, hz)[0] - hz

    # The rigid drive on an integrator resonates at ω² ≈ ki K/J, friction pulls it down.
    drive = model.drive
    inertia = drive["J_L"] + 2.0 * drive["N_2"] ** 2 * pinion_inertia(drive)
    pull = 2.0 * drive["N_1"] * drive["N_2"] * drive["K_d"] * drive["K_M"]
    guess = (2.0 * np.pi * hz) ** 2 * inertia / pull
    none = f"no ki puts a resonance at {hz:g} Hz with kp {kp:.3g} V/(rad/s)"
    try:
        found = float(np.exp(brentq(miss, log(0.7 * guess), log(1.8 * guess), xtol=1e-3)))
    except ValueError:  # no change of sign
        raise ValueError(none) from None
    at, peak, inside = closed_loop_peak(model, Loop(kp, found, LIMIT), amplitude, hz)
    if not inside or peak < 1.0 or abs(at / hz - 1.0) > CLOSE:
        raise ValueError(f"{none}: the largest gain is {peak:.2g} at {at:.3g} Hz")
    return ResonantGains(kp, found, at, peak, amplitude)
