"""PI gains from bandwidth and phase margin on a linear model.

At a crossover ω_c the controller must have gain 1/|G| and phase −180° + φ_m − arg G; both
follow in closed form, and ω_c is searched until the closed loop has the bandwidth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, log10, pi, radians, sin

import control as ct
import numpy as np
from scipy.optimize import brentq

from dmptm_ctrl.control.pi import (
    common_mode,
    loop_response,
    outside_poles,
    sampled_drive,
    sampled_pi,
)
from dmptm_ctrl.control.sections import Section, in_series

SAMPLE_TIME = 1e-3  # s; the rig's loop, physics section 5
MARGIN_SLACK_DEG = 5.0  # between the sum of a sampled integrator and an integral
GRID = 4000  # log-spaced frequencies; some 30 in the width of the sharpest resonance


@dataclass(frozen=True)
class PiTuning:
    """Gains and what the linear loop does with them."""

    kp: float  # V/(rad/s)
    ki: float  # V/rad
    crossover_hz: float  # where the open loop is 1
    bandwidth_hz: float  # where the closed loop falls 3 dB below 1
    phase_margin_deg: float
    gain_margin_db: float  # the smallest over all frequencies where the phase is −180°
    peak: float  # largest closed-loop gain

    def __str__(self) -> str:
        return (
            f"kp {self.kp:.4g} V/(rad/s), ki {self.ki:.4g} V/rad\n"
            f"crossover {self.crossover_hz:.3g} Hz, bandwidth {self.bandwidth_hz:.3g} Hz, "
            f"phase margin {self.phase_margin_deg:.1f} deg, gain margin {self.gain_margin_db:.1f} "
            f"dB,\nlargest closed-loop gain {self.peak:.3g}"
        )


def gains_at(response: complex, omega: float, phase_margin_deg: float) -> tuple[float, float]:
    """Return (kp, ki) that cross 1 at `omega` [rad/s] with the phase margin, in closed form."""
    phase = -pi + radians(phase_margin_deg) - atan2(response.imag, response.real)
    return cos(phase) / abs(response), -omega * sin(phase) / abs(response)


def tune_pi(
    plant: ct.StateSpace,
    bandwidth_hz: float,
    phase_margin_deg: float = 60.0,
    *,
    sample_time: float = SAMPLE_TIME,
) -> PiTuning:
    """Find the PI gains of the speed loop, the same voltage on all motors.

    Parameters
    ----------
    plant : StateSpace
        One voltage [V] in, or one per motor; ``omega_L`` [rad/s] among its outputs.
    bandwidth_hz : float [Hz]
        Frequency at which the closed loop falls 3 dB below 1.
    phase_margin_deg : float [deg]
        Between 20 and 90. What is reached differs by some degrees, since the loop is sampled.
    sample_time : float [s]
        Of the loop. The delay of sampling counts in the margins.

    Returns
    -------
    PiTuning
        ``kp`` [V/(rad/s)], ``ki`` [V/rad], ``crossover_hz``, ``bandwidth_hz``,
        ``phase_margin_deg``, ``gain_margin_db``, and ``peak``, the largest closed-loop gain.

    Raises
    ------
    ValueError
        A phase margin outside its range, or aims that no PI meets: a gain would be negative,
        or the loop unstable.

    Examples
    --------
    >>> pi = dm.tune_pi(dm.three_dof(dm.paper_drive()), bandwidth_hz=20.0)
    >>> round(pi.kp, 1), round(pi.ki)  # V/(rad/s), V/rad
    (17.6, 901)
    >>> print(pi)
    kp 17.63 V/(rad/s), ki 901.1 V/rad
    crossover 14.5 Hz, bandwidth 20.2 Hz, phase margin 60.9 deg, gain margin 9.5 dB,
    largest closed-loop gain 1.29
    """
    if not 20.0 <= phase_margin_deg <= 90.0:
        raise ValueError(f"phase margin {phase_margin_deg:g}°, it must be between 20 and 90")
    if not 0.0 < bandwidth_hz < 0.25 / sample_time:
        raise ValueError(
            f"bandwidth {bandwidth_hz:g} Hz is not between 0 and a quarter of the sample rate"
        )
    aims = f"{bandwidth_hz:g} Hz with {phase_margin_deg:g}°"
    drive = common_mode(plant)
    target = 2.0 * pi * bandwidth_hz

    def excess(crossover: float) -> float:
        """Closed-loop gain at the wanted bandwidth over −3 dB, in logarithm."""
        kp, ki = gains_at(loop_response(drive, crossover, sample_time), crossover, phase_margin_deg)
        open_loop = (kp + ki / (1j * target)) * loop_response(drive, target, sample_time)
        return float(np.log(abs(open_loop / (1 + open_loop)) * np.sqrt(2.0)))

    low, high = target / 20.0, target
    if excess(low) * excess(high) > 0.0:
        raise ValueError(f"no PI gives {aims} on this plant")
    crossover = brentq(excess, low, high, xtol=1e-9 * target)
    kp, ki = gains_at(loop_response(drive, crossover, sample_time), crossover, phase_margin_deg)
    if kp <= 0.0 or ki <= 0.0:
        raise ValueError(
            f"{aims} would need kp {kp:.3g} V/(rad/s) and "
            f"ki {ki:.3g} V/rad; lower the bandwidth or the margin"
        )
    found = assess_pi(plant, kp, ki, sample_time=sample_time)
    if found.phase_margin_deg < phase_margin_deg - MARGIN_SLACK_DEG:
        raise ValueError(
            f"{aims} makes a resonance cross 1 again, at "
            f"{found.crossover_hz:.3g} Hz with {found.phase_margin_deg:.3g}°; lower the bandwidth"
        )
    return found


def assess_pi(
    plant: ct.StateSpace,
    kp: float,
    ki: float,
    *,
    sample_time: float = SAMPLE_TIME,
    sections: Sequence[Section] = (),
) -> PiTuning:
    """Return margins, crossover and bandwidth of the sampled PI loop with given gains.

    Parameters
    ----------
    plant : StateSpace
        One voltage [V] in, or one per motor; ``omega_L`` [rad/s] among its outputs.
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    sample_time : float [s]
    sections : sequence of (b0, b1, b2, a1, a2)
        Second-order difference equations behind the PI.

    Returns
    -------
    PiTuning
        Printed with units; ``crossover_hz``, ``bandwidth_hz``, ``phase_margin_deg``,
        ``gain_margin_db``, and ``peak``, the largest closed-loop gain.

    Raises
    ------
    ValueError
        The loop is unstable.

    Examples
    --------
    >>> found = dm.margins(dm.three_dof(dm.paper_drive()), kp=5.0, ki=90.0)
    >>> round(found.phase_margin_deg), round(found.gain_margin_db)
    (63, 21)
    """
    held = sampled_drive(plant, sample_time)
    controller = in_series(sampled_pi(kp, ki, sample_time), sections, sample_time)
    unstable = outside_poles(held * controller)
    if unstable.size:
        hz = np.abs(np.angle(unstable)) / (2.0 * pi * sample_time)
        raise ValueError(
            f"the loop is unstable at {hz.max():.3g} Hz with kp {kp:.3g} V/(rad/s), "
            f"ki {ki:.3g} V/rad; lower the gains or the bandwidth"
        )
    omega = np.geomspace(1e-2, 0.999 * pi / sample_time, GRID)
    shift = np.exp(1j * omega * sample_time)
    response = held(shift) * controller(shift)
    closed = np.abs(response / (1.0 + response))
    gain_margin, phase_margin, _, _, crossover, _ = ct.stability_margins(ct.frd(response, omega))
    below = np.flatnonzero(closed < np.sqrt(0.5))
    last = below[0] if below.size else omega.size - 1
    bandwidth = np.interp(-np.sqrt(0.5), -closed[[last - 1, last]], omega[[last - 1, last]])
    return PiTuning(
        kp,
        ki,
        float(crossover) / (2.0 * pi),
        float(bandwidth) / (2.0 * pi),
        float(phase_margin),
        20.0 * log10(gain_margin) if np.isfinite(gain_margin) else np.inf,
        float(closed.max()),
    )
