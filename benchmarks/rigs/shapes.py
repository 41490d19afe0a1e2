"""Drives of other shapes than the paper's: rig files a little off, logs, held-out logs, labels.

Five shapes: one inertia; motor and load with a shaft; geared joint with two encoders; linear
axis; gimbal with an encoder and a gyro. What is lacking in the rig file is drawn in shares of
the torque and the speed that are usual for the machine, and grows until the held-out error of
the true machine without it is twice its floor, the error with inertias 1 % off.
"""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from rigs.machine import (
    FRICTION,
    OPEN,
    POSITION_LOOP,
    SPEED_LOOP,
    STEP,
    Loop,
    Machine,
    simulate,
)
from rigs.rig import plain, write_folder
from rigs.shape_effects import DEG, EFFECTS, LATE, SHAPES, UNKNOWN, WAVES, Scale

BAND = 30.0  # Hz, of the speeds that are compared
GROWTH, TRIES = 1.5, 6


class Drive(NamedTuple):
    """A machine, what its rig file leaves out, and how it is logged."""

    shape: str
    machine: Machine
    lacking: dict  # name -> fields that it sets
    scale: Scale
    dt: float
    encoders: tuple  # counts per turn or metre
    noise: float  # of the speed sensor


def fits(names):
    """Shapes on which all effects can be."""
    of = EFFECTS | UNKNOWN
    return [shape for shape in SHAPES if all(shape in of[n][0] for n in names)]


def draw(seed, names, grown=None):
    """Draw a drive; `grown` multiplies sizes by name. The same seed, the same machine."""
    rng = np.random.default_rng([seed, 31])
    shape = str(rng.choice(fits(names)))
    torque, inertia, gain = {
        "rotor": (rng.uniform(2, 5), rng.uniform(0.01, 0.04), 1.0),
        "shaft": (rng.uniform(0.1, 0.2), rng.uniform(5e-4, 1e-3), rng.uniform(0.015, 0.03)),
        "gear": (rng.uniform(0.03, 0.06), rng.uniform(1.5e-4, 3e-4), rng.uniform(0.005, 0.01)),
        "axis": (rng.uniform(20, 40), rng.uniform(4, 8), float(rng.choice([1.0, 15.0]))),
        "gimbal": (rng.uniform(7, 12), rng.uniform(0.4, 1.0), rng.uniform(1.5, 3.0)),
    }[shape]
    slow = rng.uniform(0.2, 0.5)
    speed = 0.5 * torque * slow / inertia
    coulomb = torque * rng.uniform(0.08, 0.16)
    scale = Scale(torque, speed, torque / gain, slow, coulomb)
    viscous, law = inertia / slow, int(rng.integers(len(FRICTION)))
    fields = {
        "gain": gain, "j1": inertia, "b1": viscous, "coulomb": coulomb, "law": law,
        "smooth": 1e-3 * speed,
    }  # fmt: skip
    stribeck = rng.random() < 0.3
    if stribeck and not {"coulomb_friction", "stribeck_friction"} & set(names):
        fields |= {"rise_at_rest": rng.uniform(0.3, 0.6) * coulomb, "stribeck_speed": 0.05 * speed}
    gap = rng.random() < 0.5 and shape == "gear" and "backlash" not in names
    ratio = 1.0
    if shape in ("shaft", "gear"):
        ratio = float(rng.integers(15, 40)) if shape == "gear" else 1.0
        part = rng.uniform(0.35, 0.6)
        ring = 2 * np.pi * (rng.uniform(60, 100) if shape == "gear" else rng.uniform(12, 25))
        load = (1 - part) * inertia
        reduced = part * load
        fields |= {
            "j1": part * inertia, "j2": load * ratio**2, "b1": 0.7 * viscous,
            "b2": 0.3 * viscous * ratio**2, "stiffness": ring**2 * reduced, "ratio": ratio,
            "damping": 2 * rng.uniform(0.03, 0.08) * ring * reduced,
        }  # fmt: skip
        if gap:
            fields["half_gap"] = 1e-3 * speed
    fields["bristle"] = coulomb / (fields["j1"] * 600.0**2)
    lacking = {}
    for name in names:
        make = (EFFECTS | UNKNOWN)[name][1]
        own = np.random.default_rng([seed, *map(ord, name)])
        lacking[name] = plain(make(own, (grown or {}).get(name, 1.0), scale)) if make else {}
        fields |= lacking[name]
    if "unbalance" in lacking and ratio > 1.0:  # counts at the load
        fields["unbalance_cos"] *= ratio
        fields["unbalance_sin"] *= ratio
    if "quadratic_drag" in lacking:
        fields["quadratic"] *= ratio**3
    counts = {
        "rotor": (40000.0,), "shaft": (8192.0, 8192.0), "gear": (4096.0, 65536.0),
        "axis": (1e6,), "gimbal": (72000.0,),
    }[shape]  # fmt: skip
    both = shape == "gear" or (shape == "shaft" and rng.random() < 0.5)
    alone = "shaft_compliance" in names or not both
    dt = float(rng.choice([1e-3, 1e-3, 2e-3, 5e-4]))
    if LATE & set(names):
        dt = min(dt, 1e-3)
    drive = Drive(
        shape, Machine(**fields), lacking, scale, dt,
        counts[:1] if alone else counts, 2e-3 * speed if shape == "gimbal" else 0.0,
    )  # fmt: skip
    return drive


