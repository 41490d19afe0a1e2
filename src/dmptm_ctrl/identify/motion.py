"""What the sensors say of the motion: smooth speeds, accelerations in windows, who slides.

Newton's law is tested against a window φ: ∫ φ a dt needs no derivative of a reading, the
differences fall on φ (weak form; Messenger & Bortz, J. Comput. Phys. 443 (2021) 110525).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import convolve1d

from dmptm_ctrl.identify.disturbance import course, disturbance
from dmptm_ctrl.identify.records import RING_COUNT, Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.along import acting_in, reading_along
from dmptm_ctrl.simulate.dual import MOTORS
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.model import Floats, Model

WINDOW_SECONDS = 0.04  # of φ: averages the 231 Hz mode out, passes 25 Hz
SMOOTH_SECONDS = 0.012  # of the speeds that friction is evaluated at
SETTLED = 5.0  # distances of pre-sliding after a reversal, from which friction is that of sliding
CREEP = np.deg2rad(0.3)  # rad/s of the ring gear; slower, friction is not a function of speed
QUIET = np.deg2rad(0.4 / 60)  # rad, standard deviation of z in a window: rattling pinions exceed it
NEAR = 0.4  # of the half-gap; closer to the middle nothing touches
IMPACT_SECONDS = 0.02  # after a simulated impact, when no encoder measures the real one
GYRO_NOISE = np.deg2rad(0.05)  # rad/s per sample


def hann(n: int) -> Floats:
    """Hann window of unit sum, zero just outside."""
    k = np.arange(1, n + 1)
    w = np.sin(np.pi * k / (n + 1)) ** 2
    return np.asarray(w / w.sum(), np.float64)


@dataclass(frozen=True, eq=False)
class Motion:
    """A record's motion in overlapping windows. SI units.

    Attributes
    ----------
    declared : Model
        That the motion was prepared with.
    run : (n, 8) array
        Readings in the columns of `compiled.OUTPUTS`, speeds smoothed.
    pinion_speed : (n, 2) array
    window : (m,) array
        φ, unit sum.
    starts : (w,) array of int
        First sample of each window.
    ring, pinions : (w,), (w, 2) arrays
        Accelerations.
    slides : (w,) array of bool
        All three bodies move one way throughout.
    touches : (w, 2) array of bool
        The pinion rests on one flank throughout.
    flank : (n, 2) array
        Which flank is near, 1 or −1.
    """

    rec: Record
    declared: Model
    run: Floats
    pinion_speed: Floats
    window: Floats
    starts: np.ndarray
    ring: Floats
    pinions: Floats
    slides: np.ndarray
    touches: np.ndarray
    flank: np.ndarray

    def mean(self, rows: Floats, *, held: bool = True) -> Floats:
        """Window means, (..., n) → (..., w).

        A second difference at sample i weighs the forces before and after it alike: those
        held from each sample to the next, as a voltage is. What is known at the instants,
        as an angle or a speed is, counts as it is (`held` false).
        """
        return averaged(rows, [self], held=held)

    @property
    def time(self) -> Floats:
        """Mid of each window [s] from the start of the log."""
        middle = self.starts + 0.5 * (self.window.size - 1)
        return np.asarray(middle * self.rec.dt)


def averaged(rows: Floats, several: Sequence[Motion], *, held: bool = True) -> Floats:
    """Window means of several motions one after another, (..., n) → (..., w)."""
    window, ends = several[0].window, np.cumsum([mo.run.shape[0] for mo in several])
    counts = np.array([mo.starts.size for mo in several])
    flat = np.ascontiguousarray(rows, np.float64).reshape(-1, rows.shape[-1])
    out = np.empty((flat.shape[0], int(counts.sum())))
    weigh(flat, window, np.array([0, *ends[:-1]]), counts, held, out)
    return out.reshape(*rows.shape[:-1], out.shape[1])


@cached(nogil=True, fastmath={"reassoc", "contract"})
def weigh(rows: Floats, window: Floats, begins: Any, counts: Any, held: bool, out: Floats) -> None:
    """Write window means, of half-overlapping windows from the second sample of each part on."""
    hop = window.size // 2
    for r in range(rows.shape[0]):
        w = 0
        for part in range(begins.size):
            rising = 0.0
            for k in range(counts[part] + 1):
                first = begins[part] + 1 + k * hop
                up, down = 0.0, 0.0
                for i in range(hop):
                    x = rows[r, first + i]
                    if held:
                        x = 0.5 * (x + rows[r, first + i - 1])
                    up += window[i] * x
                    down += window[hop + i] * x
                if k > 0:
                    out[r, w] = rising + down
                    w += 1
                rising = up


def second_difference(angle: Floats, dt: float) -> Floats:
    """Central second difference, zero at the ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / dt**2
    return out


def first_difference(speed: Floats, dt: float) -> Floats:
    """Central first difference, zero at the ends."""
    out = np.zeros_like(speed)
    out[1:-1] = (speed[2:] - speed[:-2]) / (2.0 * dt)
    return out


def odd_span(seconds: float, dt: float) -> int:
    """Odd number of samples nearest to a span, at least 3."""
    return max(3, 2 * round(0.5 * seconds / dt) + 1)


def smooth(rows: Floats, n: int) -> Floats:
    """Zero-phase mean along the last axis, by a Hann window of odd length."""
    return np.asarray(convolve1d(rows, hann(n), mode="nearest"))


def one_way(speed: Floats, least: float, m: int, starts: np.ndarray) -> np.ndarray:
    """Windows throughout which the speed keeps its sign and exceeds `least`."""
    sign = np.where(speed > least, 1, np.where(speed < -least, -1, 0))
    view = sliding_window_view(sign, m)[starts]
    return np.asarray((view[:, 0] != 0) & (view == view[:, :1]).all(1))


