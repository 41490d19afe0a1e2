"""What an effect does to a loop: the same controller on the drive without and with it."""

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
import pandas as pd

from dmptm_ctrl.control.shaping import SampledPlant
from dmptm_ctrl.design.aims import error_unit, missed
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, FASTEST, Duty, usual_duty
from dmptm_ctrl.design.linear import level, linear_plant, linear_rig
from dmptm_ctrl.design.rig_aims import rig_aims
from dmptm_ctrl.simulate.any_model import (
    AnyModel,
    at_rest,
    effects_of,
    inputs_of,
    loop_parts,
    speed_read,
    steps_of,
)
from dmptm_ctrl.simulate.closed import close_loop
from dmptm_ctrl.simulate.loop_check import check_loop
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.rig_model import RigModel, declared_effects

# shares of the largest speed, that of the usual duty or of a rig's
SPEEDS = (0.2, 1.0)  # of turns about which the loop is linearised
AMPLITUDES = (2.0 / 15.0, 10.0 / 15.0)  # of the sines that measure the bandwidth
SLOW_STEP = 1.0 / 15.0  # sticking shows at slow steps
ASKED = 0.05 / 15.0  # a setpoint below asks for no motion
SWEEP_HZ = np.geomspace(1.0, 80.0, 24)
SWEEP_S = 2.0  # s per frequency, the second half is measured
STUCK = 1e-9  # rad/s; friction holds exactly


@dataclass(frozen=True, eq=False)
class Impact:
    """The loop on both drives, "nominal" and "augmented"."""

    table: pd.DataFrame  # a row per quantity; columns nominal, augmented, change in %
    duty: Duty
    speeds: dict[str, Floats]  # that is controlled, along the duty [rad/s, of a rig SI]
    sweep_hz: Floats
    gains: dict[str, Floats]  # (amplitudes, m) of the closed loop
    effects: tuple[str, ...]
    unit: tuple[str, float] = ("deg/s", DEG)  # of speeds that are shown, and its size in SI

    def __str__(self) -> str:
        return str(self.table.round(2))

    def plot(self, **options: Any) -> Any:
        """Draw speeds and errors along the duty, and closed-loop gains; see `plots.control`."""
        from dmptm_ctrl.plots.control import plot_impact

        return plot_impact(self, **options)


def impact(
    model: Any,
    controller: Controller,
    *,
    nominal: AnyModel | None = None,
    duty: Duty | None = None,
    theta_L: float = 0.0,
) -> Impact:
    """Run one controller on a drive with and without its effects, and compare.

    Parameters
    ----------
    model : Model, RigModel or Diagnosis
        A Diagnosis counts with its `augmented` model.
    controller : Controller
        The same on both drives.
    nominal : Model or RigModel, optional
        The drive without the effects; by default `model` with its effects taken away, but for
        those that a rig file declares.
    duty : Duty, optional
        By default the usual one; of a rig that of :func:`~dmptm_ctrl.design.rig_aims.rig_aims`.
    theta_L : float
        Angle to start from [rad]; a rig starts at 0.

    Returns
    -------
    Impact
        ``table`` of margins, errors, limit cycle and bandwidth on both drives, ``inf`` where no
        gain up to 80 Hz falls 3 dB; ``plot()`` draws the runs.

    Raises
    ------
    ValueError
        A model without effects and no `nominal` to compare with.
    TypeError
        Another kind of model.

    Examples
    --------
    >>> model = dm.Model().with_effect("unbalance", cosine=8.0, sine=0.0)
    >>> print(dm.impact(model, dm.Controller(5.0, 90.0, preload=0.3)))
    """
    augmented: Any = getattr(model, "augmented", model)
    if not isinstance(augmented, Model | RigModel):
        raise TypeError("impact takes a Model, a RigModel or a Diagnosis first")
    rig = augmented.rig if isinstance(augmented, RigModel) else None
    known = {e.key for e in declared_effects(rig)} if rig else ()
    effects = [key for key in effects_of(augmented) if key not in known]
    if nominal is None:
        if not effects:
            raise ValueError("the model has no effects; give the nominal one to compare it with")
        nominal = augmented.without(effects)
    dt, parts = controller.sample_time, (controller.input, controller.sensor)
    if duty is None and isinstance(augmented, RigModel):
        duty = rig_aims(augmented, *parts, limit=controller.limit, sample_time=dt).duty
    duty = duty or usual_duty(dt)
    unit, size = error_unit(controller)
    top = FASTEST if rig is None else float(np.abs(duty.reference).max())
    columns, speeds, gains = {}, {}, {}
    for name, model in (("nominal", nominal), ("augmented", augmented)):
        columns[name], speeds[name] = _along(model, controller, duty, theta_L, top)
        gains[name] = swept_gains(model, controller, top)
        for amplitude, row in zip(AMPLITUDES, gains[name], strict=True):
            key = f"bandwidth at {amplitude * top / size:g} {unit}, Hz"
            columns[name][key] = _falls(SWEEP_HZ, row)
    table = pd.DataFrame(columns)
    table["change_percent"] = 100.0 * (table["augmented"] / table["nominal"] - 1.0)
    return Impact(table, duty, speeds, SWEEP_HZ, gains, tuple(effects), (unit, size))


