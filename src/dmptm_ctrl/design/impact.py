"""What an effect does to a loop: the same controller on the drive without and with it."""

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
import pandas as pd

from dmptm_ctrl.control.shaping import SampledPlant
from dmptm_ctrl.design.aims import missed
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, usual_duty
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import close_loop
from dmptm_ctrl.simulate.loop_check import check_loop
from dmptm_ctrl.simulate.model import Floats, Model

SPEEDS = (3 * DEG, 15 * DEG)  # rad/s, turns about which the loop is linearised
AMPLITUDES = (2 * DEG, 10 * DEG)  # rad/s, of the sines that measure the bandwidth
SLOW_STEP = 1 * DEG  # rad/s; sticking shows at slow steps
SWEEP_HZ = np.geomspace(1.0, 80.0, 24)
SWEEP_S = 2.0  # s per frequency, the second half is measured
STUCK = 1e-9  # rad/s; friction holds exactly
ASKED = 0.05 * DEG  # rad/s; a setpoint below asks for no motion


@dataclass(frozen=True, eq=False)
class Impact:
    """The loop on both drives, "nominal" and "augmented"."""

    table: pd.DataFrame  # a row per quantity; columns nominal, augmented, change in %
    duty: Duty
    speeds: dict[str, Floats]  # of the ring gear along the duty [rad/s]
    sweep_hz: Floats
    gains: dict[str, Floats]  # (amplitudes, m) of the closed loop
    effects: tuple[str, ...]

    def plot(self, **options: Any) -> Any:
        """Draw speeds and errors along the duty, and closed-loop gains; see `plots.control`."""
        from dmptm_ctrl.plots.control import plot_impact

        return plot_impact(self, **options)


def impact(
    found: Any,
    controller: Controller,
    *,
    nominal: Model | None = None,
    duty: Duty | None = None,
    theta_L: float = 0.0,
) -> Impact:
    """Tell what the effects of a model do to a loop.

    Parameters
    ----------
    found : Model or Diagnosis
        A Diagnosis counts with its `augmented` model.
    controller : Controller
        The same on both drives.
    nominal : Model, optional
        The drive without the effects; by default `found` with its effects taken away.
    duty : Duty, optional
    theta_L : float
        Angle to start from [rad].

    Returns
    -------
    Impact

    Raises
    ------
    ValueError
        A model without effects and no `nominal` to compare with.
    TypeError
        Of a drive of another shape.

    Examples
    --------
    >>> model = dm.Model().with_effect("unbalance", cosine=8.0, sine=0.0)
    >>> print(dm.impact(model, dm.Controller(5.0, 90.0, preload=0.3)).table)
    """
    augmented: Model = getattr(found, "augmented", found)
    if not isinstance(augmented, Model):
        raise TypeError("impact takes a Model, or the Diagnosis of a dual-motor drive")
    if nominal is None:
        if not augmented.effects:
            raise ValueError("the model has no effects; give the nominal one to compare it with")
        nominal = augmented.without(augmented.effects)
    duty = duty or usual_duty(controller.sample_time)
    columns, speeds, gains = {}, {}, {}
    for name, model in (("nominal", nominal), ("augmented", augmented)):
        columns[name], speeds[name] = _along(model, controller, duty, theta_L)
        gains[name] = swept_gains(model, controller)
        for amplitude, row in zip(AMPLITUDES, gains[name], strict=True):
            key = f"bandwidth at {amplitude / DEG:g} deg/s, Hz"
            columns[name][key] = _falls(SWEEP_HZ, row)
    table = pd.DataFrame(columns)
    table["change_percent"] = 100.0 * (table["augmented"] / table["nominal"] - 1.0)
    return Impact(table, duty, speeds, SWEEP_HZ, gains, tuple(augmented.effects))


