"""The experiment that would decide between an effect and what it may be confused with.

Both are in fitted models; a signal that drives these apart, against what a free run leaves
anyway, tells one from the other.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.predict import low_pass
from dmptm_ctrl.diagnosis.ranking import name_of
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Floats

EXPERIMENT_FILE = "next_experiment.csv"
SECONDS = 20.0
SAMPLE_TIME = 1e-3  # s
BENT = 3.0  # standard deviations beyond which a sample tells no more: rattle differs by itself
# model errors that no parameter mends, rad/s and rad at the pinion, and how long one lasts
SPEED_FLOOR, TWIST_FLOOR, LASTING = np.deg2rad(0.03), np.deg2rad(0.15 / 60), 0.1
BIAS = 0.25  # share of the largest voltage, of a preload
CHIRP_HZ = (0.3, 15.0)
SLOW_HZ, QUICK_HZ = 0.1, 0.5


def chirp(t: Floats) -> Floats:
    """Sweep of constant amplitude."""
    low, high = CHIRP_HZ
    rate = np.log(high / low) / SECONDS
    return np.asarray(np.sin(2 * np.pi * low * (np.exp(rate * t) - 1.0) / rate))


def stairs(t: Floats) -> Floats:
    """Eight levels, forth and back."""
    levels = np.array([0.5, 0.7, 0.85, 1.0, -0.5, -0.7, -0.85, -1.0])
    return np.asarray(levels[np.minimum((t / SECONDS * levels.size).astype(int), levels.size - 1)])


def slow(t: Floats) -> Floats:
    """Slow sine."""
    return np.asarray(np.sin(2 * np.pi * SLOW_HZ * t))


def quick(t: Floats) -> Floats:
    """Quick sine."""
    return np.asarray(np.sin(2 * np.pi * QUICK_HZ * t))


# name → what it does, and voltages of both motors per volt of the largest one seen
SIGNALS: dict[str, tuple[str, Callable[[Floats], tuple[Floats, Floats]]]] = {
    "slow sine": ("both motors, a slow sine", lambda t: (slow(t), slow(t))),
    "quick sine": ("both motors, a quick sine", lambda t: (quick(t), quick(t))),
    "stairs": ("both motors, eight levels forth and back", lambda t: (stairs(t), stairs(t))),
    "sweep": ("both motors, a sweep of frequency", lambda t: (chirp(t), chirp(t))),
    "preloaded sine": (
        "a slow sine, the motors biased against each other",
        lambda t: (slow(t) + BIAS, slow(t) - BIAS),
    ),
    "preloaded sweep": (
        "a sweep of frequency, the motors biased against each other",
        lambda t: (chirp(t) + BIAS, chirp(t) - BIAS),
    ),
    "left motor": ("the left motor alone, a slow sine", lambda t: (2.0 * slow(t), 0.0 * t)),
    "right motor": ("the right motor alone, a slow sine", lambda t: (0.0 * t, 2.0 * slow(t))),
}


@dataclass(frozen=True, eq=False)
class Experiment:
    """A signal that tells effects apart.

    Attributes
    ----------
    name, description : str
    against : tuple of str
        The candidates that it tells apart.
    gain : float
        Expected log-likelihood ratio times two between the two that are hardest to tell.
    so_far : float
        The same of all logs at hand together, per span of the experiment.
    volts : (2, n) array
        Of the left and the right motor, every :data:`SAMPLE_TIME`.
    """

    name: str
    description: str
    against: tuple[str, ...]
    gain: float
    so_far: float
    volts: Floats

    def table(self) -> pd.DataFrame:
        """Return the signal as columns time_s, u_left_V, u_right_V."""
        time = SAMPLE_TIME * np.arange(self.volts.shape[1])
        return pd.DataFrame({"time_s": time, "u_left_V": self.volts[0], "u_right_V": self.volts[1]})

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {
            "name": self.name,
            "description": self.description,
            "file": EXPERIMENT_FILE,
            "seconds": SECONDS,
            "tells_apart": list(self.against),
            "gain": self.gain,
            "gain_of_these_logs": self.so_far,
        }


def apart(one: Floats, other: Floats, dt: float, twist: bool) -> float:
    """Expected log-likelihood ratio times two between two models, from runs on the same voltages.

    Columns as of :func:`~dmptm_ctrl.simulate.compiled.march`.
    """
    misses = [low_pass(one[:, 1] - other[:, 1], dt) / SPEED_FLOOR]
    if twist:
        misses += [(one[:, k] - other[:, k]) / TWIST_FLOOR for k in (6, 7)]
    news = len(one) * dt / LASTING
    return float(sum(news * np.mean(np.minimum(np.abs(m), BENT) ** 2) for m in misses))


def next_experiment(selection: Selection, measured: Measured, jobs: int = 1) -> Experiment | None:
    """Choose the signal that best separates an effect from its rivals.

    Parameters
    ----------
    selection : Selection
    measured : Measured
    jobs : int
        Threads. The result does not depend on it.

    Returns
    -------
    Experiment or None
        None where nothing was found, or nothing else comes near.
    """
    contested = [entry for entry in selection.entries if entry.confusable_with]
    if not contested:
        return None
    entry = max(contested, key=lambda e: len(e.confusable_with))
    # rivals are fitted beside the same other effects, so that only the effect differs
    models = {name_of(entry.key): selection.final.left.base.model}
    models |= {
        name_of(r.keys[0]): r.fitted[0].fit.model
        for r in entry.rivals
        if r.keys[0] in entry.confusable_with
    }
    twist = measured.has_motor_encoders
    left = selection.base.left
    motions = [*left.balance.motions, *left.held.motions]
    largest = max(float(np.abs(mo.rec.u).max()) for mo in motions)
    time: Floats = SAMPLE_TIME * np.arange(round(SECONDS / SAMPLE_TIME), dtype=np.float64)

    def told(task: tuple[Floats, float]) -> float:
        volts, dt = task
        own, *others = (march(m, volts, rest(m, 0.0), dt) for m in models.values())
        return min(apart(own, other, dt, twist) for other in others)

    signals = {name: largest * np.array(wave(time)) for name, (_, wave) in SIGNALS.items()}
    for volts in signals.values():
        np.clip(volts, -largest, largest, out=volts)
    planned = [(volts, SAMPLE_TIME) for volts in signals.values()]
    done = in_threads(told, planned + [(mo.rec.u, mo.rec.dt) for mo in motions], jobs)
    gains = dict(zip(signals, done, strict=False))  # first of all
    best = max(gains, key=lambda name: gains[name])
    seconds = sum(mo.rec.dt * mo.rec.theta.size for mo in motions)
    so_far = sum(done[len(signals) :]) * SECONDS / seconds
    description = SIGNALS[best][0]
    return Experiment(best, description, tuple(models), gains[best], so_far, signals[best])
