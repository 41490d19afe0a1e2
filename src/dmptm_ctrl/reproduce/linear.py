"""Section 2: linear models, resonances, what the simplification costs; section 3: the tooth."""

import numpy as np

from dmptm_ctrl.control import close_speed_loop, common_mode, tune_pi
from dmptm_ctrl.drive import (
    ERRATA,
    Tooth,
    iso_single_stiffness,
    mesh_damping,
    mesh_damping_ratio,
    mesh_torsion,
    nine_dof_parameters,
    nine_dof_ss,
    nine_dof_train,
    pair_stiffness,
    pinion_inertia,
    rigid_equivalent,
    simplification_cost,
    solve_modes,
    three_dof_ss,
    three_dof_train,
)
from dmptm_ctrl.plots.linear import bode_compare, simplification_plot, step_compare
from dmptm_ctrl.plots.paper import convergence_plot
from dmptm_ctrl.reproduce.items import DEG, RIG_LOOP, Context, Item, Picture, Table
from dmptm_ctrl.reproduce.resonances import OURS

ZETA = (0.03, 0.17)  # below Eq. 24
GENTLE_HZ, GENTLE_MARGIN = 2.0, 60.0  # stable on the 9-DOF model too


def errata(context: Context) -> list[Item]:
    """List what the paper misprints."""
    rows = [(e.where, e.printed, e.corrected, e.proof) for e in ERRATA.values()]
    caption = "Corrected by default, as printed on request. Proofs: docs/errata.md, tests/drive."
    table = Table("errata", "Errata", ("where", "printed", "corrected", "why"), rows, caption)
    return [table._replace(here=f"{len(rows)} corrections")]


def convergence(context: Context) -> list[Item]:
    """The 9-DOF's low modes go to the 3-DOF's, with the corrected J̄3 only."""
    p = nine_dof_parameters(context.drive, J_1=1e-4)
    softness = np.geomspace(1.0, 1e-4, 9)
    right = solve_modes(three_dof_train(rigid_equivalent(context.drive, p))).omega[1:]
    printed = context.drive.with_values(J_2=p["J_1"] + p["J_2"] + p["J_3"])
    wrong = solve_modes(three_dof_train(printed)).omega[1:]
    low = []
    for soft in softness:
        stiff = {k: p[k] / soft for k in ("K_01", "K_12", "K_23")}
        low.append(solve_modes(nine_dof_train(context.drive, **{**p, **stiff})).omega[1:3])
    found = np.array(low)
    errors = {
        "antisymmetric, J̄3 corrected": abs(found[:, 0] / right[0] - 1),
        "symmetric, J̄3 corrected": abs(found[:, 1] / right[1] - 1),
        "antisymmetric, J̄3 as printed": abs(found[:, 0] / wrong[0] - 1),
    }
    panel = convergence_plot(softness, errors, title="9-DOF against 3-DOF model")
    first, last = errors["antisymmetric, J̄3 corrected"][[-2, -1]]
    order = np.log(last / first) / np.log(softness[-1] / softness[-2])
    caption = (
        "As K01, K12, K23 grow, the modes meet at first order in compliance. With J̄3 as "
        "printed below Eq. 16 they never do (drawn with J1 = 1e-4 kg·m², which shows it)."
    )
    here = f"order {order:.2f} with N1² (Jm + J1)"
    title = "From 9 to 3 degrees of freedom"
    return [Picture("convergence", title, panel, caption, "Eq. 16", ERRATA["J3_bar"].printed, here)]


def simplification(context: Context) -> list[Item]:
    """H∞ and H2 of the error beside a balanced truncation."""
    cost = simplification_cost(context.drive)
    names = {"full": "9-DOF model itself", "three_dof": "3-DOF", "balanced": "balanced truncation"}
    rows = [(n, f"{cost.h_inf[k]:.4g}", f"{cost.h_2[k]:.4g}") for k, n in names.items()]
    caption = (
        "Errors against the 9-DOF model from both voltages to the speeds of ring gear and motors "
        f"(the latter divided by N1 N2). {OURS}"
    )
    return [
        Table(
            "simplification",
            "What the simplification costs",
            ("model", "H∞ [(rad/s)/V]", "H2 [(rad/s)/V √(rad/s)]"),
            rows,
            caption,
            here=f"H∞ {cost.h_inf['three_dof']:.3g}, balanced {cost.h_inf['balanced']:.3g}",
        ),
        Picture("simplification_error", "The same over frequency", simplification_plot(cost), OURS),
    ]


