"""The same drive and loop in other simulators: C, numba, python-control, CasADi, the reference.

Each `run(substeps or tolerance)` gives the ring gear's speed at the samples [rad/s].
"""

import ctypes
import shutil
import subprocess
from importlib.util import find_spec
from math import exp
from pathlib import Path

import control as ct
import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from dmptm_ctrl.simulate import reference
from dmptm_ctrl.simulate.blocks import initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.dual import start

REST = 1e-5  # rad/s; as in scalar_rk4.c and in the python-control blocks
SPEED = 5  # of the ring gear among the states


def packed(drive):
    """Numbers in the order of scalar_rk4.c."""
    law = [
        drive[name.format(body, way)]
        for body in "3L"
        for way in ("plus", "minus")
        for name in ("T{}s_{}", "T{}c_{}", "W{}_{}", "B{}_{}")
    ]
    gain = drive["N_1"] * drive["K_d"] * drive["K_M"]
    pinion = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    rest_of = [drive[key] for key in ("J_L", "k_m", "c", "c_f", "gap_l", "gap_r")]
    return np.array([gain, drive["N_2"], pinion, *rest_of, *law])


class ScalarC:
    """RK4 at a fixed step, compiled with cc -O3 for this CPU."""

    def __init__(self, folder):
        library = Path(folder) / "scalar_rk4.so"
        source = Path(__file__).with_name("scalar_rk4.c")
        command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", str(source)]
        subprocess.run([*command, "-o", str(library), "-lm"], check=True)
        self._run = ctypes.CDLL(str(library)).run

    @staticmethod
    def available():
        return shutil.which("cc") is not None

    def __call__(self, model, loop, target, dt, substeps):
        out = np.empty((target.size, 3))
        numbers = packed(model.drive), np.array(loop), np.ascontiguousarray(target)
        pointer = ctypes.POINTER(ctypes.c_double)
        self._run(
            *(a.ctypes.data_as(pointer) for a in numbers),
            *(ctypes.c_long(target.size), ctypes.c_long(substeps), ctypes.c_double(dt)),
            out.ctypes.data_as(pointer),
        )
        return out[:, 1]


@njit
def _mesh(z, rate, k, c, cf, gap):
    side = 1.0 if z >= 0.0 else -1.0
    closing = side * rate
    pressed = k * (side * z - gap)
    touch = pressed + c * closing > 0.0
    if touch and closing > 0.0 and pressed < cf * closing:
        flight = (z + side * gap) / rate + c / k
        decay = exp(-k / (c + cf) * max(flight, 0.0))
        touch = side * (z + ((c + cf) * decay - cf) / k * rate) >= gap
    return k * (z - side * gap) + c * rate if touch else cf * rate


@njit
def _rate(x, u, p):
    dx = np.empty(6)
    left = _mesh(x[0] - p[1] * x[2], x[3] - p[1] * x[5], p[4], p[5], p[6], p[7])
    right = _mesh(x[1] - p[1] * x[2], x[4] - p[1] * x[5], p[4], p[5], p[6], p[8])
    nets = (p[0] * u[0] - left, p[0] * u[1] - right, p[1] * (left + right))
    for i in range(3):
        v, net = x[3 + i], nets[i]
        sign = 1.0 if v > REST else -1.0 if v < -REST else 1.0 if net > 0.0 else -1.0
        f = (9 if i < 2 else 17) + (0 if sign > 0.0 else 4)
        speed = abs(v)
        dx[i] = v
        if speed <= REST and abs(net) <= p[f]:
            dx[i] = dx[3 + i] = 0.0
            continue
        if speed <= REST:
            speed = 0.0
        friction = p[f + 1] + (p[f] - p[f + 1]) * exp(-speed / p[f + 2]) + p[f + 3] * speed
        dx[3 + i] = (net - sign * friction) / (p[2] if i < 2 else p[3])
    return dx


@njit
def _naive(p, loop, target, substeps, dt):
    x = np.zeros(6)
    out = np.empty(target.size)
    integral = 0.0
    h = dt / substeps
    for i in range(target.size):
        out[i] = x[5]
        error = target[i] - x[5]
        integral += error * dt
        common = min(max(loop[0] * error + loop[1] * integral, -loop[2]), loop[2])
        u = (common + loop[3], common + loop[4])
        for _ in range(substeps):
            a = _rate(x, u, p)
            b = _rate(x + 0.5 * h * a, u, p)
            c = _rate(x + 0.5 * h * b, u, p)
            d = _rate(x + h * c, u, p)
            x = x + h / 6.0 * (a + 2.0 * (b + c) + d)
    return out


def naive_numba(model, loop, target, dt, substeps):
    """The same RK4 as one would write it with numba and NumPy."""
    return _naive(packed(model.drive), np.array(loop), target, substeps, dt)


class _Sampled:
    """PI loop at the samples."""

    def __init__(self, loop, dt):
        self.loop, self.dt, self.integral = loop, dt, 0.0

    def __call__(self, wanted, speed):
        error = wanted - speed
        self.integral += error * self.dt
        common = self.loop.kp * error + self.loop.ki * self.integral
        common = min(max(common, -self.loop.limit), self.loop.limit)
        return common + self.loop.bias_l, common + self.loop.bias_r


