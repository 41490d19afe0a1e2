"""Numbers behind the pictures of a dual-motor drive: folded residuals, orders per turn, gaps.

The residual that is folded is chosen by where the effect acts: the reading of the speed
sensor for sensors, the twist of the left pinion for meshes (with motor encoders), else the
torque at the ring gear that the model lacks. That torque is read off an observer: driven by
the measured angle with bandwidth ω0 the model lags by an angle e and a speed v behind a torque
T = J ω0² e + B v that it does not know.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.diagnosis.quality import Rows, fold, order_amplitudes
from dmptm_ctrl.drive import pinion_inertia
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.identify.records import Record, block_mean, predict
from dmptm_ctrl.plots.diagnosis import Evidence
from dmptm_ctrl.plots.gaps import animated_uri, busiest, gap_motion
from dmptm_ctrl.plots.page import data_uri
from dmptm_ctrl.plots.quality import Orders, plot_orders
from dmptm_ctrl.simulate.model import Floats, Model

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.dual_report import DualSource

OBSERVER_HZ = 5.0  # above what position, load and speed change by; below the impact chatter
SLOWEST = np.deg2rad(1.0)  # rad/s; slower than this a direction is not sure
BLOCK_SECONDS = 0.005  # orders are of means over blocks: to 100 Hz, past the 60 Hz mode
MAX_ORDER = 12.0  # per motor turn
ORDERS_PER_TURN = 100  # lines per unit order
ARCMIN = np.rad2deg(1.0) * 60.0
TORQUE = "torque the model lacks,\nat the ring gear [N·m]"


def folded(source: "DualSource", name: str, unexplained: tuple[str, ...]) -> Evidence:
    """Fold what is left over the variable that an effect depends on.

    Of no effect (a name that is empty, or on no list) over the first of the `unexplained`
    variables.
    """
    effect = CATALOGUE.get(name)
    without, after = source.without(name), source.models[1]
    records = {r.name: r for r in (*source.measured.fit, *source.measured.held)}.values()
    values = after.effects.get(name, {})
    on = depends_on(effect, unexplained)
    sides: list[list[Rows]] = [[], []]
    variable = quantity = ""
    for rec in records:
        speed = low_pass(rec.omega, rec.dt)
        share = min(1.0, rec.dt * 2.0 * np.pi * OBSERVER_HZ)  # closer samples count as one
        for rows, model in zip(sides, (without, after), strict=True):
            run = predict(rec, model, OBSERVER_HZ)
            x, variable = abscissa(on, rec, run, model, effect, values)
            y, keep, quantity = left_over(rec, run, model, effect)
            keep = keep & (np.abs(speed) > SLOWEST)
            rows.append((x[keep], y[keep], np.sign(speed[keep]), share))
    return fold(sides[0], sides[1], variable, quantity, name if effect else "")


def depends_on(effect: Effect | None, unexplained: tuple[str, ...]) -> str:
    """Return the variable to fold over."""
    if effect is None:
        return unexplained[0] if unexplained else "theta_L"
    if effect.site == "sensor_delay":
        return "acceleration"
    return "du_dt" if "du_dt" in effect.depends_on else effect.depends_on[0]


def abscissa(
    on: str,
    rec: Record,
    run: Floats,
    model: Model,
    effect: Effect | None,
    values: Mapping[str, float],
) -> tuple[Floats, str]:
    """Return the variable along a log in the unit of its label."""
    n1 = model.drive["N_1"]
    if on == "theta_m":
        turn = rec.theta * n1 * model.drive["N_2"]
        if rec.twist is not None:
            turn = turn + n1 * rec.twist[:, 0]
        if effect is not None and effect.site == "mesh":
            period = 2.0 * np.pi / (model.drive["z_3"] if effect.name == "mesh_error" else 1.0)
            return np.rad2deg(np.mod(turn / n1, period)), "angle of the left pinion [deg]"
        period = 2.0 * np.pi / max(1.0, round(values.get("order", 1.0)))
        return np.rad2deg(np.mod(turn, period)), "angle of the left motor [deg]"
    if on == "time":
        seconds = rec.time - rec.time[0]
        if "frequency" in values:
            return np.mod(seconds, 1.0 / values["frequency"]), "time, modulo one period [s]"
        return seconds, "time [s]"
    voltage = rec.u.mean(0)
    if effect is not None and effect.name == "torque_constant_mismatch":
        return rec.u[0] - rec.u[1], "voltage left − right [V]"
    table: dict[str, tuple[Floats, str]] = {
        "theta_L": (np.rad2deg(rec.theta), "ring-gear angle [deg]"),
        "omega_L": (np.rad2deg(low_pass(rec.omega, rec.dt)), "ring-gear speed [deg/s]"),
        "omega_m": (low_pass(rec.omega, rec.dt) * n1 * model.drive["N_2"], "motor speed [rad/s]"),
        "acceleration": (
            np.rad2deg(np.gradient(low_pass(rec.omega, rec.dt), rec.dt)),
            "acceleration of the ring gear [deg/s²]",
        ),
        "u": (voltage, "voltage, mean of both motors [V]"),
        "du_dt": (
            np.gradient(low_pass(voltage, rec.dt), rec.dt),
            "rate of the voltage, mean of both motors [V/s]",
        ),
        "mesh_torque": (
            model.drive["N_2"] * np.abs(run[:, 4:6]).sum(1),
            "load on both meshes, at the ring gear [N·m]",
        ),
        "time_at_rest": (since_rest(rec), "time since the last rest [s]"),
    }
    return table[on]


def since_rest(rec: Record) -> Floats:
    """Time since the speed was last below :data:`SLOWEST` [s]."""
    rest = np.abs(low_pass(rec.omega, rec.dt)) <= SLOWEST
    index = np.arange(rest.size)
    last = np.maximum.accumulate(np.where(rest, index, 0))
    return np.asarray((index - last) * rec.dt)


def left_over(
    rec: Record, run: Floats, model: Model, effect: Effect | None
) -> tuple[Floats, np.ndarray, str]:
    """Return the residual along a log, where it is known, and its label."""
    everywhere = np.ones(rec.theta.size, bool)
    site = effect.site if effect is not None else ""
    n2 = model.drive["N_2"]
    if site.startswith("sensor"):
        # The reading against the motion of the angle; the model's reading has its effect.
        y = np.rad2deg(low_pass(rec.omega - run[:, 1], rec.dt))
        return y, everywhere, "speed reading − model [deg/s]"
    fast = effect is not None and effect.depends_on == ("theta_m",)
    if rec.twist is not None and (site == "mesh" or fast):
        label = "twist of the left pinion,\nmeasured − model [arcmin]"
        return *_twist_missed(rec.twist[:, 0], run, model), label
    inertia = model.drive["J_L"] + 2.0 * n2**2 * pinion_inertia(model.drive)
    forward, backward = (
        model.drive[f"BL_{way}"] + 2.0 * n2**2 * model.drive[f"B3_{way}"]
        for way in ("plus", "minus")
    )
    viscous = np.where(rec.omega > 0.0, forward, backward)
    lag, slower = rec.theta - run[:, 0], low_pass(rec.omega - run[:, 1], rec.dt)
    lacking = inertia * (2.0 * np.pi * OBSERVER_HZ) ** 2 * lag + viscous * slower
    return lacking, everywhere, TORQUE


def _twist_missed(twist: Floats, run: Floats, model: Model) -> tuple[Floats, np.ndarray]:
    """What a run misses of the left pinion's twist [arcmin], and where both are on one flank."""
    flank = np.sign(twist) * (np.abs(twist) > 0.75 * model.drive["gap_l"])
    predicted = run[:, 2] / model.drive["N_1"] - model.drive["N_2"] * run[:, 0]
    return ARCMIN * (twist - predicted), (flank != 0.0) & (flank == np.sign(run[:, 6]))


