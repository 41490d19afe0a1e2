"""Torque ripple that the gyro shows faster than the windows of the balances.

Rotor magnets push many times per motor turn: at all but creeping speeds faster than the 25 Hz
that a window passes. While the ring gear and both sides turn one way with both meshes closed,
the drive is linear and the ring gear's speed answers a torque as

    ω(s)/T(s) = (2 ζ ω0 s + ω0²) / (J s (s² + 2 ζ ω0 s + ω0²)),   J = J_L + 2 N2² J̄3,

the inertia of all bodies raised by the mode of the pinions together against the ring gear,
ω0² = k_m (1/J̄3 + 2 N2²/J_L), 2 ζ ω0 = c (1/J̄3 + 2 N2²/J_L). What a model leaves of the
measured speed above the windows' band, whitened, is noise and the torque that it lacks.
Source: paper Eqs. 16 to 18, closed meshes; matched filter in coloured noise, Kay 1998, ch. 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import cont2discrete, freqz, lfilter

from dmptm_ctrl.identify.disturbance import Course, course, disturbance
from dmptm_ctrl.identify.motion import GYRO_NOISE, WINDOW_SECONDS, Motion, hann, odd_span, smooth
from dmptm_ctrl.identify.windows import Keyed, inertias, pull_of
from dmptm_ctrl.simulate.dual import MOTORS
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.plant import Floats, Plant

FINER = 2  # steps per sample in which a torque acts: an order may have two samples per period
WHITE = 8  # coefficients that whiten what is left: the meshes' wobble is a narrow band
EXTREME = 0.01  # share of samples at either end that do not show the colour of the rest
LEAST = 100  # samples of a log, below which nothing is identified
FAINTEST = 0.01  # share of a gyro's usual noise that any has
NEARLY = 1e-3  # share by which two motors' waves must differ to be separated
GRID = 2048  # frequencies at which the response is known
KEPT = 64  # difference equations kept
RECENT = 4  # results kept per motion


@dataclass(eq=False)
class Ripple:
    """The fast part of one motion."""

    motion: Motion

    def __post_init__(self) -> None:
        mo = self.motion
        self.left = lru_cache(RECENT)(self._left)
        self.span = odd_span(WINDOW_SECONDS, mo.rec.dt)
        closed = np.zeros(mo.run.shape[0], bool)
        for start in mo.starts[mo.slides & mo.touches.all(1)]:
            closed[start : start + mo.window.size] = True
        reach = np.ones(self.span + 2 * WHITE)
        # how the meshes ring after a jump of the voltage is no torque ripple
        calm = closed & (np.abs(self.driven) < GYRO_NOISE)
        self.used = np.convolve(~calm, reach, "same") < 0.5

    @property
    def usable(self) -> bool:
        """Whether there are samples enough."""
        return int(self.used.sum()) >= LEAST

    @cached_property
    def driven(self) -> Floats:
        """Fast part of the speed that the commanded voltages give the declared drive, (n,)."""
        plant = self.motion.declared.plant()
        gain = plant.link_values[0, 0] * pull_of(plant)
        torque = gain * np.repeat(self.motion.rec.u.sum(0), FINER)
        return self.fast(self.speed(torque, closed(plant)))

    @cached_property
    def measured(self) -> Floats:
        """Fast part of the measured speed beside that, (n,)."""
        return self.fast(self.motion.rec.omega) - self.driven

    @cached_property
    def colour(self) -> Floats:
        """Coefficients of the filter that whitens what the declared model leaves, (WHITE + 1,)."""
        row = self.measured
        row = np.clip(row, *np.quantile(row[self.used], (EXTREME, 1.0 - EXTREME)))
        row[~self.used] = 0.0
        lags = np.array([row[: row.size - k] @ row[k:] for k in range(WHITE + 1)])
        # a sensor's noise is white, and there where a log has none
        lags[0] += FAINTEST**2 * GYRO_NOISE**2 * row.size
        return np.concatenate([[1.0], -solve_toeplitz(lags[:-1], lags[1:])])

    def speed(self, torque: Floats, answer: bytes) -> Floats:
        """Speed of the ring gear [rad/s], (n,), by a torque on it in finer steps, (n FINER,)."""
        return np.asarray(lfilter(*answers(answer, self.motion.rec.dt), torque)[::FINER])

    def fast(self, row: Floats) -> Floats:
        """What changes within the windows' span, (n,)."""
        return row - smooth(row, self.span)

    @cached_property
    def finer(self) -> Course:
        """Voltages and motion in finer steps."""
        mo = self.motion
        n = mo.run.shape[0]
        at, places = np.arange(n * FINER) / FINER, np.arange(n)
        run = np.array([np.interp(at, places, column) for column in mo.run.T]).T
        return course([np.repeat(mo.rec.u, FINER, axis=1)], [run], mo.rec.dt / FINER)

    def torque(self, plant: Plant) -> Floats:
        """Torque of a model's effects, summed at the ring gear, (n FINER,)."""
        # no fast effect depends on what the meshes carry
        torque = disturbance(self.finer, plant).torque
        n2 = plant.link_values[0, 0]
        total = np.zeros_like(self.finer.time)
        for lever, row in zip((n2, n2, 1.0), torque, strict=True):
            if row is not None:
                total += lever * row
        return total

    def missing(self, plant: Plant) -> Floats:
        """Speed [rad/s] that a model does not explain, whitened, where the drive slides, (k,).

        Of its effects the fast ones count: no other may live on what they leave. What
        was computed lately is kept: most that a fit moves changes nothing here.
        """
        fast = [p for p in plant.places if p.effect.fast and plant.on[p.flag]]
        if not fast:
            return self.left(Keyed(plant))
        on = np.zeros_like(plant.on)
        on[[p.flag for p in fast]] = 1
        numbers = (plant.values[p.first : p.first + len(p.effect.parameters)] for p in fast)
        key = on.tobytes(), np.concatenate([*numbers]).tobytes(), closed(plant), pull_of(plant)
        return self.left(Keyed(plant._replace(on=on), *key))

    def _left(self, given: Keyed) -> Floats:
        """Speed that is left by the effects of a plant, all of them fast."""
        row = self.measured
        if given.key:
            torque = self.torque(given.plant)
            row = row - self.fast(self.speed(torque, closed(given.plant)))
        return np.asarray(lfilter(self.colour, 1.0, row)[self.used])

    def overlap(
        self, missing: Floats, weights: Floats, most: int
    ) -> tuple[NDArray[np.complex128], Floats, NDArray[np.complex128]]:
        """Products of unit waves of each order on either motor, to first order.

        Parameters
        ----------
        missing, weights : (k,) arrays
            Of :meth:`missing`, and what each sample counts.
        most : int
            Orders 1 to `most` per motor turn.

        Returns
        -------
        with_missing : (2, most) complex array
        own, crossed : (most,) arrays, real and complex
            Each motor's with itself, left with right.
        """
        plant = self.motion.declared.plant()
        answer = answers(closed(plant), self.motion.rec.dt)
        row = np.zeros(self.used.size)
        row[self.used] = weights * missing
        # what a wave's filtered samples weigh is what the wave's own samples weigh, filtered back
        row = self.fast(lfilter(self.colour, 1.0, row[::-1])[::-1])
        back = np.zeros(row.size * FINER)
        back[::FINER] = row
        back = lfilter(*answer, back[::-1])[::-1]
        turns = self.finer.motors
        gain = plant.body_ratio[MOTORS[0]] * plant.link_values[0, 0]
        found = gain * np.array([waves(angle, back, most) for angle in turns])
        counts = np.zeros(self.used.size)
        counts[self.used] = weights
        pace = np.abs(self.motion.run[:, 1]) * gain * self.motion.rec.dt / (FINER * np.pi)
        difference = self.motion.run[:, 2] - self.motion.run[:, 3]
        own, crossed = powers(pace, difference, counts, self.response(answer), most)
        return found, gain**2 * own, gain**2 * crossed

    def response(self, answer: tuple[Floats, Floats]) -> Floats:
        """Squared response of a whitened sample to a torque, up to half a cycle per step, (GRID,).

        Steps are the finer ones.
        """
        w = np.linspace(0.0, np.pi, GRID)
        _, steady = freqz(*answer, np.maximum(w, 1e-6))
        _, slow = freqz(hann(self.span), 1.0, FINER * w)
        _, white = freqz(self.colour, 1.0, FINER * w)
        delay = np.exp(0.5j * (self.span - 1) * FINER * w)
        return np.asarray(np.abs(steady * (1.0 - slow * delay) * white) ** 2)


