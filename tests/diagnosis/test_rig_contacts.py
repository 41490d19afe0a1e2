"""Evidence for gaps, meshes and detents of drives by rig.toml, simulated by other means."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import logs_of
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.rig_diagnose import _no_gap, diagnose_rig, split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.drive.rig_dual import paper_rig
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.following import touching
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march


def geared(gap, unknown=False):
    """A gear with the load behind it; the motor's encoder sees it alone."""
    machine = Machine(
        gain=1.0, emf=0.0, j1=2e-4, j2=0.013, ratio=10.0, k=0.4, c=1e-4, gap=gap, fc=5e-3,
        fc2=0.04, b1=2e-4, b2=0.02,
    )  # fmt: skip
    kinds = (("multisine", 0.04), ("sine", 0.02), ("steps", 0.03))
    bench = Bench(machine, kinds, 3.0, 2e-3, counts=65536, sensors=("position",))
    text = bench.rig().replace('"unknown"', '"0.013 kg m^2 ± 20 %"', 2)
    text = text.replace('viscous = "0.013 kg m^2 ± 20 %"', 'viscous = "unknown"', 1)
    text = text.replace("± 40 %", "± 10 %").replace("shaft.coupling", "mesh.coupling")
    text = text.replace("viscous =", 'coulomb = "unknown"\nviscous =')
    if unknown:
        text = text.replace("[mesh.coupling]", '[mesh.coupling]\nbacklash = "unknown"')
    rig = parse_rig(text, "rig.toml")
    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig)))
    evidence = RigEvidence(logs, held, 1)
    return evidence, evidence.base(State(rough_start(RigModel(rig), logs)))


@pytest.mark.long
@pytest.mark.parametrize("unknown", [False, True])
def test_a_gap_before_a_load_that_nothing_measures(unknown):
    """A soft spring is the nearest thing; the gap is found beside the stiff one.

    As well where the rig file says that there is one of unknown size.
    """
    evidence, base = geared(0.03, unknown)
    assert len([*_no_gap(base.fit.model)]) == unknown
    assert base.fit.values["link.coupling.stiffness"] < 0.36  # soft by the gap
    found = evidence.candidates(base, ["backlash@coupling"])
    best = max((c for c in found if c.acceptable), key=lambda c: c.evidence)
    fit = evidence.adopt(base, best).fit
    assert fit.values["backlash@coupling.half_gap"] == pytest.approx(0.03, rel=0.1)
    assert fit.values["link.coupling.stiffness"] == pytest.approx(0.4, rel=0.1)
    assert not [*_no_gap(fit.model)]


@pytest.mark.long
def test_a_weight_behind_a_gear_is_found_by_the_motor_alone():
    """A wave of one turn of the load; at the motor it would be a spring, over this travel."""
    machine = Machine(
        gain=1.0, emf=0.0, j1=2e-4, j2=0.013, ratio=10.0, k=40.0, c=0.01, fc=5e-3, b1=2e-4, b2=0.02,
    )  # fmt: skip
    kinds = (("multisine", 0.2), ("sine", 0.1), ("steps", 0.06))
    bench = Bench(machine, kinds, 3.0, 2e-3, counts=65536, sensors=("position",))
    text = bench.rig().replace("± 40 %", "± 10 %").replace("shaft.coupling", "mesh.coupling")
    text = text.replace('"unknown"', '"0.013 kg m^2 ± 20 %"', 2)
    text = text.replace('viscous = "0.013 kg m^2 ± 20 %"', 'viscous = "unknown"', 1)
    text = text.replace("viscous =", 'coulomb = "unknown"\nviscous =', 1)
    rig = parse_rig(text.replace('stiffness = "unknown"', 'stiffness = "rigid"'), "rig.toml")
    weight = 0.3  # N·m at the load

    def with_weight(log):
        turn = log["out_position"] / 10.0
        more = weight / 10.0 * np.sin(turn)
        return Log(log.name, log.time, {**log.channels, "in_drive": log["in_drive"] + more})

    logs = [with_weight(log) for log in logs_of(bench, rig)]
    found = diagnose_rig(logs, rig, jobs=1)
    (effect,) = found.effects
    assert (effect.name, effect.location) == ("unbalance", "load")
    assert abs(effect.parameters["sine"]["value"]) == pytest.approx(weight, rel=0.05)


