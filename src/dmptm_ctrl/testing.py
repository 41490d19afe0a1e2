"""Assertions for the tests of those who own a machine, with pytest or without.

>>> def test_last_night():
...     assert_explained("model.toml", "logs/tonight")
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import control

    from dmptm_ctrl.check.run import Check
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.rig_model import RigModel


def assert_explained(model: Any, logs: Any, *, tolerance: float = 0.05) -> "Check":
    """Assert that logs are of the machine that a model describes.

    Parameters
    ----------
    model : Model, RigModel or path of a model.toml
    logs : folder, files or Logs
    tolerance : float
        Share of its value by which an entry may differ.

    Returns
    -------
    Check
        What was found.

    Raises
    ------
    AssertionError
        Something has moved; the message says what, and by how many standard errors.
    LogError
        Logs or a model file that cannot be used.
    """
    from dmptm_ctrl.check.run import check

    found = check(model, logs, tolerance=tolerance)
    if not found.same:
        raise AssertionError(found.summary())
    return found


def assert_margins(
    loop: "control.TransferFunction | control.StateSpace",
    *,
    gain_db: float = 6.0,
    phase_deg: float = 30.0,
    peak: float | None = None,
) -> None:
    """Assert the margins of an open loop.

    Parameters
    ----------
    loop : TransferFunction or StateSpace
        Controller times plant, one input and one output, continuous or sampled.
    gain_db, phase_deg : float
        Least gain margin [dB], up or down, and phase margin [deg].
    peak : float, optional
        Largest sensitivity that is allowed.

    Raises
    ------
    AssertionError
        The closed loop is unstable, or a margin is smaller; the message says which.
    TypeError
        A loop of another kind.
    """
    import control as ct

    if not isinstance(loop, ct.TransferFunction | ct.StateSpace) or not loop.issiso():
        raise TypeError("loop needs to be a TransferFunction or StateSpace from one to one signal")
    closed = ct.feedback(loop, 1)
    poles = closed.poles()
    stable = np.all(np.abs(poles) < 1.0) if closed.isdtime(strict=True) else np.all(poles.real < 0)
    if not stable:
        raise AssertionError("the closed loop is unstable")
    gain, phase, distance, *_ = ct.stability_margins(loop)
    # up or down: a gain that may fall is a margin of a loop that integrates twice
    gain, phase = abs(20.0 * np.log10(gain)), abs(phase)
    if gain < gain_db:
        raise AssertionError(f"gain margin is {gain:.3g} dB; it must be at least {gain_db:.3g} dB")
    if phase < phase_deg:
        raise AssertionError(
            f"phase margin is {phase:.3g} deg; it must be at least {phase_deg:.3g} deg"
        )
    if peak is not None and not 1.0 / distance <= peak:
        raise AssertionError(f"sensitivity peaks at {1.0 / distance:.3g}; {peak:.3g} is allowed")


def assert_tracks(
    model: "Model | RigModel",
    controller: Any,
    reference: ArrayLike,
    *,
    rms: float,
    noise: ArrayLike | None = None,
) -> float:
    """Assert that a model follows a setpoint under a controller.

    Parameters
    ----------
    model : Model or RigModel
        The simulated machine.
    controller : Controller or path of a controller.toml
    reference : (n,) array_like [rad/s]
        Setpoint of the ring gear's speed at the controller's sample time; of a rig that of its
        sensor.
    rms : float [rad/s]
        Largest root mean square of the error that is allowed.
    noise : (n,) array_like [rad/s], optional
        On the speed reading.

    Returns
    -------
    float
        The error's root mean square [rad/s].

    Raises
    ------
    AssertionError
        The error is larger, or not finite.
    LogError
        No such controller file.
    """
    from dmptm_ctrl.design.aims import missed
    from dmptm_ctrl.design.controller import Controller, read_controller
    from dmptm_ctrl.design.duty import Duty
    from dmptm_ctrl.simulate.any_model import loop_parts
    from dmptm_ctrl.simulate.closed import close_loop

    if not isinstance(controller, Controller):
        controller = read_controller(Path(controller))
    duty = Duty(np.asarray(reference, float), controller.sample_time)
    run = close_loop(model, controller, duty.time, duty.reference, noise=noise)
    sensor = loop_parts(controller.model, controller.input, controller.sensor)[1]
    miss = missed(model, duty, run.outputs[sensor], sensor=sensor)
    error, unit = float(np.sqrt(np.mean(miss**2))), controller.units[1]
    if not error <= rms:
        raise AssertionError(f"tracking error is {error:.4g} {unit}/s rms; {rms:.4g} is allowed")
    return error
