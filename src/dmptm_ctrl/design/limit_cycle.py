"""Limit cycles of the speed loop, by :mod:`~dmptm_ctrl.design.harmonic_balance`."""

from typing import NamedTuple

import numpy as np

from dmptm_ctrl.design.harmonic_balance import POINTS, Balance, Cycle, mesh_along
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.simulate.model import Model

HARMONICS = 31  # pinions touch for 2 ms of a period of 40 ms: the pulse needs twenty at least
# Harmonics are added in steps; a step that loses the cycle may be taken in another way.
LADDERS = ((3, 7, 15, 31, 61), (3, 5, 7, 11, 15, 21, 31, 45, 61))
FEW = (1, 3)  # harmonics of the first search
DEPTHS = (1.05, 1.3, 2.0, 4.0)  # amplitudes of z tried first, in half-gaps
HZ = (8.0, 14.0, 25.0, 45.0, 80.0, 140.0)  # frequencies tried first
SLOWEST_HZ = 3.0
SAME = 0.03  # relative difference in frequency below which two answers are one
BALANCED = 5e-3  # of the mesh torque, what may be left; landings fall between the points
ROUGHLY = 5e-2  # the same on the way there
STILL = 1e-4  # rad/s, an oscillation below is rest


class LimitCycle(NamedTuple):
    """A periodic solution; whether it attracts, a simulation tells.

    Attributes
    ----------
    hz : float
    amplitude : float [rad/s]
        Of the ring-gear speed, √2 times its rms.
    twist : float [rad]
        Half the peak-to-peak of z, of the chain that moves most.
    first_hz : float
        What one harmonic says: describing functions of mesh and friction. NaN where they say
        nothing.
    """

    hz: float
    amplitude: float
    twist: float
    first_hz: float


def mesh_describing_function(law: Backlash, amplitude: float, omega: float) -> complex:
    """First harmonic of the mesh torque over z = amplitude · sin ωt [N·m/rad]."""
    angle = 2.0 * np.pi * (np.arange(POINTS) + 0.5) / POINTS
    torque = np.empty((3, POINTS))
    mesh_along(amplitude * np.sin(angle), amplitude * omega * np.cos(angle), law, torque)
    return complex(2j * np.mean(torque[0] * np.exp(-1j * angle)) / amplitude)


def limit_cycles(
    model: Model,
    kp: float,
    ki: float,
    *,
    preload: float = 0.0,
    sample_time: float = 1e-3,
    harmonics: int = HARMONICS,
) -> list[LimitCycle]:
    """Return the limit cycles about rest that harmonic balance finds, largest first.

    Parameters
    ----------
    model : Model
        Without effects but delays and lags.
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    preload : float [V]
    sample_time : float [s]
    harmonics : int

    Raises
    ------
    ValueError
        An effect that depends on angle or time.
    """
    balance = Balance(model, kp, ki, sample_time, preload)
    found: list[LimitCycle] = []
    for start in _starts(balance):
        cycle = _refined(balance, start, harmonics)
        if cycle is None:
            continue
        hz = cycle.omega / (2.0 * np.pi)
        if any(abs(hz / c.hz - 1.0) < SAME for c in found):
            continue
        alone = balance.solve(start, 1, free=True)
        first = alone.omega / (2.0 * np.pi) if alone.left < BALANCED else np.nan
        amplitude = float(np.sqrt(2.0) * cycle.speed.std())
        found.append(LimitCycle(float(hz), amplitude, cycle.twist, float(first)))
    return sorted(found, key=lambda c: -c.amplitude)


def _refined(balance: Balance, start: Cycle, harmonics: int) -> Cycle | None:
    """Add harmonics to a solution; None where it gets lost on every way."""
    for ladder in LADDERS:
        cycle = start
        for n in (*(k for k in ladder if k < harmonics), harmonics):
            cycle = balance.solve(cycle, n, free=True)
            if cycle.left > ROUGHLY or not _moves(cycle):
                break
        else:
            if cycle.left < BALANCED:
                return cycle
    return None


def _starts(balance: Balance) -> list[Cycle]:
    """Solutions with one harmonic and with few, from a grid of amplitudes and frequencies.

    One harmonic finds the fast cycles that are nearly sines, few find those with a pulse.
    """
    found: list[Cycle] = []
    for depth in DEPTHS:
        for hz in HZ:
            omega = 2.0 * np.pi * hz
            z = depth * balance.length
            guess = balance.guess(z, omega, balance.free_ring(z, omega))
            for n in FEW:
                cycle = balance.solve(guess, n, free=True)
                known = any(
                    abs(cycle.omega / c.omega - 1.0) < SAME and c.ring.size == cycle.ring.size
                    for c in found
                )
                if cycle.left < ROUGHLY and _moves(cycle) and not known:
                    found.append(cycle)
    return found


def _moves(cycle: Cycle) -> bool:
    """Whether it is more than rest, and goes round once in its period."""
    n = cycle.ring.size // 2
    size = np.hypot(cycle.z[:, 1 : n + 1], cycle.z[:, n + 1 :]).max(axis=0)
    moves = float(cycle.speed.std()) > STILL and cycle.omega > 2.0 * np.pi * SLOWEST_HZ
    return moves and int(size.argmax()) == 0
