"""The damping of the meshes, by the law of the flanks that a model has.

Eq. 21 damps by c from the touch on, flanks that damp by depth by another number in place of it.
"""

from dataclasses import replace

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.simulate.model import Model

DAMPING = "c"
FLANKS, OF_FLANKS = "flank_damping", "damping"
# Torque of a mesh [N·m] at which flanks damp as the c does that a drive declares, and by how much
# it may be more or less: friction and preload of the paper's rig put 2 to 12 on a mesh.
LOADED, SPREAD = 5.0, 2.0


def by_depth(model: Model) -> bool:
    """Whether the flanks of a model damp by depth."""
    return FLANKS in model.effects


def damping_of(model: Model) -> float:
    """Return c [N·m·s/rad], or that of flanks that damp by depth [s/rad]."""
    return model.effects[FLANKS][OF_FLANKS] if by_depth(model) else model.drive[DAMPING]


def damped(model: Model, value: float) -> Model:
    """Return a model with another damping."""
    if by_depth(model):
        return model.with_effect(FLANKS, **{**model.effects[FLANKS], OF_FLANKS: value})
    return model.with_values(**{DAMPING: value})


def possible(model: Model, declared: Drive) -> tuple[float, float, float]:
    """Return the least and the largest damping of a model, and what its declaration says."""
    low, high = declared.quantities[DAMPING].range
    if not by_depth(model):
        return low, high, declared[DAMPING]
    return low / LOADED / SPREAD, high / LOADED * SPREAD, declared[DAMPING] / LOADED


def undamped(drive: Drive) -> Drive:
    """Return a drive whose flanks do not damp from the touch on; no fit and no draw moves that."""
    none = replace(drive.quantities[DAMPING], value=0.0, low=0.0, high=0.0)
    return Drive({**drive.quantities, DAMPING: none}, drive.name)