def without(drive, names):
    """The machine without some of what is lacking in its rig file."""
    p, zero = drive.machine, Machine()
    for name in names:
        if name == "coulomb_friction":
            p = p._replace(coulomb=0.0, rise_at_rest=0.0)
        elif name == "shaft_compliance":
            p = p._replace(j1=p.j1 + p.j2 / p.ratio**2, b1=p.b1 + p.b2 / p.ratio**2, j2=0.0)
        else:
            p = p._replace(**{field: getattr(zero, field) for field in drive.lacking[name]})
    return p


def waveform(rng, kind, n, dt, slow):
    """Signal of size 1 for open-loop kinds and speeds, a path of speed 1 for positions."""
    t = dt * np.arange(n)
    if kind == "rest":
        return np.zeros(n)
    if kind in ("steps", "vsteps"):
        hold = rng.uniform(2.0, 4.0) * slow
        levels = rng.uniform(-1, 1, int(t[-1] / hold) + 2)
        return levels[(t / hold).astype(int)]
    if kind in ("sines", "small"):
        lines = rng.uniform(0.15, 1.2, 3) / slow / 2
        waves = np.sin(2 * np.pi * lines[:, None] * t + rng.uniform(0, 6, (3, 1))).sum(axis=0)
        return waves / np.abs(waves).max() * (0.45 if kind == "small" else 1.0)
    if kind in ("chirp", "chirp_fast", "sweep"):
        first = {"chirp": 0.05, "chirp_fast": 0.5, "sweep": 0.03}[kind] / slow
        last = {"chirp": 3.0, "chirp_fast": 12.0, "sweep": 0.3}[kind] / slow
        growth = (last / first) ** (1 / t[-1])
        return np.sin(2 * np.pi * first * (growth**t - 1) / np.log(growth))
    if kind == "prbs":
        hold = max(round(0.3 * slow / dt), 1)
        return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    if kind == "slowramp":
        return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * t / 10.0))
    # positions: trap (fast moves with rests), slow, csine
    if kind == "csine":
        return slow * 3 * np.sin(2 * np.pi * t / (18 * slow))
    fast = 1.0 if kind == "trap" else 0.15
    path, here, start = np.zeros(n), 0.0, 0.3 * slow
    while start < t[-1]:
        there = rng.uniform(-1, 1) * 8 * slow * math.sqrt(fast)
        length = max(abs(there - here) / fast, slow)
        ramp = np.clip((t - start) / length, 0, 1)
        path = np.where(t >= start, here + (there - here) * ramp, path)
        here, start = there, start + length + rng.uniform(0.3, 1.0) * slow
    return path


