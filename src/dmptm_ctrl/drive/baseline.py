"""The existing three-inertia model that the paper compares with (its refs 17 to 20).

The same three bodies, but a classical dead zone (no torque in the gap, no gap damping) and
viscous friction only. It is a drive like any other: linear models, simulator and fit take
it as they take the proposed one.
"""

from dataclasses import replace
from math import pi

from dmptm_ctrl.drive.parameters import DEG, Drive, Quantity, paper_drive, physical, viscous_mean

# Widest viscous friction a fit may need to stand in for the Coulomb friction it lacks:
# 28 N·m over 1 deg/s at the ring gear, 2.8 N·m over 2 deg/s at a pinion, rounded up.
_VISCOUS_HIGH = {"3": 100.0, "L": 2000.0}  # N·m·s/rad
USUAL = 10.0 * DEG  # rad/s, a speed of the paper's experiments
_DRY = [f"T{body}{kind}_{sign}" for body in "3L" for sign in ("plus", "minus") for kind in "sc"]


def baseline_drive(drive: Drive | None = None, *, speed: float = USUAL) -> Drive:
    """Return a drive as the paper's "existing" model has it: dead zone, viscous friction.

    Dry friction, gap damping and stiffness variation are zero and declared exact. Viscous
    friction stands in for the dry friction: it takes as much work from a sine of the ring
    gear's speed, B + 4 Tc/(π ω). It is declared open, since a fit can do better still. With
    the viscous friction of Table 2 alone it would be the same linear model as the proposed one:
    dead zone and dry friction have no linear part.

    Parameters
    ----------
    drive : Drive, optional
        Default: the paper's, corrected.
    speed : float
        Amplitude of that sine at the ring gear [rad/s], by default the paper's 10 deg/s.

    Returns
    -------
    Drive

    Raises
    ------
    ValueError
        A speed that is not positive.

    Examples
    --------
    >>> dm.baseline(dm.paper_drive())["TLc_plus"]
    0.0
    """
    drive = paper_drive() if drive is None else drive
    physical("speed of the baseline's sine", speed, "rad/s")
    turns = {"3": drive["N_2"] * speed, "L": speed}
    q = dict(drive.quantities)
    for name in (*_DRY, "c_f", "k_a"):
        q[name] = Quantity(0.0, q[name].unit, 0.0, "absent from the three-inertia model")
    for body, high in _VISCOUS_HIGH.items():
        dry = 0.5 * (drive[f"T{body}c_plus"] + drive[f"T{body}c_minus"])
        for sign in ("plus", "minus"):
            name = f"B{body}_{sign}"
            q[name] = replace(
                q[name],
                value=viscous_mean(drive, body) + 4.0 * dry / (pi * turns[body]),
                source=f"work of Table 2's friction at {speed / DEG:g} deg/s",
                low=0.0,
                high=high,
            )
            scale = f"W{body}_{sign}"
            q[scale] = replace(q[scale], tolerance=0.0)
    return Drive(q, f"{drive.name}, existing three-inertia model")
