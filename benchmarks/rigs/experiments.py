"""The experiments: the paper's eight, a turn and a multisine, and others like them."""

from typing import NamedTuple

import numpy as np

from rigs.nominal import DEG
from rigs.plant import SAMPLE

GAINS = np.array([0.08, 1.5])  # k_p [V s/deg], k_i [V/deg]
PRELOAD = 0.15  # V
MULTISINE_HZ = (0.7, 1.3, 2.9, 5.3, 8.9, 13.7, 21.1, 37.0, 61.0, 95.0)
_MULTISINE_V = 0.342  # amplitude of a line is this times f^-0.35


class Experiment(NamedTuple):
    closed: bool
    signal: np.ndarray  # V, or deg/s when closed
    start: float  # rad, angle of the ring gear at rest
    preload: float = 0.0  # V


def _time(seconds):
    return np.arange(round(seconds / SAMPLE)) * SAMPLE


def sine(amplitude, frequency, seconds):
    return amplitude * np.sin(2 * np.pi * frequency * _time(seconds))


def square(amplitude, frequency, seconds):
    """Switches on whole samples, starts positive."""
    half = round(0.5 / frequency / SAMPLE)
    return amplitude * (1.0 - 2.0 * (np.arange(round(seconds / SAMPLE)) // half % 2))


def multisine(phases, scale, seconds):
    t = _time(seconds)[:, None]
    lines = np.array(MULTISINE_HZ)
    return np.sum(scale * lines**-0.35 * np.sin(2 * np.pi * lines * t + phases), axis=1)


def turn(speed, seconds, ramp=0.5, reverse=36.0):
    """Ramp up, run, turn round at `reverse`, never faster than `speed`."""
    t = _time(seconds)
    return np.clip(np.minimum(t / ramp, (reverse + ramp - t) / ramp), -1.0, 1.0) * speed


def paper(rng):
    """The ten logs of a rig; starting angles and multisine phases are drawn."""
    start = rng.uniform(-20, 20, 9) * DEG
    phases = rng.uniform(-np.pi, np.pi, len(MULTISINE_HZ))
    return {
        "open_sine_0v60": Experiment(False, sine(0.60, 0.5, 6), start[0]),
        "open_sine_0v75": Experiment(False, sine(0.75, 1.0, 5), start[1]),
        "open_square_0v60": Experiment(False, square(0.60, 0.4, 7.5), start[2]),
        "open_square_0v75": Experiment(False, square(0.75, 0.4, 7.5), start[3]),
        "open_multisine_preload": Experiment(
            False, multisine(phases, _MULTISINE_V, 10), start[4], PRELOAD
        ),
        "closed_sine_10": Experiment(True, sine(10.0, 0.5, 6), start[5]),
        "closed_sine_15": Experiment(True, sine(15.0, 1.0, 5), start[6]),
        "closed_square_10": Experiment(True, square(10.0, 0.5, 6), start[7]),
        "closed_square_15": Experiment(True, square(15.0, 1.0, 5), start[8]),
        "closed_turn_20": Experiment(True, turn(20.0, 37), -170 * DEG),
    }


def mixed(rng):
    """Three logs for judging predictions: sines and steps of voltage, sines of speed, a turn."""
    phases = rng.uniform(-np.pi, np.pi, (2, len(MULTISINE_HZ)))
    start = rng.uniform(-20, 20, 3) * DEG
    steps = square(0.45, rng.uniform(0.3, 0.5), 10)
    lines = rng.uniform((0.3, 0.8, 1.4), (0.8, 1.4, 2.5))
    wish = sum(sine(7.0, line, 10) for line in lines)
    return {
        "held_open_mix": Experiment(
            False, steps + multisine(phases[0], 0.6 * _MULTISINE_V, 10), start[0], 0.05
        ),
        "held_closed_mix": Experiment(True, wish, start[1]),
        "held_turn_back": Experiment(True, turn(-15.0, 26), start[2]),
    }


def others(rng, count, prefix="other"):
    """Experiments of the same kinds at other amplitudes, phases, frequencies and angles."""
    kinds = ("open_sine", "open_square", "open_multisine", "closed_sine", "closed_square")
    made = {}
    for i in range(count):
        kind = kinds[i % len(kinds)]
        start = rng.uniform(-60, 60) * DEG
        frequency, seconds = rng.uniform(0.35, 1.2), rng.uniform(5, 8)
        volts, speed = rng.uniform(0.55, 0.85), rng.uniform(8, 18)
        phases = rng.uniform(-np.pi, np.pi, len(MULTISINE_HZ))
        scale, preload = _MULTISINE_V * rng.uniform(0.85, 1.15), rng.choice([0.0, 0.1, 0.2])
        experiment = {
            "open_sine": Experiment(False, sine(volts, frequency, seconds), start),
            "open_square": Experiment(False, square(volts, 0.6 * frequency, seconds), start),
            "open_multisine": Experiment(False, multisine(phases, scale, seconds), start, preload),
            "closed_sine": Experiment(True, sine(speed, frequency, seconds), start),
            "closed_square": Experiment(True, square(speed, frequency, seconds), start),
        }[kind]
        made[f"{prefix}_{i + 1}_{kind}"] = experiment
    return made
