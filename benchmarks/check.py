"""How often `dmptm check` raises a false alarm, and how often it finds what has moved.

    python benchmarks/check.py [--machines 20] [--reruns 10] [--seed 1] [--sensors all|load|rig]
    python benchmarks/check.py --trend docs/images/trend.png

Each machine is drawn inside the declared ranges, has cogging and an unbalance, is fitted on one
campaign of four logs, and checked on others: unchanged, and with one change. Gaps and cogging
show with motor encoders only. `--sensors rig` draws machines of a motor and a load by a rig file,
simulated by another program; the encoder's zero differs from log to log, and friction by 1 %.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from dmptm_ctrl.check.evidence import evidence_of, only_own
from dmptm_ctrl.check.moved import entries_of, find_moved, information_of
from dmptm_ctrl.check.run import check
from dmptm_ctrl.diagnosis.residual import closed
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.fit import drive_unknowns, effect_unknowns
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.pushing_teeth import in_contact
from dmptm_ctrl.identify.records import records
from dmptm_ctrl.identify.rig_fit import fit_rig
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import Loop, close_loop, rest
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.rig_files.truth import Bench, Machine, integrate

__all__ = ["integrate"]  # for other benchmarks

DT, SECONDS = 1e-3, 5.0
DEG = np.pi / 180
RING, MOTOR = 2 * np.pi / 2**18, 2 * np.pi / 1e4  # rad per count
GYRO = 0.05 * DEG  # rad/s
TIME = DT * np.arange(round(SECONDS / DT))
LOOP = Loop(0.08 / DEG, 1.5 / DEG, 10.0)
FREE = 0.5  # of a declared range, from which machines are drawn
CHANGES = {
    "friction of the ring gear": 1.2,
    "gap of the left mesh": 1.2,
    "cogging": 2.0,
}
SEEN_AT_THE_RING = ("friction of the ring gear",)


RIG_CHANGES = {
    "coulomb_friction@motor": ({"fc", "fs"}, 1.2),
    "link.coupling.half_gap": ({"gap"}, 1.2),
    "cogging@motor": ({"cog"}, 2.0),
}
SHAFT = """\
stiffness = "10 N m/rad ± 60 %"
damping = "0.01 N m s/rad ± 90 %"
backlash = "0.02 rad ± 90 %"
"""


def rig_machine(rng):
    """A drawn motor that drives a load through a gap."""
    ranges = {
        "fc": (0.015, 0.03), "cog": (7e-3, 12e-3), "b1": (3e-4, 6e-4), "j1": (8e-5, 1.3e-4),
        "j2": (1.5e-3, 3e-3), "k": (8.0, 15.0), "c": (8e-3, 2e-2), "gap": (0.01, 0.02),
        "b2": (1e-3, 3e-3), "fc2": (0.02, 0.05),
    }  # fmt: skip
    drawn = {name: float(rng.uniform(*between)) for name, between in ranges.items()}
    return Machine(**drawn, fs=drawn["fc"], order=7.0, ratio=4.0)


def rig_changed(truth, what):
    """The machine with one change."""
    names, factor = RIG_CHANGES[what]
    return replace(truth, **{name: factor * getattr(truth, name) for name in names})


def rig_campaign(truth, rng, homed=False):
    """Its rig file, and four logs as sensors give them; encoders start anywhere, or are homed."""
    bench = Bench(
        truth, sensors=("speed", "position", "speed2", "position2"), seconds=6.0,
        speed_noise=0.1, counts=65536, drift=0.01, zero=not homed, seed=int(rng.integers(1 << 30)),
        extra={"shaft": SHAFT},
    )  # fmt: skip
    text = bench.rig()
    encoder = 'resolution = "65536 counts/rev"' + homed * "\nabsolute = true"
    for column, unit, more in (("q", "rad", encoder), ("w", "rad/s", 'noise = "0.1 rad/s"')):
        for name in (column, f"{column}2"):
            begin = f'column = "{name}"\nunit = "{unit}"\n'
            text = text.replace(begin, f"{begin}{more}\n")
    rig = parse_rig(text, "rig.toml")
    return rig, rig.read([pd.DataFrame(columns) for columns in bench.logs().values()])


def rig_fitted(_, campaign):
    """The machine as a fit on logs knows it; what it does not know follows from the logs."""
    rig, logs = campaign
    start = RigModel(
        rig,
        (
            *(Placed("coulomb_friction", b, {"level": 0.01}) for b in ("motor", "load")),
            Placed("cogging", "motor", {"cosine": 5e-3, "sine": 0.0, "order": 7.0}),
        ),
        {"body.motor.viscous": 5e-4, "body.load.viscous": 2e-3, "body.load.inertia": 2e-3},
    )
    balance = balance_of(rig, logs)
    model = fit_rig(State(start), balance, iterations=60).model
    for _ in range(2):  # as a diagnosis does: each fit knows better when teeth touch
        model = fit_rig(State(model), in_contact(balance, model, logs), iterations=60).model
    return model, {}


def machine(rng):
    """A drawn machine."""
    drive = paper_drive()
    drawn = {}
    for name in drive.free:
        low, high = drive.quantities[name].range
        drawn[name] = rng.uniform(
            *(drive[name] + FREE * (edge - drive[name]) for edge in (low, high))
        )
    model = Model(drive.with_values(**drawn))
    turn = rng.uniform(0, 2 * np.pi, 3)
    cogging = 0.015
    model = model.with_effect(
        "cogging", order=12.0,
        left_cosine=cogging * np.cos(turn[0]), left_sine=cogging * np.sin(turn[0]),
        right_cosine=cogging * np.cos(turn[1]), right_sine=cogging * np.sin(turn[1]),
    )  # fmt: skip
    return model.with_effect("unbalance", cosine=5.0 * np.cos(turn[2]), sine=5.0 * np.sin(turn[2]))


def changed(model, what):
    """The machine with one change."""
    if what == "cogging":
        values = {
            k: v if k == "order" else CHANGES[what] * v for k, v in model.effects[what].items()
        }
        return model.with_effect(what, **values)
    names = {
        "friction of the ring gear": ("TLs_plus", "TLc_plus", "TLs_minus", "TLc_minus"),
        "gap of the left mesh": ("gap_l",),
    }[what]
    return model.with_values(**{n: CHANGES[what] * model.drive[n] for n in names})


def campaign(model, rng):
    """Four logs as sensors give them."""
    size = rng.uniform(0.9, 1.1, 4)
    closed_10 = 10 * size[0] * DEG * np.sin(2 * np.pi * 0.5 * TIME)
    closed_15 = 15 * size[1] * DEG * np.sin(2 * np.pi * TIME)
    square = 0.75 * size[2] * np.sign(np.sin(2 * np.pi * 0.4 * TIME + 1e-9))
    lines = np.array([0.7, 1.3, 2.9, 5.3, 8.9, 13.7, 21.1, 37.0])
    phases = rng.uniform(0, 2 * np.pi, lines.size)
    waves = 0.342 * lines**-0.35 * np.sin(2 * np.pi * TIME[:, None] * lines + phases)
    multisine = size[3] * waves.sum(axis=1)
    logs = []
    for name, signal, loop, preload in (
        ("closed_sine_10", closed_10, True, 0.0),
        ("closed_sine_15", closed_15, True, 0.0),
        ("open_square", square, False, 0.0),
        ("open_multisine", multisine, False, 0.15),
    ):
        start = rng.uniform(-30, 30) * DEG
        if loop:
            u, out = close_loop(model, LOOP, signal, DT, theta_L=start, noise=noise(rng))
        else:
            u = np.array([signal + preload, signal - preload])
            out = simulate(model, TIME, u, rest(model, start)).outputs.T
        channels = {
            "u_left": u[0], "u_right": u[1],
            "theta_L": RING * np.round(out[:, 0] / RING), "omega_L": out[:, 1] + noise(rng),
            "theta_ml": MOTOR * np.round(out[:, 2] / MOTOR),
            "theta_mr": MOTOR * np.round(out[:, 3] / MOTOR),
        }  # fmt: skip
        logs.append(Log(name, TIME, channels))
    return logs


def noise(rng):
    return GYRO * rng.standard_normal(TIME.size)


def fitted(model, logs):
    """The machine as a fit on logs knows it, and its standard errors."""
    prior = Model(paper_drive(), model.effects)
    unknowns = drive_unknowns(prior)
    for name in model.effects:
        unknowns += tuple(k for k in effect_unknowns(name) if k.name != "order")
    _, fit = closed(records(logs, prior.drive), prior, Model(paper_drive()), unknowns, 1)
    sd = np.sqrt(np.diag(fit.covariance))
    errors = {
        (k.name if k.effect is None else f"{k.effect}.{k.name}"): float(s * k.scale)
        for k, s in zip(unknowns, sd, strict=True)
    }
    return fit.model, errors


def checked(model, errors, logs):
    """What has moved by a check, and all entries refitted."""
    evidence = only_own(evidence_of(model, logs))
    return find_moved(information_of(evidence, errors), entries_of(evidence.parameters))


def load_only(logs):
    """The logs without motor encoders."""
    kept = ("u_left", "u_right", "theta_L", "omega_L")
    return [Log(log.name, log.time, {k: log[k] for k in kept}) for log in logs]


def draw_trend(file, seed):
    """Picture of a ring gear whose friction grows by a quarter in half a year."""
    rng = np.random.default_rng([seed, 0])
    truth = machine(rng)
    model, errors = fitted(truth, campaign(truth, rng))
    logs = []
    for month, growth in enumerate((1.0, 1.01, 1.05, 1.11, 1.18, 1.25), start=1):
        names = ("TLs_plus", "TLc_plus", "TLs_minus", "TLc_minus")
        worn = truth.with_values(**{n: growth * truth.drive[n] for n in names})
        for log in campaign(worn, rng):
            name = f"2026-{month:02d}-01_{log.name}"
            logs.append(Log(name, log.time, {k: log[k] for k in log.channels}))
    found = check(model, logs, errors=errors)
    print(found.summary())
    found.plot().get_figure().savefig(file, dpi=110, bbox_inches="tight")


def counted(machines, reruns, seed, sensors):
    """Checks of unchanged machines, false alarms, and changes found and named first."""
    if sensors == "rig":
        changes = [*RIG_CHANGES]
        kind = rig_machine, rig_fitted, rig_campaign, rig_changed, lambda pair: pair[1]
    else:
        changes = [k for k in CHANGES if sensors == "all" or k in SEEN_AT_THE_RING]
        kind = machine, fitted, campaign, changed, load_only if sensors == "load" else list
    draw, fit, logged, worn, seen = kind
    alarms, found, named = 0, dict.fromkeys(changes, 0), dict.fromkeys(changes, 0)
    for k in range(machines):
        rng = np.random.default_rng([seed, k])
        truth = draw(rng)
        first = logged(truth, rng)
        model, errors = fit(truth, first if sensors == "rig" else seen(first))
        for _ in range(reruns):
            moved, _ = checked(model, errors, seen(logged(truth, rng)))
            if moved:
                alarms += 1
                print("false alarm:", "; ".join(c.text() for c in moved), flush=True)
        for what in changes:
            moved, alone = checked(model, errors, seen(logged(worn(truth, what), rng)))
            found[what] += bool(moved)
            name = moved[0].entry.name if moved else "-"
            named[what] += name == what
            if name != what:
                own = next(c for c in alone if c.entry.name == what)
                print(f"{what}: first {name}; alone {own.text()}", flush=True)
    return machines * reruns, alarms, found, named


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--reruns", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sensors", choices=("all", "load", "rig"), default="all")
    parser.add_argument("--trend", help="picture to draw instead")
    asked = parser.parse_args()
    if asked.trend:
        draw_trend(asked.trend, asked.seed)
        return
    began = time.time()
    runs, alarms, found, named = counted(asked.machines, asked.reruns, asked.seed, asked.sensors)
    print(f"{runs} checks of unchanged machines: {alarms} false alarms")
    for what in found:
        print(f"{what}: found {found[what]}, named first {named[what]} of {asked.machines}")
    print(f"{time.time() - began:.0f} s")


if __name__ == "__main__":
    main()
