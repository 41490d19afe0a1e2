"""A rig file that describes a dual-motor drive, as the built-in model of such drives has it."""

from dataclasses import replace

from dmptm_ctrl.data import PAPER_RIG
from dmptm_ctrl.drive.parameters import Drive, paper_drive
from dmptm_ctrl.drive.rig import CONTACTS, Body, Input, Link, Rig, is_known
from dmptm_ctrl.drive.rigfile import load_rig
from dmptm_ctrl.signals.columns import Column

MOTOR_ANGLES = ("theta_ml", "theta_mr")
_FRICTION = {"static": "T{}s", "coulomb": "T{}c", "stribeck_speed": "W{}", "viscous": "B{}"}


def paper_rig() -> Rig:
    """Return the paper's drive as bodies and links, from the rig file that comes with the package.

    Returns
    -------
    Rig
        Five bodies: two motors, two pinions, one ring gear.

    Examples
    --------
    >>> dm.paper_rig()
    <Rig 'paper': 5 bodies, 4 links, 2 inputs, 2 sensors>
    """
    return load_rig(PAPER_RIG)


def dual_motor(rig: Rig) -> Drive | None:
    """Return the built-in drive that a rig file describes; None where it is another.

    Two motors, each by a rigid reducer on a pinion, both pinions by a mesh with a gap on one
    ring gear; both sides alike but for the half-gaps; position and speed of the ring gear
    measured, besides the position of both motors or of none; no effect declared.
    """
    sides = _sides(rig)
    if sides is None:
        return None
    left, right = sides
    source, motor, reducer, pinion, mesh = left
    if motor.friction or _own(left) != _own(right):
        return None
    ring, base = rig.body(mesh.second), paper_drive()
    declared = {
        "K_d": source.factors.get("amplifier"),
        "K_M": source.factors.get("torque_constant"),
        "J_m": motor.inertia,
        "J_2": pinion.inertia,
        "J_L": ring.inertia,
        "N_1": reducer.ratio,
        "N_2": mesh.ratio,
        "k_m": mesh.stiffness,
        "c": mesh.damping,
        "c_f": mesh.gap_damping or base.quantities["c_f"],
        "gap_l": mesh.half_gap,
        "gap_r": right[4].half_gap,
    }
    for body, label in ((pinion, "3"), (ring, "L")):
        exponent = body.friction.get("stribeck_exponent")
        declared[f"delta{label}"] = exponent or base.quantities[f"delta{label}"]
        for key, name in _FRICTION.items():
            for side in ("plus", "minus"):
                own = body.friction.get(key) or body.friction.get(f"{key}_{side}")
                declared[f"{name.format(label)}_{side}"] = own
    known = {k: v for k, v in declared.items() if v is not None and is_known(v)}
    if len(known) < len(declared):
        return None
    whole = {**base.quantities, **known}
    units = {k: q.unit for k, q in base.quantities.items()}
    return Drive({k: replace(q, unit=units[k]) for k, q in whole.items()}, rig.name)


def dual_columns(rig: Rig) -> dict[str, Column]:
    """Columns of a dual-motor rig's logs under the names of the built-in model."""
    sides = _sides(rig)
    assert sides is not None
    found = {
        side[0].column: Column(name, side[0].unit, side[0].sign)
        for side, name in zip(sides, ("u_left", "u_right"), strict=True)
    }
    if rig.data.time is not None:
        column, unit = rig.data.time
        found[column] = Column("time", unit)
    motors = {side[1].name: name for side, name in zip(sides, MOTOR_ANGLES, strict=True)}
    for sensor in rig.sensors:
        on_ring = "theta_L" if sensor.measures == "position" else "omega_L"
        name = motors.get(sensor.body, on_ring)
        found[sensor.column] = Column(name, sensor.unit, sensor.sign)
    return found


_Side = tuple[Input, Body, Link, Body, Link]


def _sides(rig: Rig) -> tuple[_Side, _Side] | None:
    if len(rig.bodies) != 5 or len(rig.links) != 4 or len(rig.inputs) != 2 or rig.effects:
        return None
    found: list[_Side] = []
    for source in rig.inputs:
        reducer = next((k for k in rig.links if k.rigid and k.first == source.body), None)
        if reducer is None:
            return None
        mesh = next((k for k in rig.links if k.first == reducer.second and k.half_gap), None)
        if mesh is None or mesh.contact != CONTACTS[0]:
            return None
        found.append((source, rig.body(source.body), reducer, rig.body(reducer.second), mesh))
    left, right = found
    ring = left[4].second
    motors = [(left[1].name, "position"), (right[1].name, "position")]
    needed = sorted([(ring, "position"), (ring, "speed")])
    measured = sorted((s.body, s.measures) for s in rig.sensors)
    if ring != right[4].second or measured not in (needed, sorted(needed + motors)):
        return None
    return left, right


def _own(side: _Side) -> tuple[object, ...]:
    """What both sides have in common: all but names and the half-gap."""
    source, motor, reducer, pinion, mesh = side
    rest = replace(mesh, name="", first="", half_gap=None)
    bodies = motor.inertia, motor.friction, pinion.inertia, pinion.friction
    return (source.factors, *bodies, reducer.ratio, rest)
