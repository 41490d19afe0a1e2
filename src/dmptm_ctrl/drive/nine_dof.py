"""The paper's detailed linear model: per side motor, two wheels and a pinion; one ring gear.

Assembled joint by joint from Eqs. 1 to 15: motor shaft K01, bevel mesh K12 at radii R1 and
R2, output shaft K23, ring mesh K34 at radii R3 and R_L.

The paper prints none of K01, K12, K23, J1, J3, α, δ, R ("proprietary background of the
manufacturer"). :data:`NINE_DOF_DEFAULTS` are ours, orders of magnitude, and a result that
depends on them is never the paper's.
"""

from collections.abc import Mapping, Sequence
from math import atan, cos, pi, radians
from types import MappingProxyType

import control as ct
import numpy as np

from dmptm_ctrl.drive.parameters import (
    Drive,
    Quantity,
    paper_drive,
    physical,
    positive,
    viscous_mean,
)
from dmptm_ctrl.drive.train import GearTrain, Joint

SHEAR_MODULUS = 8.0e10  # Pa, steel


def shaft_stiffness(diameter: float, length: float) -> float:
    """Torsional stiffness [N·m/rad] of a solid steel shaft; diameter and length in m."""
    positive(diameter=diameter, length=length)
    return SHEAR_MODULUS * pi * diameter**4 / 32.0 / length


def _ours(value: float, unit: str, why: str) -> Quantity:
    return Quantity(value, unit, 0.0, f"ours, order of magnitude: {why}")


NINE_DOF_DEFAULTS: Mapping[str, Quantity] = MappingProxyType(
    {
        "K_01": _ours(
            shaft_stiffness(0.014, 0.040),
            "N·m/rad",
            "steel shaft 14 mm × 40 mm, usual on 80 mm servo motors",
        ),
        "K_12": _ours(1.0e8, "N/m", "steel bevel mesh, 10 N/(µm·mm) over 10 mm face width"),
        "K_23": _ours(
            shaft_stiffness(0.022, 0.030),
            "N·m/rad",
            "steel shaft 22 mm × 30 mm; with K_12 some 8 N·m/arcmin at the output of a "
            "60 mm reducer, whose catalogues give 3 to 10",
        ),
        "J_1": _ours(1.3e-5, "kg·m²", "catalogues of 60 mm, 25:1 planetary reducers: 0.13 kg·cm²"),
        "J_3": _ours(1.0e-3, "kg·m²", "pinion of 40 mm diameter with its shaft and clamping hub"),
        "R_2": _ours(0.025, "m", "a wheel that fits a 60 mm frame"),
        "R_3": _ours(0.020, "m", "20 teeth of module 2 mm"),
        "alpha_1": _ours(radians(20.0), "rad", "standard pressure angle"),
        "alpha_3": _ours(radians(20.0), "rad", "standard pressure angle"),
        "D_12": _ours(2.0e3, "N·s/m", "Eq. 24's ζ = 0.03 with the wheels' masses at the mesh"),
        "D_m": _ours(0.0, "N·m·s/rad", "in D_3, as Table 2 measures reducer and motor together"),
        "D_1": _ours(0.0, "N·m·s/rad", "in D_3"),
        "D_2": _ours(0.0, "N·m·s/rad", "in D_3"),
    }
)
OPTIONAL = ("J_2", "R_1", "R_L", "delta_1", "K_34", "D_34", "D_3", "D_L")  # follow from the others


def nine_dof_parameters(drive: Drive | None = None, **overrides: float) -> dict[str, float]:
    """Return all parameters of the 9-DOF model of a drive, SI, by the paper's symbols.

    Overrides are any of :data:`NINE_DOF_DEFAULTS`, and J_2 (of the driven wheel alone), R_1, R_L,
    delta_1, K_34, D_34, D_3, D_L, which otherwise follow: J_2 so that N1² J1 + J2 + J3 is Table
    1's J2 and the 3-DOF model's J̄3 is the same; R2/R1 = N1; R_L/R3 = N2; K34 R3² C34 = k_m;
    D34 R3² C34 = c; δ1 of a right-angle bevel pair. ValueError for an unknown name, or a value
    that is not positive (not negative for a damping).
    """
    drive = paper_drive() if drive is None else drive
    drive.check()
    known = (*NINE_DOF_DEFAULTS, *OPTIONAL)
    for key in overrides:
        if key not in known:
            raise ValueError(f"no 9-DOF parameter {key!r}; there are {', '.join(known)}")
    p = {key: q.value for key, q in NINE_DOF_DEFAULTS.items()} | overrides
    n1, n2 = drive["N_1"], drive["N_2"]
    c34 = cos(p["alpha_3"]) ** 2
    p = {
        "J_2": drive["J_2"] - n1**2 * p["J_1"] - p["J_3"],
        "R_1": p["R_2"] / n1,
        "R_L": p["R_3"] * n2,
        "delta_1": atan(1.0 / n1),
        "K_34": drive["k_m"] / (p["R_3"] ** 2 * c34),
        "D_34": drive["c"] / (p["R_3"] ** 2 * c34),
        "D_3": viscous_mean(drive, "3"),
        "D_L": viscous_mean(drive, "L"),
        **p,
    }
    for key, value in p.items():
        physical(f"9-DOF parameter {key}", value, zero=key.startswith("D_"))
    return p


