"""The drive under its sampled speed loop, as python-control returns responses."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.simulate import _finite, _timepts, compiled
from dmptm_ctrl.simulate.model import Model, refuse_negative
from dmptm_ctrl.simulate.response import response

if TYPE_CHECKING:
    import control


def close_loop(
    model: Model,
    controller: Any,
    timepts: ArrayLike,
    reference: ArrayLike,
    *,
    theta_L: float = 0.0,
    noise: ArrayLike | None = None,
    substeps: int = compiled.SUBSTEPS,
) -> "control.TimeResponseData":
    """Run a drive under a sampled speed loop, from rest.

    Parameters
    ----------
    model : Model
    controller : Loop or Controller
        A PI loop, or what :func:`~dmptm_ctrl.design.tune.tune_controller` designs.
    timepts : (n,) array [s]
        Evenly spaced; the controller runs once per point.
    reference : (n,) array [rad/s]
        Setpoint of the ring gear's speed.
    theta_L : float [rad]
        First angle of the ring gear.
    noise : (n,) array [rad/s], optional
        Added to the speed that the controller reads.
    substeps : int
        Steps of the simulator per sample.

    Returns
    -------
    TimeResponseData
        Outputs :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS` in SI, then ``u_left`` and
        ``u_right`` [V]; input ``ref`` [rad/s].

    Raises
    ------
    ValueError
        Shapes that do not fit, uneven time points, a value that is not finite, or time steps
        other than the controller's sample time.
    TypeError
        A model or a controller of another kind.
    """
    if not isinstance(model, Model):
        raise TypeError(f"close_loop takes a Model first, not {type(model).__name__}")
    own_step = getattr(controller, "sample_time", None)
    law = controller.law() if hasattr(controller, "law") else controller
    if not hasattr(law, "kp"):
        raise TypeError(
            f"close_loop takes a Loop or a Controller second, not {type(controller).__name__}"
        )
    refuse_negative(model)
    time = _timepts(timepts)
    dt = float(time[-1] - time[0]) / (time.size - 1)
    if own_step is not None and abs(dt - own_step) > 1e-6 * own_step:
        raise ValueError(
            f"timepts are {dt:.6g} s apart; the controller's sample time is {own_step:.6g} s"
        )
    target = _finite("reference", reference, (time.size,), "a speed at each time point")
    heard = None
    if noise is not None:
        heard = _finite("noise", noise, (time.size,), "a speed at each time point")
    u, out = compiled.close_loop(
        model, law, target, dt, theta_L=theta_L, noise=heard, substeps=substeps
    )
    return response(
        time,
        np.vstack([out.T, u]),
        inputs=target[np.newaxis],
        issiso=False,
        output_labels=[*compiled.OUTPUTS, "u_left", "u_right"],
        input_labels=["ref"],
        sysname=model.drive.name,
        title=f"{model.drive.name} under its speed loop",
    )
