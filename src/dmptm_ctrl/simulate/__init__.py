"""Simulation of a drive: compiled for work, in python-control blocks, or by the reference."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import control

    from dmptm_ctrl.drive.rig import Rig
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.rig_model import RigModel

METHODS = {  # and their options
    "compiled": ("substeps", "contact"),
    "blocks": ("rtol", "atol", "pade_order", "contact"),
    "reference": ("rtol",),
}
EVEN = 1e-6  # relative unevenness of the time steps that is rounding


def simulate(
    model: "Model | RigModel | Rig",
    timepts: ArrayLike,
    inputs: ArrayLike,
    initial_state: ArrayLike | None = None,
    *,
    method: str = "compiled",
    **options: Any,
) -> "control.TimeResponseData":
    """Run a drive open loop on sampled voltages, held between samples.

    Parameters
    ----------
    model : Model, RigModel or Rig
        A rig of any shape has one input per input of the rig [SI], from rest, and the options of
        :func:`~dmptm_ctrl.simulate.rig_run.march`; outputs are its sensors.
    timepts : (n,) array [s]
        Evenly spaced. Effects that depend on time count it from the first point.
    inputs : (2, n) array [V]
        Left and right motor voltage.
    initial_state : (6,) array, optional
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; by default at rest at angle 0, the
        pinions at mid-gap.
    method : {"compiled", "blocks", "reference"}
        The compiled loop, for work; the blocks of
        :func:`~dmptm_ctrl.simulate.blocks.to_blocks`; or the slow
        :mod:`~dmptm_ctrl.simulate.reference` with every switch located.
    **options
        `substeps` (int, steps per sample) of "compiled"; `rtol` of "reference";
        `rtol`, `atol`, `pade_order` of "blocks". `contact` of "compiled" and "blocks" is the law
        of the meshes: "eq21", or "two_state", the law that paper Eq. 21 stands for; its teeth
        relax within 0.1 ms, so compiled it wants 64 substeps or more.

    Returns
    -------
    TimeResponseData
        Outputs :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS` in SI, readings of the sensors
        without noise. Where python-control is not imported yet, the numbers do not wait for it,
        see :mod:`~dmptm_ctrl.simulate.response`.

    Raises
    ------
    ValueError
        Shapes that do not fit, uneven or too few time points, values that are not finite,
        an effect of negative size, a method that does not exist.
    TypeError
        An option that the method does not have.

    Examples
    --------
    >>> time = np.arange(0.0, 1.0, 1e-3)
    >>> volts = np.array([0.6 * np.sin(np.pi * time)] * 2)
    >>> run = dm.simulate(dm.Model(dm.paper_drive()), time, volts)
    >>> speed = run.outputs[run.output_labels.index("omega_L")]  # rad/s
    """
    if not hasattr(model, "drive"):
        return _rig_simulated(model, timepts, inputs, initial_state, method, options)
    drive = cast("Model", model)
    from dmptm_ctrl.simulate.compiled import OUTPUTS
    from dmptm_ctrl.simulate.response import response

    if method not in METHODS:
        raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
    for key in options:
        if key not in METHODS[method]:
            has = ", ".join(METHODS[method])
            raise TypeError(f"method {method!r} has no option {key!r}; it has {has}")
    drive.check()
    substeps = options.get("substeps", 1)
    if int(substeps) != substeps or substeps < 1:
        raise ValueError(f"substeps is {substeps!r}; needs a whole number of at least 1")
    time = _timepts(timepts)
    u = _finite("inputs", inputs, (2, time.size), "left and right voltage at each time point")
    x0 = _start(drive, initial_state)
    dt = (time[-1] - time[0]) / (time.size - 1)
    return response(
        time,
        _run(method, drive, u, x0, dt, options).T,
        inputs=u,
        output_labels=list(OUTPUTS),
        input_labels=["u_left", "u_right"],
        sysname=drive.drive.name,
        title=f"{drive.drive.name} ({method})",
    )


def _rig_simulated(
    model: Any,
    timepts: ArrayLike,
    inputs: ArrayLike,
    initial_state: ArrayLike | None,
    method: str,
    options: dict[str, Any],
) -> "control.TimeResponseData":
    from dmptm_ctrl.simulate.response import response
    from dmptm_ctrl.simulate.rig_run import MARCH_OPTIONS, as_rig_model, march

    model = as_rig_model(model, "simulate")
    if method != "compiled" or initial_state is not None:
        raise ValueError("a rig of any shape runs compiled, from `position` and `speed` by body")
    for key in options:
        if key not in MARCH_OPTIONS:
            raise TypeError(f"no option {key!r} for a rig; there are {', '.join(MARCH_OPTIONS)}")
    model.check()
    time = _timepts(timepts)
    rows = np.atleast_2d(np.asarray(inputs, float))
    shape = (len(model.layout.inputs), time.size)
    u = _finite("inputs", rows, shape, "inputs by time")
    run = march(model, u, float(time[1] - time[0]), **options)
    names = [s.name for s in model.rig.sensors]
    return response(
        time,
        np.array([run.reading(name) for name in names]),
        inputs=run.u,
        output_labels=names,
        input_labels=list(model.layout.inputs),
        title=model.rig.name,
    )


def _run(
    method: str,
    model: "Model",
    u: NDArray[np.float64],
    x0: NDArray[np.float64],
    dt: float,
    options: dict[str, Any],
) -> NDArray[np.float64]:
    if method == "compiled":
        from dmptm_ctrl.simulate.compiled import march

        return march(model, u, x0, dt, **options)
    if method == "reference":
        from dmptm_ctrl.simulate.reference import simulate as run_reference

        return run_reference(model, u, x0, dt, **options)
    from dmptm_ctrl.simulate.blocks import run

    return run(model, u, x0, dt, **options)


def _start(model: "Model", state: ArrayLike | None) -> NDArray[np.float64]:
    """State that a run begins with, by default at rest."""
    from dmptm_ctrl.simulate.compiled import rest

    if state is None:
        return rest(model, 0.0)
    return _finite("initial_state", state, (6,), "three angles and their speeds")


def _timepts(timepts: ArrayLike) -> NDArray[np.float64]:
    time = np.asarray(timepts, float)
    if time.ndim != 1 or time.size < 2:
        raise ValueError(f"timepts has shape {time.shape}; needs (n,) with n ≥ 2")
    if not np.isfinite(time).all():
        raise ValueError("timepts holds a value that is not finite")
    steps = time[1:] - time[:-1]
    least, most, mean = steps.min(), steps.max(), (time[-1] - time[0]) / steps.size
    if least <= 0.0 or most - least > EVEN * mean + 8.0 * np.spacing(time[-1]):
        raise ValueError(
            f"timepts is uneven: steps from {least:.6g} to {most:.6g} s; "
            "the voltage is held over equal samples"
        )
    return time


def _finite(
    name: str, values: ArrayLike, shape: tuple[int, ...], meaning: str
) -> NDArray[np.float64]:
    array = np.array(values, float)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; needs {shape}: {meaning}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    return array
