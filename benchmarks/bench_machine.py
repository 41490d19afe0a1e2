"""Machines of many kinds, drawn at random and simulated with nothing of dmptm_ctrl.

Friction by tanh, LuGre or Karnopp's stick band, explicit steps of 10 to 20 µs, sampled loops on
quantised readings, drives with a current loop; their logs, and a rig file that declares them.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numba import njit

TANH, LUGRE, KARNOPP = 0, 1, 2
OPEN, SPEED_LOOP, POSITION_LOOP = 0, 1, 2


class Machine(NamedTuple):
    """SI; torque or force per unit of the signal is `gain`."""

    gain: float
    emf: float  # braking torque per speed, of a motor driven by voltage
    lag: float
    delay: float
    dead: float
    limit: float
    offset: float
    j1: float
    b1: float
    fc1: float
    fs1: float  # static, at standstill
    vs1: float
    asym: float
    quad: float
    pos: float  # friction that goes with the angle
    cog: float
    order: float
    phase: float
    unb: float
    cable: float
    rise: float  # friction above its warm level at the start
    warm: float  # s
    j2: float
    b2: float
    fc2: float
    k: float
    c: float
    gap: float
    ratio: float
    v0: float  # speed below which friction builds up
    law: int


@njit(cache=True)
def _friction(law, v, level, z, h, v0, mass, torque):
    """Return friction and bristle."""
    if level <= 0.0:
        return 0.0, z
    if law == TANH:
        return level * np.tanh(v / v0), z
    if law == LUGRE:
        length = v0 * 2e-3
        z = z + h * (v - abs(v) / length * z)
        z = min(length, max(-length, z))
        return level * z / length, z
    stop = torque + mass * v / h  # Karnopp: what would stop it within the step
    if abs(v) < v0 * 0.1:
        return min(level, max(-level, stop)), z
    return (level if v > 0 else -level), z


@njit(cache=True)
def run(p, reference, dt, fine, mode, kp, ki, kv, umax, count, noise, q0, clock):
    """Return commands and motion at the samples: u, q1, v1, q2, v2."""
    n = reference.size
    out = np.empty((n, 5))
    h = dt / fine
    q1, v1, q2, v2 = q0, 0.0, q0 / p.ratio, 0.0
    z1, z2, current, integral = 0.0, 0.0, 0.0, 0.0
    last, speed = round(q1 / count) * count, 0.0
    late = round(p.delay / h)
    u = np.zeros(n)
    for i in range(n):
        here = round(q1 / count) * count
        speed += 0.5 * ((here - last) / dt - speed)
        last = here
        if mode == OPEN:
            command = reference[i]
        elif mode == SPEED_LOOP:
            error = reference[i] - speed
            integral += ki * error * dt
            integral = min(umax, max(-umax, integral))
            command = kp * error + integral
        else:
            command = kv * (kp * (reference[i] - here) - speed)
        u[i] = min(umax, max(-umax, command))
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = u[i], q1, v1, q2, v2
        for j in range(fine):
            at = i * fine + j - late
            s = u[max(at, 0) // fine] + p.offset if at >= 0 else 0.0
            if p.dead > 0.0:
                s = s - p.dead if s > p.dead else (s + p.dead if s < -p.dead else 0.0)
            if p.limit > 0.0:
                s = min(p.limit, max(-p.limit, s))
            goal = p.gain * s - p.emf * v1
            current = goal if p.lag <= 0 else current + h / p.lag * (goal - current)
            t = clock + (i * fine + j) * h
            way = 1.0 + p.asym if v1 > 0 else 1.0 - p.asym
            level = p.fc1 + (p.fs1 - p.fc1) * np.exp(-((v1 / p.vs1) ** 2))
            level = way * (level + p.pos * np.cos(q1 + 0.7))
            cold = 1.0 + p.rise * np.exp(-t / p.warm)
            load = p.unb * np.sin(q1) + p.cable * q1 - p.cog * np.cos(p.order * q1 + p.phase)
            load += p.quad * v1 * abs(v1) + way * cold * p.b1 * v1
            shaft = 0.0
            if p.j2 > 0.0:
                twist, rate = q1 - p.ratio * q2, v1 - p.ratio * v2
                if abs(twist) > p.gap:
                    side = p.gap if twist > 0 else -p.gap
                    shaft = p.k * (twist - side) + p.c * rate
                    if p.gap > 0 and shaft * twist < 0:
                        shaft = 0.0
            push = current + noise[i] - load - shaft
            rub, z1 = _friction(p.law, v1, cold * level, z1, h, p.v0, p.j1, push)
            if p.j2 > 0.0:
                push2 = p.ratio * shaft - p.b2 * v2
                rub2, z2 = _friction(p.law, v2, p.fc2, z2, h, p.v0 / p.ratio, p.j2, push2)
                v2 += h * (push2 - rub2) / p.j2
                q2 += h * v2
            v1 += h * (push - rub) / p.j1
            q1 += h * v1
    return out


class Style(NamedTuple):
    """How a bench is built, logged and written down."""

    name: str
    rate: float  # Hz
    seconds: float
    kinds: tuple  # excitation of each run
    mode: int
    sensors: tuple  # of q, w, q2, w2
    gain_known: bool
    linear: bool
    counts: float  # per turn, or per metre
    voltage: bool
    law: int


MOST_SAMPLES = 60_000  # of all runs of a bench

OPEN_KINDS = ("steps", "square", "sine", "chirp", "multisine", "triangle", "prbs")
LOOP_KINDS = ("moves", "sine", "square", "triangle", "steps")


def style_of(rng, case):
    """Draw a bench."""
    mode = int(rng.choice([OPEN, OPEN, SPEED_LOOP, POSITION_LOOP]))
    if case.get("needs_loop"):
        mode = POSITION_LOOP
    if case.get("open"):
        mode = OPEN
    linear = bool(mode == POSITION_LOOP and rng.random() < 0.4 and not case.get("rotary"))
    rate = float(rng.choice([200, 500, 1000, 1000, 2000]))
    if case.get("fast"):
        rate = float(rng.choice([1000, 1000, 2000, 4000]))
    runs = int(rng.choice([1, 2, 3, 4, 7]))
    runs = case.get("runs", runs)
    kinds = LOOP_KINDS if mode else OPEN_KINDS
    first = case.get("kinds", kinds)
    chosen = tuple(str(k) for k in rng.choice(first, min(runs, len(first)), replace=False))
    if runs > len(chosen):
        chosen += tuple(str(k) for k in rng.choice(kinds, runs - len(chosen)))
    sensors = case.get("sensors") or [("q",), ("w",), ("q", "w"), ("q",)][int(rng.integers(4))]
    if mode == POSITION_LOOP and "q" not in sensors:
        sensors = ("q", *sensors)
    seconds = float(rng.choice([6, 10, 20])) if runs > 1 else 20.0
    seconds = min(seconds, MOST_SAMPLES / (rate * runs))
    return Style(
        "bench", rate, seconds, chosen, mode, tuple(sensors),
        bool(rng.random() < 0.5), linear,
        float(rng.choice([2000, 4096, 8192, 20000, 65536])),
        bool(rng.random() < 0.5), int(rng.integers(3)),
    )  # fmt: skip


def signal(rng, kind, n, dt, slow):
    """Excitation of size 1; `slow` is the time constant of the drive [s]."""
    t = dt * np.arange(n)
    if kind == "steps":
        hold = rng.uniform(0.7, 2.0) * slow * 2
        levels = rng.uniform(-1, 1, int(t[-1] / hold) + 2)
        return levels[(t / hold).astype(int)]
    if kind == "square":
        return np.sign(np.sin(2 * np.pi * t / (6 * slow) + 0.3))
    if kind == "triangle":
        return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * t / (8 * slow)))
    if kind == "sine":
        return np.sin(2 * np.pi * t / (rng.uniform(3, 8) * slow))
    if kind == "chirp":
        f0, f1 = 0.1 / slow, min(30.0, 0.05 / dt)
        growth = (f1 / f0) ** (1 / t[-1])
        return np.sin(2 * np.pi * f0 * (growth**t - 1) / np.log(growth))
    if kind == "multisine":
        f = np.arange(1, 40) * 0.1 / slow
        f = f[f < 0.1 / dt]
        phases = rng.uniform(0, 2 * np.pi, f.size)
        y = np.cos(2 * np.pi * f[:, None] * t + phases[:, None]).sum(axis=0)
        return y / np.abs(y).max()
    if kind == "prbs":
        hold = max(round(0.15 * slow / dt), 1)
        return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    y, here, start = np.zeros(n), 0.0, 0.3 * slow  # moves
    while start < t[-1]:
        there = rng.uniform(-1, 1)
        length = max(abs(there - here), 0.2) * rng.uniform(2, 5) * slow
        x = np.clip((t - start) / length, 0, 1)
        y = np.where(t >= start, here + (there - here) * (10 * x**3 - 15 * x**4 + 6 * x**5), y)
        here, start = there, start + length + rng.uniform(0, 0.6) * slow
    return y


def machine_of(rng, style, case):
    """Draw a machine, and put in what the case says, as shares of the typical torque."""
    u0 = float(rng.choice([1.0, 5.0, 24.0]))  # V, A or N·m of the signal
    gain = float(10 ** rng.uniform(-2, 1)) * (20 if style.linear else 1)
    torque = gain * u0
    w0 = 0.3 if style.linear else float(rng.choice([10.0, 60.0, 200.0]))
    slow = float(rng.choice([0.1, 0.2, 0.4]))
    inertia = torque * slow / w0
    size = {k: v * rng.uniform(0.8, 1.25) for k, v in case.get("share", {}).items()}
    coulomb = torque * size.get("coulomb", 0.0)
    viscous = torque * rng.uniform(0.15, 0.5) / w0
    split = rng.uniform(0.35, 0.65)
    two = case.get("two", False)
    j1, j2 = (split * inertia, (1 - split) * inertia) if two else (inertia, 0.0)
    ratio = float(rng.choice([1.0, 5.0, 20.0])) if two and case.get("geared") else 1.0
    ring = 2 * np.pi * rng.uniform(*case.get("ring", (15.0, 40.0)))
    k = ring**2 * j2
    rubs = case.get("rubs", "motor")
    return (
        Machine(
            gain=gain,
            emf=0.3 * viscous if style.voltage else 0.0,
            lag=size.get("lag", float(rng.uniform(1e-4, 4e-4))),
            delay=round(size["delay"] * style.rate) / style.rate if "delay" in size else 0.0,
            dead=u0 * size.get("dead", 0.0),
            limit=u0 * size.get("limit", 0.0),
            offset=u0 * size.get("offset", 0.0) * float(rng.choice([-1, 1])),
            j1=j1,
            b1=viscous * (0.7 if style.voltage else 1.0) * (0.6 if two else 1.0),
            fc1=coulomb if rubs in ("motor", "both") else 0.0,
            fs1=(coulomb if rubs in ("motor", "both") else 0.0)
            + torque * size.get("stribeck", 0.0),
            vs1=w0 * rng.uniform(0.03, 0.08),
            asym=size.get("asym", 0.0) * float(rng.choice([-1, 1])),
            quad=torque * size.get("quad", 0.0) / w0**2,
            pos=torque * size.get("pos", 0.0),
            cog=torque * size.get("cog", 0.0),
            order=float(rng.choice([7, 12, 24, 36])),
            phase=float(rng.uniform(0, 6)),
            unb=torque * size.get("unb", 0.0),
            cable=torque * size.get("cable", 0.0) / (0.1 if style.linear else 3.0),
            rise=size.get("rise", 0.0),
            warm=style.seconds * 0.25,
            j2=j2 * ratio**2,
            b2=viscous * 0.4 * ratio**2 if two else 0.0,
            fc2=coulomb * ratio * (1.0 if rubs == "load" else 0.7 if rubs == "both" else 0.0),
            k=k,
            c=2 * rng.uniform(0.02, 0.06) * ring * j2,
            gap=size.get("gap_angle", 0.0),
            ratio=ratio,
            v0=w0 * 5e-4,
            law=style.law,
        ),
        torque,
        w0,
        slow,
        u0,
    )


def logs_of(rng, style, machine, torque, w0, slow, u0, case):
    """Simulate the runs: frames by name."""
    dt = 1 / style.rate
    n = round(style.seconds / dt)
    fine = max(round(dt / 1e-5), 1) if machine.j2 > 0 else max(round(dt / 2e-5), 1)
    per = 2 * np.pi / style.counts if not style.linear else 1 / (style.counts * 50)
    reach = case.get("reach", 0.1 if style.linear else 3.0 * max(w0 / 60, 0.3))
    inertia = machine.j1 + machine.j2 / machine.ratio**2
    frames = {}
    clock = 0.0
    for number, kind in enumerate(style.kinds):
        drift = 1 + case.get("drift", 0.03) * rng.normal()
        own = machine._replace(
            fc1=machine.fc1 * drift, fs1=machine.fs1 * drift, fc2=machine.fc2 * drift,
            offset=machine.offset + case.get("drift", 0.03) * 0.1 * u0 * rng.normal(),
        )  # fmt: skip
        size = rng.uniform(0.6, 1.0)
        wave = signal(rng, kind, n, dt, slow * (4 if style.mode == POSITION_LOOP else 1))
        umax, kp, ki, kv = 1e9, 0.0, 0.0, 0.0
        band = min(12.0 / slow, 0.15 * style.rate)
        if style.mode == OPEN:
            reference = size * u0 * wave
        elif style.mode == SPEED_LOOP:
            reference = size * 0.8 * w0 * wave
            kp, umax = band * inertia / machine.gain, 2.5 * u0
            ki = kp * band / 4
        else:
            reference = size * reach * wave
            kv, kp, umax = band * inertia / machine.gain, band / 4, 2.5 * u0
        if machine.limit > 0 and style.mode == OPEN:
            umax = 1e9
        noise = 0.01 * torque * rng.normal(size=n)
        start = 0.0 if style.mode == POSITION_LOOP else rng.uniform(0, 6)
        out = run(own, reference, dt, fine, style.mode, kp, ki, kv, umax, per, noise, start, clock)
        clock += style.seconds if machine.rise else 0.0
        frame = {"t": dt * np.arange(n), "u": out[:, 0]}
        for name, column in (("q", 1), ("w", 2), ("q2", 3), ("w2", 4)):
            if name not in style.sensors:
                continue
            y = out[:, column]
            if name.startswith("w"):
                low = y[0]
                filtered = np.empty(n)
                share = 1 - np.exp(-dt / 3e-4)
                for i in range(n):
                    low += share * (y[i] - low)
                    filtered[i] = low
                scale = 3e-3 * w0 / (machine.ratio if name == "w2" else 1.0)
                y = filtered + scale * rng.normal(size=n)
            else:
                zero = y[0] if style.mode != POSITION_LOOP else 0.0
                y = np.round((y - zero) / per) * per
            frame[name] = y
        frames[f"run{number + 1}_{kind}"] = pd.DataFrame(frame)
    return frames


def rig_of(rng, style, machine, torque, case):
    """Rig file: inertia and viscous friction, and what the case declares."""
    whole = machine.j1 + machine.j2 / machine.ratio**2
    known = style.gain_known
    turn, force = ("m", "N") if style.linear else ("rad", "N m")
    key, unit = ("mass", "kg") if style.linear else ("inertia", "kg m^2")
    told = whole if case.get("one_body", True) else machine.j1
    told *= rng.uniform(0.9, 1.1)
    value = f'"{told:.4g} {unit} ± 20 %"' if known else '"unknown"'
    lines = [f'name = "{style.name}"', "[body.motor]", f"{key} = {value}", 'viscous = "unknown"']
    if case.get("declared") == "coulomb":
        lines.append('coulomb = "unknown"')
    symbol = "V" if style.voltage else "A"
    lines += ["[input.drive]", 'column = "u"', f'unit = "{symbol}"', 'body = "motor"']
    if known:
        lines.append(f'gain = "{machine.gain:.6g} {force}/{symbol}"')
    if not case.get("one_body", True):
        lines += ["[body.load]", f'{key} = "unknown"', 'viscous = "unknown"']
        kind = "mesh" if case.get("geared") else "shaft"
        lines += [f"[{kind}.coupling]", 'between = ["motor", "load"]', f"ratio = {machine.ratio}"]
        lines += [f'stiffness = "{case.get("stiffness", "unknown")}"']
    for name in style.sensors:
        on = "load" if name.endswith("2") and not case.get("one_body", True) else "motor"
        lines += [
            f"[sensor.{name}]", f'column = "{name}"',
            f'unit = "{turn}{"/s" if name.startswith("w") else ""}"', f'body = "{on}"',
        ]  # fmt: skip
    lines += ["[data]", 'time = { column = "t", unit = "s" }']
    return "\n".join(lines) + "\n"
