"""A drive as python-control blocks: the dual-motor drive, or a rig of any shape.

See :mod:`~.block_parts` for what the blocks are.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from dmptm_ctrl.drive.state_space import system_name
from dmptm_ctrl.simulate.block_parts import (
    PADE_ORDER,
    REST_SPEED,
    Delay,
    Given,
    Names,
    part_blocks,
    pi_block,
)
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop
from dmptm_ctrl.simulate.dual import plant_with
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import Floats, Plant

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.rig_model import RigModel

__all__ = ["REST_SPEED", "drive_states", "initial_state", "run", "to_blocks"]

MAX_STEP = 0.01  # s; so that no turn of the motion is stepped over
SIDES = ("l", "r")
DUAL = Names(
    [
        (f"amplifier_{s}", f"u_{side}", f"voltage_{s}")
        for s, side in zip(SIDES, ("left", "right"), strict=True)
    ],
    ["pinion_l", "pinion_r", "ring", "motor_l", "motor_r"],
    ["l", "r", "ring", "motor_l", "motor_r"],
    ("theta", "omega"),
    [
        *((f"theta_3{s}", f"omega_3{s}") for s in SIDES),
        ("ring_angle", "ring_speed"),
        *((f"theta_m{s}", f"omega_m{s}") for s in SIDES),
    ],
    [
        *((f"mesh_{s}", f"torque_{s}", f"z_{s}") for s in SIDES),
        *((f"reducer_{s}", f"reducer_torque_{s}", f"reducer_twist_{s}") for s in SIDES),
    ],
    {"sensor": {0: "theta_L", 1: "omega_L"}},
)


def to_blocks(
    model: "Model | RigModel",
    *,
    loop: Loop | None = None,
    pade_order: int = PADE_ORDER,
    contact: str = "eq21",
    others: Sequence[str] = (),
) -> ct.InterconnectedSystem:
    """Return the drive as python-control blocks; see :meth:`.model.Model.to_blocks`."""
    model.check()
    own, dual = cast("Any", model), hasattr(model, "drive")
    if not isinstance(loop, Loop | None):
        raise TypeError(f"loop must be a Loop, not a {type(loop).__name__}")
    if not dual and (loop or contact != "eq21"):
        raise ValueError("loop and contact are of a dual-motor drive; a rig file has its own")

    def plant_of(values: Mapping[str, float]) -> Plant:
        if dual:
            return plant_with(own.with_values(**values), contact)
        changed = own.with_values(values)
        changed.check()
        return changed.plant()

    known = own.drive if dual else own.quantities
    given = Given(plant_of, [*known], others=others, loop=loop, pade_order=pade_order)
    names = DUAL if dual else _rig_names(own)
    blocks = part_blocks(given, names)
    inputs = [command for _, command, _ in names.inputs]
    outputs = [*OUTPUTS] if dual else [sensor.name for sensor in own.rig.sensors]
    if loop is not None:
        blocks.append(pi_block(given))
        inputs, outputs = ["ref"], [*outputs, *inputs]
    return ct.interconnect(
        blocks,
        inputs=inputs,
        outputs=outputs,
        name=system_name(own.rig.name) if not dual else "drive_loop" if loop else "drive",
        check_unused=False,  # speeds of motors, twists of links are for whoever wants them
    )


def _rig_names(model: "RigModel") -> Names:
    layout = model.layout
    turning = {g: b for b, g in reversed(layout.coordinate.items())}  # the first of each group
    leading = [turning[g] for g in range(layout.coordinates)]
    return Names(
        [(f"input_{x}", x, f"{x}_acting") for x in layout.inputs],
        [f"body_{first}" for first in leading],
        leading,
        ("q", "v"),
        [(f"q_{x}", f"v_{x}") for x in layout.bodies],
        [(f"link_{x}", f"{x}_torque", f"{x}_twist") for x in layout.links],
        {f"sensor_{s.name}": {i: s.name} for i, s in enumerate(model.rig.sensors)},
    )


def initial_state(model: "Model", sys: ct.InterconnectedSystem, x0: ArrayLike) -> Floats:
    """Return the state of `sys`, the blocks of a model, for a state of the three bodies.

    `x0` (6,) is θ3l, θ3r, θL [rad] and their speeds [rad/s]; motors turn with their pinions. No
    voltage before the start; a late speed sensor has seen this speed for long.
    """
    bodies = np.asarray(x0, float)
    known = {"ring_theta": bodies[2], "ring_omega": bodies[5]}
    for side, s in enumerate(SIDES):
        known[f"pinion_{s}_theta"] = known[f"motor_{s}_theta"] = bodies[side]
        known[f"pinion_{s}_omega"] = known[f"motor_{s}_omega"] = bodies[3 + side]
        twist = bodies[side] - model.drive["N_2"] * bodies[2]
        half_gap = model.drive[f"gap_{s}"]
        known[f"mesh_{s}_position"] = min(max(twist, -half_gap), half_gap)
    stored = [label for label in sys.state_labels if label.startswith("sensor_delay")]
    late = Delay(float(model.plant().sensor_delay[1]), len(stored))
    known.update(zip(stored, late.settled(bodies[5]), strict=True))
    return np.array([known.get(label, 0.0) for label in sys.state_labels])


def drive_states(model: "Model", side: int, u: float) -> dict[str, float]:
    """Return the states of a motor's drive, by their name in `to_blocks`, once `u` [V] lasted."""
    parts, block = Parts(model.plant()), f"amplifier_{SIDES[side]}"
    late = Delay(parts.inputs[side][1], PADE_ORDER)
    states = dict(zip(late.states, late.settled(u), strict=True))
    aim, tau = parts.lag(side, parts.signal(side, u, 0.0))
    if tau > 0.0:
        states["lag"] = aim
    return {f"{block}_{name}": float(x) for name, x in states.items()}


def run(
    model: "Model | RigModel",
    u: Floats,
    x0: Floats | None,
    dt: float,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    **options: Any,
) -> Floats:
    """Run the blocks of a model on held signals, restarted at each of their jumps.

    Parameters and result as of :func:`dmptm_ctrl.simulate.reference.simulate`; `rtol`,
    `atol` [rad, rad/s] of SciPy's RK45; other `options` as of :func:`to_blocks`. RuntimeError
    where the integrator gives up.
    """
    sys = model.to_blocks(**options)
    # a rig starts from rest at 0, where it remembers nothing
    state = np.zeros(sys.nstates) if x0 is None else initial_state(cast("Model", model), sys, x0)
    n = u.shape[1]
    out = np.empty((n, sys.noutputs))
    jumps = np.flatnonzero(np.any(np.diff(u) != 0.0, axis=0)) + 1
    ends = sorted({*jumps.tolist(), n - 1})
    first = 0
    out[0] = sys.output(0.0, state, u[:, 0])
    for last in ends:
        held = u[:, first]
        times = np.arange(first, last + 1) * dt
        found = solve_ivp(
            lambda t, x, held=held: sys.dynamics(t, x, held),
            (times[0], times[-1]),
            state,
            t_eval=times[1:],
            rtol=rtol,
            atol=atol,
            max_step=MAX_STEP,
        )
        if not found.success:
            raise RuntimeError(f"the blocks failed at t = {found.t[-1]:.6f} s: {found.message}")
        for i, x in enumerate(found.y.T, first + 1):
            out[i] = sys.output(i * dt, x, u[:, i])
        state, first = found.y[:, -1], last
    return out
