"""What a PI loop does on the nonlinear drive: overshoot, settling, limit cycle."""

from typing import Any, NamedTuple

import numpy as np
from scipy.signal import periodogram

from dmptm_ctrl.simulate.any_model import AnyModel, loop_parts, speed_read
from dmptm_ctrl.simulate.closed import close_loop
from dmptm_ctrl.simulate.plant import Floats

BAND = 0.05  # of the step; settled is inside, and what stays outside after that oscillates
QUIET = 0.01  # of the step; amplitude below which an oscillation is called excluded
LASTING = 0.5  # the second half of the observation keeps this share of the first's amplitude


class LoopCheck(NamedTuple):
    """Step of the setpoint from rest."""

    overshoot: float  # largest excess over the step, relative to it
    settling_time: float  # s, until the mean speed stays within 5 % of the step; or infinite
    # rad/s, of the lasting oscillation: √2 times its standard deviation; 0 where it is excluded
    limit_cycle_amplitude: float
    limit_cycle_hz: float  # its strongest line; 0 where it is excluded
    time: Floats  # (n,) [s]
    omega_L: Floats  # rad/s, of a rig the controlled speed
    ref: Floats


def check_loop(
    model: AnyModel,
    loop: Any,
    speed: float,
    *,
    duration: float = 6.0,
    sample_time: float = 1e-3,
    window: float = 0.02,
) -> LoopCheck:
    """Step the setpoint from rest to `speed` [rad/s] and judge the speed that is controlled.

    Model and loop are as of :func:`~.closed.close_loop`. Try slow steps: sticking shows there. The
    last two thirds of `duration` [s] are watched for a limit cycle. Overshoot and settling are
    those of a running mean over `window` [s]: chatter of the pinions above 1/window is not the
    loop's. ValueError for a step of height 0.
    """
    if speed == 0.0:
        raise ValueError("a step of height 0 has no overshoot")
    n = round(duration / sample_time)
    time = np.asarray(np.arange(n) * sample_time, float)
    ref = np.full(n, speed, float)
    run = close_loop(model, loop, time, ref)
    source, name = (getattr(loop, part, "") for part in ("input", "sensor"))
    sensor = loop_parts(model, source, name)[1]
    omega = speed_read(model, run.outputs[sensor], sample_time, sensor)
    width = max(1, round(window / sample_time))
    smooth = np.convolve(omega, np.ones(width) / width, "same") / speed
    smooth = smooth[: n - width]  # the mean is one-sided at the end
    outside = np.flatnonzero(np.abs(smooth - 1.0) > BAND)
    last = outside[-1] + 1 if outside.size else 0
    settling = time[last] if last < smooth.size else np.inf
    amplitude, hz = _limit_cycle(omega[n // 3 :], sample_time, abs(speed))
    return LoopCheck(max(float(smooth.max()) - 1.0, 0.0), settling, amplitude, hz, time, omega, ref)


def _limit_cycle(omega: Floats, dt: float, scale: float) -> tuple[float, float]:
    """Amplitude and frequency of an oscillation that does not die out; zeros if there is none."""
    first, second = np.array_split(omega, 2)
    early, late = (np.sqrt(2.0) * float(np.std(part)) for part in (first, second))
    if late < QUIET * scale or late < LASTING * early:
        return 0.0, 0.0
    hz, power = periodogram(second, 1.0 / dt, window="hann", detrend="linear")
    return late, float(hz[power.argmax()])
