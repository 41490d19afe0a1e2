"""Resonances of the linear drive: frequencies, shapes, kinds, sensitivities.

    K v = ω² M v     generalised symmetric eigenproblem, equal to Eqs. 19 and 20

Undamped 3-DOF modes in closed form: 0; √(k/J̄3), the pinions against each other with the
ring still; √(k/J̄3 + 2 k N2²/J_L), the pinions together against the ring.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dmptm_ctrl.drive.nine_dof import nine_dof_parameters, nine_dof_train
from dmptm_ctrl.drive.parameters import Drive, paper_drive, pinion_inertia
from dmptm_ctrl.drive.three_dof import three_dof_train
from dmptm_ctrl.drive.train import Floats, GearTrain

RIGID_RATIO = 1e-5  # of the highest frequency; eigh leaves √ε ≈ 1e-8 of it for a rigid mode
PARITY = 0.99  # |⟨v, swap v⟩| of a mode that is (anti)symmetric in left and right


@dataclass(frozen=True)
class Modes:
    """Undamped modes of a gear train, lowest first."""

    train: GearTrain
    omega: Floats  # (n,) rad/s
    shapes: Floats  # (n, n) rad, columns, scaled to vᵀ M v = 1 kg·m²
    # "rigid", "antisymmetric" (left against right, ring still), "symmetric" (left with right),
    # "mixed" where the two sides differ; "elastic" where there are no two
    kinds: tuple[str, ...]
    damping_ratios: Floats  # (n,) ζ of the damped modes, nearest in frequency; 0 of the rigid one

    def __str__(self) -> str:
        each = zip(self.hz, self.kinds, self.damping_ratios + 0.0, strict=True)  # −0 is 0
        return "\n".join(f"{hz:8.4g} Hz  {kind}, damping ratio {z:.3g}" for hz, kind, z in each)

    @property
    def hz(self) -> Floats:
        """Frequencies [Hz]."""
        return self.omega / (2.0 * pi)

    @property
    def turns(self) -> Floats:
        """Shapes over the rigid turn, columns with largest entry 1, (n, n).

        All bodies alike in the rigid mode, whatever the ratios between them.
        """
        turns = self.shapes / self.shapes[:, :1]
        peak = np.abs(turns).argmax(axis=0)
        return turns / turns[peak, range(turns.shape[1])]


def solve_modes(train: GearTrain | Drive) -> Modes:
    """Return the modes of a linear drive; of a Drive those of its 3-DOF model.

    TypeError for another kind.
    """
    if isinstance(train, Drive):
        train = three_dof_train(train)
    if not isinstance(train, GearTrain):
        raise TypeError(f"modes takes a Drive or a GearTrain, not {type(train).__name__}")
    squares, shapes = linalg.eigh(train.stiffness, train.mass)
    omega = np.sqrt(np.clip(squares, 0.0, None))
    omega[omega < RIGID_RATIO * omega[-1]] = 0.0
    shapes *= np.sign(shapes[np.abs(shapes).argmax(axis=0), range(omega.size)])
    kinds = tuple(_kind(train, w, v) for w, v in zip(omega, shapes.T, strict=True))
    poles = linalg.eigvals(train.matrices(outputs=())[0])
    return Modes(train, omega, shapes, kinds, damping_ratios(poles, omega))


def _kind(train: GearTrain, omega: float, shape: Floats) -> str:
    if omega == 0.0:
        return "rigid"
    other = {"l": "r", "r": "l"}
    mirrored = [b[:-1] + other.get(b[-1], b[-1]) for b in train.bodies]
    if sorted(mirrored) != sorted(train.bodies) or mirrored == list(train.bodies):
        return "elastic"
    other_way = shape[[train.bodies.index(b) for b in mirrored]]
    parity = shape @ train.mass @ other_way / sqrt(other_way @ train.mass @ other_way)
    if parity > PARITY:
        return "symmetric"
    return "antisymmetric" if parity < -PARITY else "mixed"


def damping_ratios(poles: NDArray[np.complex128], omega: Floats) -> Floats:
    """Damping ratio of the poles nearest to each frequency; 0 for a rigid mode, (n,)."""
    pairs = poles[poles.imag > 0.0]
    ratios = np.zeros_like(omega)
    for i in np.flatnonzero(omega):
        if pairs.size == 0:  # all overdamped
            ratios[i] = 1.0
            continue
        nearest = np.abs(np.abs(pairs) - omega[i]).argmin()
        ratios[i] = -pairs[nearest].real / abs(pairs[nearest])
        pairs = np.delete(pairs, nearest)
    return ratios


def closed_form(drive: Drive) -> Floats:
    """Undamped 3-DOF frequencies [rad/s] in closed form, (3,), ascending; the first is 0."""
    pinions = drive["k_m"] / pinion_inertia(drive)
    ring = 2.0 * drive["k_m"] * drive["N_2"] ** 2 / drive["J_L"]
    return np.array([0.0, sqrt(pinions), sqrt(pinions + ring)])


def both_readings(drive: Drive | None = None) -> dict[str, Drive]:
    """Return the drive, by default the paper's, for both readings of Table 1's J2.

    The table's J2 = 0.125 kg·m² equals N1² Jm exactly. "beside" takes it as what stays on
    the pinion side beside N1² Jm (the default); "motor" as N1² Jm itself, nothing beside.
    """
    drive = paper_drive() if drive is None else drive
    return {"beside": drive, "motor": drive.with_values(J_2=0.0)}


THREE_DOF_PARAMETERS = ("k_m", "J_m", "J_2", "J_L", "N_1", "N_2")


def sensitivities(
    drive: Drive | None = None, *, dof: int = 3, **overrides: float
) -> dict[str, Floats]:
    """Relative sensitivity (∂f/f)/(∂p/p) of each frequency to each parameter, (n,) by its name.

    From the modes: ∂(ω²) = vᵀ (∂K − ω² ∂M) v, nothing is solved again; 0 for the rigid mode.
    Doubling a frequency by a parameter needs the parameter to grow about 2^(1/s) fold.
    Parameters are all that a frequency of this model depends on. `dof` is 3 or 9, overrides are
    9-DOF parameters, see :func:`nine_dof_parameters`. ValueError for another `dof` and for
    overrides of the 3-DOF model.
    """
    drive = paper_drive() if drive is None else drive
    build, names = _family(drive, dof, overrides)
    base = solve_modes(build("", 1.0))
    result = {}
    for name in names:
        # Mass and stiffness are low-degree polynomials of each parameter: the central
        # difference of the matrices is exact to rounding at this step.
        h = 1e-4
        up, down = build(name, 1.0 + h), build(name, 1.0 - h)
        d_mass = (up.mass - down.mass) / (2.0 * h)
        d_stiffness = (up.stiffness - down.stiffness) / (2.0 * h)
        modes = zip(base.omega, base.shapes.T, strict=True)
        result[name] = np.array(
            [w and v @ (d_stiffness - w**2 * d_mass) @ v / (2.0 * w**2) for w, v in modes]
        )
    return result


def _family(
    drive: Drive, dof: int, overrides: dict[str, float]
) -> tuple[Callable[[str, float], GearTrain], tuple[str, ...]]:
    """Return a builder with one parameter scaled, and the names it can scale."""
    if dof not in (3, 9):
        raise ValueError(f"dof is {dof}, it must be 3 or 9")
    if dof == 3 and overrides:
        raise ValueError(f"the 3-DOF model has no {', '.join(overrides)}")
    p = {} if dof == 3 else nine_dof_parameters(drive, **overrides)

    def build(name: str, factor: float) -> GearTrain:
        own = {name: factor * p[name]} if name in p else {}
        other = {name: factor * drive[name]} if name and not own else {}
        scaled = drive.with_values(**other)
        return three_dof_train(scaled) if dof == 3 else nine_dof_train(scaled, **{**p, **own})

    nine = ("J_m", "J_L", *(key for key in p if not key.startswith("D_")))
    return build, THREE_DOF_PARAMETERS if dof == 3 else nine