def closed(plant: Plant) -> bytes:
    """Inertia of a side and of the ring gear, ratio, stiffness and damping of closed meshes."""
    return np.array([*inertias(plant), *plant.link_values[0, :3]]).tobytes()


@lru_cache(KEPT)
def answers(numbers: bytes, dt: float) -> tuple[Floats, Floats]:
    """Difference equation from a torque on the ring gear to its speed, in finer steps.

    `numbers` are those of :func:`closed`, `dt` the sample time [s].
    """
    j3, jl, n2, k_m, c = np.frombuffer(numbers)
    ease = 1.0 / j3 + 2.0 * n2 * n2 / jl
    damping, squared, inertia = c * ease, k_m * ease, jl + 2.0 * n2 * n2 * j3
    system = [damping / inertia, squared / inertia], [1.0, damping, squared, 0.0]
    b, a, _ = cont2discrete(system, dt / FINER, method="foh")
    return b.ravel(), a


@cached(nogil=True)
def waves(angle: Floats, weights: Floats, most: int) -> NDArray[np.complex128]:
    """Σ weight · exp(i n angle) for orders n of 1 to `most`."""
    out = np.zeros(most, np.complex128)
    for i in range(angle.size):
        if weights[i] != 0.0:
            turn = complex(np.cos(angle[i]), np.sin(angle[i]))
            wave = weights[i] * turn
            for n in range(most):
                out[n] += wave
                wave *= turn
    return out


