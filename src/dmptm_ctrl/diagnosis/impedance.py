"""How loud the balance of a model is for one and the same motion.

The likelihood is that of the motion, given the input. A balance is in torques: what turns
motion into torque has a determinant, and a model that takes little torque for what shakes the
sensors leaves little. Behind a soft spring an inertia takes none.
"""

from dataclasses import replace

import numpy as np

from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.forces import effective_input
from dmptm_ctrl.identify.inverse_dynamics import Balance, passed, pushed
from dmptm_ctrl.simulate.linear import linear_train
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

LINES = 200  # of the band, over which a resonance's logarithm is even


def effort(model: RigModel, balance: Balance) -> float:
    """Logarithm of the torque that all bodies together take, per acceleration.

    In units of what drives give, of which an amplifier may let through a part.
    """
    plant, layout = model.plant(), model.layout
    groups = {*balance.seen(layout), 0}
    rows = np.array([m.moving.sum() for m in balance.motions], np.float64)
    shares = []
    for motion in balance.motions:
        given = {name: effective_input(model, motion, name) for name in motion.u}
        shares.append(passed(*(pushed(model, u, groups) for u in (given, motion.u))))
    share = float(rows @ np.log(shares)) / max(float(rows.sum()), 1.0)
    return float(np.log(plant.inertia @ untwisted(plant) ** 2)) - share


def loudness(model: RigModel, balance: Balance) -> float:
    """Mean over the band of the logarithm of |torque/acceleration|, less that of a rigid drive.

    0 without springs that were added to the declared model. `balance` gives the sensors and the
    band.
    """
    springs = tuple(e for e in model.effects if e.name == SHAFT_COMPLIANCE.name)
    return _level(model, balance, springs) - _level(model, balance, ()) if springs else 0.0


def _level(whole: RigModel, balance: Balance, springs: tuple[Placed, ...]) -> float:
    model = replace(whole, effects=springs)
    train, layout = linear_train(model), model.layout
    lines = (np.arange(LINES) + 0.5) / LINES  # evenly spaced in the band
    w = (2 * np.pi * balance.bandwidth * lines)[:, None, None]
    torque = train.mass - train.stiffness / w**2 - 1j * train.damping / w
    seen = sorted({*balance.seen(layout)})
    if 0 not in seen:  # the driven side follows from the other through the spring
        return float(-np.log(np.abs(np.linalg.inv(torque)[:, seen[0], 0])).mean())
    hidden = [k for k in range(layout.coordinates) if k not in seen]
    inner = np.linalg.det(torque[:, hidden][:, :, hidden])
    others = np.log(train.inertia[[k for k in seen if k != 0]]).sum()
    return float(np.log(np.abs(np.linalg.det(torque) / inner)).mean() - others)