def nine_dof_train(drive: Drive | None = None, **overrides: float) -> GearTrain:
    """Return the 9-DOF model of a drive in contact; overrides as of :func:`nine_dof_parameters`."""
    drive = paper_drive() if drive is None else drive
    p = nine_dof_parameters(drive, **overrides)
    bodies = (*("ml", "1l", "2l", "3l"), *("mr", "1r", "2r", "3r"), "L")
    c12 = cos(p["alpha_1"]) ** 2 * cos(p["delta_1"])  # appendix
    c34 = cos(p["alpha_3"]) ** 2
    unit = dict(zip(bodies, np.eye(len(bodies)), strict=True))
    joints = []
    for s in "lr":
        motor, wheel, driven, pinion = (unit[f"{b}{s}"] for b in ("m", "1", "2", "3"))
        bevel = p["R_1"] * wheel - p["R_2"] * driven  # Eq. 9
        ring = p["R_3"] * pinion - p["R_L"] * unit["L"]  # Eq. 14
        joints += [
            Joint(f"T01_{s}", motor - wheel, p["K_01"], 0.0),
            Joint(f"T12_{s}", bevel, p["K_12"] * c12, p["D_12"] * c12, p["R_2"]),
            Joint(f"T23_{s}", driven - pinion, p["K_23"], 0.0),
            Joint(f"tau_{s}", ring, p["K_34"] * c34, p["D_34"] * c34, p["R_3"]),
        ]
    side = [drive["J_m"], p["J_1"], p["J_2"], p["J_3"]]
    viscous = [p["D_m"], p["D_1"], p["D_2"], p["D_3"]]
    return GearTrain(
        name="nine_dof",
        bodies=bodies,
        inertia=np.array([*side, *side, drive["J_L"]]),
        viscous=np.array([*viscous, *viscous, p["D_L"]]),
        joints=tuple(joints),
        drives=np.column_stack([unit["ml"], unit["mr"]]),
        torque_per_volt=drive["K_d"] * drive["K_M"],
    )


def nine_dof_ss(
    drive: Drive | None = None,
    *,
    inputs: str = "voltage",
    outputs: Sequence[str] = ("omega_L",),
    states: str = "twists",
    **overrides: float,
) -> ct.StateSpace:
    """Return the 9-DOF model as a state-space system.

    Parameters
    ----------
    drive, inputs, states
        As in :func:`dmptm_ctrl.drive.three_dof.three_dof_ss`.
    outputs : sequence of str
        ``theta_…`` [rad] and ``omega_…`` [rad/s] of ml, 1l, 2l, 3l, mr, 1r, 2r, 3r, L;
        torques [N·m] ``T01_l`` at the motor, ``T12_l`` at the driven wheel, ``T23_l`` in the
        output shaft, ``tau_l`` at the pinion, and the same with r.
    **overrides : float
        What the paper does not print, SI: stiffnesses ``K_01``, ``K_23`` of the shafts, ``K_12``
        of the first gear [N/m]; inertias ``J_1``, ``J_3``; radii ``R_2``, ``R_3``; dampings.
        :func:`nine_dof_parameters` lists all.

    Returns
    -------
    StateSpace

    Raises
    ------
    ValueError
        A name or value that does not exist or makes no sense.

    Notes
    -----
    Paper, Eqs. 1 to 15 (Eq. 15's F_l34r is F_l34t). Unprinted parameters are ours.

    Examples
    --------
    >>> dm.nine_dof(dm.paper_drive(), K_12=5e7).nstates  # a softer first gear
    17
    """
    train = nine_dof_train(drive, **overrides)
    return train.to_ss(inputs=inputs, outputs=outputs, states=states)


def reduced_pinion_inertia(
    n1: float, j_m: float, j_1: float, j_2: float, j_3: float, *, as_printed: bool = False
) -> float:
    """Return J̄3 [kg·m²]: what a rigid reducer of ratio `n1` and its motor weigh at the pinion.

    From motor, both stages of the reducer, and pinion [kg·m²]. J1 turns with the motor, so it
    counts N1² fold; as printed below Eq. 16 it does not. ValueError for a ratio that is not
    positive, an inertia that is negative, and a number that is not finite.
    """
    positive(n1=n1)
    for name, inertia in (("j_m", j_m), ("j_1", j_1), ("j_2", j_2), ("j_3", j_3)):
        physical(name, inertia, "kg·m²", zero=True)
    if as_printed:
        return n1**2 * j_m + j_1 + j_2 + j_3
    return n1**2 * (j_m + j_1) + j_2 + j_3
