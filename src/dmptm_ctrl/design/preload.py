"""Preload: how much keeps both meshes closed, and what it costs."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, sine
from dmptm_ctrl.drive import Drive, pinion_inertia
from dmptm_ctrl.simulate.compiled import close_loop
from dmptm_ctrl.simulate.dual import RING
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts

NEAR_REVERSAL = 0.05  # s
SMOOTH = (1.5, 0.15)  # common voltage over the bias at half the bias, and width of the transition
COASTING = 5.0 * DEG  # rad/s of the setpoint, over which a bias fades that is for reversals only


def load_torque_along(model: Model, duty: Duty, theta_L: float = 0.0) -> Floats:
    """Return the torque that the ring gear takes along a duty [N·m], (n,).

    Inertia, friction with its effects, and the load's effects; of the kernels.
    """
    parts, inertia = Parts(model.plant()), model.drive["J_L"]
    angle = theta_L + np.cumsum(duty.reference) * duty.sample_time
    rate = duty.acceleration
    torque = np.empty(duty.reference.size)
    for i, (theta, omega) in enumerate(zip(angle, duty.reference, strict=True)):
        t = i * duty.sample_time
        held = unloaded_friction(parts, RING, omega, theta, t)
        torque[i] = inertia * rate[i] + held - parts.torque(RING, 0.0, theta, omega, t)
    return torque


def unloaded_friction(
    parts: Parts, body: int, omega: float, theta: float = 0.0, t: float = 0.0
) -> float:
    """Return the friction of a body without load [N·m], signed like its speed; 0 at rest."""
    way = float(np.sign(omega))
    return way and way * float(parts.sliding(body, way, theta, omega, t, 0.0, 0.0)[0])


def common_volts_along(model: Model, duty: Duty) -> Floats:
    """Return the voltage that both motors share along a duty [V], (n,): half of the load each."""
    parts, drive = Parts(model.plant()), model.drive
    rubs = [unloaded_friction(parts, 0, float(v)) for v in drive["N_2"] * duty.reference]
    swing = pinion_inertia(drive) * drive["N_2"] * duty.acceleration
    share = load_torque_along(model, duty) / (2.0 * drive["N_2"])
    return np.asarray((share + swing + np.array(rubs)) / volt_at_pinion(drive), float)


def volt_at_pinion(drive: Drive) -> float:
    """Return what a volt of a motor is worth at its pinion [N·m/V]."""
    return drive["N_1"] * (drive["K_d"] * drive["K_M"])


def smallest_preload(model: Model, duty: Duty, theta_L: float = 0.0) -> float:
    """Return the least preload [V] that keeps both meshes closed along a duty.

    Each mesh carries half of the load's torque; the preload has to outweigh that half in
    the mesh that would open:  u_b > max |T_load| / (2 N2 N1 K_d K_M).

    Parameters
    ----------
    model : Model
    duty : Duty
        A setpoint over time, such as ``dm.Aims().duty``; see there.
    theta_L : float [rad]
        Where it starts.

    Returns
    -------
    float [V]

    Examples
    --------
    >>> round(dm.smallest_preload(dm.Model(), dm.Aims().duty), 2)  # V
    0.24
    """
    worst = float(np.abs(load_torque_along(model, duty, theta_L)).max())
    return worst / (2.0 * model.drive["N_2"] * volt_at_pinion(model.drive))


class Preload(NamedTuple):
    """A duty under one preload; errors and torques are rms."""

    open_share: float  # of the settled time, with a mesh that carries nothing or left its side
    error: float  # deg/s
    torque: float  # of a motor [N·m]
    friction: float  # mean that the preload adds in both reducers, at the pinions [N·m]
    reversal_error: float  # within NEAR_REVERSAL of a reversal of the setpoint [deg/s]


def assess_preload(model: Model, controller: Controller, duty: Duty) -> Preload:
    """Run a duty and return whether the preload kept both meshes closed, and what it cost."""
    u, out = close_loop(model, controller.law(), duty.reference, duty.sample_time)
    return _assessed(model, duty, u, out, 1.0 if controller.preload >= 0.0 else -1.0)


def assess_bias(model: Model, controller: Controller, duty: Duty, bias: ArrayLike) -> Preload:
    """Run a duty under a bias (n,) [V] over time, instead of the controller's preload.

    It is added left and taken off right at every sample; not part of the voltage limit.
    """
    volts = np.asarray(bias, float)
    push = np.zeros((volts.size, 3))
    push[:, 0] = volt_at_pinion(model.drive) * volts
    push[:, 1] = -push[:, 0]
    law = replace(controller, preload=0.0).law()
    u, out = close_loop(model, law, duty.reference, duty.sample_time, extra=push)
    return _assessed(model, duty, u + np.array([volts, -volts]), out, 1.0)


def _assessed(model: Model, duty: Duty, u: Floats, out: Floats, way: float) -> Preload:
    settled = slice(round(duty.settling / duty.sample_time), None)
    left, right = out[settled, 4], out[settled, 5]
    opened = (way * left <= 0.0) | (way * right >= 0.0)
    miss = np.rad2deg(out[settled, 1] - duty.reference[settled])
    parts, friction = Parts(model.plant()), 0.0
    for side, mesh in ((0, left), (1, right)):
        mean = float(np.abs(mesh).mean())
        friction += parts.sliding(side, 1.0, 0.0, 0.0, 0.0, mean, 0.0)[0]
        friction -= parts.sliding(side, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)[0]
    return Preload(
        float(opened.mean()),
        float(np.sqrt(np.mean(miss**2))),
        float(model.drive["K_d"] * model.drive["K_M"] * np.sqrt(np.mean(u[:, settled] ** 2))),
        float(friction),
        float(np.sqrt(np.mean(miss[_reversing(duty)[settled]] ** 2))),
    )


def _reversing(duty: Duty) -> NDArray[np.bool_]:
    """Samples near a change of the setpoint's sign; all of them where there is none."""
    sign = np.sign(duty.reference)
    at = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    at = np.append(at, np.flatnonzero((sign[1:-1] == 0.0) & (sign[:-2] * sign[2:] < 0.0)))
    if at.size == 0:
        return np.ones(sign.size, bool)
    gap = np.abs(np.arange(sign.size)[:, None] - at).min(axis=1)
    return np.asarray(gap * duty.sample_time <= NEAR_REVERSAL, bool)