IN_LOOP = {"trap": POSITION_LOOP, "slow": POSITION_LOOP, "csine": POSITION_LOOP,
           "vsteps": SPEED_LOOP, "sweep": SPEED_LOOP}  # fmt: skip


def kinds(names):
    """Kinds of the logs to fit and of those that judge, and the seconds of these."""
    if WAVES & set(names):
        late = bool(LATE & set(names))
        fit = ("slow", "sweep", "trap", "chirp_fast" if late else "small", "steps", "vsteps")
        return fit, ("sweep", "steps"), 2.5
    if LATE & set(names):
        return ("steps", "chirp_fast", "prbs", "trap", "slow", "sines"), ("chirp_fast", "prbs"), 10
    if "base_vibration" in names:
        return ("rest", "steps", "trap", "vsteps", "sines", "slow"), ("steps", "trap"), 10
    return ("steps", "trap", "chirp", "slow", "vsteps", "sines"), ("steps", "trap"), 10


def experiment(rng, drive, kind, seconds):
    """(loop, reference, start) of one log."""
    p, s = drive.machine, drive.scale
    count = 1.0 / drive.encoders[0] * (1.0 if drive.shape == "axis" else 2 * np.pi)
    mode = IN_LOOP.get(kind, OPEN)
    wave = waveform(rng, kind, round(seconds / drive.dt), drive.dt, s.slow)
    inertia = p.j1 + (p.j2 / p.ratio**2 if p.j2 else 0.0)
    band = min(6.0 / s.slow, 0.05 / drive.dt)  # rad/s
    start = 0.0 if mode == POSITION_LOOP or drive.shape == "axis" else rng.uniform(-1, 1)
    if mode == OPEN:
        return Loop(OPEN, count=count), s.signal * rng.uniform(0.7, 1.0) * wave, start
    gain = band * inertia / p.gain
    if mode == SPEED_LOOP:
        loop = Loop(mode, gain, gain * band / 4, 0.0, 2 * s.signal, count)
        return loop, 0.8 * s.speed * wave, start
    loop = Loop(mode, band / 4, 0.0, gain, 2 * s.signal, count)
    return loop, 0.6 * s.speed * wave, start


def columns(drive):
    """Column of each sensor: (name, unit, radians or metres per unit, index of the reading)."""
    found = {
        "rotor": [("phi", "rad", 1.0, 1)],
        "shaft": [("m_enc_deg", "deg", DEG, 1), ("l_enc_deg", "deg", DEG, 2)],
        "gear": [("phi_m", "rad", 1.0, 1), ("phi_l", "deg", DEG, 2)],
        "axis": [("x_mm", "mm", 1e-3, 1)],
        "gimbal": [("el_deg", "deg", DEG, 1)],
    }[drive.shape][: len(drive.encoders)]
    return found + ([("gyro_dps", "deg/s", DEG, 3)] if drive.noise else [])


def signal_column(drive):
    if drive.shape == "axis":
        return ("F_N", "N") if drive.machine.gain == 1.0 else ("i_A", "A")
    return ("T_Nm", "N m") if drive.shape == "rotor" else ("u_V", "V")


def log(rng, drive, loop, reference, start):
    """One log as a table, rounded by its sensors."""
    out = simulate(drive.machine, loop, reference, drive.dt, start, STEP)
    if not np.isfinite(out).all():
        raise FloatingPointError("the machine's simulation left the finite numbers")
    table = {"t": drive.dt * np.arange(reference.size), signal_column(drive)[0]: out[:, 0]}
    turn = 1.0 if drive.shape == "axis" else 2 * np.pi
    for name, _, unit, column in columns(drive):
        y = out[:, column]
        if column == 3:
            y = y + drive.noise * rng.standard_normal(y.size)
        else:
            count = turn / drive.encoders[column - 1]
            y = np.round(y / count) * count
        table[name] = y / unit
    if loop.mode != OPEN:
        table["ref"] = reference
    return pd.DataFrame({name: np.round(x, 7) + 0.0 for name, x in table.items()})


def held_error(machine, drive, experiments, tables, truth):
    """Free-run error of the speed on the held-out logs [% of rms], over all sensors."""
    return compared(replayed(machine, drive, experiments, tables), truth, drive.dt)


