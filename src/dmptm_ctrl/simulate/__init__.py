"""Simulation of a drive: compiled for work, in python-control blocks, or by the reference."""

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import control

    from dmptm_ctrl.drive.rig import Rig
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.rig_model import RigModel

METHODS: dict[str, tuple[str, str, Sequence[str]]] = {  # module and function, options
    "compiled": ("compiled", "march", ("substeps", "contact")),
    "blocks": ("blocks", "run", ("rtol", "atol", "pade_order", "contact")),
    "reference": ("reference", "simulate", ("rtol",)),
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
        A rig of any shape has one input per input of the rig [SI], from rest; outputs are its
        sensors. Compiled it has the options of :func:`~dmptm_ctrl.simulate.rig_run.march`.
    timepts : (n,) array [s]
        Evenly spaced. Effects that depend on time count it from the first point.
    inputs : (2, n) array [V]
        Left and right motor voltage.
    initial_state : (6,) array, optional
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; by default at rest at angle 0, the
        pinions at mid-gap.
    method : {"compiled", "blocks", "reference"}
        The compiled loop, for work; the blocks of
        :meth:`~dmptm_ctrl.simulate.model.Model.to_blocks`; or the slow
        :mod:`~dmptm_ctrl.simulate.reference` with every switch located.
    **options
        `substeps` (int, steps per sample) of "compiled"; `rtol` of "reference";
        `rtol`, `atol`, `pade_order` of "blocks". `contact` of "compiled" and "blocks" is the law
        of the meshes: "eq21", or "two_state", the law that paper Eq. 21 stands for; its teeth
        relax within 0.1 ms, so compiled it wants 64 substeps or more.

    Returns
    -------
    TimeResponseData
        ``theta_L`` [rad], ``omega_L`` [rad/s] of the ring gear, ``theta_ml``, ``theta_mr`` [rad] of
        the motors, ``torque_l``, ``torque_r`` [N·m] and ``z_l``, ``z_r`` [rad], mesh torques and
        relative angles at the pinions; of a rig its sensors. Without noise.

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
    >>> speed = run.outputs["omega_L"]  # rad/s
    """
    from dmptm_ctrl.simulate.compiled import INPUTS, OUTPUTS
    from dmptm_ctrl.simulate.response import response

    if method not in METHODS:
        raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
    own, x0 = cast("Any", model), None
    module, function, known = METHODS[method]
    names: Sequence[str]
    seen: Sequence[str]
    if hasattr(model, "drive"):
        names, seen, name = INPUTS, OUTPUTS, own.drive.name
        x0 = _start(own, initial_state)
    else:
        from dmptm_ctrl.simulate.rig_run import MARCH_OPTIONS, as_rig_model

        own = as_rig_model(own, "simulate")
        if initial_state is not None:
            raise ValueError("a rig of any shape starts at `position` and `speed` by body")
        if method == "compiled":
            module, function, known = "rig_run", "march_readings", MARCH_OPTIONS
        known = [k for k in known if k != "contact"]
        names, seen, name = own.layout.inputs, [s.name for s in own.rig.sensors], own.rig.name
    for key in options:
        if key not in known:
            has = ", ".join(known)
            raise TypeError(f"method {method!r} has no option {key!r}; it has {has}")
    substeps = options.get("substeps")
    if substeps is not None and (int(substeps) != substeps or substeps < 1):
        raise ValueError(f"substeps is {substeps!r}; needs a whole number of at least 1")
    own.check()
    time, dt = _timepts(timepts)
    shape = len(names), time.size
    u = _finite("inputs", np.atleast_2d(np.array(inputs, float)), shape, "inputs by time points")
    run = getattr(import_module(f"{__name__}.{module}"), function)
    rows = run(own, u, x0, dt, **options).T
    return response(
        time, rows, inputs=u, output_labels=list(seen), input_labels=list(names),
        sysname=name, title=f"{name} ({method})",
    )  # fmt: skip


def _start(model: "Model", state: ArrayLike | None) -> NDArray[np.float64]:
    """State that a run begins with, by default at rest."""
    from dmptm_ctrl.simulate.compiled import rest

    if state is None:
        return rest(model, 0.0)
    return _finite("initial_state", state, (6,), "three angles and their speeds")


def _timepts(timepts: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """Time points, which are even, and the step between them [s]."""
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
    return time, float(mean)


def _finite(
    name: str, values: ArrayLike, shape: tuple[int, ...], meaning: str
) -> NDArray[np.float64]:
    array = np.array(values, float)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; needs {shape}: {meaning}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    return array