class Schedule(NamedTuple):
    """How a bias b [V] follows the common voltage u [V] and the setpoint speed ω [rad/s]."""

    source: str
    bias: Callable[[float, Floats, Floats], Floats]  # (b, u, ω) -> volts


def _fading(start: float, end: float) -> Callable[[float, Floats, Floats], Floats]:
    """Bias b that fades from |u| = `start` b on, to 0 at `end` b."""

    def bias(b: float, u: Floats, omega: Floats) -> Floats:
        return b * np.clip((end * b - np.abs(u)) / ((end - start) * b), 0.0, 1.0)

    return bias


PROFILE = "torque-bias profile of antennas, a function of the load (ref. 15, Gawronski et al. 2000)"
SCHEDULES = {
    "constant": Schedule(
        "equal and opposite bias torques, as the paper says of refs 13 to 16",
        lambda b, u, omega: np.full(u.size, b),
    ),
    "fades late": Schedule(PROFILE, _fading(1.0, 2.5)),
    "fades early": Schedule(PROFILE, _fading(0.3, 1.0)),
    "switched": Schedule(
        "two-motor rack drive (JSME Mechatronics 2018, B22, abstract)",
        lambda b, u, omega: np.where(np.abs(u) < b, b, 0.0),
    ),
    "smooth": Schedule(
        "time-varying bias that saves energy, of the authors of ref. 16 (Zhao, Ren 2017, "
        "abstract); the sigmoid is ours",
        lambda b, u, omega: b * expit((SMOOTH[0] - np.abs(u) / b) / SMOOTH[1]),
    ),
    "at reversals": Schedule(
        "bias only where teeth would change flanks; ours",
        lambda b, u, omega: b * np.exp(-np.abs(omega) / COASTING),
    ),
}


def schedules(
    model: Model, controller: Controller, duty: Duty, preloads: ArrayLike
) -> dict[str, list[Preload]]:
    """Compare preloads [V] that stay with such that give way, as functions of time on a duty.

    The bias of every one of :data:`SCHEDULES` follows from the voltage that the model needs
    along the duty and from the setpoint, so that all are compared alike. What a controller
    does by itself (`relief_from`, `relief_to`) is a profile of the measured command; its own
    preload and relief are replaced. Preloads are (n,), at rest and above 0.
    """
    tried = np.asarray(preloads, float)
    if not np.all(tried > 0.0):
        raise ValueError(f"preloads {tried}: each must be above 0 V")
    volts = common_volts_along(model, duty)
    plain = replace(controller, relief_from=0.0, relief_to=0.0)
    return {
        name: [
            assess_bias(model, plain, duty, schedule.bias(b, volts, duty.reference))
            for b in map(float, tried)
        ]
        for name, schedule in SCHEDULES.items()
    }


def boundary(
    model: Model,
    controller: Controller,
    accelerations: ArrayLike,
) -> tuple[Floats, Floats]:
    """Return the least preload [V] for sines of 1 Hz, (n,) peak accelerations [rad/s²].

    Two answers, (n,) each: by the balance (:func:`smallest_preload`) and by bisection on the
    simulated loop, where a mesh must not open at any sample of the second period.
    """
    peaks = np.asarray(accelerations, float)
    found = np.array([_least(model, controller, float(peak)) for peak in peaks]).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _least(model: Model, controller: Controller, peak: float) -> tuple[float, float]:
    """Least preload for one sine, by the balance and by bisection."""
    dt = controller.sample_time
    duty = Duty(sine(peak / (2.0 * np.pi), 1.0, 2.0, dt), dt, settling=1.0)
    least = smallest_preload(model, duty)
    low, high = 0.0, 6.0 * least
    while high - low > 0.01 * least:
        middle = 0.5 * (low + high)
        tried = replace(controller, preload=middle)
        if assess_preload(model, tried, duty).open_share > 0.0:
            low = middle
        else:
            high = middle
    return least, high