def travelled(angle: Floats, speed: Floats) -> Floats:
    """Angle since the speed last changed its sign."""
    turned = np.flatnonzero(np.diff(np.sign(speed))) + 1
    last = np.zeros(angle.size, int)
    last[turned] = turned
    return np.asarray(np.abs(angle - angle[np.maximum.accumulate(last)]))


def corrected(rec: Record, model: Model) -> Record:
    """Take the model's sensor effects off the readings, to first order."""
    plant = model.plant()
    late = plant.sensor_delay[1]
    t = rec.dt * np.arange(rec.theta.size, dtype=np.float64)
    theta, omega = reading_along(acting_in(plant).get(("sensor", 0), ()), rec.theta, rec.omega, t)
    theta, omega = 2.0 * rec.theta - theta, 2.0 * rec.omega - omega
    if late > 0.0:
        omega = np.interp(t + late, t, omega)
    twist = rec.twist
    if twist is not None:
        twist = twist + plant.link_values[0, 0] * (rec.theta - theta)[:, None]
    return replace(rec, theta=theta, omega=omega, twist=twist)


def motion(rec: Record, model: Model, simulated: Floats | None = None) -> Motion:
    """Prepare a record; without motor encoders the gaps are those of a simulated run.

    Parameters
    ----------
    simulated : (n, 8) array, optional
        Needed where the record has no twist.
    """
    rec = corrected(rec, model)
    plant, dt, n = model.plant(), rec.dt, rec.theta.size
    n1, n2 = plant.body_ratio[MOTORS[0]], plant.link_values[0, 0]
    m = 2 * max(3, round(0.5 * WINDOW_SECONDS / dt))
    odd = odd_span(SMOOTH_SECONDS, dt)
    window = hann(m)
    starts = np.arange(1, n - m - 1, m // 2)  # half overlapping, see `Motion.mean`
    view = sliding_window_view

    # Gyro and encoder both measure the ring gear's acceleration; weigh by their noise.
    by_gyro = first_difference(rec.omega, dt)
    by_encoder = second_difference(rec.theta, dt)
    # standard deviations of ∫φ̇ω and ∫φ̈θ for a Hann window
    t = m * dt
    noise_gyro = GYRO_NOISE * 2 * np.pi / t
    noise_encoder = RING_COUNT / np.sqrt(12.0) * (2 * np.pi / t) ** 2
    share = noise_encoder**2 / (noise_gyro**2 + noise_encoder**2)
    ring = view(share * by_gyro + (1.0 - share) * by_encoder, m)[starts] @ window

    omega = smooth(rec.omega, odd)
    run = np.zeros((n, 8))
    run[:, 0], run[:, 1] = rec.theta, omega
    if rec.twist is not None:
        z = rec.twist
        pinion = z + n2 * rec.theta[:, None]
        speed = np.column_stack([smooth(first_difference(pinion[:, s], dt), odd) for s in (0, 1)])
        acceleration = np.column_stack(
            [view(second_difference(pinion[:, s], dt), m)[starts] @ window for s in (0, 1)]
        )
    else:
        assert simulated is not None
        z = simulated[:, 6:8]
        speed = n2 * np.column_stack([omega, omega])
        acceleration = n2 * np.column_stack([ring, ring])
    run[:, 2:4] = n1 * (z + n2 * rec.theta[:, None])
    run[:, 6:8] = z

    z = z + shifts(rec, run, model)
    gaps = plant.link_values[:2, 4]
    touches = np.empty((starts.size, 2), bool)
    for s in (0, 1):
        if rec.twist is not None:
            away, wait = NEAR * gaps[s], 0
        else:
            away, wait = gaps[s], round(IMPACT_SECONDS / dt)
        side = np.where(z[:, s] > away, 1, np.where(z[:, s] < -away, -1, 0))
        seen = view(np.pad(side, (wait, 0)), m + wait)[starts]
        touches[:, s] = (seen[:, 0] != 0) & (seen == seen[:, :1]).all(1)
        if rec.twist is not None:
            touches[:, s] &= view(z[:, s], m)[starts].std(1) < QUIET
    slides = one_way(omega, CREEP, m, starts)
    if rec.twist is not None:
        slides &= one_way(speed[:, 0], n2 * CREEP, m, starts)
        slides &= one_way(speed[:, 1], n2 * CREEP, m, starts)
    else:
        slides &= touches.all(1)
    for body, angle in enumerate((run[:, 2] / n1, run[:, 3] / n1, rec.theta)):
        settled = SETTLED * plant.bristles[body, 0]
        if settled > 0.0:
            slides &= (travelled(angle, omega) > settled)[starts]
    flank = np.where(z > 0.0, 1.0, -1.0)
    return Motion(
        rec, model, run, speed, window, starts, ring, acceleration, slides, touches, flank
    )


def shifts(rec: Record, run: Floats, model: Model) -> Floats:
    """What the model's errors of teeth and gears shift z by, (n, 2) [rad].

    Where they are as large as the gap, z alone shows neither the flank nor what chatters.
    """
    shift = np.zeros((run.shape[0], 2))
    if rec.twist is not None:
        rows = disturbance(course([rec.u], [run], rec.dt), model.plant()).shift
        for column, row in zip(shift.T, rows, strict=True):
            if row is not None:
                column[:] = row
    return shift


def motions(
    records: Sequence[Record], model: Model, runs: Sequence[Floats | None], jobs: int
) -> tuple[Motion, ...]:
    """Prepare several records; of those without motor encoders `runs` are simulated ones."""
    pairs = list(zip(records, runs, strict=True))
    done = in_threads(
        lambda pair: motion(pair[0], model, pair[1]), pairs, jobs, lambda pair: pair[0].omega.size
    )
    return tuple(done)
