"""Controllers of a user's own on the compiled plant, at the sample rate.

Three kinds: a compiled function, which the compiled loop calls; any Python callable; a sampled
system of python-control. `close` runs a rig under each of them.
"""

from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np

from dmptm_ctrl.simulate.plant import Floats
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import RigRun, march
from dmptm_ctrl.simulate.run import Controller

Law = Callable[[float, float, Floats], Any]


def sampled(system: ct.LTI, reading: int | None = None) -> Law:
    """Return a discrete system of python-control as a law ``(t, target, y) -> u``.

    Parameters
    ----------
    system : StateSpace or TransferFunction
        With a sample time. Its inputs are the target and all readings; or, with `reading`, the
        one input is the target less that reading.
    reading : int, optional

    Raises
    ------
    ValueError
        A continuous system.
    """
    state_space = ct.ss(system)
    if not state_space.isdtime(strict=True):
        raise ValueError("the controller is continuous; give one with a sample time, as by c2d")
    state = np.zeros(state_space.nstates)

    def law(t: float, target: float, y: Floats) -> Floats:
        nonlocal state
        given = np.append(target, y) if reading is None else np.array([target - y[reading]])
        u: Floats = state_space.C @ state + state_space.D @ given
        state = state_space.A @ state + state_space.B @ given
        return u

    return law


def simulate_with_controller(
    model: RigModel,
    law: Law | Controller | ct.LTI,
    target: Floats,
    dt: float,
    **options: Any,
) -> RigRun:
    """Run a rig under a controller of one's own.

    Parameters
    ----------
    model : RigModel
    law : callable, Controller or discrete system
        ``law(t, target, y)`` returns the signals of the inputs, one each or one number for a
        single input; `y` are the readings of the sensors, SI, in the order of the rig. A system
        takes the target less the first reading. A :class:`~.run.Controller` is called by the
        compiled loop and costs a hundredth.
    target : (n,) array
    dt : float
        Sample time [s].
    **options
        `substeps`, `state`, `push`, `position` and `speed` of :func:`~.chain.march`.

    Returns
    -------
    RigRun
        Another call goes on from its `state`.

    Raises
    ------
    ValueError
        A continuous system.
    """
    if isinstance(law, ct.LTI):
        law = sampled(law, 0)
    nothing = np.zeros((len(model.layout.inputs), len(target)))
    goal = np.asarray(target, float)
    return march(model, nothing, dt, controller=law, reference=goal, **options)