@cached(nogil=True)
def powers(
    pace: Floats, difference: Floats, weights: Floats, response: Floats, most: int
) -> tuple[Floats, NDArray[np.complex128]]:
    """Halves of Σ weight · response, and the same times exp(i n difference), for each order.

    `pace` is the frequency of the first order as a share of that where the response ends.
    """
    own, crossed = np.zeros(most), np.zeros(most, np.complex128)
    last = response.size - 1
    for i in range(pace.size):
        if weights[i] != 0.0:
            step = complex(np.cos(difference[i]), np.sin(difference[i]))
            turn = step
            for n in range(most):
                at = pace[i] * (n + 1)
                k = min(int(at * last), last)
                part = 0.5 * weights[i] * response[k]
                own[n] += part
                crossed[n] += part * turn
                turn *= step
    return own, crossed


def order_gains(parts: Sequence[tuple[Ripple, Floats, Floats]], most: int) -> Floats:
    """Fall of the weighted square by either motor's waves of each order, (most,), first order.

    `parts` are motions, what is missing in them and what each of their samples counts.
    """
    if not parts:
        return np.zeros(most)
    found = np.zeros((2, most), np.complex128)
    own, crossed = np.zeros(most), np.zeros(most, np.complex128)
    for ripple, row, counts in parts:
        more = ripple.overlap(row, counts, most)
        found, own, crossed = found + more[0], own + more[1], crossed + more[2]
    firm = own * (1.0 + NEARLY) + np.finfo(float).tiny
    left, right = found
    square = firm * (np.abs(left) ** 2 + np.abs(right) ** 2)
    both = 2.0 * np.real(crossed * np.conj(left) * right)
    return np.asarray((square - both) / (firm**2 - np.abs(crossed) ** 2))
