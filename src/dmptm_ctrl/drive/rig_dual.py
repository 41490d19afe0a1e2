"""A rig file that describes a dual-motor drive, as the built-in model of such drives has it."""

from dataclasses import replace

from dmptm_ctrl.data import PAPER_RIG
from dmptm_ctrl.drive.parameters import Drive, Quantity, paper_drive
from dmptm_ctrl.drive.rig import CONTACTS, Body, Input, Link, Rig
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
    """
    return load_rig(PAPER_RIG)


def dual_motor(rig: Rig) -> Drive | None:
    """Return the built-in drive that a rig file describes; None where it is another.

    Two motors, each by a rigid reducer on a pinion, both pinions by a mesh with a gap on one
    ring gear; both sides alike but for the half-gaps; position and speed of the ring gear
    measured, besides the position of both motors or of none; no effect declared.

    Parameters
    ----------
    rig : Rig
    """
    sides = _sides(rig)
    if sides is None:
        return None
    left, right = sides
    source, motor, reducer, pinion, mesh = left
    if not _alike(left, right):
        return None
    ring = rig.body(mesh.second)
    factors = source.factors
    if not {"amplifier", "torque_constant"} <= set(factors) or not _complete(pinion, ring, mesh):
        return None
    assert mesh.stiffness is not None
    assert mesh.damping is not None
    base = paper_drive()
    q: dict[str, Quantity] = {
        **base.quantities,
        "K_d": factors["amplifier"],
        "K_M": factors["torque_constant"],
        "J_m": motor.inertia,
        "J_2": pinion.inertia,
        "J_L": ring.inertia,
        "N_1": reducer.ratio,
        "N_2": mesh.ratio,
        "k_m": mesh.stiffness,
        "c": mesh.damping,
        "gap_l": _known(mesh.half_gap),
        "gap_r": _known(right[4].half_gap),
    }
    if mesh.gap_damping is not None:
        q["c_f"] = mesh.gap_damping
    for body, label in ((pinion, "3"), (ring, "L")):
        for key, name in _FRICTION.items():
            for side in ("plus", "minus"):
                both = body.friction.get(key)
                q[f"{name.format(label)}_{side}"] = both or body.friction[f"{key}_{side}"]
    units = base.quantities
    return Drive({k: replace(v, unit=units[k].unit) for k, v in q.items()}, rig.name)


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


def _alike(left: _Side, right: _Side) -> bool:
    one, other = left, right
    return (
        one[0].factors == other[0].factors
        and one[1].inertia == other[1].inertia
        and not one[1].friction
        and not other[1].friction
        and one[2].ratio == other[2].ratio
        and one[3].inertia == other[3].inertia
        and one[3].friction == other[3].friction
        and replace(one[4], name="", first="", half_gap=None)
        == replace(other[4], name="", first="", half_gap=None)
    )


def _complete(pinion: Body, ring: Body, mesh: Link) -> bool:
    """Whether everything that the built-in model needs is declared with a value."""
    quantities = [mesh.ratio, mesh.stiffness, mesh.damping, mesh.half_gap]
    for body in (pinion, ring):
        quantities.append(body.inertia)
        for key in _FRICTION:
            both = body.friction.get(key)
            quantities += [both or body.friction.get(f"{key}_{s}") for s in ("plus", "minus")]
    return all(q is not None and q.value == q.value for q in quantities)


def _known(quantity: Quantity | None) -> Quantity:
    assert quantity is not None
    return quantity
