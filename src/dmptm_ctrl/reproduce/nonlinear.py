"""Section 3: backlash and friction; section 4.2: parameters from experiments; PI tuning."""

import numpy as np

from dmptm_ctrl.control import tune_pi
from dmptm_ctrl.drive import three_dof_ss
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law
from dmptm_ctrl.identify.experiments import Estimate
from dmptm_ctrl.identify.experiments_breakaway import reducer_breakaway, ring_breakaway
from dmptm_ctrl.identify.experiments_contact import gap_damping
from dmptm_ctrl.identify.experiments_dynamic import shaken_turns
from dmptm_ctrl.identify.experiments_rig import ramp, shaken_turn, staircase, taps
from dmptm_ctrl.identify.experiments_steady import FrictionPoints, constant_speed, stribeck_fit
from dmptm_ctrl.plots.paper import friction_plot, mesh_path_plot
from dmptm_ctrl.plots.style import SEQUENCE, axes
from dmptm_ctrl.reproduce.items import DEG, Context, Item, Picture, Table
from dmptm_ctrl.reproduce.parts import PER_UNIT, PRINTED_UNIT
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.loop_check import check_loop
from dmptm_ctrl.simulate.mesh_path import along_path
from dmptm_ctrl.simulate.model import Model

CHATTER_HZ, CHATTER = 231.0, 1e-4  # Hz, rad: the symmetric mode, as after a reversal
LIFT = 0.3  # of the chatter: how deep the flank is touched on average
SPEEDS = np.array([0.06, 0.12, 0.25, 0.5, 1, 2, 4, 8, 16, 30]) * DEG  # rad/s of the ring gear
PRELOADS = (0.6, -0.6, 1.2)  # V
LINES = np.unique(np.round(np.geomspace(2, 260, 24) * 4) / 4).tolist()  # Hz
PERIOD = 4.0  # s
SEED = 1


def two_laws(context: Context) -> list[Item]:
    """Eq. 21 with its exponent put right, beside the two-state original."""
    drive, omega = context.drive, 2 * np.pi * CHATTER_HZ
    half_gap = drive["gap_l"]
    paths = []
    for c, c_f in ((drive["c"], drive["c_f"]), (10.0, 0.5)):
        law = Backlash(drive["k_m"], c, c_f, half_gap)
        path = along_path(
            lambda t: -half_gap + CHATTER * (np.sin(omega * t) - LIFT),
            lambda t: CHATTER * omega * np.cos(omega * t),
            2 / CHATTER_HZ,
            law,
            position=-half_gap,
        )
        paths.append((f"c = {c:g}, c_f = {c_f:g} N·m·s/rad", path))
    panels = mesh_path_plot(paths, half_gap)
    worst = [np.abs(p.memoryless - p.two_state).max() for _, p in paths]
    caption = (
        "A pinion that chatters at 231 Hz on one flank. Eq. 21 has no memory; it parts from the "
        "two-state original just after release, while the tooth relaxes, and in the moment of "
        f"contact: by {worst[0]:.2g} N·m at the declared damping, by {worst[1]:.2g} N·m for an "
        "instant at the upper bounds of c and c_f."
    )
    return [
        Picture(
            "two_laws",
            "Where Eq. 21 parts from its original",
            panels[0, 0],
            caption,
            "Eq. 21",
            "exponent (z + b)/(ż + k)",
            f"apart by {worst[0]:.1g} N·m at most with the declared c",
        )
    ]


def parameters(context: Context) -> list[Item]:
    """Every experiment of section 4.2 on a rig of known parameters."""
    rng, model, drive = np.random.default_rng(SEED), Model(context.drive), context.drive
    context.say("constant speeds under preload")
    stairs = [staircase(model, [*SPEEDS, *-SPEEDS[::-1]], b, rng) for b in PRELOADS]
    steady = constant_speed(drive, stairs)
    curves = {**stribeck_fit(steady.reducer), **stribeck_fit(steady.ring)}
    context.say("ramps")
    reducers = reducer_breakaway(drive, [ramp(model, r, 0.4, rng) for r in (0.02, -0.02)])
    rings = [ramp(model, r, 0.6, rng, from_flank=True) for r in (0.02, -0.02)]
    static = reducers | ring_breakaway(drive, rings, reducers)
    context.say("shaken turns")
    shaken = [
        shaken_turn(model, LINES, v, rng, differential=d) for d, v in ((False, 0.04), (True, 0.005))
    ]
    dynamic = shaken_turns(drive, shaken, period=PERIOD, lines=LINES)
    context.say("flights through the gaps")
    known = {**curves, **{n: static[n] for n in reducers}, "J_2": dynamic["J_2"]}
    flights = gap_damping(drive, taps(model, (0.45, 0.6, 0.8, 1.0), rng), known)
    found = [
        ("reverse motion under preload", steady.estimates),
        ("constant speeds", {n: e for n, e in curves.items() if n[2] != "s"}),
        ("ramps", static),
        ("frequency response", {n: e for n, e in dynamic.items() if n in drive}),
        ("flights", flights),
    ]
    rows = [
        (how, name, *_said(estimate), f"{drive[name] / PER_UNIT.get(estimate.unit, 1.0):.5g}")
        for how, estimates in found
        for name, estimate in estimates.items()
    ]
    pictures = [
        _friction_picture(steady.reducer, curves, "reducers with motors, at the pinion"),
        _friction_picture(steady.ring, curves, "ring gear"),
    ]
    caption = (
        "One run of each experiment on a simulated rig with the declared parameters and its "
        "sensors' noise and resolution. Of such estimates 95 % lie within two standard errors "
        "(tests/identify/test_experiments.py)."
    )
    header = ("experiment", "parameter", "found ± se", "unit", "true")
    gaps = [steady.estimates[n].value / DEG * 60 for n in ("gap_l", "gap_r")]
    return [
        Table(
            "parameters",
            "Parameters from experiments",
            header,
            rows,
            caption,
            "section 4.2, Tables 1, 2",
            "Δ1 = 14′, Δ2 = 10′, …",
            f"{gaps[0]:.2f}′, {gaps[1]:.2f}′, …: column “true” is the paper's",
        ),
        *pictures,
    ]


