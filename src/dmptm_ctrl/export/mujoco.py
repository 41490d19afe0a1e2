"""A drive as joint and actuator parameters of MuJoCo, with a word on what they cannot say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from dmptm_ctrl.export.program import ascii_text
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.simulate.model import Model
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
    return _of_rig(model) if isinstance(model, RigModel) else _of_dual(model)


def _of_dual(model: Model) -> Joint:
    d, effects = model.drive, model.effects
    n1, n2 = d["N_1"], d["N_2"]

    def mean(name: str) -> float:
        return 0.5 * (d[f"{name}_plus"] + d[f"{name}_minus"])

    emf = effects.get("back_emf", {}).get("damping", 0.0)
    delay = effects.get("drive_delay", {}).get("delay", 0.0)
    lag = effects.get("current_lag", {}).get("time_constant", 0.0)
    gear = n1 * n2 * d["K_d"] * d["K_M"]
    lost = [
        f"backlash: half-gaps {d['gap_l']:.4g} and {d['gap_r']:.4g} rad at the pinions",
        f"compliance of the meshes: {d['k_m']:.4g} N m/rad at each pinion",
        "static friction above Coulomb's, and friction that differs by direction",
        *_lost(effects),
    ]
    return Joint(
        "ring_gear", "hinge", 2.0 * n2**2 * (n1**2 * d["J_m"] + d["J_2"]),
        mean("TLc") + 2.0 * n2 * mean("T3c"),
        mean("BL") + 2.0 * n2**2 * (mean("B3") + n1**2 * emf),
        d["J_L"], (("left", gear, delay, lag), ("right", gear, delay, lag)), tuple(lost),
    )  # fmt: skip


def _of_rig(model: RigModel) -> Joint:
    plant, layout = model.plant(), model.layout
    reach = untwisted(plant)
    last = model.rig.bodies[-1]
    own = layout.ratio[last.name] * reach[layout.coordinate[last.name]]  # per first coordinate
    inertia = model.value(f"body.{last.name}.inertia")
    total = friction = damping = 0.0
    for group, r in enumerate(reach.tolist()):
        total += (r / own) ** 2 * float(plant.inertia[group])
    for k, body in enumerate(layout.bodies):
        lever = abs(layout.ratio[body] * reach[layout.coordinate[body]] / own)
        law = plant.law[k]
        coulomb = 0.5 * float(law[1] + law[5])
        viscous = 0.5 * float(law[3] + law[7])
        for effect in model.effects:
            if effect.on == body and effect.name == "coulomb_friction":
                coulomb += effect.values.get("level", 0.0)
            if effect.on == body and effect.name == "viscous_friction":
                viscous += effect.values.get("coefficient", 0.0)
        friction += lever * coulomb
        damping += lever**2 * viscous
    actuators = []
    for j, name in enumerate(layout.inputs):
        body = layout.input_body[name]
        lever = layout.ratio[body] * reach[layout.coordinate[body]] / own
        gain, delay, lag = (float(x) for x in plant.input_values[j, :3])
        actuators.append((name, lever * gain, delay, lag))
    names = {e.name: e for e in model.effects}
    lost = [f"{link}: compliance{' and backlash' * bool(gap)}" for link, gap in
            zip(layout.links, plant.link_gap, strict=True)]  # fmt: skip
    return Joint(
        last.name, "slide" if last.linear else "hinge", total - inertia, friction, damping,
        inertia, tuple(actuators),
        (*lost, "static friction above Coulomb's, and friction that differs by direction",
         *_lost(names)),
    )  # fmt: skip


def _lost(effects: Any) -> list[str]:
    return [f"effect {name}" for name in effects if name not in _KEPT]


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