@pytest.mark.long
def test_no_gap_before_a_load_that_nothing_measures():
    evidence, base = geared(0.0)
    assert base.fit.values["link.coupling.stiffness"] == pytest.approx(0.4, rel=0.05)
    found = evidence.candidates(base, ["backlash@coupling"])
    assert all(c.evidence < LEVEL or not c.acceptable for c in found)


@pytest.mark.parametrize("gap", [0.0, 0.028])
def test_a_gap_between_coarse_encoders(gap):
    """Rounding by 1.5 mrad hides how far a gear winds up, not that it has a gap of 28 mrad."""
    machine = Machine(
        gain=0.01, emf=0.0, j1=8e-5, j2=0.08, ratio=30.0, k=8.0, c=2e-3, gap=gap, fc=6.5e-3,
        b1=6e-4, b2=0.2, bristle=1e-3,
    )  # fmt: skip
    kinds = (("steps", 6.0), ("sine", 4.0), ("chirp", 3.0), ("steps", 4.0))
    bench = Bench(machine, kinds, 8.0, 2e-3, counts=65536, sensors=("position", "position2"))
    text = bench.rig().replace('inertia = "unknown"', 'inertia = "0.08 kg m^2 ± 20 %"')
    text = text.replace("viscous =", 'coulomb = "6.5e-3 N m ± 30 %"\nviscous =', 1)
    rig = parse_rig(re.sub(r"(\[sensor.*\])", r"\1\nabsolute = true", text), "rig.toml")

    def read(name, y):
        return 1.5e-3 * np.round(y / 1.5e-3) if name == "q" else y

    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig, read)))
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig), logs)))
    found = [c for c in evidence.candidates(base, ["backlash@coupling"]) if c.acceptable]
    assert len(found) == (gap > 0.0)
    for one in found:
        half = evidence.adopt(base, one).fit.values["backlash@coupling.half_gap"]
        assert half == pytest.approx(gap, rel=0.1)
        # a twist that wanders in the gap correlates; what is left beside the gap does less
        before, after = (fit.likelihood.independent for fit in (base.fit, one.fitted[1]))
        assert after[1] > 1.5 * before[1]


GEARED = Machine(
    gain=1.0, emf=0.0, j1=2e-3, j2=0.2, ratio=4.0, k=300.0, c=0.3, gap=6e-3, fc=0.05, b1=0.01,
    fc2=0.2, b2=0.1,
)  # fmt: skip
MESH = {
    "pinion_runout": {"runout": 5e-4},
    "ring_gear_eccentricity": {"eccentric": 5e-4},
    "mesh_error": {"tooth": 3e-4},
    "backlash_variation": {"tight": 2e-3},
    "stiffness_variation": {"uneven": 0.3},
}


@pytest.mark.parametrize("name", ["pinion_runout", "mesh_error", "backlash_variation"])
def test_errors_of_a_mesh_between_two_encoders(name):
    machine = replace(GEARED, **MESH[name])
    kinds = (("steps", 0.9), ("sine", 0.7), ("steps", 0.6))
    bench = Bench(machine, kinds, 5.0, 2e-3, counts=2**20, sensors=("position", "position2"))
    text = bench.rig().replace("shaft.coupling", "mesh.coupling")
    text = text.replace('inertia = "unknown"', 'inertia = "0.2 kg m^2 ± 10 %"')
    text = text.replace('stiffness = "unknown"', 'stiffness = "300 N m/rad ± 10 %"\n'
        'damping = "0.3 N m s/rad ± 20 %"\nhalf_gap = "6 mrad ± 10 %"')  # fmt: skip
    for coulomb, viscous in ((0.05, 0.01), (0.2, 0.1)):
        own = f'coulomb = "{coulomb} N m ± 12 %"\nviscous = "{viscous} N m s/rad ± 20 %"'
        text = text.replace('viscous = "unknown"', own, 1)
    text = re.sub(r"(\[sensor.*\])", r"\1\nabsolute = true", text)
    rig = parse_rig(text, "rig.toml")
    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig)))
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig), logs)))
    key = f"{name}@coupling"
    alike = [f"{other}@coupling" for other in MESH if other != name]
    (one,), others = (evidence.candidates(base, keys) for keys in ([key], alike))
    assert one.gain > LEVEL
    assert one.held_gain > LEVEL
    assert not one.objection
    assert one.evidence > max(c.evidence for c in others)
    if name == "backlash_variation":
        assert one.fitted[1].model.effect(key).values["order"] == 1.0
    true, share = next(iter(MESH[name].values())), 300.0 if name == "stiffness_variation" else 1.0
    found = one.fitted[1].values
    assert np.hypot(found[f"{key}.cosine"], found[f"{key}.sine"]) == pytest.approx(
        true * share, rel=0.2
    )