def replayed(machine, drive, experiments, tables):
    """Speeds of all sensors, per log, on the logged commands."""
    signal = signal_column(drive)[0]
    low = butter(4, min(BAND, 0.2 / drive.dt), fs=1 / drive.dt, output="sos")
    runs = []
    for (_, _, start), table in zip(experiments, tables, strict=True):
        loop, u = Loop(OPEN), table[signal].to_numpy()
        out = simulate(machine, loop, u, drive.dt, start, STEP)
        if drive.machine.j2 and not machine.j2:  # a rigid shaft
            out[:, 2] = out[:, 1] / machine.ratio
        speeds = [
            out[:, at] if at == 3 else np.gradient(out[:, at], drive.dt)
            for *_, at in columns(drive)
        ]
        runs.append(sosfiltfilt(low, np.array(speeds)))
    return runs


def compared(runs, truth, dt):
    """RMS of the differences over that of the truth, mean square over the sensors [%]."""
    off, size = (np.zeros(truth[0].shape[0]) for _ in range(2))
    for mine, true in zip(runs, truth, strict=True):
        off += np.sum((mine - true) ** 2, axis=1)
        size += np.sum(true**2, axis=1)
    return float(100 * np.sqrt(np.mean(off / size)))


def judged(seed, names, grown):
    """A drive with its held-out logs, and the error of each way of leaving something out."""
    drive = draw(seed, names, grown)
    rng = np.random.default_rng([seed, 32])
    _, held, seconds = kinds(names)
    experiments = [experiment(rng, drive, kind, seconds) for kind in held]
    tables = [log(rng, drive, *e) for e in experiments]
    truth = replayed(drive.machine, drive, experiments, tables)

    def error(machine):
        return held_error(machine, drive, experiments, tables, truth)

    p = drive.machine
    floor = error(p._replace(j1=1.01 * p.j1, j2=1.01 * p.j2))
    errors = {name: error(without(drive, [name])) for name in names}
    bare = error(without(drive, names)) if names else None
    logs = {f"held{i:02d}_{kind}": t for i, (kind, t) in enumerate(zip(held, tables, strict=True))}
    return drive, logs, floor, errors, bare


def make(seed, names, folder):
    """Write a drive's rig.toml, logs and held-out logs; returns its label."""
    grown = dict.fromkeys(names, 1.0)
    for _ in range(TRIES):
        drive, held, floor, errors, bare = judged(seed, names, grown)
        faint = [name for name, error in errors.items() if error < 2 * floor]
        if not faint:
            break
        grown |= {name: GROWTH * grown[name] for name in faint}
    rng = np.random.default_rng([seed, 33])
    fit, *_ = kinds(names)
    logs = {
        f"fit{i:02d}_{kind}": log(rng, drive, *experiment(rng, drive, kind, 10.0))
        for i, kind in enumerate(fit)
    }
    write_folder(held, folder.with_name(f"{folder.name}.held"))
    write_folder(logs, folder)
    (folder / "rig.toml").write_text(rig_file(rng, drive, folder.name), encoding="utf-8")
    listed = [name for name in names if name in EFFECTS]
    unlisted = [name for name in names if name in UNKNOWN]
    label = {
        "truth": listed,
        "held_error_percent": {"floor": floor, "without_the_effects": bare},
        "things": {
            name: {
                "name": name if name in EFFECTS else None,
                "main": True,
                "material": bool(error >= 2 * floor),
                "rise_percent": error - floor,
            }
            for name, error in errors.items()
        },
        "shape": drive.shape,
        "friction": FRICTION[drive.machine.law],
        "seed": seed,
        "parameters": {name: parameters(name, drive) for name in listed},
    }
    if unlisted:
        of = UNKNOWN[unlisted[0]][2]
        label |= {"on_no_list": unlisted[0], "depends_on_any_of": list(of)}
    return plain(label)