def _said(estimate: Estimate) -> tuple[str, str]:
    value, se = (x / PER_UNIT.get(estimate.unit, 1.0) for x in (estimate.value, estimate.se))
    unit = PRINTED_UNIT.get(estimate.unit, estimate.unit)
    text = str(Estimate(value, se, "")).strip()
    return text, unit


def _friction_picture(points: FrictionPoints, fit: dict[str, Estimate], what: str) -> Picture:
    b = points.body
    keys = [f"{n.format(b)}_{s}" for s in ("plus", "minus") for n in ("T{}s", "T{}c", "W{}", "B{}")]
    law = stribeck_law(*(fit[key].value for key in keys), exponent=1.0)  # type: ignore[misc]
    top = np.abs(points.speed).max()
    speed = np.geomspace(np.abs(points.speed).min(), top, 200)
    speed = np.concatenate([-speed[::-1], speed])
    torque = np.array([np.sign(w) * sliding_torque(w, np.sign(w), law) for w in speed])
    panel = friction_plot(points.speed, points.torque, points.se, (speed, torque), title=what)
    name = "friction_ring" if b == "L" else "friction_reducers"
    caption = "Dry friction falls from static to Coulomb, then viscous friction takes over."
    title = f"Friction of the {what}"
    return Picture(name, title, panel, caption, "Eq. 25, Table 2")


def tuning(context: Context) -> list[Item]:
    """PI gains from bandwidth and phase margin, checked on the nonlinear drive."""
    plant = three_dof_ss(context.drive)
    rows, runs = [], {}
    for hz, margin in ((2.0, 60.0), (5.0, 60.0), (5.0, 75.0), (20.0, 60.0)):
        gains = tune_pi(plant, hz, margin)
        loop = Loop(gains.kp, gains.ki, 10.0)
        for speed in (1.0, 10.0):
            check = check_loop(Model(context.drive), loop, speed * DEG)
            cycle = "excluded"
            if check.limit_cycle_amplitude > 0.0:
                amplitude = check.limit_cycle_amplitude / DEG
                cycle = f"{amplitude:.2g} deg/s at {check.limit_cycle_hz:.3g} Hz"
            settles = np.isfinite(check.settling_time)
            rows.append(
                (
                    f"{hz:g} Hz, {margin:g}°",
                    f"{gains.kp * DEG:.4g}",
                    f"{gains.ki * DEG:.4g}",
                    f"{gains.gain_margin_db:.1f}",
                    f"{speed:g}",
                    f"{100 * check.overshoot:.0f}",
                    f"{check.settling_time:.2f}" if settles else "never",
                    cycle,
                )
            )
            if speed == 10.0 and margin == 60.0:
                runs[f"{hz:g} Hz, {margin:g}°"] = check
    panels = axes(None, 2, figsize=(6.5, 5.0), sharex=True)[:, 0]
    for (label, check), style in zip(runs.items(), SEQUENCE, strict=False):
        cycles = check.limit_cycle_amplitude > 0.0
        look = {**style, "linewidth": 0.6, "linestyle": "-"} if cycles else style
        panels[int(cycles)].plot(check.time, check.omega_L / DEG, label=label, **look)
    for panel in panels:
        panel.set(ylabel="speed [deg/s]", xlim=(0, 1.5))
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    panels[0].set_title("Setpoint step of 10 deg/s on the nonlinear drive")
    panels[1].set_xlabel("time [s]")
    header = (
        *("aim", "kp [V s/deg]", "ki [V/deg]", "gain margin [dB]", "step [deg/s]"),
        *("overshoot [%]", "settling [s]", "limit cycle"),
    )
    caption = (
        "The linear model calls all of these stable. With the gaps in it, the fastest one hammers "
        "from flank to flank after a step of 10 deg/s, and never settles."
    )
    return [
        Table("tuning", "PI tuning", header, rows, caption, here="limit cycle found at 20 Hz, 60°"),
        Picture("tuning_steps", "The same as steps", panels[0], caption),
    ]
