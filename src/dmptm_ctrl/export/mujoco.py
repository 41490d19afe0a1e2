"""A drive as joint and actuator parameters of MuJoCo, with a word on what they cannot say."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from dmptm_ctrl.export.program import ascii_text
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.simulate.dual import MOTORS, RING
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

_KEPT = ("drive_delay", "current_lag", "back_emf", "viscous_friction", "coulomb_friction")


@dataclass(frozen=True)
class Joint:
    """One joint, all bodies of the drive seen at it."""

    name: str
    kind: str  # "hinge" or "slide"
    armature: float  # inertia of all but the joint's own body [kg·m² or kg]
    frictionloss: float  # Coulomb friction, mean of both directions [N·m or N]
    damping: float  # N·m·s/rad or N·s/m
    inertia: float  # of the joint's own body; it belongs to the body in MuJoCo
    # name, gear at the joint, dead time, lag [s]
    actuators: tuple[tuple[str, float, float, float], ...]
    lost: tuple[str, ...]  # what of the model is not in it


def mujoco_joint(model: Model | RigModel) -> Joint:
    """Return a drive as one joint: of the ring gear, or of the last body of a rig file."""
    plant = model.plant()
    if isinstance(model, RigModel):
        bodies, names = list(model.layout.bodies), list(model.layout.inputs)
        last = model.rig.bodies[-1]
        name, kind, load = last.name, "slide" if last.linear else "hinge", bodies.index(last.name)
        inertia = model.value(f"body.{name}.inertia")
        placed = [(e.name, bodies.index(e.on), e.values) for e in model.effects if e.on in bodies]
        gaps = zip(model.layout.links, plant.link_gap, strict=True)
        lost = [f"{link}: compliance{' and backlash' * bool(gap)}" for link, gap in gaps]
        others = [e.name for e in model.effects]
    else:
        d, names = model.drive, ["left", "right"]
        name, kind, load, inertia = "ring_gear", "hinge", RING, d["J_L"]
        placed = [(e, m, values) for e, values in model.effects.items() for m in MOTORS]
        lost = [
            f"backlash: half-gaps {d['gap_l']:.4g} and {d['gap_r']:.4g} rad at the pinions",
            f"compliance of the meshes: {d['k_m']:.4g} N m/rad at each pinion",
        ]
        others = [*model.effects]
    reach = untwisted(plant, int(plant.body_coordinate[load])) / plant.body_ratio[load]
    turns = plant.body_ratio * reach[plant.body_coordinate]  # of each body per turn of the load
    coulomb, viscous = (0.5 * (plant.law[:, k] + plant.law[:, k + 4]) for k in (1, 3))
    for effect, body, values in placed:
        coulomb[body] += values.get("level", 0.0) * (effect == "coulomb_friction")
        viscous[body] += values.get("coefficient", 0.0) * (effect == "viscous_friction")
        viscous[body] += values.get("damping", 0.0) * (effect == "back_emf")
    gears = turns[plant.input_body] * plant.input_values[:, 0]
    lags = [Parts(plant).lag(j, 0.0)[1] for j in range(len(names))]
    rows = zip(names, gears.tolist(), plant.input_values[:, 1].tolist(), lags, strict=True)
    return Joint(
        name, kind, float(reach**2 @ plant.inertia) - inertia, float(abs(turns) @ coulomb),
        float(turns**2 @ viscous), inertia, tuple(rows),
        (*lost, "static friction above Coulomb's, and friction that differs by direction",
         *(f"effect {e}" for e in dict.fromkeys(others) if e not in _KEPT)),
    )  # fmt: skip


def mujoco_text(joint: Joint, source: Path) -> str:
    """Return a joint as an MJCF model that holds it alone, to be copied from."""
    root = Element("mujoco", model=joint.name)
    # friction and damping act implicitly: at 1 ms they are stiff
    SubElement(root, "option", timestep="0.001", gravity="0 0 0", integrator="implicitfast")
    body = SubElement(SubElement(root, "worldbody"), "body", name=f"{joint.name}_body")
    SubElement(
        body, "joint", name=joint.name, type=joint.kind, axis="0 0 1",
        armature=_number(joint.armature), frictionloss=_number(joint.frictionloss),
        damping=_number(joint.damping),
    )  # fmt: skip
    mass = joint.inertia if joint.kind == "slide" else 1.0
    turning = " ".join([_number(joint.inertia)] * 3)
    SubElement(body, "inertial", pos="0 0 0", mass=_number(mass), diaginertia=turning)
    actuators = SubElement(root, "actuator")
    for name, gear, delay, lag in joint.actuators:
        item = SubElement(actuators, "general", name=name, joint=joint.name, gear=_number(gear))
        if lag > 0.0:
            item.set("dyntype", "filterexact")
            item.set("dynprm", _number(lag))
        if delay > 0.0:
            item.set("delay", _number(delay))
            item.set("nsample", str(int(delay / 1e-3) + 2))
    indent(root)
    notes = [*origin(source), "SI units. Not in it:", *(f"  {line}" for line in joint.lost)]
    plain = "\n".join(ascii_text(line).replace("--", "- -") for line in notes)
    return f"<!--\n{plain}\n-->\n" + tostring(root, encoding="unicode") + "\n"


def _number(value: float) -> str:
    return f"{value:.9g}"
