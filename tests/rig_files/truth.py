"""Small machines to diagnose, simulated by other means than the package's.

One or two bodies; LuGre friction (bristles, no set-valued law), explicit integration at 20 µs,
white noise and rounding on the sensors, drift of friction from run to run. Nothing of
dmptm_ctrl is used.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit


@njit(cache=True)
def integrate(u, dt, fine, p, state, drift):
    """Return positions and speeds at the samples. `p` in the order of Machine.row().

    `state` (7,) is moved on: q1, v1, q2, v2, bristles of both, torque of the motor.
    """
    (
        gain,
        emf,
        lag,
        delay,
        j1,
        j2,
        k,
        c,
        gap,
        ratio,
        b1,
        fc,
        fs,
        vs,
        b2,
        fc2,
        asym,
        offset,
        cog,
        order,
        cable,
        unb,
        quad,
        pos,
        bristle,
        dead,
        limit,
        runout,
        eccentric,
        tooth,
        teeth,
        tight,
        uneven,
        spot,
        place,
        half,
        form,
    ) = p
    n = u.size
    out = np.empty((n, 4))
    h = dt / fine
    q1, v1, q2, v2, z1, z2, torque = state
    held = round(delay / h)
    total = n * fine
    for i in range(total):
        if i % fine == 0:
            row = i // fine
            out[row, 0], out[row, 1], out[row, 2], out[row, 3] = q1, v1, q2, v2
        j = max(i - held, 0) // fine
        s = u[j] + offset
        if dead > 0.0:
            s = s - dead if s > dead else (s + dead if s < -dead else 0.0)
        if limit > 0.0:
            s = min(limit, max(-limit, s))
        target = gain * s - emf * v1
        torque = target if lag <= 0.0 else torque + h / lag * (target - torque)
        # LuGre: dz = v − |v| z / (g/σ0), F = σ0 z + σ1 dz
        way = 1.0 + asym if v1 > 0.0 else 1.0 - asym
        g = drift * way * (fc + (fs - fc) * np.exp(-abs(v1) / vs) + pos * np.cos(q1))
        if spot > 0.0:
            away = abs((q1 - place + np.pi) % (2.0 * np.pi) - np.pi) / half
            g += drift * way * spot * np.exp(-0.5 * away**form)
        f1 = 0.0
        if g > 0.0:
            stiff = g / bristle
            dz = v1 - abs(v1) / bristle * z1
            z1 += h * dz
            z1 = min(bristle, max(-bristle, z1))
            f1 = stiff * z1 + 0.3 * np.sqrt(stiff * j1) * dz * np.exp(-((v1 / (0.05 * vs)) ** 2))
        f1 += drift * way * b1 * v1 + quad * v1 * abs(v1)
        f1 -= cog * np.cos(order * q1) + unb * np.cos(q1) - cable * q1
        if j2 > 0.0:
            g2 = fc2
            f2 = b2 * v2
            if g2 > 0.0:
                dz = v2 - abs(v2) / bristle * z2
                z2 += h * dz
                z2 = min(bristle, max(-bristle, z2))
                f2 += g2 / bristle * z2
            tw, rate = q1 - ratio * q2, v1 - ratio * v2
            tw += runout * np.cos(q1) + eccentric * np.cos(q2) + tooth * np.cos(teeth * q1)
            rate -= runout * np.sin(q1) * v1 + eccentric * np.sin(q2) * v2
            rate -= tooth * teeth * np.sin(teeth * q1) * v1
            half, stiffness = gap + tight * np.cos(q2), k * (1.0 + uneven * np.cos(teeth * q1))
            if gap > 0.0:
                if tw > half:
                    shaft = max(stiffness * (tw - half) + c * rate, 0.0)
                elif tw < -half:
                    shaft = min(stiffness * (tw + half) + c * rate, 0.0)
                else:
                    shaft = 0.0
            else:
                shaft = stiffness * tw + c * rate
            a1 = (torque - f1 - shaft) / j1
            a2 = (ratio * shaft - f2) / j2
            v2 += h * a2
            q2 += h * v2
        else:
            a1 = (torque - f1) / j1
        v1 += h * a1
        q1 += h * v1
    state[:] = np.array([q1, v1, q2, v2, z1, z2, torque])
    return out


@dataclass(frozen=True)
class Machine:
    """A DC-motor bench of 100 W: 12 V, 3000 rpm. SI; torque per volt is `gain`."""

    gain: float = 0.05
    emf: float = 2e-3
    lag: float = 0.0
    delay: float = 0.0
    j1: float = 1e-4
    j2: float = 0.0
    k: float = 0.0
    c: float = 0.0
    gap: float = 0.0
    ratio: float = 1.0
    b1: float = 2e-4
    fc: float = 0.0
    fs: float = 0.0
    vs: float = 3.0
    b2: float = 0.0
    fc2: float = 0.0
    asym: float = 0.0
    offset: float = 0.0
    cog: float = 0.0
    order: float = 12.0
    cable: float = 0.0
    unb: float = 0.0
    quad: float = 0.0
    pos: float = 0.0
    bristle: float = 1e-4
    dead: float = 0.0
    limit: float = 0.0
    runout: float = 0.0  # rad, of the pinion
    eccentric: float = 0.0  # rad at the pinion, of the gear
    tooth: float = 0.0  # rad, error of each
    teeth: float = 20.0
    tight: float = 0.0  # rad, change of half the gap around the gear
    uneven: float = 0.0  # share of the stiffness, once per tooth
    spot: float = 0.0  # N m of friction at a place of the turn
    place: float = 1.0
    half: float = 0.5
    form: float = 2.0  # a bump; the larger, the sharper its edges

    def row(self):
        values = {**self.__dict__}
        values["fs"] = max(self.fs, self.fc)
        return tuple(float(v) for v in values.values())

    def run(self, u, dt, *, start=(0.0, 0.0), drift=1.0, fine=None):
        fine = fine or max(round(dt / 2e-5), 1)
        return integrate(np.asarray(u, float), dt, fine, self.row(), self.at(*start), drift)

    def at(self, q1=0.0, v1=0.0):
        """State at a place, with the load in step."""
        return np.array([q1, v1, q1 / self.ratio, v1 / self.ratio, 0.0, 0.0, 0.0])


def signal(kind, seconds, dt, level, seed=0):
    """Voltage over time: steps, square, sine, chirp, multisine or prbs."""
    t = dt * np.arange(round(seconds / dt))
    rng = np.random.default_rng(seed)
    if kind == "steps":
        edges = rng.uniform(-1, 1, int(seconds / 0.7) + 1)
        return level * edges[(t / 0.7).astype(int)]
    if kind == "square":
        return level * np.sign(np.sin(2 * np.pi * 0.6 * t + 0.3))
    if kind == "sine":
        return level * np.sin(2 * np.pi * 0.5 * t)
    if kind == "chirp":
        f0, f1 = 0.2, min(40.0, 0.1 / dt)
        rate = (f1 / f0) ** (1 / seconds)
        return level * np.sin(2 * np.pi * f0 * (rate**t - 1) / np.log(rate))
    if kind == "multisine":
        f = np.arange(1, 60) * 0.5
        f = f[f < 0.15 / dt]
        phase = -np.pi * np.arange(f.size) * (np.arange(f.size) + 1) / f.size
        y = np.cos(2 * np.pi * f[:, None] * t + phase[:, None]).sum(axis=0)
        return level * y / np.abs(y).max()
    if kind == "prbs":
        hold = max(round(0.03 / dt), 1)
        bits = rng.choice([-1.0, 1.0], t.size // hold + 1)
        return level * np.repeat(bits, hold)[: t.size]
    raise ValueError(kind)


@dataclass(frozen=True)
class Bench:
    """How a machine is measured."""

    machine: Machine
    kinds: tuple = (("steps", 6.0), ("sine", 5.0), ("chirp", 4.0), ("square", 4.0))
    seconds: float = 8.0
    dt: float = 1e-3
    speed_noise: float = 0.3  # rad/s
    counts: int = 8192
    drift: float = 0.0  # relative spread of friction between runs
    sensors: tuple = ("speed",)
    seed: int = 0
    zero: bool = False  # the encoder starts anywhere
    extra: dict = field(default_factory=dict)

    def logs(self):
        """Return {name: columns}, with columns t, u and per sensor w, q, w2, q2."""
        rng = np.random.default_rng(1000 + self.seed)
        found = {}
        for number, (kind, level) in enumerate(self.kinds):
            u = signal(kind, self.seconds, self.dt, level, self.seed + number)
            drift = 1 + self.drift * rng.normal()
            start = rng.uniform(0, 6) if self.zero else 0.0
            out = self.machine.run(u, self.dt, start=(start, 0.0), drift=max(drift, 0.2))
            step = 2 * np.pi / self.counts
            columns = {"t": self.dt * np.arange(u.size), "u": u}
            for name, index in (("q", 0), ("w", 1), ("q2", 2), ("w2", 3)):
                wanted = {"q": "position", "w": "speed", "q2": "position2", "w2": "speed2"}[name]
                if wanted not in self.sensors:
                    continue
                values = out[:, index]
                if name[0] == "q":
                    values = np.round((values - values[0]) / step) * step
                else:
                    values = values + self.speed_noise * rng.normal(size=values.size)
                columns[name] = values
            found[f"run{number + 1}_{kind}"] = columns
        return found

    def rig(self):
        """Return a rig file that declares inertia and viscous friction only."""
        machine = self.machine
        inertia = machine.j1
        if self.extra.get("one_body"):
            inertia += machine.j2 / machine.ratio**2
        text = [
            'name = "bench"', "[body.motor]", f'inertia = "{inertia:g} kg m^2 ± 40 %"',
            'viscous = "unknown"', "[input.drive]", 'column = "u"', 'unit = "V"',
            'body = "motor"', f'gain = "{machine.gain:g} N m/V"',
        ]  # fmt: skip
        load = "motor"
        if machine.j2 > 0 and not self.extra.get("one_body"):
            load = "load"
            text += [
                "[body.load]", 'inertia = "unknown"', 'viscous = "unknown"', "[shaft.coupling]",
                'between = ["motor", "load"]', f"ratio = {machine.ratio}",
                self.extra.get("shaft", 'stiffness = "unknown"'),
            ]  # fmt: skip
        units = {"w": "rad/s", "q": "rad", "w2": "rad/s", "q2": "rad"}
        names = {"speed": "w", "position": "q", "speed2": "w2", "position2": "q2"}
        for sensor in self.sensors:
            column = names[sensor]
            body = load if column.endswith("2") else "motor"
            text += [
                f"[sensor.{sensor}]", f'column = "{column}"', f'unit = "{units[column]}"',
                f'body = "{body}"',
            ]  # fmt: skip
        text += ["[data]", 'time = "t"', self.extra.get("data", "")]
        return "\n".join(text) + "\n"

    def with_(self, **changes):
        return replace(self, **changes)
