"""The experiments of section 4.2 on a simulated rig, with its sensors: logs to learn on.

The same signals can be run on a real rig; the functions of the other ``experiments`` modules
take logs from either.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import Loop, close_loop, march, rest
from dmptm_ctrl.simulate.model import Floats, Model

DEG = np.pi / 180
# Stiff enough to hold a constant speed on the falling branch of the Stribeck curve, whose
# slope at the ring gear is −1300 N·m·s/rad; kp alone gives 2800.
SPEED_LOOP = Loop(kp=0.3 / DEG, ki=10.0 / DEG, limit=10.0)  # V/(rad/s), V/rad, V
RAMP_SECONDS = 0.5  # between two speeds of a staircase


class Sensors(NamedTuple):
    """Resolution and noise of the rig's sensors, as in its logs."""

    gyro: float = 0.05 * DEG  # rad/s rms per sample
    ring: float = 2 * np.pi / 2**18  # rad, one count
    motor: float = 2 * np.pi / 10_000  # rad, one count


def as_log(
    name: str,
    u: Floats,
    out: Floats,
    noise: Floats,
    dt: float,
    *,
    sensors: Sensors = Sensors(),
    ref: Floats | None = None,
) -> Log:
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
        "theta_L": np.round(out[:, 0] / sensors.ring) * sensors.ring,
        "omega_L": out[:, 1] + noise,
        "theta_ml": np.round(out[:, 2] / sensors.motor) * sensors.motor,
        "theta_mr": np.round(out[:, 3] / sensors.motor) * sensors.motor,
    }
    if ref is not None:
        channels["ref"] = ref
    return Log(name, np.asarray(dt * np.arange(noise.size), float), channels)


def staircase(
    model: Model,
    speeds: Sequence[float],
    preload: float,
    rng: np.random.Generator,
    *,
    seconds: float = 4.0,
    loop: Loop = SPEED_LOOP,
    sensors: Sensors = Sensors(),
    dt: float = 1e-3,
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
    flat, slope = round(seconds / dt), round(RAMP_SECONDS / dt)
    parts, before = [], 0.0
    for speed in speeds:
        parts += [np.linspace(before, speed, slope, endpoint=False), np.full(flat, speed)]
        before = speed
    ref = np.concatenate(parts)
    noise = sensors.gyro * rng.standard_normal(ref.size)
    biased = loop._replace(bias_l=preload, bias_r=-preload)
    start = rng.uniform(-0.5, 0.5)
    u, out = close_loop(model, biased, ref, dt, theta_L=start, noise=noise)
    return as_log(f"staircase_{preload:+g}V", u, out, noise, dt, sensors=sensors, ref=ref)


def ramp(
    model: Model,
    rate: float,
    top: float,
    rng: np.random.Generator,
    *,
    from_flank: bool = False,
    sensors: Sensors = Sensors(),
    dt: float = 1e-3,
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
    n = round(top / abs(rate) / dt)
    common = rate * dt * np.arange(n)
    u = np.array([common, common])
    x0 = rest(model, rng.uniform(-0.5, 0.5))
    x0[:2] += rng.uniform(-0.5, 0.5, 2) * [model.drive["gap_l"], model.drive["gap_r"]]
    if from_flank:
        gaps = np.array([model.drive["gap_l"], model.drive["gap_r"]])
        x0[:2] = model.drive["N_2"] * x0[2] + np.sign(rate) * gaps
    out = march(model, u, x0, dt)
    where = "flank" if from_flank else "gap"
    return as_log(
        f"ramp_{where}_{rate:+g}V_s",
        u,
        out,
        sensors.gyro * rng.standard_normal(len(out)),
        dt,
        sensors=sensors,
    )


def taps(
    model: Model,
    volts: Sequence[float],
    rng: np.random.Generator,
    *,
    half_period: float = 0.4,
    repeats: int = 4,
    sensors: Sensors = Sensors(),
    dt: float = 1e-3,
) -> Log:
    """Push both pinions from flank to flank, against each other.

    Parameters
    ----------
    volts : sequence of float [V]
        Heights of the differential square wave; different ones tell damping from friction.
    half_period : float [s]
        Long enough to cross the gap and come to rest.
    repeats : int
        Periods of each height.
    """
    half = round(half_period / dt)
    wave = np.concatenate(
        [v * np.r_[np.ones(half), -np.ones(half)] for v in volts for _ in range(repeats)]
    )
    u = np.array([wave, -wave])
    out = march(model, u, rest(model, rng.uniform(-0.5, 0.5)), dt)
    return as_log("taps", u, out, sensors.gyro * rng.standard_normal(len(out)), dt, sensors=sensors)


def shaken_turn(
    model: Model,
    lines: Sequence[float],
    volts: float,
    rng: np.random.Generator,
    *,
    differential: bool,
    turn: float = 0.75,
    preload: float = 1.2,
    period: float = 4.0,
    periods: int = 8,
    sensors: Sensors = Sensors(),
    dt: float = 1e-3,
) -> Log:
    """Add a multisine to a steady turn under preload, where the drive is linear.

    Parameters
    ----------
    lines : sequence of float [Hz]
        Whole multiples of 1/period.
    volts : float [V]
        Amplitude of each line.
    differential : bool
        Shake the motors against each other, else together.
    turn, preload : float [V]
        Common voltage that keeps the drive turning, and what holds the flanks.
    period : float [s]
    periods : int
        Kept; one more runs before them to settle.
    """
    n = round(period / dt)
    t = dt * np.arange(n)
    phases = rng.uniform(0, 2 * np.pi, len(lines))
    wave = volts * np.sum(np.sin(2 * np.pi * np.outer(t, lines) + phases), axis=1)
    wave = np.tile(wave, periods + 1)
    sign = -1.0 if differential else 1.0
    u = np.array([turn + preload + wave, turn - preload + sign * wave])
    keep = n - 1  # one sample more than whole periods, so that all their steps are there
    out = march(model, u, rest(model, rng.uniform(-0.5, 0.5)), dt)[keep:]
    name = "shaken_differential" if differential else "shaken_common"
    return as_log(
        name, u[:, keep:], out, sensors.gyro * rng.standard_normal(len(out)), dt, sensors=sensors
    )
