"""Linear design to stated margins: the fastest PI that keeps them, and what no PI can beat."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray
from slycot import ab09ad

from dmptm_ctrl.control.pi import common_mode, pi_controller, sampled_drive
from dmptm_ctrl.control.sections import Section, sampled_notch
from dmptm_ctrl.control.tuning import GRID, SAMPLE_TIME, PiTuning, assess_pi, gains_at

SLOWEST_HZ = 0.3  # below, a loop is not worth closing
STEPS = 400  # of the search for the crossover; 1.3 % each
NEGLIGIBLE = 1e-5
MOST_STATES = 6  # of a plant for synthesis, whose equations are worse conditioned with each state
CLEAR = 3.0  # crossovers up, from where on no resonance may come near gain 1, whatever its phase
NOTCHES = ((0.1, 0.3), (0.1, 0.7), (0.3, 0.3), (0.3, 0.7))  # depth, width
FASTER = 1.1  # crossover over that of the PI alone, at which the resonance in its way shows
WORTH = 1.15  # gain in crossover below which a notch is not worth its numbers
HIGHEST_NOTCH = 0.45  # of the sample rate
VOLTS_PER_ERROR = 10.0  # of a controller, over the proportional gain of the PI
WEIGHT_FLOOR = 1e-3  # mixsyn wants weights without poles on the axis: the integrator's leak


class SampledPlant:
    """Frequency response of a drive, with sections, under a sampled loop, computed once."""

    def __init__(
        self,
        plant: ct.StateSpace,
        sample_time: float = SAMPLE_TIME,
        sections: Sequence[Section] = (),
    ) -> None:
        held = sampled_drive(plant, sample_time)
        self.sample_time = sample_time
        self.omega = np.geomspace(2.0 * np.pi * SLOWEST_HZ, 0.999 * np.pi / sample_time, GRID)
        self.shift = np.exp(1j * self.omega * sample_time)
        self.response = held(self.shift)
        late = 1.0 / self.shift
        for b0, b1, b2, a1, a2 in sections:
            above, below = b0 + (b1 + b2 * late) * late, 1.0 + (a1 + a2 * late) * late
            self.response = self.response * above / below

    def gains(self, crossover_hz: float, phase_margin_deg: float) -> tuple[float, float]:
        """Return (kp, ki) of the sampled PI that crosses 1 there with the margin."""
        omega = 2.0 * np.pi * crossover_hz
        at = np.interp(np.log(omega), np.log(self.omega), self.response)
        # ki dt z/(z − 1) = ki dt/2 + ki dt/(2j tan(ω dt/2)): the half joins kp, the rest is ki/jω.
        warp = 0.5 * omega * self.sample_time / np.tan(0.5 * omega * self.sample_time)
        kp, ki = gains_at(complex(at), omega, phase_margin_deg)
        return kp - 0.5 * ki / warp * self.sample_time, ki / warp

    def loop(self, kp: float, ki: float) -> NDArray[np.complex128]:
        """Return the open loop on the grid."""
        return (kp + ki * self.sample_time * self.shift / (self.shift - 1.0)) * self.response

    def tightest(self, kp: float, ki: float, crossover_hz: float) -> tuple[float, float]:
        """Return the gain margin [dB] at −180° and in any resonance, and where it is met [Hz].

        A resonance above 1 can be stable by its phase; the phase of the next drive differs.
        So from :data:`CLEAR` crossovers on the phase does not count.
        """
        loop = self.loop(kp, ki)
        turned = np.abs(np.diff(np.unwrap(np.angle(loop)) // np.pi)) > 0
        crossing = np.append(turned, False) & (loop.real < 0.0)
        crossing |= self.omega > CLEAR * 2.0 * np.pi * crossover_hz
        size = np.where(crossing, np.abs(loop), 1e-12)
        worst = int(size.argmax())
        return float(-20.0 * np.log10(size[worst])), float(self.omega[worst] / (2.0 * np.pi))


def fastest_pi(
    plant: ct.StateSpace,
    phase_margin_deg: float = 60.0,
    gain_margin_db: float = 8.0,
    *,
    highest_hz: float = 60.0,
    sample_time: float = SAMPLE_TIME,
    sections: Sequence[Section] = (),
) -> PiTuning:
    """Return the PI with the highest crossover, up to `highest_hz`, that keeps both margins.

    The gain margin also holds for resonances beyond the crossover, whatever their phase. Sections
    are notches behind the PI, see :func:`~dmptm_ctrl.control.sections.sampled_notch`. ValueError
    where not even :data:`SLOWEST_HZ` keeps the margins.
    """
    sampled = SampledPlant(plant, sample_time, sections)
    for hz in np.geomspace(highest_hz, SLOWEST_HZ, STEPS):
        kp, ki = sampled.gains(hz, phase_margin_deg)
        if kp > 0.0 and ki > 0.0 and sampled.tightest(kp, ki, hz)[0] >= gain_margin_db:
            try:
                return assess_pi(plant, kp, ki, sample_time=sample_time, sections=sections)
            except ValueError:  # unstable by what the margins do not show
                continue
    raise ValueError(
        f"no PI keeps {phase_margin_deg:g}° and {gain_margin_db:g} dB on this plant, "
        f"not even at {SLOWEST_HZ:g} Hz"
    )


class Notched(NamedTuple):
    """A PI with a notch at the resonance that limits the PI alone."""

    gains: PiTuning
    hz: float
    depth: float
    width: float


def notched_pi(
    plant: ct.StateSpace,
    alone: PiTuning,
    phase_margin_deg: float = 60.0,
    gain_margin_db: float = 8.0,
    *,
    highest_hz: float = 60.0,
    sample_time: float = SAMPLE_TIME,
) -> Notched | None:
    """Return the fastest PI with a notch where the gain margin of the PI `alone` is met.

    None where no notch gains :data:`WORTH` in crossover.
    """
    faster = SampledPlant(plant, sample_time)
    gains = faster.gains(FASTER * alone.crossover_hz, phase_margin_deg)
    _, hz = faster.tightest(*gains, FASTER * alone.crossover_hz)
    best, least = None, WORTH * alone.crossover_hz
    for depth, width in NOTCHES if hz < HIGHEST_NOTCH / sample_time else ():
        section = sampled_notch(hz, depth, width, sample_time)
        try:
            found = fastest_pi(
                plant,
                phase_margin_deg,
                gain_margin_db,
                highest_hz=highest_hz,
                sample_time=sample_time,
                sections=[section],
            )
        except ValueError:
            continue
        if found.crossover_hz > least:
            best, least = Notched(found, hz, depth, width), found.crossover_hz
    return best


class LinearReference(NamedTuple):
    """How far a PI is from the best linear controller for the same weights."""

    controller: ct.StateSpace  # of `mixsyn`, from error to voltage
    optimal: float  # largest singular value over frequency of the weighted S, K S and T
    reached: float  # the same with the PI


def linear_reference(plant: ct.StateSpace, gains: PiTuning) -> LinearReference:
    """Synthesise the H∞-optimal controller for the loop that a PI was tuned for.

    Weights: S as small below the PI's crossover as an integrator makes it and at most 2,
    K S at most :data:`VOLTS_PER_ERROR` times the PI's proportional gain, T at most 1.5 and small
    ten crossovers up. ArithmeticError where the synthesis fails, or ends above the PI.
    """
    drive = essential(common_mode(plant))
    crossover = 2.0 * np.pi * gains.crossover_hz
    w1 = ct.ss(ct.tf([0.5, crossover], [1.0, WEIGHT_FLOOR * crossover]))
    w2 = ct.ss(ct.tf([1.0 / (VOLTS_PER_ERROR * gains.kp)], [1.0]))
    w3 = ct.ss(ct.tf([1.0, 0.66 * 10 * crossover], [WEIGHT_FLOOR, 10 * crossover]))
    with warnings.catch_warnings():  # python-control's own use of what it deprecates
        warnings.simplefilter("ignore", FutureWarning)
        best, _, info = ct.mixsyn(drive, w1, w2, w3)
    pi = pi_controller(gains.kp, gains.ki)
    pi = ct.ss(pi.A, pi.B, pi.C, pi.D)
    optimal, reached = float(info[0]), _weighted_peak(drive, pi, (w1, w2, w3))
    if optimal > reached:
        raise ArithmeticError("the synthesis has no answer: its equations are ill-conditioned here")
    return LinearReference(best, optimal, reached)


def essential(sys: ct.StateSpace) -> ct.StateSpace:
    """Return a system without the states that the input hardly moves or the output hardly sees.

    By balanced truncation, to :data:`NEGLIGIBLE` of the largest Hankel singular value: what
    the two sides of a drive do against each other, mainly.
    """
    if sys.poles().real.max() >= 0.0:
        return sys
    size = sys.nstates, sys.ninputs, sys.noutputs
    *_, values = ab09ad("C", "B", "S", *size, sys.A, sys.B, sys.C)
    order = min(int(np.sum(values > NEGLIGIBLE * values[0])), MOST_STATES)
    _, a, b, c, _ = ab09ad("C", "B", "S", *size, sys.A, sys.B, sys.C, nr=order)
    return ct.ss(a, b, c, sys.D)


def _weighted_peak(plant: ct.StateSpace, controller: ct.StateSpace, weights: tuple) -> float:
    """Largest gain of the stacked weighted closed loop, over frequency."""
    omega = np.geomspace(1e-3, 1e5, 4000)
    g, k = plant(1j * omega), controller(1j * omega)
    s = 1.0 / (1.0 + g * k)
    rows = [w(1j * omega) * part for w, part in zip(weights, (s, k * s, g * k * s), strict=True)]
    return float(np.sqrt(np.sum(np.abs(rows) ** 2, axis=0)).max())