# Names of a field in a label where they are not its own.
LABELS = {
    "lag": "time_constant_s", "delay": "delay_s", "sensor_delay": "delay_s",
    "gain_error": "share", "dead_band": "half_width_V", "quadratic": "coefficient_N_m_s2_rad2",
    "cable": "stiffness_N_m_rad", "unbalance_cos": "cos_N_m", "unbalance_sin": "sin_N_m",
    "load_friction": "coefficient", "warm_time": "time_constant_s", "spot": "height_N_m",
}  # fmt: skip


def parameters(name, drive):
    """True values as the label says them."""
    p = drive.machine
    labels = {LABELS.get(f, f): getattr(p, f) for f in drive.lacking[name]}
    if name == "base_vibration":
        labels["frequency_Hz"] = p.vibration_rate / (2 * np.pi)
    if name == "local_spot":
        labels |= {"place_deg": p.spot_place / DEG, "sigma_deg": p.spot_width / DEG}
    return labels


def rig_file(rng, drive, name):
    """What its user would declare: 5 to 15 % off, with honest tolerances."""
    p, lacking = drive.machine, drive.lacking
    slides = drive.shape == "axis"
    force, turn = ("N", "m") if slides else ("N m", "rad")

    def off(value):
        return value * (1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.15))

    one_body = p.j2 == 0.0 or "shaft_compliance" in lacking
    whole = without(drive, ["shaft_compliance"]) if p.j2 and one_body else p
    first = {"gimbal": "platform", "axis": "carriage"}.get(drive.shape, "motor")
    first = "rotor" if one_body and drive.shape in ("rotor", "shaft") else first
    inertia, unit = ("mass", "kg") if slides else ("inertia", "kg m^2")
    lines = [
        f'name = "{name}"',
        f"[body.{first}]",
        f'{inertia} = "{off(whole.j1):.4g} {unit} ± 20 %"',
        f'viscous = "{off(whole.b1):.4g} {force} s/{turn} ± 30 %"',
    ]
    if "coulomb_friction" not in lacking:
        lines.append(f'coulomb = "{off(p.coulomb):.4g} {force} ± 30 %"')
        if p.rise_at_rest and "stribeck_friction" not in lacking:
            lines += [
                f'static = "{off(p.coulomb + p.rise_at_rest):.4g} {force} ± 40 %"',
                f'stribeck_speed = "{off(p.stribeck_speed):.4g} {turn}/s ± 50 %"',
                "stribeck_exponent = 1.0",
            ]
    second = "table" if drive.shape == "gear" else "load"
    if not one_body:
        lines += [
            f"[body.{second}]",
            f'inertia = "{off(p.j2):.4g} {unit} ± 20 %"',
            'viscous = "unknown"',
            "[shaft.gear]" if drive.shape == "gear" else "[shaft.coupling]",
            f'between = ["{first}", "{second}"]',
            f"ratio = {p.ratio:g}",
            'damping = "unknown"',
        ]
        known = drive.shape == "shaft"
        stiffness = f"{off(p.stiffness):.4g} N m/rad ± 30 %" if known else "unknown"
        lines.append(f'stiffness = "{stiffness}"')
        if p.half_gap and "backlash" not in lacking:
            lines.append(f'half_gap = "{off(p.half_gap):.4g} rad ± 50 %"')
    column, unit = signal_column(drive)
    lines += ["[input.drive]", f'column = "{column}"', f'unit = "{unit}"', f'body = "{first}"']
    if unit != force:
        lines.append(f'gain = "{p.gain:.6g} {force}/{unit}"')
    for sensor, unit, _, at in columns(drive):
        body = second if at == 2 else first
        lines += [f"[sensor.{sensor}]", f'column = "{sensor}"', f'unit = "{unit}"']
        lines.append(f'body = "{body}"')
        if at == 3:
            lines.append(f'noise = "{drive.noise:.3g} rad/s"')
        else:
            count = 1 / drive.encoders[at - 1] * (1.0 if slides else 2 * np.pi)
            lines += [f'resolution = "{count:.6g} {turn}"', "absolute = true"]
    lines += ["[data]", 'time = { column = "t", unit = "s" }']
    return "\n".join(lines) + "\n"
