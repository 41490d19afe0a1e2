"""The drive under its sampled speed loop, as python-control returns responses."""

from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.rig import Controller as RigController
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.simulate import _finite, _timepts, compiled
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import as_rig_model, march


def close_loop(
    model: Model | RigModel | Rig,
    controller: Any,
    timepts: ArrayLike,
    reference: ArrayLike,
    *,
    theta_L: float = 0.0,
    noise: ArrayLike | None = None,
    substeps: int | None = None,
) -> control.TimeResponseData:
    """Run a drive under a sampled speed loop, from rest.

    The pinions of a dual-motor drive begin in the middle of their gaps. Keep the setpoint at 0
    until the preload has closed them, some 0.5 s; a step before that may make the loop hammer.

    Parameters
    ----------
    model : Model, RigModel or Rig
    controller : Loop or Controller
        A PI loop, or what :func:`~dmptm_ctrl.design.tune.tune_controller` designs. Of a rig also
        the rig file's controller; a Loop is on its first input and first speed sensor [SI].
    timepts : (n,) array [s]
        Evenly spaced; the controller runs once per point.
    reference : (n,) array [rad/s]
        Setpoint of the ring gear's speed; of a rig that of its sensor, SI.
    theta_L : float [rad]
        First angle of the ring gear; a rig starts at 0.
    noise : (n,) array [rad/s], optional
        Added to the speed that the controller reads.
    substeps : int, optional
        Steps of the simulator per sample; by default of 125 µs, or what the fastest mode of a
        rig needs.

    Returns
    -------
    TimeResponseData
        ``theta_L`` [rad], ``omega_L`` [rad/s] of the ring gear, ``theta_ml``, ``theta_mr`` [rad] of
        the motors, ``torque_l``, ``torque_r`` [N·m] and ``z_l``, ``z_r`` [rad], mesh torques and
        relative angles at the pinions; then ``u_left``, ``u_right`` [V]; input ``ref`` [rad/s]. Of
        a rig its sensors, then its inputs.

    Raises
    ------
    ValueError
        Shapes that do not fit, uneven time points, a value that is not finite, or time steps
        other than the controller's sample time.
    TypeError
        A model or a controller of another kind.

    Examples
    --------
    >>> time = np.arange(0.0, 1.0, 1e-3)
    >>> loop = dm.Loop(kp=5.0, ki=90.0, limit=10.0, bias_l=0.3, bias_r=-0.3)
    >>> run = dm.close_loop(dm.Model(), loop, time, np.full(1000, 0.2))
    """
    time, dt = _timepts(timepts)
    target = _finite("reference", reference, (time.size,), "a setpoint at each time point")
    heard = None
    if noise is not None:
        heard = _finite("noise", noise, (time.size,), "a speed at each time point")
    if isinstance(model, Model):
        name, labels = model.drive.name, [*compiled.OUTPUTS, "u_left", "u_right"]
        law = _law(controller, dt)
        model.check()
        u, out = compiled.close_loop(
            model, law, target, dt, theta_L=theta_L, noise=heard,
            substeps=substeps,
        )  # fmt: skip
        rows = [*out.T, *u]
    else:
        rig = as_rig_model(model, "close_loop")
        own: Any = controller
        if hasattr(controller, "law"):
            own = _law(controller, dt).controller()
        elif noise is not None:
            raise ValueError("noise is heard by a designed controller only; this one reads without")
        elif isinstance(controller, compiled.Loop):
            own = _of_rig(rig, controller)
        elif not isinstance(own, RigController):
            given = type(controller).__name__
            raise TypeError(f"close_loop of a rig takes a Loop or its own controller, not {given}")
        rig.check()
        still = np.zeros((len(rig.layout.inputs), time.size))
        run = march(
            rig, still, dt, controller=own, reference=target, added=heard, substeps=substeps
        )
        sensors = [s.name for s in rig.rig.sensors]
        name, labels = rig.rig.name, [*sensors, *rig.layout.inputs]
        rows = [*(run.reading(sensor) for sensor in sensors), *run.u]
    return control.TimeResponseData(
        time,
        np.array(rows),
        inputs=target[np.newaxis],
        output_labels=labels,
        input_labels=["ref"],
        sysname=name,
        title=f"{name} under its loop",
        issiso=False,
    )


def _law(controller: Any, dt: float) -> Any:
    """What the loop of a dual-motor drive calls each `dt` seconds."""
    law = controller.law() if hasattr(controller, "law") else controller
    if not hasattr(law, "controller"):
        raise TypeError(
            f"close_loop takes a Loop or a Controller second, not {type(controller).__name__}; "
            "Loop(kp, ki, limit=...) makes one from gains"
        )
    own_step = getattr(controller, "sample_time", dt)
    if abs(dt - own_step) > 1e-6 * own_step:
        raise ValueError(
            f"timepts are {dt:.6g} s apart; the controller's sample time is {own_step:.6g} s"
        )
    return law


def _of_rig(model: RigModel, loop: compiled.Loop) -> RigController:
    """A PI loop on the first input of a rig and its first speed sensor."""
    sensor = next((s for s in model.rig.sensors if s.measures == "speed"), None)
    if sensor is None or loop.bias_l or loop.bias_r:
        lacking = "it has no speed sensor; tune_controller makes a loop on a position"
        why = lacking if sensor is None else "a preload needs two motors"
        raise ValueError(f"no PI loop on {model.rig.name}: {why}")
    gains = {"kp": loop.kp, "ki": loop.ki}
    source = model.layout.inputs[0]
    return RigController("pi_speed", source, sensor.name, gains, "", "", loop.limit)