def gaps_uri(source: "DualSource") -> str:
    """Moving picture of the gaps in the first held-out log as a data URI; empty: they are still."""
    motion = gap_motion(source.measured.held_logs[0], source.augmented)
    return animated_uri(busiest(motion)) or ""


def orders_uri(along: Orders) -> str:
    """Picture of the orders as a data URI."""
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    plot_orders(along, ax=figure.subplots())
    return data_uri(figure)


def orders(source: "DualSource") -> Orders:
    """Amplitude of what is left per order of the motor's turn, before and after.

    Of the transmission error (twist of the left pinion, measured − model) where there are motor
    encoders, else of the speed.
    """
    records = {r.name: r for r in (*source.measured.fit, *source.measured.held)}.values()
    count = round(MAX_ORDER * ORDERS_PER_TURN)
    twisted = all(rec.twist is not None for rec in records)
    sides = []
    for model in source.models:
        parts = [_along_the_turn(rec, model, twisted) for rec in records]
        angle, left, weight = (np.concatenate([p[i] for p in parts]) for i in range(3))
        sides.append(order_amplitudes(angle, left, weight, 1.0 / ORDERS_PER_TURN, count))
    quantity = "transmission error [arcmin]" if twisted else "speed, measured − model [deg/s]"
    teeth = source.models[1].drive["z_3"] / source.models[1].drive["N_1"]
    marks = {"motor turn": 1.0, "tooth mesh": float(teeth)}
    bank = np.arange(1, count + 1) / ORDERS_PER_TURN
    return Orders(bank, sides[0], sides[1], quantity, marks)


def _along_the_turn(rec: Record, model: Model, twisted: bool) -> tuple[Floats, Floats, Floats]:
    """Motor angle, what is left and the angle passed per block, where the drive moves."""
    run = predict(rec, model, OBSERVER_HZ)
    n1 = model.drive["N_1"]
    turn = rec.theta * n1 * model.drive["N_2"]
    if twisted:
        assert rec.twist is not None
        turn = turn + n1 * rec.twist[:, 0]
        left, good = _twist_missed(rec.twist[:, 0], run, model)
    else:
        left = np.rad2deg(low_pass(rec.omega - run[:, 1], rec.dt))
        good = np.ones(rec.theta.size, bool)
    good = good & (np.abs(low_pass(rec.omega, rec.dt)) > SLOWEST)
    rows = np.array([turn, left, good.astype(float)])
    angle, value, share = block_mean(rows, max(1, round(BLOCK_SECONDS / rec.dt)))
    weight = np.abs(np.gradient(angle)) * (share == 1.0)
    return angle, value, weight
