"""What the simulator does where a limit cycle is predicted, and which cycles it has."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from dmptm_ctrl.design.harmonic_balance import Balance
from dmptm_ctrl.design.harmonics import Cycle, shifted
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import Loop, rest
from dmptm_ctrl.simulate.model import Floats

SECONDS = 7.0
WATCHED = 3.0  # s at the end of a run
SUBSTEPS = 32  # per sample; 128 change no cycle of the benchmark by more than 0.5 %
NO_LIMIT = 1e3  # V, so that no voltage limit takes part
PULSES = (3.0, 15.0, 40.0)  # deg/s for PULSE seconds, what sets a cycle off
PULSE = 0.3  # s
STILL = 1e-4  # rad/s, an oscillation below is rest
LOST = 1e3  # rad/s, a loop that runs away
SLOWEST_HZ = 2.0
PADDED = 8  # finer steps of the spectrum
SUBHARMONICS = (1, 2, 3)  # rounds after which a motion may repeat
SEEDED = 40  # harmonics read off a simulated wave, at most
READABLE = 0.45  # of the sample rate
REPEATS = 0.15  # of the twist, what a periodic wave may leave


class Simulated(NamedTuple):
    """An oscillation that lasts in the simulator."""

    hz: float  # strongest line in the spectrum of z
    amplitude: float  # of the ring-gear speed, √2 times its rms [rad/s]
    twist: float  # half the peak-to-peak of z, of the side that moves most [rad]


class Run(NamedTuple):
    """End of a run: numbers, and waves of ring speed (n,) and of z (m, n)."""

    numbers: Simulated
    speed: Floats
    z: Floats

    @property
    def lasts(self) -> bool:
        """Whether it oscillates and stays finite."""
        return bool(np.isfinite(self.numbers.hz))


def run_cycles(balance: Balance, cycles: Sequence[Cycle]) -> list[Run]:
    """Run the loop from the states of cycles, then after each of :data:`PULSES` from rest."""
    dt = balance.sample_time
    time = np.arange(round(SECONDS / dt)) * dt
    count = len(cycles) + len(PULSES)
    setpoints = np.zeros((count, time.size))
    for row, pulse in zip(setpoints[len(cycles) :], PULSES, strict=True):
        row[time < PULSE] = np.deg2rad(pulse)
    states = np.tile(rest(balance.model, 0.0), (count, 1))
    volts = np.zeros(count)
    for i, cycle in enumerate(cycles):
        states[i], volts[i] = balance.state(cycle)
    kp, ki, preload = balance.kp, balance.ki, balance.preload
    loops = [Loop(kp, ki, NO_LIMIT, float(v) + preload, float(v) - preload) for v in volts]
    with np.errstate(all="ignore"):
        runs = simulate_batch(
            [balance.model] * count, time, setpoints, states, loop=loops,
            outputs=["omega_L", "z_l", "z_r"], substeps=SUBSTEPS, jobs=1,
        )  # fmt: skip
        ends = runs.outputs[:, :, -round(WATCHED / dt) :]
        return [_measured(end[0], end[1 : 1 + balance.sides], dt) for end in ends]


def _measured(speed: Floats, z: Floats, dt: float) -> Run:
    """Numbers of a wave; NaN where it rests or runs away."""
    if not np.abs(speed).max() < LOST:
        return Run(Simulated(np.nan, np.inf, np.nan), speed, z)
    if speed.std() < STILL:
        return Run(Simulated(np.nan, 0.0, np.nan), speed, z)
    widest = z[int(np.ptp(z, axis=1).argmax())]
    window = np.hanning(widest.size)
    points = PADDED * widest.size
    size = np.abs(np.fft.rfft((widest - widest.mean()) * window, points))
    first = int(SLOWEST_HZ * points * dt)
    k = first + int(size[first:].argmax())
    a, b, c = np.log(size[k - 1 : k + 2])
    hz = (k + 0.5 * (a - c) / (a - 2.0 * b + c)) / (points * dt)
    amplitude = float(np.sqrt(2.0) * speed.std())
    return Run(Simulated(float(hz), amplitude, float(0.5 * np.ptp(widest))), speed, z)


def wave_of(run: Run, dt: float) -> Cycle | None:
    """Return the harmonics of a simulated wave as a start for the balance; None if irregular.

    The period is that of the strongest line, or two or three of it, whichever leaves least.
    """
    time = np.asarray(np.arange(run.speed.size) * dt, float)
    widest = run.z[int(np.ptp(run.z, axis=1).argmax())]
    best: tuple[float, float, int] | None = None
    for rounds in SUBHARMONICS:
        near = 2.0 * np.pi * run.numbers.hz / rounds
        n = min(SEEDED, int(READABLE * 2.0 * np.pi / (near * dt)))
        if n < rounds:
            continue

        def left(omega: float, n: int = n) -> float:
            return _fitted(time, widest, omega, n)[1]

        found = minimize_scalar(left, bounds=(0.997 * near, 1.003 * near), method="bounded")
        if best is None or found.fun < 0.5 * best[0]:  # a longer period has to be worth it
            best = float(found.fun), float(found.x), n
    if best is None or best[0] > REPEATS * float(np.std(widest)):
        return None
    _, omega, n = best
    z = np.array([_fitted(time, part, omega, n)[0] for part in run.z])
    ring = _fitted(time, run.speed, omega, n)[0]
    ring[0] = 0.0
    return shifted(Cycle(omega, z, ring, 0.0, 1.0))


def _fitted(time: Floats, wave: Floats, omega: float, n: int) -> tuple[Floats, float]:
    """Packed harmonics of a wave by least squares, and the rms of what they leave."""
    angle = omega * np.outer(time, np.arange(1, n + 1))
    columns = np.hstack([np.ones((time.size, 1)), np.cos(angle), -np.sin(angle)])
    packed, *_ = np.linalg.lstsq(columns, wave, rcond=None)
    return packed, float(np.sqrt(np.mean((wave - columns @ packed) ** 2)))
