"""The experiment that would decide between an effect and what it may be confused with.

Both are in fitted models; a signal that drives these apart, against what a free run leaves
anyway, distinguishes one from the other.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from dmptm_ctrl.diagnosis.candidate import Candidate, name_of
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.drive.rig_units import input_symbol
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march as march_rig

Task = tuple[Floats, float]  # signals, sample time [s]
Wave = Callable[[Floats], Floats]
_Key = TypeVar("_Key")

EXPERIMENT_FILE = "next_experiment.csv"
SECONDS = 20.0
SAMPLE_TIME = 1e-3  # s
BENT = 3.0  # standard deviations beyond which a sample says no more: chatter differs by itself
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


def sine(hz: float) -> Wave:
    """Sine of a frequency [Hz]."""
    return lambda t: np.asarray(np.sin(2 * np.pi * hz * t))


def alike(wave: Wave) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Give the same to both motors."""
    return lambda t: (wave(t), wave(t))


slow, quick = sine(SLOW_HZ), sine(QUICK_HZ)
WAVES: dict[str, tuple[Wave, str]] = {  # of one input, with what they are called
    "slow sine": (slow, "a slow sine"),
    "quick sine": (quick, "a quick sine"),
    "stairs": (stairs, "eight levels forth and back"),
    "sweep": (chirp, "a sweep of frequency"),
}
# name → what it does, and voltages of both motors per volt of the largest one seen
SIGNALS: dict[str, tuple[str, Callable[[Floats], tuple[Floats, Floats]]]] = {
    **{name: (f"both motors, {what}", alike(wave)) for name, (wave, what) in WAVES.items()},
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
    """A signal that separates effects.

    Attributes
    ----------
    against : tuple of str
        The candidates that it separates.
    gain : float
        Expected log-likelihood ratio times two between the two that are hardest to separate.
    so_far : float
        The same of all logs at hand together, per span of the experiment.
    volts : (inputs, n) array
        Of the left and the right motor, every `sample_time` [s]; of a rig its inputs' signals, SI.
    columns : tuple of str
        What the signals are called in a table, with their units.
    """

    name: str
    description: str
    against: tuple[str, ...]
    gain: float
    so_far: float
    volts: Floats
    columns: tuple[str, ...] = ("u_left_V", "u_right_V")
    sample_time: float = SAMPLE_TIME

    def table(self) -> pd.DataFrame:
        """Return the signal as columns time_s, u_left_V, u_right_V; of a rig its inputs."""
        time = self.sample_time * np.arange(self.volts.shape[1])
        return pd.DataFrame({"time_s": time, **dict(zip(self.columns, self.volts, strict=True))})

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


def separation(one: Floats, other: Floats, dt: float, twist: bool) -> float:
    """Expected log-likelihood ratio times two between two models, from runs on the same voltages.

    Columns as of :func:`~dmptm_ctrl.simulate.compiled.march`.
    """
    misses = [low_pass(one[:, 1] - other[:, 1], dt) / SPEED_FLOOR]
    if twist:
        misses += [(one[:, k] - other[:, k]) / TWIST_FLOOR for k in (6, 7)]
    independent = len(one) * dt / LASTING
    return float(sum(independent * np.mean(np.minimum(np.abs(m), BENT) ** 2) for m in misses))


def _contested(selection: Selection) -> tuple[Entry, list[Candidate]] | None:
    """Entry with most effects that it may be confused with, and these.

    They are fitted beside the same other effects, so that only the effect differs. None where
    there is none.
    """
    entry = max(selection.entries, key=lambda e: len(e.confusable_with), default=None)
    if entry is None or not entry.confusable_with:
        return None
    return entry, [r for r in entry.rivals if r.keys[0] in entry.confusable_with]


def _best(
    worth: Callable[[Task], float],
    planned: Mapping[_Key, Floats],
    dt: float,
    logged: Sequence[Task],
    jobs: int,
) -> tuple[_Key, float, float]:
    """Signal that separates most, how far, and how far the logs do per span of an experiment."""
    done = in_threads(worth, [*((signals, dt) for signals in planned.values()), *logged], jobs)
    gains = dict(zip(planned, done, strict=False))  # first of all
    best = max(gains, key=lambda key: gains[key])
    seconds = sum(signals.shape[1] * step for signals, step in logged)
    return best, gains[best], sum(done[len(planned) :]) * SECONDS / seconds


def rig_experiment(selection: Selection, runs: Runs, jobs: int = 1) -> Experiment | None:
    """Choose a signal of one input of a rig, as `next_experiment` does.

    Models are compared by the sensor that `runs` compare, against what the final model's run
    leaves of it in the logs. It has the logs' sample time and their largest signals.
    """
    contested = _contested(selection)
    if contested is None or runs.after is None:
        return None
    entry, rivals = contested
    models: dict[str, RigModel] = {entry.key: selection.final.fit.model}
    models |= {r.keys[0]: r.fitted[1].model for r in rivals}
    rig, dt = models[entry.key].rig, runs.logs[0].sample_time
    left = np.concatenate([m - a for m, a in zip(runs.measured, runs.after, strict=True)])
    floor = float(np.sqrt(np.mean(left**2)))
    time: Floats = dt * np.arange(round(SECONDS / dt), dtype=np.float64)
    logged = [
        (np.array([log[i.channel] for i in rig.inputs]), log.sample_time) for log in runs.logs
    ]

    def worth(task: Task) -> float:
        signals, step = task
        own, *others = (
            runs.seen(march_rig(m.opened, signals, step).reading(runs.sensor.name), step)
            for m in models.values()
        )
        bent = [np.minimum(np.abs(own - o) / floor, BENT) ** 2 for o in others]
        return min(signals.shape[1] * step / LASTING * float(np.mean(b)) for b in bent)

    planned: dict[tuple[str, str], Floats] = {}
    for j, source in enumerate(rig.inputs):
        largest = max(float(np.abs(signals[j]).max()) for signals, _ in logged)
        for name, (wave, _) in WAVES.items():
            planned[source.name, name] = np.zeros((len(rig.inputs), time.size))
            planned[source.name, name][j] = largest * wave(time)
    best, gain, so_far = _best(worth, planned, dt, logged, jobs)
    return Experiment(
        best[1],
        f"{best[0]}, {WAVES[best[1]][1]}",
        tuple(models),
        gain,
        so_far,
        planned[best],
        tuple(f"{i.name}_{input_symbol(rig, i.name) or '1'}" for i in rig.inputs),
        dt,
    )


def next_experiment(selection: Selection, measured: Measured, jobs: int = 1) -> Experiment | None:
    """Choose the signal that best separates an effect from its rivals.

    None where nothing was found, or nothing else comes near. The result does not depend on `jobs`.
    """
    contested = _contested(selection)
    if contested is None:
        return None
    entry, rivals = contested
    models = {name_of(entry.key): selection.final.left.base.model}
    models |= {name_of(r.keys[0]): r.fitted[0].fit.model for r in rivals}
    twist = measured.has_motor_encoders
    left = selection.base.left
    motions = [*left.balance.motions, *left.held.motions]
    largest = max(float(np.abs(mo.rec.u).max()) for mo in motions)
    time: Floats = SAMPLE_TIME * np.arange(round(SECONDS / SAMPLE_TIME), dtype=np.float64)

    def worth(task: Task) -> float:
        volts, dt = task
        own, *others = (march(m, volts, rest(m, 0.0), dt) for m in models.values())
        return min(separation(own, other, dt, twist) for other in others)

    signals = {name: largest * np.array(wave(time)) for name, (_, wave) in SIGNALS.items()}
    for volts in signals.values():
        np.clip(volts, -largest, largest, out=volts)
    logged = [(mo.rec.u, mo.rec.dt) for mo in motions]
    best, gain, so_far = _best(worth, signals, SAMPLE_TIME, logged, jobs)
    return Experiment(best, SIGNALS[best][0], tuple(models), gain, so_far, signals[best])
