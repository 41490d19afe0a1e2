"""What a torque on one coordinate changes of a balance: derivatives without the whole residual.

A balance is linear in the torques on measured bodies. Where two models differ in friction or load
torques alone, only these are evaluated anew.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.identify.following import loaded
from dmptm_ctrl.identify.forces import Forces, forces_of, rubbed
from dmptm_ctrl.identify.inverse_dynamics import passed, pushed, pushing
from dmptm_ctrl.identify.measured_motion import Motion, Nuisance
from dmptm_ctrl.identify.teeth import carried, in_twist, put_through
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import Plant, untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance

TORQUES = "friction", "motor", "load", "presliding"  # sites of effects that are torques on bodies
OF_FRICTION = "law", "bristles", "places", "on", "values"  # what these change of a plant


def by_torque(
    model: RigModel,
    balance: "Balance",
    motion: Motion,
    group: int,
    torque: Floats,
    stiffness: Mapping[str, Any],
) -> Floats:
    """Change of the residual by a torque on a coordinate along a log.

    Parameters
    ----------
    torque : (..., n) array
    stiffness : mapping of link to float or (n,) array
        Of toothed links.

    Returns
    -------
    (equations, ..., rows) array
    """
    layout, plant = model.layout, model.plant()
    reach, seen = untwisted(plant), balance.seen(layout)
    row = motion.reduce(torque)
    out = np.zeros((len(balance.points), *row.shape))
    out[0] = reach[group] * row
    at = dict.fromkeys(range(layout.coordinates), np.zeros_like(row)) | {group: row}
    through = carried(model, balance.teeth, {group: row})
    at = put_through(model, at, through)
    for k, g in enumerate(seen):
        name = balance.link_of.get(k, "")
        if (name and name in motion.calm) or np.ndim(stiffness.get(name, 0.0)):
            along = carried(model, [name], {group: torque})[name]
            wound = in_twist(model, balance, name, 0.0, 0.0, along, stiffness[name])
            out[k] = motion.reduce(motion.calm.get(name, 1.0) * wound) if along.size > 1 else 0.0
        elif name:
            out[k] = in_twist(model, balance, name, 0.0, 0.0, through[name], stiffness[name])
        elif k > 0 and g not in seen[:k]:
            out[k] = at[g] * balance.heft / (reach[g] * plant.inertia[g])
    return out


@dataclass(frozen=True, eq=False)
class Rubbing:
    """Torques of a model along a log, beside which friction and load torques are others."""

    model: RigModel
    balance: "Balance"
    motion: Motion
    forces: Forces
    left: Mapping[int, Floats]  # by coordinate, the torques of toothed links not taken out
    passed: float

    @classmethod
    def of(
        cls, model: RigModel, balance: "Balance", motion: Motion, nuisance: Nuisance
    ) -> "Rubbing":
        """Evaluate all torques once."""
        forces = forces_of(model, balance, motion, nuisance)
        left = {g: own - forces.need[g] for g, own in forces.own.items()}
        share = passed(pushing(model, forces), pushed(model, motion.u, forces.measured))
        return cls(model, balance, motion, forces, left, share)

    def changed(self, there: RigModel, nuisance: Nuisance, groups: set[int]) -> Floats:
        """Change of the residual by another model's friction on coordinates, (equations, rows)."""
        forces, found = self.forces, np.zeros((len(self.balance.points), self.motion.rows.size))
        stiffness = {name: twist[3] for name, twist in forces.twists.items()}
        for g in groups:
            left = rubbed(
                there, self.motion, g, forces.measured[g], forces.moved[g],
                forces.load, forces.volts, nuisance, toothed=bool(forces.twists),
            )  # fmt: skip
            more = left - self.left[g]
            found += by_torque(self.model, self.balance, self.motion, g, more, stiffness)
        found[0] /= self.passed
        return found


def torques_decide(model: RigModel, balance: "Balance") -> bool:
    """Whether motion and torques of links follow from sensors alone, whatever rubs."""
    layout, plant = model.layout, model.plant()
    gaps = zip(layout.links, plant.link_gap, strict=True)
    return (
        not loaded(model)
        and {*balance.seen(layout)} == {*range(layout.coordinates)}
        and not any(gap and name not in balance.teeth for name, gap in gaps)
    )


def friction_alone(model: RigModel, there: RigModel) -> set[int] | None:
    """Coordinates on which friction or load torques differ; None where more than that does."""
    one, other = model.plant(), there.plant()
    for name in Plant._fields:
        same = np.array_equal(getattr(one, name), getattr(other, name))
        if name not in OF_FRICTION and not same:
            return None
    differ = np.any(one.law != other.law, axis=1) | np.any(one.bristles != other.bristles, axis=1)
    bodies = {b for b, other_law in zip(model.layout.bodies, differ, strict=True) if other_law}
    for old, new in zip(model.effects, there.effects, strict=True):
        if old.values != new.values:
            entry = PLACED_CATALOGUE[old.name]
            if entry.place != "body" or entry.site not in TORQUES or entry.by_load:
                return None
            bodies.add(old.on)
    return {model.layout.coordinate[b] for b in bodies}