def python_control(model, loop, target, dt):
    """python-control as it comes: `interconnect`, `input_output_response`, RK45.

    Its PI is continuous; the step is held below the sample, or short pulses are missed.
    """
    sys = to_blocks(model, loop=loop)
    start = initial_state(model, sys, np.zeros(6))
    found = ct.input_output_response(
        sys,
        dt * np.arange(target.size),
        target,
        start,
        solve_ivp_method="RK45",
        solve_ivp_kwargs={"max_step": dt},
    )
    return found.outputs[list(sys.output_labels).index("omega_L")]


def sampled_blocks(model, loop, target, dt, rtol):
    """The right-hand side of python-control's blocks in RK45 from sample to sample."""
    sys = to_blocks(model)
    ring = sys.state_labels.index("ring_omega")
    state = initial_state(model, sys, np.zeros(6))
    control, out = _Sampled(loop, dt), np.empty(target.size)
    for i, wanted in enumerate(target):
        out[i] = state[ring]
        u = np.array(control(wanted, state[ring]))
        found = solve_ivp(
            lambda t, x, u=u: sys.dynamics(t, x, u),
            (i * dt, (i + 1) * dt),
            state,
            rtol=rtol,
            atol=1e-3 * rtol,
        )
        state = found.y[:, -1]
    return out


def located(model, loop, target, dt, rtol):
    """The package's reference under the sampled loop: DOP853, every switch located."""
    plant = model.plant()
    hybrid = reference._Hybrid(plant)
    y = np.zeros(hybrid.size)
    y[:6] = np.hstack(start(plant, rest(model, 0.0)))
    silent = reference._Recorder(hybrid, 0, dt)
    control, out = _Sampled(loop, dt), np.empty(target.size)
    for i, wanted in enumerate(target):
        out[i] = y[SPEED]
        hybrid.u = control(wanted, y[SPEED])
        y = reference._through_hold(hybrid, i * dt, (i + 1) * dt, y, dt, rtol, silent)
    return out


class CasADi:
    """RK4 at a fixed step in CasADi's virtual machine, if it is installed."""

    def __init__(self, model, loop, dt, samples, substeps):
        import casadi as ca

        p = packed(model.drive).tolist()
        x, u, z = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("z", 7)
        wanted = ca.SX.sym("wanted")

        def mesh(twist, speed, gap):
            k, c, cf = p[4:7]
            side = ca.if_else(twist >= 0, 1.0, -1.0)
            closing, pressed = side * speed, k * (side * twist - gap)
            safe = ca.if_else(speed == 0, 1.0, speed)
            decay = ca.exp(-k / (c + cf) * ca.fmax((twist + side * gap) / safe + c / k, 0.0))
            reached = side * (twist + ((c + cf) * decay - cf) / k * speed) >= gap
            clear = ca.logic_or(closing <= 0, pressed >= cf * closing)
            touch = ca.logic_and(pressed + c * closing > 0, ca.logic_or(clear, reached))
            return ca.if_else(touch, k * (twist - side * gap) + c * speed, cf * speed)

        left = mesh(x[0] - p[1] * x[2], x[3] - p[1] * x[5], p[7])
        right = mesh(x[1] - p[1] * x[2], x[4] - p[1] * x[5], p[8])
        angles, speeds = [], []
        for i, net in enumerate([p[0] * u[0] - left, p[0] * u[1] - right, p[1] * (left + right)]):
            v, law = x[3 + i], p[9:17] if i < 2 else p[17:25]
            slow = ca.fabs(v) <= REST
            sign = ca.if_else(slow, ca.if_else(net > 0, 1.0, -1.0), ca.sign(v))
            f = [ca.if_else(sign > 0, a, b) for a, b in zip(law[:4], law[4:], strict=True)]
            speed = ca.if_else(slow, 0.0, ca.fabs(v))
            friction = f[1] + (f[0] - f[1]) * ca.exp(-speed / f[2]) + f[3] * speed
            held = ca.logic_and(slow, ca.fabs(net) <= f[0])
            speeds.append(ca.if_else(held, 0.0, (net - sign * friction) / p[2 if i < 2 else 3]))
            angles.append(ca.if_else(held, 0.0, v))
        rate = ca.Function("rate", [x, u], [ca.vertcat(*angles, *speeds)])
        h, state = dt / substeps, z[:6]
        error = wanted - z[5]
        integral = z[6] + error * dt
        common = ca.fmin(ca.fmax(loop.kp * error + loop.ki * integral, -loop.limit), loop.limit)
        volts = ca.vertcat(common + loop.bias_l, common + loop.bias_r)
        start, drive = ca.SX.sym("s", 6), ca.SX.sym("v", 2)
        a = rate(start, drive)
        b = rate(start + 0.5 * h * a, drive)
        c = rate(start + 0.5 * h * b, drive)
        d = rate(start + h * c, drive)
        step = ca.Function("step", [start, drive], [start + h / 6 * (a + 2 * (b + c) + d)])
        end = step.mapaccum(substeps)(state, ca.repmat(volts, 1, substeps))[:, -1]
        sample = ca.Function("sample", [z, wanted], [ca.vertcat(end, integral)])
        self._run = sample.mapaccum(samples - 1)

    @staticmethod
    def available():
        return find_spec("casadi") is not None

    def __call__(self, target):
        return np.append(0.0, np.array(self._run(np.zeros(7), target[None, :-1]))[5])