def _along(
    model: AnyModel, controller: Controller, duty: Duty, theta_L: float, top: float
) -> tuple[dict[str, float], Floats]:
    """Rows of the table, and the speed along the duty."""
    rows: dict[str, float] = {}
    (unit, size), (volt, _) = error_unit(controller), controller.units
    for share in (None,) if isinstance(model, RigModel) else SPEEDS:
        speed = top * (share or 0.0)
        at = f" at {speed / size:g} {unit}" if share else ""
        phase, gain, crossover = margins(model, controller, speed, theta_L)
        rows[f"crossover{at}, Hz"] = crossover
        rows[f"phase margin{at}, deg"] = phase
        rows[f"gain margin{at}, dB"] = gain
    run = close_loop(model, controller, duty.time, duty.reference, theta_L=theta_L)
    inputs, sensor = loop_parts(model, controller.input, controller.sensor)
    u = run.outputs[-len(inputs_of(model)) :][list(inputs)]
    settled = slice(round(duty.settling / duty.sample_time), None)
    speeds = speed_read(model, run.outputs[sensor], duty.sample_time, sensor)
    omega, ref, asked = speeds[settled], duty.reference[settled], ASKED * top
    miss = missed(model, duty, run.outputs[sensor], sensor=sensor)[settled] / size
    rows[f"tracking error rms, {unit}"] = float(np.sqrt(np.mean(miss**2)))
    rows[f"tracking error max, {unit}"] = float(np.abs(miss).max())
    reversals = max(int(np.sum(np.diff(np.sign(ref[np.abs(ref) > asked])) != 0)), 1)
    stuck = np.sum((np.abs(omega) < STUCK) & (np.abs(ref) > asked))
    rows["sticking per reversal, ms"] = 1e3 * float(stuck) * duty.sample_time / reversals
    signal = "voltage" if volt == "V" else "signal"
    rows[f"{signal} rms, {volt}"] = float(np.sqrt(np.mean(u[:, settled] ** 2)))
    step = check_loop(model, controller, SLOW_STEP * top, sample_time=duty.sample_time)
    cycle = f"limit cycle at {SLOW_STEP * top / size:g} {unit}, {unit}"
    rows[cycle] = step.limit_cycle_amplitude / size
    return rows, speeds


def margins(
    model: AnyModel, controller: Controller, speed: float, theta_L: float = 0.0
) -> tuple[float, float, float]:
    """Return phase margin [deg], gain margin [dB] and crossover [Hz] about a steady turn.

    Of a rig in contact, at any speed. Of the sampled loop with all its sections, by
    python-control on the frequency response.
    """
    dt = controller.sample_time
    if isinstance(model, RigModel):
        plant = linear_rig(level(model), controller.input, controller.sensor, dt)
    else:
        plant = linear_plant(model, speed=speed, theta_L=theta_L)
    sampled = SampledPlant(plant, dt)
    loop = controller.to_discrete()(sampled.shift) * sampled.response
    gain, phase, _, _, crossover, _ = ct.stability_margins(ct.frd(loop, sampled.omega))
    return float(phase), 20.0 * float(np.log10(gain)), float(crossover) / (2.0 * np.pi)


def swept_gains(model: AnyModel, controller: Controller, top: float = FASTEST) -> Floats:
    """Return closed-loop gains of the nonlinear drive, (amplitudes, frequencies).

    First harmonic of the speed over that of a sine setpoint, one run each; amplitudes are shares
    of the `top` speed [rad/s].
    """
    dt = controller.sample_time
    time = np.arange(round(SWEEP_S / dt)) * dt
    half = time >= 0.5 * SWEEP_S
    waves = np.exp(2j * np.pi * SWEEP_HZ[:, None] * time)
    targets = np.concatenate([a * top * waves.imag for a in AMPLITUDES])
    sensor = loop_parts(model, controller.input, controller.sensor)[1]
    common = Common(
        dt, steps_of(model, dt), time.size, np.zeros((1, len(inputs_of(model)), 0)), targets,
        np.zeros((0, 0)), (f"reading{sensor}",),
    )  # fmt: skip
    count, law = len(targets), controller.law()
    runs, _ = run_many([model] * count, [at_rest(model)] * count, common, [law] * count)
    gains = []
    for k, (target, (reading,)) in enumerate(zip(targets, runs, strict=True)):
        speed = speed_read(model, reading, dt, sensor)
        wave = waves[k % SWEEP_HZ.size]
        basis = np.column_stack([wave.real[half], wave.imag[half], np.ones(half.sum())])
        fits = np.linalg.lstsq(basis, np.column_stack([target[half], speed[half]]), rcond=None)[0]
        gains.append(np.hypot(*fits[:2, 1]) / np.hypot(*fits[:2, 0]))
    return np.array(gains).reshape(len(AMPLITUDES), SWEEP_HZ.size)


def _falls(hz: Floats, gain: Floats) -> float:
    """Frequency where the gain first falls 3 dB below 1; infinite where it does not."""
    below = np.flatnonzero(gain < np.sqrt(0.5))
    if below.size == 0 or below[0] == 0:
        return float(np.inf if below.size == 0 else hz[0])
    k = below[0]
    where = np.interp(-np.sqrt(0.5), -gain[[k - 1, k]], np.log(hz[[k - 1, k]]))
    return float(np.exp(where))
