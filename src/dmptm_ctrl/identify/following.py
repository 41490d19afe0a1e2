"""Bodies that no sensor sees, joined through declared gaps to bodies that one sees.

Their run depends on the moment of every impact, which no model predicts. While teeth touch they
move with the measured bodies. In the balance of all together the torques of the teeth cancel,
whatever they are. So links of such bodies count as rigid, and a run says only when they touch.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.identify.measured_motion import coordinates_of
from dmptm_ctrl.identify.rig_simulate import free_run, with_other_teeth
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import link_matrices
from dmptm_ctrl.simulate.rig_model import RigModel, link_sides

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance

FOLLOWS = 0.2  # of the frequency at which hidden bodies ring; to its square they follow
IMPACT = 0.02  # s after an impact; teeth chatter, and its moment is not measured
LEAD_HZ = 0.05  # slow lead of the runs by what is measured: bounds drift only


def followed(rig: Rig, sensors: Iterable[str]) -> tuple[frozenset[str], float]:
    """Links beyond which bodies follow the measured ones, and up to which frequency [Hz]."""
    model = RigModel(rig)
    try:
        plant, layout = model.plant(), model.layout
    except ValueError:  # a spring or an inertia is unknown: only runs identify it
        return frozenset(), inf
    seen = {*coordinates_of(layout, sensors)}
    hidden = [g for g in range(layout.coordinates) if g not in seen]
    rows, springs, _, _ = link_matrices(plant)
    own = rows[:, hidden]
    joined = np.any(own != 0.0, axis=1)
    if not joined.any() or not plant.link_gap[joined].all():
        return frozenset(), inf
    square = np.linalg.eigvals((own.T * springs) @ own / plant.inertia[hidden, None])
    lowest = float(np.sqrt(np.abs(square).min())) / (2.0 * np.pi)
    names = frozenset(n for n, one in zip(layout.links, joined, strict=True) if one)
    return names, FOLLOWS * lowest


def touching(balance: "Balance", model: RigModel, logs: Iterable[Log]) -> "Balance":
    """Leave out when followed links are open in runs of a model on the logs."""
    if not balance.closed:
        return balance
    named, several = {log.name: log for log in logs}, [model.opened]
    several += with_other_teeth(model.opened)
    return replace(
        balance,
        motions=tuple(
            replace(m, open_links=_open_links(balance.closed, several, named[m.name])[m.samples])
            for m in balance.motions
        ),
    )


def _open_links(closed: frozenset[str], models: Iterable[RigModel], log: Log) -> Floats:
    """Share of runs in which a followed link does not touch, or did not lately, (n,).

    Of runs with slightly other teeth: when they meet is chance after some impacts.
    """
    return np.asarray(np.mean([_open(closed, one, log) for one in models], axis=0))


def _open(closed: frozenset[str], model: RigModel, log: Log) -> NDArray[np.bool_]:
    run = free_run(model, log, lead_hz=LEAD_HZ)
    open_ = np.zeros(len(log), bool)
    for link in (k for k in model.rig.links if k.name in closed):
        ratio, gap = (model.value(f"link.{link.name}.{key}") for key in ("ratio", "half_gap"))
        twist = run.position(link.first) - ratio * run.position(link.second)
        side = np.where(np.abs(twist) < gap, 0.0, np.sign(twist))
        open_ |= lately_changed(side, log.sample_time) | (side == 0.0)
    return open_


def lately_changed(side: Floats, dt: float) -> NDArray[np.bool_]:
    """Samples at which teeth lie on another flank than a moment before, or have just come."""
    changed = np.zeros(side.size, bool)
    for late in range(1, round(IMPACT / dt) + 1):
        changed[late:] |= side[late:] != side[:-late]
    return changed


def loaded(model: RigModel) -> bool:
    """Whether friction of a model goes with what links carry."""
    return any(PLACED_CATALOGUE[e.name].by_load for e in model.effects)


def loads_of(
    model: RigModel,
    measured: Mapping[int, tuple[Floats, Floats, Floats]],
    pushed: Mapping[str, Floats],
    braked: Callable[[str], Floats],
) -> dict[str, Floats]:
    """Torque of followed links at their first bodies, by what the hidden bodies beyond take.

    Parameters
    ----------
    measured : mapping of coordinate to position, speed and acceleration
    pushed : mapping of body to (n,) array
        Torque of its motor.
    braked : callable
        Torque that friction and effects take of a body.
    """
    layout = model.layout
    found: dict[str, Floats] = {}
    seen = {layout.sensor_body[s.name] for s in model.rig.sensors}
    for name in sorted(model.closed):
        ratio = model.value(f"link.{name}.ratio")
        near, far = link_sides(model, name)
        side, lever = (far, ratio) if seen & {*near} else (near, 1.0)
        torque = np.zeros(1)
        for body, r in side.items():
            a = layout.ratio[body] * measured[layout.coordinate[body]][2]
            takes = model.value(f"body.{body}.inertia") * a + braked(body)
            torque = torque + r / lever * (takes - pushed.get(body, 0.0))
        found[name] = torque
    return found
