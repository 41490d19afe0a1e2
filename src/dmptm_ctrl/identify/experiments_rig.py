"""The experiments of section 4.2 on a simulated rig, with its sensors: logs to learn on.

The same signals can be run on a real rig; the functions of the other ``experiments`` modules
take logs from either.
"""

from collections.abc import Sequence

import numpy as np

from dmptm_ctrl.identify.records import RING_COUNT
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import Loop, close_loop, march, rest
from dmptm_ctrl.simulate.model import Floats, Model

DEG = np.pi / 180
DT = 1e-3  # s
# Noise and resolution of the rig's sensors, as in its logs
GYRO = 0.05 * DEG  # rad/s rms per sample
MOTOR_COUNT = 2 * np.pi / 10_000  # rad
# Stiff enough to hold a constant speed on the falling branch of the Stribeck curve, whose
# slope at the ring gear is −1300 N·m·s/rad; kp alone gives 2800.
SPEED_LOOP = Loop(kp=0.3 / DEG, ki=10.0 / DEG, limit=10.0)  # V/(rad/s), V/rad, V
RAMP_SECONDS = 0.5  # between two speeds of a staircase
TAP_SECONDS = 0.4  # of each tap: long enough to cross the gap and come to rest
TURN, TURN_PRELOAD = 0.75, 1.2  # V, keep the shaken drive turning, and hold its flanks
SHAKEN_SECONDS = 4.0  # of one period of the multisine
SHAKEN_PERIODS = 8  # kept; one more runs before them to settle


def as_log(name: str, u: Floats, out: Floats, noise: Floats, ref: Floats | None = None) -> Log:
    """Return a simulated run as its sensors would log it.

    Parameters
    ----------
    u : (2, n) array [V]
    out : (n, 8) array
        Of the compiled simulator.
    noise : (n,) array [rad/s]
        Of the gyro; what the loop saw, if there was one.
    """
    channels = {
        "u_left": u[0],
        "u_right": u[1],
        "theta_L": np.round(out[:, 0] / RING_COUNT) * RING_COUNT,
        "omega_L": out[:, 1] + noise,
        "theta_ml": np.round(out[:, 2] / MOTOR_COUNT) * MOTOR_COUNT,
        "theta_mr": np.round(out[:, 3] / MOTOR_COUNT) * MOTOR_COUNT,
    }
    if ref is not None:
        channels["ref"] = ref
    return Log(name, np.asarray(DT * np.arange(noise.size), float), channels)


def staircase(
    model: Model,
    speeds: Sequence[float],
    preload: float,
    rng: np.random.Generator,
    *,
    seconds: float = 2.0,
) -> Log:
    """Hold one speed after another under preload.

    Parameters
    ----------
    speeds : sequence of float [rad/s]
        Of the ring gear.
    preload : float [V]
        On the left motor, its negative on the right one: holds the flanks.
    seconds : float [s]
        At each speed.
    """
    flat, slope = round(seconds / DT), round(RAMP_SECONDS / DT)
    parts, before = [], 0.0
    for speed in speeds:
        parts += [np.linspace(before, speed, slope, endpoint=False), np.full(flat, speed)]
        before = speed
    ref = np.concatenate(parts)
    noise = GYRO * rng.standard_normal(ref.size)
    biased = SPEED_LOOP._replace(bias_l=preload, bias_r=-preload)
    start = rng.uniform(-0.5, 0.5)
    u, out = close_loop(model, biased, ref, DT, theta_L=start, noise=noise)
    return as_log(f"staircase_{preload:+g}V", u, out, noise, ref)


def ramp(
    model: Model, rate: float, top: float, rng: np.random.Generator, *, from_flank: bool = False
) -> Log:
    """Raise the voltage of both motors slowly from 0 until everything moves.

    Parameters
    ----------
    rate : float [V/s]
        Its sign is the direction.
    top : float [V]
        Where the ramp ends.
    from_flank : bool
        Start with both pinions on the flanks that they will push, else at mid-gap.
    """
    n = round(top / abs(rate) / DT)
    common = rate * DT * np.arange(n)
    u = np.array([common, common])
    x0 = rest(model, rng.uniform(-0.5, 0.5))
    gaps = np.array([model.drive["gap_l"], model.drive["gap_r"]])
    x0[:2] += rng.uniform(-0.5, 0.5, 2) * gaps
    if from_flank:
        x0[:2] = model.drive["N_2"] * x0[2] + np.sign(rate) * gaps
    out = march(model, u, x0, DT)
    where = "flank" if from_flank else "gap"
    return as_log(f"ramp_{where}_{rate:+g}V_s", u, out, GYRO * rng.standard_normal(n))


def taps(
    model: Model, volts: Sequence[float], rng: np.random.Generator, *, repeats: int = 3
) -> Log:
    """Push both pinions from flank to flank, against each other.

    Parameters
    ----------
    volts : sequence of float [V]
        Heights of the differential square wave; different ones separate damping from friction.
    repeats : int
        Periods of each height.
    """
    half = round(TAP_SECONDS / DT)
    wave = np.concatenate(
        [v * np.r_[np.ones(half), -np.ones(half)] for v in volts for _ in range(repeats)]
    )
    u = np.array([wave, -wave])
    out = march(model, u, rest(model, rng.uniform(-0.5, 0.5)), DT)
    return as_log("taps", u, out, GYRO * rng.standard_normal(len(out)))


def shaken_turn(
    model: Model,
    lines: Sequence[float],
    volts: float,
    rng: np.random.Generator,
    *,
    differential: bool,
) -> Log:
    """Add a multisine to a steady turn under preload, where the drive is linear.

    Parameters
    ----------
    lines : sequence of float [Hz]
        Whole multiples of 1/:data:`SHAKEN_SECONDS`.
    volts : float [V]
        Amplitude of each line.
    differential : bool
        Shake the motors against each other, else together.
    """
    n = round(SHAKEN_SECONDS / DT)
    t = DT * np.arange(n)
    phases = rng.uniform(0, 2 * np.pi, len(lines))
    wave = volts * np.sum(np.sin(2 * np.pi * np.outer(t, lines) + phases), axis=1)
    wave = np.tile(wave, SHAKEN_PERIODS + 1)
    sign = -1.0 if differential else 1.0
    u = np.array([TURN + TURN_PRELOAD + wave, TURN - TURN_PRELOAD + sign * wave])
    keep = n - 1  # one sample more than whole periods, so that all their steps are there
    out = march(model, u, rest(model, rng.uniform(-0.5, 0.5)), DT)[keep:]
    name = "shaken_differential" if differential else "shaken_common"
    return as_log(name, u[:, keep:], out, GYRO * rng.standard_normal(len(out)))