def _along(
    model: Model, controller: Controller, duty: Duty, theta_L: float
) -> tuple[dict[str, float], Floats]:
    """Rows of the table, and the speed along the duty."""
    rows: dict[str, float] = {}
    for speed in SPEEDS:
        phase, gain, crossover = margins(model, controller, speed, theta_L)
        at = f"at {speed / DEG:g} deg/s"
        rows[f"crossover {at}, Hz"] = crossover
        rows[f"phase margin {at}, deg"] = phase
        rows[f"gain margin {at}, dB"] = gain
    law = controller.law()
    u, out = close_loop(model, law, duty.reference, duty.sample_time, theta_L=theta_L)
    judged = slice(round(duty.settling / duty.sample_time), None)
    omega, ref = out[judged, 1], duty.reference[judged]
    miss = missed(model, duty, out[:, 1])[judged] / DEG
    rows["tracking error rms, deg/s"] = float(np.sqrt(np.mean(miss**2)))
    rows["tracking error max, deg/s"] = float(np.abs(miss).max())
    reversals = max(int(np.sum(np.diff(np.sign(ref[np.abs(ref) > ASKED])) != 0)), 1)
    stuck = np.sum((np.abs(omega) < STUCK) & (np.abs(ref) > ASKED))
    rows["sticking per reversal, ms"] = 1e3 * float(stuck) * duty.sample_time / reversals
    rows["voltage rms, V"] = float(np.sqrt(np.mean(u[:, judged] ** 2)))
    step = check_loop(model, law, SLOW_STEP, sample_time=duty.sample_time)  # type: ignore[arg-type]
    rows[f"limit cycle at {SLOW_STEP / DEG:g} deg/s, deg/s"] = step.limit_cycle_amplitude / DEG
    return rows, out[:, 1]


def margins(
    model: Model, controller: Controller, speed: float, theta_L: float = 0.0
) -> tuple[float, float, float]:
    """Return phase margin [deg], gain margin [dB] and crossover [Hz] about a steady turn.

    Of the sampled loop with all its sections, by python-control on the frequency response.
    """
    plant = linear_plant(model, speed=speed, theta_L=theta_L)
    sampled = SampledPlant(plant, controller.sample_time)
    loop = controller.to_discrete()(sampled.shift) * sampled.response
    gain, phase, _, _, crossover, _ = ct.stability_margins(ct.frd(loop, sampled.omega))
    return float(phase), 20.0 * float(np.log10(gain)), float(crossover) / (2.0 * np.pi)


def swept_gains(model: Model, controller: Controller) -> Floats:
    """Return closed-loop gains of the nonlinear drive, (amplitudes, frequencies).

    First harmonic of the speed over that of a sine setpoint, one run each.
    """
    dt = controller.sample_time
    time = np.arange(round(SWEEP_S / dt)) * dt
    half = time >= 0.5 * SWEEP_S
    waves = np.exp(2j * np.pi * SWEEP_HZ[:, None] * time)
    targets = np.concatenate([a * waves.imag for a in AMPLITUDES])
    runs = simulate_batch(
        [model] * len(targets), time, targets, loop=controller.law(), outputs=["omega_L"], n_jobs=1
    )
    gains = []
    for k, (target, speed) in enumerate(zip(targets, runs.outputs[:, 0], strict=True)):
        wave = waves[k % SWEEP_HZ.size]
        basis = np.column_stack([wave.real[half], wave.imag[half], np.ones(half.sum())])
        fits = np.linalg.lstsq(basis, np.column_stack([target[half], speed[half]]), rcond=None)[0]
        gains.append(np.hypot(*fits[:2, 1]) / np.hypot(*fits[:2, 0]))
    return np.array(gains).reshape(len(AMPLITUDES), SWEEP_HZ.size)


def _falls(hz: Floats, gain: Floats) -> float:
    """Frequency where the gain first falls 3 dB below 1; the last one where it does not."""
    below = np.flatnonzero(gain < np.sqrt(0.5))
    if below.size == 0 or below[0] == 0:
        return float(hz[-1] if below.size == 0 else hz[0])
    k = below[0]
    where = np.interp(-np.sqrt(0.5), -gain[[k - 1, k]], np.log(hz[[k - 1, k]]))
    return float(np.exp(where))
