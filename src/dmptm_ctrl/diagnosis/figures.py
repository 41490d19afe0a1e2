"""Numbers behind the pictures of a diagnosis: speeds on held-out logs, folded residuals.

The residual that is folded is chosen by where the effect acts: the reading of the speed
sensor for sensors, the twist of the left chain for meshes (with motor encoders), else the
torque at the ring gear that the model lacks. That torque is read off an observer: led by
the measured angle with bandwidth ω0 the model lags by an angle e and a speed v behind a torque
T = J ω0² e + B v that it does not know.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.diagnosis.predict import low_pass, speeds
from dmptm_ctrl.drive import pinion_inertia
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import Record, predict
from dmptm_ctrl.plots.diagnosis import Curve, Evidence, Overlay
from dmptm_ctrl.simulate.model import Floats, Model

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.report import Diagnosis

OBSERVER_HZ = 5.0  # above what position, load and speed change by; below the rattle
SLOWEST = np.deg2rad(1.0)  # rad/s; slower than this a direction is not sure
BINS = 24
TAILS = (0.5, 99.5)  # percentiles of the variable; what lies beyond has too few samples
MIN_NEWS = 3.0  # independent samples that a bin's mean and spread need
ARCMIN = np.rad2deg(1.0) * 60.0
TORQUE = "torque the model lacks,\nat the ring gear [N·m]"


def overlays(diagnosis: "Diagnosis") -> tuple[Overlay, ...]:
    """Speeds on each held-out log below 30 Hz [deg/s], before and after."""
    before, after = models(diagnosis)
    done = []
    for log in diagnosis.measured.held_logs:
        seen, old = speeds(before, log)
        new = speeds(after, log)[1]
        done.append(Overlay(log.name, log.time, np.rad2deg(seen), np.rad2deg(old), np.rad2deg(new)))
    return tuple(done)


def models(diagnosis: "Diagnosis") -> tuple[Model, Model]:
    """Return the models that `error` judges: neither has seen the held-out logs."""
    before, after = diagnosis.fits
    return Model(before.model.drive), after.model


def folded(diagnosis: "Diagnosis") -> Evidence:
    """Fold what is left over the variable that the first effect depends on."""
    name = diagnosis.effects[0].name if diagnosis.effects else ""
    effect = CATALOGUE.get(name)
    before, after = models(diagnosis)
    records = list(
        {rec.name: rec for rec in (*diagnosis.measured.fit, *diagnosis.measured.held)}.values()
    )
    values = after.effects.get(name, {})
    on = depends_on(effect, diagnosis.depends_on)
    rows: dict[str, list[tuple[Floats, Floats, Floats, float]]] = {"before": [], "after": []}
    variable = quantity = ""
    for rec in records:
        for key, model in (("before", before), ("after", after)):
            run = predict(rec, model.arrays(), OBSERVER_HZ)
            x, variable = abscissa(on, rec, run, model, effect, values)
            y, keep, quantity = left_over(rec, run, model, effect)
            speed = low_pass(rec.omega, rec.dt)
            keep = keep & (np.abs(speed) > SLOWEST)
            rows[key].append((x[keep], y[keep], np.sign(speed[keep]), rec.dt))
    pooled = np.concatenate([row[0] for row in (*rows["before"], *rows["after"])])
    low, high = np.percentile(pooled, TAILS) if pooled.size else (0.0, 1.0)
    edges = np.linspace(low, max(high, low + 1e-9), BINS + 1)
    return Evidence(
        variable,
        quantity,
        binned(rows["before"], edges),
        binned(rows["after"], edges),
        name if effect else "",
    )


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
        "omega_m": (
            low_pass(rec.omega, rec.dt) * n1 * model.drive["N_2"],
            "motor speed [rad/s]",
        ),
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
    """Return the residual along a log, where it can be judged, and its label."""
    everywhere = np.ones(rec.theta.size, bool)
    site = effect.site if effect is not None else ""
    n2 = model.drive["N_2"]
    if site.startswith("sensor"):
        # The reading against the motion of the angle; the model's reading has its effect.
        y = np.rad2deg(low_pass(rec.omega - run[:, 1], rec.dt))
        return y, everywhere, "speed reading − model [deg/s]"
    fast = effect is not None and effect.depends_on == ("theta_m",)
    if rec.twist is not None and (site == "mesh" or fast):
        twist = run[:, 2] / model.drive["N_1"] - n2 * run[:, 0]
        flank = np.sign(rec.twist[:, 0]) * (np.abs(rec.twist[:, 0]) > 0.75 * model.drive["gap_l"])
        keep = (flank != 0.0) & (flank == np.sign(run[:, 6]))
        return (
            ARCMIN * (rec.twist[:, 0] - twist),
            keep,
            "twist of the left chain,\nmeasured − model [arcmin]",
        )
    inertia = model.drive["J_L"] + 2.0 * n2**2 * pinion_inertia(model.drive)
    forward, backward = (
        model.drive[f"BL_{way}"] + 2.0 * n2**2 * model.drive[f"B3_{way}"]
        for way in ("plus", "minus")
    )
    viscous = np.where(rec.omega > 0.0, forward, backward)
    lag, slower = rec.theta - run[:, 0], low_pass(rec.omega - run[:, 1], rec.dt)
    lacking = inertia * (2.0 * np.pi * OBSERVER_HZ) ** 2 * lag + viscous * slower
    return lacking, everywhere, TORQUE


def binned(rows: list[tuple[Floats, Floats, Floats, float]], edges: Floats) -> dict[str, Curve]:
    """Mean and standard error per bin and direction.

    Samples closer than the observer's time constant count as one.
    """
    curves = {}
    x, y, way = (np.concatenate([row[i] for row in rows]) for i in range(3))
    news = np.concatenate(
        [np.full(row[0].size, min(1.0, row[3] * 2.0 * np.pi * OBSERVER_HZ)) for row in rows]
    )
    place = np.digitize(x, edges) - 1
    for direction, sign in (("forward", 1.0), ("backward", -1.0)):
        centres, means, errors = [], [], []
        for i in range(edges.size - 1):
            inside = (place == i) & (way == sign)
            count = float(news[inside].sum())
            if count >= MIN_NEWS:
                centres.append(0.5 * (edges[i] + edges[i + 1]))
                means.append(float(y[inside].mean()))
                errors.append(float(y[inside].std()) / np.sqrt(count))
        if centres:
            curves[direction] = Curve(np.array(centres), np.array(means), np.array(errors))
    return curves