def test_a_better_model_tells_anew_when_hidden_teeth_touch():
    """A cable pulls the ring back through the gaps; without it the declared model runs on."""
    rig = paper_rig()
    cable = Placed("cable_spring", "ring_gear", {"stiffness": 300.0, "offset": 0.0})
    time = 1e-3 * np.arange(6000)
    wave = 1.2 * np.sin(2 * np.pi * 0.4 * time)
    true = RigModel(rig).with_effect(cable)
    run = march(true, np.array([wave, 0.8 * wave]), 1e-3)
    channels = {"in_left": wave, "in_right": 0.8 * wave}
    channels |= {"out_encoder": run.reading("encoder"), "out_gyro": run.reading("gyro")}
    log = Log("turns", time, channels)
    whole = balance_of(rig, [log])
    declared, right = (touching(whole, model, [log]) for model in (RigModel(rig), true))
    model = RigModel(rig, closed=whole.closed)
    evidence = RigEvidence(declared, declared, 1, [log])
    base = evidence.base(State(model))
    better = evidence.base(State(model.with_effect(cable)))
    reported = [
        np.mean(state.logs.motions[0].open_links != right.motions[0].open_links)
        for state in (base, evidence.closed(better))
    ]
    assert reported[1] < 0.1 * reported[0]


def test_runs_through_impacts_are_compared_by_what_is_expected():
    """A hundred-millionth of a gap moves a single run; the mean of nine moves a third as much."""
    machine = Machine(
        gain=1.0, emf=0.0, j1=2e-4, j2=0.013, ratio=10.0, k=40.0, c=2e-3, gap=0.03, fc=5e-3,
        fc2=0.04, b1=2e-4, b2=0.02,
    )  # fmt: skip
    kinds = ("multisine", 0.1), ("chirp", 0.1)
    bench = Bench(machine, kinds, 8.0, 2e-3, counts=65536, sensors=("position",))
    model = RigModel(parse_rig(bench.rig().replace("shaft.coupling", "mesh.coupling"), "rig.toml"))
    known = {"motor.inertia": 2e-4, "motor.viscous": 2e-4, "load.inertia": 0.013}
    known = {f"body.{key}": value for key, value in known.items()} | {"body.load.viscous": 0.02}
    model = model.with_values(
        {**known, "link.coupling.stiffness": 40.0, "link.coupling.damping": 2e-3}
    )
    for body, level in (("motor", 5e-3), ("load", 0.04)):
        model = model.with_effect(Placed("coulomb_friction", body, {"level": level}))
    logs = logs_of(bench, model.rig)
    runs = Runs.none_yet(model.rig, logs, balance_of(model.rig, logs).part("held-out"), 1)

    def missed(share):
        gap = {"half_gap": 0.03 * (1.0 + share)}
        state = State(model.with_effect(Placed("backlash", "coupling", gap)))
        return runs.agreement(runs.run(state))["rmse"], runs.missed(state)

    single, expected = np.transpose([missed(k * 1e-8) for k in range(12)])
    assert np.std(single) > 0.03 * np.mean(single)
    assert np.std(expected) < 0.75 * np.std(single)
    smooth = State(model)
    assert runs.missed(smooth) == runs.agreement(runs.run(smooth))["rmse"]


def test_runs_between_detents_are_compared_by_what_is_expected():
    """Which tooth holds a motor where it turns back is chance, in the last digit of the cogging."""
    bench = Bench(Machine(fc=0.03, cog=0.05, order=24.0), (("sine", 3.0),), 10.0, 2e-3)
    rig = parse_rig(bench.rig(), "rig.toml")
    model = RigModel(rig).with_values({"body.motor.viscous": 3e-4})
    model = model.with_effect(Placed("coulomb_friction", "motor", {"level": 0.03}))
    logs = logs_of(bench, rig)
    runs = Runs.none_yet(rig, logs, balance_of(rig, logs).part("held-out"), 1)

    def missed(share):
        wave = {"cosine": 0.05 * (1.0 + share), "sine": 0.0, "order": 24.0}
        state = State(model.with_effect(Placed("cogging", "motor", wave)))
        return runs.agreement(runs.run(state))["rmse"], runs.missed(state)

    single, expected = np.transpose([missed(k * 1e-8) for k in range(12)])
    assert np.std(single) > 1e-3 * np.mean(single)
    assert np.std(expected) < 0.75 * np.std(single)
