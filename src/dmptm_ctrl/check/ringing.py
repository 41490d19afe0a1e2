"""How bodies that no sensor sees ring down from what a log began with.

A log may begin in motion. Where hidden bodies were then, and how fast, nothing shows, and the
balance has them in step with the measured ones. What that leaves is a sum of their free
oscillations, the measured bodies held: exp(λ t), with λ² M + λ C + K singular. It belongs to the
log, not to the machine.
"""

from collections.abc import Sequence

import numpy as np

from dmptm_ctrl.identify.forces import measured_motion
from dmptm_ctrl.identify.free_parameters import scales_of
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.plant import link_matrices
from dmptm_ctrl.simulate.rig_model import RigModel


def ringing(model: RigModel, balance: Balance) -> tuple[Floats, ...]:
    """Return what hidden bodies may leave in an equation of each log, (rows, ways) per log."""
    size = scales_of(balance).force
    found = []
    for motion in balance.motions:
        poles = poles_of(model, [*measured_motion(model, balance, motion)[0]])
        waves = np.exp(poles[:, None] * (motion.time - motion.time[0]))
        own = [*waves.real, *waves.imag[poles.imag > 0.0]]
        rows = [size * motion.reduce(np.ascontiguousarray(wave)) for wave in own]
        found.append(np.reshape(rows, (len(own), motion.rows.size)).T)
    return tuple(found)


def poles_of(model: RigModel, held: Sequence[int]) -> Floats:
    """Poles of a rig whose coordinates `held` do not move, one of each conjugate pair [1/s]."""
    plant = model.plant()
    hidden = [g for g in range(plant.inertia.size) if g not in held]
    rows, springs, dampers, viscous = link_matrices(plant)
    own, mass = rows[:, hidden], plant.inertia[hidden, None]
    stiffness = (own.T * springs) @ own / mass
    damping = ((own.T * dampers) @ own + np.diag(viscous[hidden])) / mass
    n = len(hidden)
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    poles = np.linalg.eigvals(system)
    return np.asarray(poles[poles.imag >= 0.0])


def at_rows(waves: Sequence[Floats], left: Sequence[Floats]) -> Floats:
    """Return a column per log, equation and way, (all rows of `left`, columns)."""
    count = left[0].shape[0]
    table = np.zeros((sum(part.size for part in left), count * sum(w.shape[1] for w in waves)))
    row = column = 0
    for own in waves:
        for _ in range(count):
            table[row : row + len(own), column : column + own.shape[1]] = own
            row, column = row + len(own), column + own.shape[1]
    return table


def without(
    waves: Sequence[Floats], left: Sequence[Floats], balance: Balance
) -> tuple[Floats, ...]:
    """Return what is left once hidden bodies have rung down, by least squares over what counts."""
    found = []
    for own, part, use in zip(waves, left, balance.counted, strict=True):
        fitted = [
            own @ np.linalg.lstsq(own[u], row[u], rcond=None)[0]
            for row, u in zip(part, np.asarray(use, bool), strict=True)
        ]
        found.append((part - np.array(fitted)) * use)
    return tuple(found)
