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
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

LINES = 200  # of the band, over which a resonance's logarithm is even


def loudness(model: RigModel, balance: Balance) -> float:
    """Mean over the band of the logarithm of |torque/acceleration|, over that without springs.

    Parameters
    ----------
    model : RigModel
    balance : Balance
        Of the sensors and the bandwidth.

    Returns
    -------
    float
        0 without a compliance that was added to the declared model and a lag of the input, which
        the balance undoes.
    """
    springs = tuple(e for e in model.effects if e.name == SHAFT_COMPLIANCE.name)
    apart = _level(model, balance, springs) - _level(model, balance, ()) if springs else 0.0
    lags = model.plant().input_values[:, 2]
    if lags.size > 1:  # the balance does not undo them
        return apart
    w = 2 * np.pi * balance.bandwidth * (np.arange(LINES) + 0.5) / LINES
    return apart + float(0.5 * np.log1p((w * lags[0]) ** 2).mean())


def _level(whole: RigModel, balance: Balance, springs: tuple[Placed, ...]) -> float:
    model = replace(whole, effects=springs)
    train, layout = linear_train(model), model.layout
    w = 2 * np.pi * balance.bandwidth * (np.arange(LINES)[:, None, None] + 0.5) / LINES
    torque = train.mass - train.stiffness / w**2 - 1j * train.damping / w
    seen = sorted({layout.coordinate[layout.sensor_body[p.name]] for p in balance.points})
    if 0 not in seen:  # the driven side follows from the other through the spring
        return float(-np.log(np.abs(np.linalg.inv(torque)[:, seen[0], 0])).mean())
    hidden = [k for k in range(layout.coordinates) if k not in seen]
    inner = np.linalg.det(torque[:, hidden][:, :, hidden])
    others = np.log(train.inertia[[k for k in seen if k != 0]]).sum()
    return float(np.log(np.abs(np.linalg.det(torque) / inner)).mean() - others)
