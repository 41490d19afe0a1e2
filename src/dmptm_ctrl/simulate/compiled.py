"""The compiled simulator: the plant sampled at the log's rate, voltage held between samples."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.arguments import refusing
from dmptm_ctrl.simulate.dual import columns, outputs, pi_loop, plant_with, start
from dmptm_ctrl.simulate.observer import rigid_observer
from dmptm_ctrl.simulate.plant import Floats, Plant
from dmptm_ctrl.simulate.run import Controller, advance, start_state, structure_for

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.law import Law
    from dmptm_ctrl.simulate.model import Model

INPUTS = ("u_left", "u_right")
# what runs of many drives call it
SEEN = {
    "theta_L": "reading0", "omega_L": "reading1", "theta_ml": "reading2", "theta_mr": "reading3",
    "torque_l": "torque0", "torque_r": "torque1", "z_l": "twist0", "z_r": "twist1",
}  # fmt: skip
OUTPUTS = tuple(SEEN)
BODIES = 4  # of these, the first: what turns; then torques and relative angles of the meshes
SUBSTEPS = 8  # steps per sample; at 1 kHz 125 µs resolves the 231 Hz mode with 35 steps
STEP = 125e-6  # s, of longer samples
# Where impacts are followed one by one: each amplifies the error of those before it. Where gaps
# damp little, steps of 125 µs diverge from the true motion after 0.3 s.
FINE_SUBSTEPS = 16


@refusing
class Loop(NamedTuple):
    """PI speed loop at the sample rate, common to both motors, with preload.

    Attributes
    ----------
    kp : float [V/(rad/s)]
    ki : float [V/rad]
    limit : float [V]
        Clip of the common voltage.
    bias_l, bias_r : float [V]
        Added on the left and on the right motor, after the clip. Opposite values are a preload:
        a ``Controller`` has them as `preload`, beside feed-forward and notches.

    Examples
    --------
    >>> dm.Loop(kp=5.0, ki=90.0, limit=10.0, bias_l=0.3, bias_r=-0.3)
    Loop(kp=5.0, ki=90.0, limit=10.0, bias_l=0.3, bias_r=-0.3)
    """

    kp: float
    ki: float
    limit: float
    bias_l: float = 0.0
    bias_r: float = 0.0

    def controller(self) -> Controller:
        """Return the loop as the compiled loop calls it."""
        return Controller(pi_loop, np.array(self), 1)


def rest(
    model: "Model", theta_L: float, *, motors: Sequence[float] | Floats | None = None
) -> Floats:
    """Return the state at rest at ring-gear angle `theta_L` [rad], pinions at mid-gap.

    Where the angles of the motors [rad] are known, they place the pinions in their gaps.
    """
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    pinions = [n2 * theta_L] * 2 if motors is None else [m / n1 for m in motors]
    return np.array([*pinions, theta_L, 0.0, 0.0, 0.0])


def march(
    model: "Model",
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    substeps: int | None = None,
    observer: tuple[float, float] | None = None,
    measured: Floats | None = None,
    begin: float = 0.0,
    meshes: bool = True,
    contact: str = "eq21",
) -> Floats:
    """Run the drive open loop, as fits do thousands of times.

    `u` (2, n) [V] is held from each sample of `dt` seconds to the next; `x0` (6,) are θ3l, θ3r, θL
    [rad] and their speeds [rad/s]; `begin` [s] is the time of the first sample. An `observer`, as
    of :func:`~.observer.observer_gains`, feeds the miss of the ring-gear angle `measured` (n,)
    back to the rigid mode. `contact` is the law of the meshes, see :func:`~.dual.plant_with`.
    Returns columns :data:`OUTPUTS` in SI, (n, 8), or without `meshes` the first 4.
    """
    plant = plant_with(model, contact)
    observed = {}
    if observer is not None:
        observed = {"observer": rigid_observer(plant, 0, observer), "measured": measured}
    return _run(plant, x0, u, dt, substeps, None, meshes, begin, **observed)[1]


def steps_in(dt: float) -> int:
    """Return how many steps the simulator takes per sample of `dt` seconds."""
    return max(SUBSTEPS, round(dt / STEP))


def _run(
    plant: Plant,
    x0: Floats,
    u: Floats,
    dt: float,
    substeps: int | None,
    extra: Floats | None,
    meshes: bool,
    begin: float = 0.0,
    **options: Any,
) -> tuple[Floats, Floats]:
    """Voltages and outputs of a run, see :func:`march`; `options` are those of `advance`."""
    structure = structure_for(plant)
    state = replace(start_state(structure, *start(plant, np.asarray(x0, float))), time=begin)
    if extra is not None and plant.inertia.size > 3:  # motors behind compliant reducers
        extra = np.hstack([extra, np.zeros((len(extra), plant.inertia.size - 3))])
    options |= {"structure": structure, "push": extra, "columns": columns(plant, meshes)}
    done = advance(plant, state, u, dt, substeps or steps_in(dt), **options)
    return done.u, outputs(plant, done.rows, meshes)


def close_loop(
    model: "Model",
    loop: "Loop | Law",
    reference: ArrayLike,
    dt: float,
    *,
    theta_L: float = 0.0,
    noise: ArrayLike | None = None,
    extra: Floats | None = None,
    substeps: int | None = None,
    meshes: bool = True,
) -> tuple[Floats, Floats]:
    """Run the plant under a sampled speed loop.

    `noise` [rad/s] is added to the speed that the controller sees; `extra` (n, 3) [N·m] are torques
    added on the two pinions and the ring gear. Returns voltages (2, n) and columns as
    :func:`march`, the speed without the noise.
    """
    target = np.array(reference, float)
    heard = None if noise is None else np.asarray(noise, float)
    return _run(
        model.plant(), rest(model, theta_L), np.zeros((2, target.size)), dt,
        substeps, extra, meshes, controller=loop.controller(), target=target, noise=heard,
    )  # fmt: skip
