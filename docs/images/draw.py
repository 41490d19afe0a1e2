"""Draw the pictures of README and pages.

python docs/images/draw.py NAME ...     diagnosis, compensation, export, experiment
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import dmptm_ctrl
from dmptm_ctrl import Model
from dmptm_ctrl.data import path
from dmptm_ctrl.design.aims import missed
from dmptm_ctrl.design.draws import FITTED
from dmptm_ctrl.design.duty import DEG, usual_duty
from dmptm_ctrl.export.controller import controller_program
from dmptm_ctrl.export.experiment import Limits, within
from dmptm_ctrl.export.native import Compiled
from dmptm_ctrl.plots.diagnosis import plot_overlay
from dmptm_ctrl.simulate.compiled import close_loop

FOLDER = Path(__file__).parent
MODEL = (
    Model()
    .with_effect("unbalance", cosine=6.0)
    .with_effect("cogging", left_cosine=0.02, right_sine=0.02, order=6.0)
    .with_effect("drive_delay", delay=2e-3)
    .with_effect("sensor_delay", delay=2e-3)
)


def panels(count, heights=None):
    figure = Figure(figsize=(7.6, 3.9), layout="constrained")
    return figure, figure.subplots(count, sharex=True, gridspec_kw={"height_ratios": heights})


def key_above(row):
    """Put the key above a plot, off its curves."""
    row.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def diagnosis():
    """The held-out log of the bundled rig on which the effect shows most."""
    found = dmptm_ctrl.diagnose(path("demo_rig"))
    overlay = max(found.overlays(), key=lambda o: o.rmse("before") - o.rmse("after"))
    names = " and ".join(e.name.replace("_", " ") for e in found.effects) or "nothing"
    figure, rows = panels(2, [3, 2])
    plot_overlay(overlay, ax=rows, title=f"A log held out of the fit. Missing: {names}")
    return figure


def compensation():
    """One move under the controller with and without what its model knows."""
    tuned = dmptm_ctrl.tune_controller(MODEL, uncertainty=FITTED, plants=64)
    duty = usual_duty()
    figure, (top, bottom) = panels(2, [2, 3])
    top.plot(duty.time, duty.reference / DEG, color="0.4")
    for label, controller, color, line in (
        ("without", tuned.without, "#d1495b", "--"),
        ("with compensation", tuned.controller, "#0b3c6f", "-"),
    ):
        _, out = close_loop(MODEL, controller.law(), duty.reference, duty.sample_time)
        judged = duty.time > duty.settling
        miss = missed(MODEL, duty, out[:, 1])[judged] / DEG
        rms = np.sqrt(np.mean(miss**2))
        name = f"{label}, rms {rms:.3f} deg/s"
        bottom.plot(duty.time[judged], miss, line, color=color, lw=1.0, label=name)
    top.set(ylabel="setpoint [deg/s]", title=f"Predicted gain: {np.median(tuned.gains):.0%}")
    bottom.set(xlim=(duty.settling, duty.time[-1]))
    bottom.set(xlabel="time [s]", ylabel="error [deg/s]")
    key_above(bottom)
    return figure


def export():
    """Voltage of a controller in Python and in C, and what lies between."""
    controller = dmptm_ctrl.Controller(
        12.0, 60.0, preload=0.3, inertia=1.0, friction=1.0, effects=1.0, model=MODEL
    )
    time = 1e-3 * np.arange(3000)
    wish = 0.25 * np.sin(2 * np.pi * 0.5 * time)
    angle = np.cumsum(wish) * 1e-3
    python, figure_rows = controller.law().stepper(1e-3), panels(2, [3, 2])
    step = Compiled(controller_program(controller))
    rows = [(w, a, 0.95 * w, 206.25 * a, 206.25 * a) for w, a in zip(wish, angle, strict=True)]
    ours, native = (np.array([run(*row) for row in rows]) for run in (python, step))
    figure, (top, bottom) = figure_rows
    top.plot(time, ours[:, 0], color="0.7", lw=4, label="Python")
    top.plot(time, native[:, 0], color="#0b3c6f", lw=1.0, label="compiled C")
    top.set(ylabel="left motor [V]")
    key_above(top)
    bottom.plot(time, np.abs(native - ours).max(axis=1) / controller.limit, "k.", ms=2)
    bottom.set(xlabel="time [s]", ylabel="difference / limit", ylim=(-1e-16, 1e-15))
    return figure


def experiment():
    """A planned signal before and after it keeps the limits, and the speed it gives."""
    import pandas as pd

    time = 1e-3 * np.arange(6000)
    wish = 1.5 * np.sin(2 * np.pi * (0.2 + 0.15 * time) * time)
    table = pd.DataFrame({"time_s": time, "u_left_V": wish + 0.2, "u_right_V": wish - 0.2})
    limits = Limits(signal=1.2, speed=0.4, travel=0.5)
    kept = within(table, limits, model=MODEL)
    volts = kept[["u_left_V", "u_right_V"]].to_numpy().T
    angle, speed = dmptm_ctrl.simulate(MODEL, time, volts).outputs[:2]
    figure, rows = panels(3)
    rows[0].plot(time, table.u_left_V, color="0.7", label="planned")
    rows[0].plot(time, kept.u_left_V, color="#0b3c6f", label="ready to run")
    key_above(rows[0])
    for row, values, limit in zip(rows[1:], (speed, angle), (0.4, 0.5), strict=True):
        row.plot(time, values, color="#0b3c6f")
        row.axhline(limit, color="#d1495b", lw=0.8, ls="--")
        row.axhline(-limit, color="#d1495b", lw=0.8, ls="--")
    for row, label in zip(rows, ("left [V]", "speed [rad/s]", "travel [rad]"), strict=True):
        row.set(ylabel=label)
    rows[2].set(xlabel="time [s]")
    return figure


PICTURES = {make.__name__: make for make in (diagnosis, compensation, export, experiment)}


def main():
    mpl.use("agg")
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]().savefig(FOLDER / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
