"""The parts of the model: parameters as used, blocks, the mesh (Tables 1, 2; Figs 11 to 15)."""

import numpy as np

from dmptm_ctrl.drive import Tooth, mesh_stiffness, paper_drive, tooth_stiffness
from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.plots.mesh import dead_zone_plot, mesh_phase_plot, tooth_plot
from dmptm_ctrl.reproduce.items import DEG, RIG_LOOP, Context, Item, Picture, Table
from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.model import Model

PER_UNIT = {"rad": DEG / 60.0, "rad/s": DEG}  # arcmin and deg/s, as the tables print them
PRINTED_UNIT = {"rad": "arcmin", "rad/s": "deg/s"}
RATES = (0.0, 0.5, -0.5)  # rad/s of the pinion in its gap
TOOTH = Tooth(0.002, 20, 0.010)  # module and face width are ours
VARIATION = 0.1  # of k_m; the paper prints no k_a


def declared(context: Context) -> list[Item]:
    """Tables 1 and 2 as printed and as used."""
    printed = paper_drive(as_printed=True)
    rows, changed = [], 0
    for name, quantity in context.drive.quantities.items():
        if quantity.source == "ours" or "not printed" in quantity.source:
            before = "–"
        else:
            before = _number(printed[name], quantity)
        after = _number(quantity.value, quantity)
        changed += before not in ("–", after)
        low, high = quantity.range
        spread = f"{_number(low, quantity)} … {_number(high, quantity)}" if high > low else "exact"
        unit = PRINTED_UNIT.get(quantity.unit, quantity.unit)
        rows.append((name, before, after, spread, unit, quantity.source))
    caption = (
        "Friction and gaps hold for ±12 % from rig to rig, inertias for ±6 %, k_m for ±10 %. T3… "
        "act on the pinion side of both reducers; gaps are half-gaps at the pinion. Angles as the "
        "paper prints them, viscous friction per radian."
    )
    header = ("symbol", "printed", "used", "range", "unit", "source")
    table = Table("declared", "Parameters as printed and as used", header, rows, caption)
    return [table._replace(paper="Tables 1, 2", here=f"{changed} values changed")]


def _number(value: float, quantity: Quantity) -> str:
    return f"{value / PER_UNIT.get(quantity.unit, 1.0):.4g}"


def blocks(context: Context) -> list[Item]:
    """Figs 13 and 15 as python-control blocks."""
    system = to_blocks(Model(context.drive), loop=RIG_LOOP)
    rows = [
        (block.name, ", ".join(block.input_labels), ", ".join(block.output_labels))
        for block in system.syslist
    ]
    caption = (
        "The nonlinear drive under its speed loop: an InterconnectedSystem of NonlinearIOSystem "
        "blocks, joined by these names. Linearised under preload it is the 3-DOF model to 1e-6 "
        "(tests/agreement/test_linear.py)."
    )
    table = Table("blocks", "Block diagram", ("block", "inputs", "outputs"), rows, caption)
    states = f"{len(rows)} blocks, {system.nstates} states"
    return [table._replace(paper="Figs 13, 15", here=states)]


def mesh(context: Context) -> list[Item]:
    """Draw the dead zone, the tooth and the stiffness by mesh phase."""
    drive = context.drive
    law = Backlash(drive["k_m"], drive["c"], drive["c_f"], drive["gap_l"])
    zone = dead_zone_plot(law, RATES, title="Torque of the left mesh")
    shape = tooth_plot(TOOTH, title="Tooth of the pinion, module 2 mm")
    stiffness = tooth_stiffness(TOOTH) * 1e-9 / TOOTH.face_width
    time = np.linspace(0.0, 2.0, 2001)
    theta = 0.3 * np.sin(np.pi * time)
    k = (drive["k_m"], VARIATION * drive["k_m"], drive["z_3"])
    speed = 0.3 * np.pi * np.cos(np.pi * time)
    laws = {
        "cos(z3 θ3), corrected": [mesh_stiffness(*k, x) for x in theta],
        "cos(ω_z t), as printed": [
            mesh_stiffness(*k, x, as_printed=(t, v))
            for x, t, v in zip(theta, time, speed, strict=True)
        ],
    }
    phase = mesh_phase_plot(time, theta, laws, title="Mesh stiffness of a swinging pinion")
    return [
        Picture(
            "dead_zone",
            "Dead zone with contact damping",
            zone[0],
            "Eq. 21 put right. At rest it is the classical dead zone; on the way in, contact "
            "damping adds a step, on the way out the teeth part before the flank: they never pull.",
            "Fig. 11, Eq. 21",
        ),
        Picture(
            "tooth_shape",
            "Tooth as a cantilever",
            shape,
            "Involute of a standard rack, force on the pitch circle. Module and width are ours.",
            "Fig. 12, Eq. 22",
            here=f"{stiffness:.0f} N/(µm·mm) by Eq. 22",
        ),
        Picture(
            "mesh_phase",
            "Stiffness by mesh phase",
            phase[0],
            f"k_a = {VARIATION:g} k_m for the picture: the paper prints none. With ω_z t a pinion "
            "that comes back to a place finds another stiffness there.",
            "Eq. 23",
            "cos(ω_z t + φ)",
            "cos(z3 θ3 + φ)",
        ),
    ]