def bode_and_step(context: Context) -> list[Item]:
    """9-DOF, 3-DOF and existing model, open and closed loop."""
    existing = context.validation[1]["existing"][0]
    plants = {
        "9-DOF": nine_dof_ss(context.drive),
        "3-DOF": three_dof_ss(context.drive),
        "existing": three_dof_ss(existing),
    }
    gains = tune_pi(plants["3-DOF"], GENTLE_HZ, GENTLE_MARGIN)
    opened = {n: common_mode(p) for n, p in plants.items()}
    closed = {
        n: close_speed_loop(p, gains.kp, gains.ki)["omega_L", "ref"] for n, p in plants.items()
    }
    said = f"kp = {gains.kp * DEG:.3g} V s/deg, ki = {gains.ki * DEG:.3g} V/deg"
    baseline = (
        "The existing model is the one fitted for Tables 3 and 4: with Table 2's viscous friction "
        "alone it would be the 3-DOF model."
    )
    rig = close_speed_loop(plants["9-DOF"], RIG_LOOP.kp, RIG_LOOP.ki).poles()
    worst = rig[rig.real.argmax()]
    warning = ""
    if worst.real > 0.0:
        warning = (
            f" With the rig's kp = {RIG_LOOP.kp * DEG:g} V s/deg the 9-DOF loop would be unstable "
            f"at {abs(worst) / (2 * np.pi):.0f} Hz, which the 3-DOF model cannot show."
        )
    tuned = f"Gains for {GENTLE_HZ:g} Hz and {GENTLE_MARGIN:g}° on the 3-DOF model: {said}."
    bode = bode_compare(opened, title="Common voltage to ring-gear speed [(rad/s)/V]")
    loop = bode_compare(closed, title="Setpoint to ring-gear speed")
    step = step_compare(
        opened, 2.0, height=0.6, scale=1 / DEG, unit="speed [deg/s]", title="Step of 0.6 V"
    )
    turn = step_compare(
        closed, 2.0, height=10.0, unit="speed [deg/s]", title="Setpoint step of 10 deg/s"
    )
    linear = f"Linear models: no dry friction. {baseline}"
    return [
        Picture("bode_open", "Bode plot, open loop", bode.axes[0, 0], f"{baseline} {OURS}"),
        Picture(
            "bode_closed", "Bode plot, closed loop", loop.axes[0, 0], f"{tuned} {OURS}{warning}"
        ),
        Picture("step_open", "Step response, open loop", step.axes[0, 0], linear),
        Picture("step_closed", "Step response, closed loop", turn.axes[0, 0], tuned),
    ]


def tooth(context: Context) -> list[Item]:
    """Eq. 22 against ISO 6336, Eq. 24 against Table 1."""
    drive = context.drive
    width, module = 0.010, 0.002
    pair = [Tooth(module, drive["z_3"], width), Tooth(module, drive["z_3"] * drive["N_2"], width)]
    per_width = 1e-9 / width  # N/m to N/(µm·mm)
    eq22, complete = pair_stiffness(*pair), pair_stiffness(*pair, complete=True)
    iso = iso_single_stiffness(pair[0].teeth, pair[1].teeth, width)
    torsion = mesh_torsion(iso, pair[0].pitch_radius)
    rows = [
        ("Eq. 22, both teeth [N/(µm·mm)]", f"{eq22 * per_width:.1f}", "not printed"),
        ("with shear, foundation, contact [N/(µm·mm)]", f"{complete * per_width:.1f}", ""),
        ("ISO 6336-1, c'th [N/(µm·mm)]", f"{iso * per_width:.1f}", ""),
        (
            "face width for k_m, module 2 mm, by c'th [mm]",
            f"{1e3 * width * drive['k_m'] / torsion:.1f}",
            "",
        ),
    ]
    args = (drive["k_m"], pinion_inertia(drive), drive["J_L"], drive["N_2"])
    rows += [
        (f"Eq. 24 corrected, c at ζ = {z:g} [N·m·s/rad]", f"{mesh_damping(z, *args):.2f}", "1")
        for z in ZETA
    ]
    ratio = mesh_damping_ratio(1.0, *args)
    rows.append(("ζ of Table 1's c = 1", f"{ratio:.4f}", "0.03 … 0.17"))
    caption = (
        "Eq. 22 knows the tooth's bending only and is about five times too stiff. Table 1's c "
        "lies outside the paper's own range of ζ."
    )
    header = ("quantity", "here", "paper")
    return [
        Table(
            "tooth",
            "Tooth stiffness and mesh damping",
            header,
            rows,
            caption,
            "Eqs. 22, 24; Table 1",
            "c = 1 N·m·s/rad, ζ = 0.03 … 0.17",
            f"c = 1 is ζ = {ratio:.4f}; ζ = 0.03 is c = {mesh_damping(ZETA[0], *args):.2f}",
        )
    ]
