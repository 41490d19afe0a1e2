"""How loud the balance of a model is for one and the same motion.

The likelihood is that of the motion, given the input. A balance is in torques: what turns
motion into torque has a determinant, and a model that takes little torque for what shakes the
sensors leaves little. Behind a soft spring an inertia takes none.
"""

from dataclasses import replace

import numpy as np

from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.simulate.linear import linear_train
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

LINES = 200  # of the band, over which a resonance's logarithm is even


def loudness(model: RigModel, balance: Balance) -> float:
    """Mean over the band of the logarithm of |torque/acceleration|, less that of a rigid drive.

    Springs that were added to the declared model change it, and the lag of an input: the balance
    undoes it. Without these it is 0. `balance` gives the sensors and the band.
    """
    springs = tuple(e for e in model.effects if e.name == SHAFT_COMPLIANCE.name)
    apart = _level(model, balance, springs) - _level(model, balance, ()) if springs else 0.0
    lags = model.plant().input_values[:, 2]
    if lags.size > 1:  # the balance does not undo them
        return apart
    return apart + float(0.5 * np.log1p((_lines(balance) * lags[0]) ** 2).mean())


def _lines(balance: Balance) -> Floats:
    """Frequencies of the band [rad/s], evenly spaced."""
    return np.asarray(2 * np.pi * balance.bandwidth * (np.arange(LINES) + 0.5) / LINES)


def _level(whole: RigModel, balance: Balance, springs: tuple[Placed, ...]) -> float:
    model = replace(whole, effects=springs)
    train, layout = linear_train(model), model.layout
    w = _lines(balance)[:, None, None]
    torque = train.mass - train.stiffness / w**2 - 1j * train.damping / w
    seen = sorted({*balance.seen(layout)})
    if 0 not in seen:  # the driven side follows from the other through the spring
        return float(-np.log(np.abs(np.linalg.inv(torque)[:, seen[0], 0])).mean())
    hidden = [k for k in range(layout.coordinates) if k not in seen]
    inner = np.linalg.det(torque[:, hidden][:, :, hidden])
    others = np.log(train.inertia[[k for k in seen if k != 0]]).sum()
    return float(np.log(np.abs(np.linalg.det(torque) / inner)).mean() - others)
