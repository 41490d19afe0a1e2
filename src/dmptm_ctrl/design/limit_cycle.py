"""Limit cycles of the speed loop, by :mod:`~dmptm_ctrl.design.harmonic_balance`.

The balance predicts; the simulator, started in the predicted state and by pulses, says what is
there (:mod:`~dmptm_ctrl.design.cycle_run`). Both numbers are returned side by side.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.design.cycle_run import STILL, Run, Simulated, run_cycles, wave_of
from dmptm_ctrl.design.harmonic_balance import Balance
from dmptm_ctrl.design.harmonics import Cycle
from dmptm_ctrl.parallel import small_matrices
from dmptm_ctrl.simulate.model import Model

# Pinions touch for 2 ms, half a period of the mesh: up to three times its frequency counts.
RESOLVED_HZ = 700.0
FEWEST, MOST = 15, 64  # harmonics
# Harmonics are added in steps; a step that loses the cycle may be taken in another way.
GROWING = ((3, 7, 15, 31), (3, 5, 7, 11, 15, 21, 31, 45))
OTHERWISE = (1.0, 0.8, 1.2, 0.7, 0.6)  # of the harmonics needed; where one grazes, another may not
FEW = (1, 3)  # harmonics of the first search
DEPTHS = (1.05, 1.3, 2.0, 4.0)  # amplitudes of z tried first, in half-gaps
HZ = (8.0, 14.0, 25.0, 45.0, 80.0, 140.0)  # frequencies tried first
SLOWEST_HZ = 3.0
ALIKE = 0.03  # relative difference in frequency below which two starts are one
SAME = 0.01  # relative difference below which two answers are one
CONFIRMED = 0.05  # relative difference of prediction and simulation that confirms
BALANCED = 1e-3  # of the mesh torque, what may be left
CERTAIN = 5e-3  # what frequency and speed may still move by
ROUGHLY = 5e-2  # of the mesh torque, what may be left on the way there


class LimitCycle(NamedTuple):
    """A periodic solution of the balance (NaN: none near), and what the simulator does there."""

    hz: float  # predicted, of the strongest harmonic of z
    amplitude: float  # predicted; of the ring-gear speed, √2 times its rms [rad/s]
    twist: float  # predicted; half the peak-to-peak of z, of the side that moves most [rad]
    # lasting oscillation that is nearest, or where a run from here ends
    simulated: Simulated | None = None
    seeded: bool = False  # whether the balance had to start from a simulated wave

    @property
    def miss(self) -> float:
        """Largest relative difference between prediction and simulation; NaN without one."""
        if self.simulated is None or np.isnan(self.simulated.hz):
            return np.nan
        predicted = np.array([self.hz, self.amplitude, self.twist])
        return float(np.abs(predicted / np.array(self.simulated) - 1.0).max())

    @property
    def confirmed(self) -> bool:
        """Whether the simulator shows it, within 5 % in frequency, amplitude and twist."""
        return self.miss <= CONFIRMED


@small_matrices
def limit_cycles(
    model: Model,
    kp: float,
    ki: float,
    *,
    preload: float = 0.0,
    sample_time: float = 1e-3,
    check: bool = True,
) -> list[LimitCycle]:
    """Return the limit cycles about rest, largest first: predicted, and as simulated.

    Harmonic balance predicts from starts of its own. With `check` the loop is simulated from
    each predicted state and after pulses; a lasting oscillation that is not predicted becomes
    a start of the balance. Several cycles may coexist, and some repel: those the simulator
    leaves, and they are not confirmed.

    Parameters
    ----------
    model : Model
        Without effects but delays and lags.
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    preload : float [V]
    sample_time : float [s]
    check : bool
        Whether to simulate.

    Returns
    -------
    list of LimitCycle
        Predicted ``hz``, ``amplitude`` [rad/s], ``twist`` [rad]; ``simulated``, ``confirmed``.

    Raises
    ------
    ValueError
        An effect that depends on angle or time, or gains that are not finite.

    Examples
    --------
    >>> for cycle in dm.limit_cycles(dm.Model(), kp=8.0, ki=3000.0):
    ...     print(cycle.hz, cycle.amplitude, cycle.confirmed)
    """
    balance = Balance(model, kp, ki, sample_time, preload)
    cycles: list[Cycle] = []
    for start in _starts(balance):
        cycle = _refined(balance, start)
        if cycle is not None and not _known(cycle, cycles):
            cycles.append(cycle)
    found = [LimitCycle(*_numbers(c)) for c in cycles]
    if check:
        found = _checked(balance, cycles, found)
    return sorted(found, key=lambda c: -c.amplitude if np.isfinite(c.amplitude) else np.inf)


def _checked(balance: Balance, cycles: list[Cycle], found: list[LimitCycle]) -> list[LimitCycle]:
    """Set the simulator beside the predictions; add what it has besides."""
    runs = run_cycles(balance, cycles)
    lasting = [run.numbers for run in runs if run.lasts]
    checked = []
    for cycle, run in zip(found, runs, strict=False):
        tried = [cycle._replace(simulated=end) for end in (run.numbers, *lasting)]
        shown = [c for c in tried if c.confirmed]
        checked.append(min(shown, key=lambda c: c.miss) if shown else tried[0])
    for run in runs:
        if not run.lasts or any(_near(run.numbers, c.simulated) for c in checked if c.confirmed):
            continue
        seeded = _from_wave(balance, run)
        checked = [c for c in checked if not (np.isnan(c.hz) and _near(run.numbers, c.simulated))]
        checked.append(seeded)
    return checked


def _from_wave(balance: Balance, run: Run) -> LimitCycle:
    """Balance a simulated wave; its numbers alone where that has no answer near."""
    best = LimitCycle(np.nan, np.nan, np.nan, run.numbers, seeded=True)
    start = wave_of(run, balance.sample_time)
    if start is None:
        return best
    for share in OTHERWISE:
        cycle = balance.solve(start, round(share * _enough(start)))
        if not _balanced(cycle) or not _moves(cycle):
            continue
        tried = LimitCycle(*_numbers(cycle), run.numbers, seeded=True)
        if np.isnan(best.hz) or tried.miss < best.miss:
            best = tried
        if best.confirmed:
            break
    return best


def _near(one: Simulated, other: Simulated | None) -> bool:
    return other is not None and bool(np.allclose(one, other, rtol=CONFIRMED))


def _numbers(cycle: Cycle) -> tuple[float, float, float]:
    """Frequency of the strongest harmonic, amplitude and twist."""
    n = cycle.ring.size // 2
    strongest = 1 + np.hypot(cycle.z[:, 1 : n + 1], cycle.z[:, n + 1 :]).max(axis=0).argmax()
    hz = strongest * cycle.omega / (2.0 * np.pi)
    return float(hz), float(np.sqrt(2.0) * cycle.speed.std()), cycle.twist


def _known(cycle: Cycle, others: Iterable[Cycle]) -> bool:
    numbers = _numbers(cycle)
    return any(np.allclose(numbers, _numbers(c), rtol=SAME) for c in others)


def _refined(balance: Balance, start: Cycle) -> Cycle | None:
    """Add harmonics to a solution; None where it gets lost on every way."""
    for numbers in GROWING:
        cycle = start
        for n in numbers:
            if n >= _enough(cycle):
                break
            cycle = balance.solve(cycle, n)
            if cycle.left > ROUGHLY or not _moves(cycle):
                break
        if cycle.left > ROUGHLY or not _moves(cycle):
            continue
        for share in OTHERWISE[:2]:
            last = balance.solve(cycle, round(share * _enough(cycle)))
            if _balanced(last) and _moves(last):
                return last
    return None


def _enough(cycle: Cycle) -> int:
    """Harmonics that resolve the touch of a pinion at the frequency of a motion."""
    return int(np.clip(np.ceil(2.0 * np.pi * RESOLVED_HZ / cycle.omega), FEWEST, MOST))


def _starts(balance: Balance) -> list[Cycle]:
    """Solutions with one harmonic (near sines) and few (pulses), from a grid of starts."""
    found: list[Cycle] = []
    for depth in DEPTHS:
        for hz in HZ:
            omega = 2.0 * np.pi * hz
            z = depth * balance.length
            guess = balance.guess(z, omega, balance.free_ring(z, omega))
            for n in FEW:
                cycle = balance.solve(guess, n)
                known = any(
                    abs(cycle.omega / c.omega - 1.0) < ALIKE and c.ring.size == cycle.ring.size
                    for c in found
                )
                if cycle.left < ROUGHLY and _moves(cycle) and not known:
                    found.append(cycle)
    return found


def _balanced(cycle: Cycle) -> bool:
    return cycle.left < BALANCED and cycle.doubt < CERTAIN


def _moves(cycle: Cycle) -> bool:
    """Whether it is more than rest."""
    return float(cycle.speed.std()) > STILL and cycle.omega > 2.0 * np.pi * SLOWEST_HZ
