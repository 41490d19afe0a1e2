"""A spring that keeps an inertia from shaking must not look better for what it does not feel."""

import numpy as np
import pytest
from tests.rig_files.truth import Machine

from dmptm_ctrl.diagnosis.impedance import effort, loudness
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig, split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

J, SHARE, ANTI, ZETA, BAND = 0.02, 0.6, 2 * np.pi * 8.0, 0.1, 40.0
ONE = """
[body.arm]
inertia = "0.02 kg m^2"
[input.u]
column = "u"
unit = "N m"
[sensor.near]
column = "q"
unit = "rad"
"""
OTHER = '[sensor.far]\ncolumn = "r"\nunit = "rad"\n'


def balanced(text):
    rig, t = parse_rig(text), 1e-3 * np.arange(4000)
    channels = {"in_u": np.sin(5 * t), "out_near": np.sin(4 * t), "out_far": np.cos(4 * t)}
    channels = {k: channels[k] for k in ("in_u", *(f"out_{s.name}" for s in rig.sensors))}
    units = {"in_u": "N·m", "out_near": "rad", "out_far": "rad"}
    log = Log("run", t, channels, units={k: units[k] for k in channels})
    return rig, balance_of(rig, [log], bandwidth=BAND)


@pytest.mark.parametrize("place", ["near", "far", "both"])
def test_is_the_torque_for_a_motion_by_hand(place):
    """Two inertias and a spring, at 20 000 frequencies."""
    rig, balance = balanced(ONE + OTHER * (place == "both"))
    values = {"share": SHARE, "antiresonance": ANTI, "damping_ratio": ZETA}
    behind = {"near": (), "far": ("near",), "both": ("far",)}[place]
    model = RigModel(rig, (Placed("shaft_compliance", "arm", values, behind),))
    w = 2 * np.pi * BAND * (np.arange(20_000) + 0.5) / 20_000
    one, two = (1 - SHARE) * J, SHARE * J
    spring = two * (ANTI**2 + 2j * ZETA * ANTI * w)
    hand = {
        "near": one + two * spring / (spring - two * w**2),
        "far": two + one * (spring - two * w**2) / spring,
        # torque of both, and the far acceleration that the spring's torque does not explain
        "both": one * (1 - spring / (two * w**2)) - two * spring / (two * w**2),
    }[place]
    expected = np.log(np.abs(hand) / J).mean()
    assert loudness(model, balance) == pytest.approx(expected, abs=0.01)
    assert loudness(RigModel(rig), balance) == 0.0


def test_friction_and_a_cog_that_shakes_at_reversals_are_no_spring():
    """A sine at one frequency: a soft spring to most of the inertia leaves the least torque."""
    t = 1e-3 * np.arange(6000)
    machine = Machine(gain=1.0, emf=0.0, j1=1.9e-4, fc=0.08, b1=1.5e-4, cog=0.2, order=72)
    push = 0.4 * np.sin(4 * np.pi * t)
    q, w, *_ = machine.run(push, 1e-3, start=(0.0, -150.0)).T
    text = ONE.replace('"0.02 kg m^2"', '"unknown"\nviscous = "unknown"')
    rig = parse_rig(text + '[sensor.speed]\ncolumn = "w"\nunit = "rad/s"\n')
    channels = {"in_u": push, "out_near": np.round(q / 6e-4) * 6e-4, "out_speed": w}
    units = {"in_u": "N·m", "out_near": "rad", "out_speed": "rad/s"}
    whole = balance_of(rig, [Log("run", t, channels, units=units)])
    logs, held, _, _ = split(rig, whole)
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig), logs)))
    best = max((c for c in evidence.candidates(base) if c.acceptable), key=lambda c: c.evidence)
    assert best.keys == ("coulomb_friction@arm",)
    # of a sine, as much friction as inertia
    none = "drive_delay@u", "current_lag@u", "shaft_compliance@arm"
    fitted = evidence.candidates(base, none)
    assert {c.keys[0] for c in fitted} == {*none}
    assert all(c.evidence < 0.0 for c in fitted)


def test_effort_is_what_all_bodies_take_of_what_drives_give():
    """A motor of 0.01 kg·m² and a load of 0.04 behind a gear of 2, of a sine clipped at a half."""
    text = ONE.replace('"0.02 kg m^2"', '"0.01 kg m^2"').replace("arm", "motor")
    gear = 'between = ["motor", "load"]\nratio = 2\nstiffness = "rigid"'
    text += f'[body.load]\ninertia = "0.04 kg m^2"\n[shaft.gear]\n{gear}\n'
    text = text.replace("[input.u]", '[input.u]\nbody = "motor"')
    rig, balance = balanced(text.replace("[sensor.near]", '[sensor.near]\nbody = "motor"'))
    model = RigModel(rig)
    assert effort(model, balance) == pytest.approx(np.log(0.01 + 0.04 / 4), abs=1e-3)
    clipped = model.with_effect(Placed("drive_saturation", "u", {"inverse_limit": 2.0}))
    u = np.sin(5e-3 * np.arange(4000))
    share = np.std(np.clip(u, -0.5, 0.5)) / np.std(u)
    assert effort(clipped, balance) == pytest.approx(np.log(0.02 / share), abs=2e-3)


def test_an_amplifier_may_give_less_than_half_of_what_is_asked():
    """It clips at a fifth of the largest command; speeds are exact sums of what it gives."""
    t, limit = 1e-3 * np.arange(8000), 0.2
    ask = np.sin(2 * np.pi * 0.7 * t) * np.sin(2 * np.pi * 3.1 * t)
    speed = np.zeros(t.size)
    for k, give in enumerate(np.clip(ask, -limit, limit)[:-1]):
        steady, keep = give / 0.05, np.exp(-0.05 * 1e-3 / J)
        speed[k + 1] = steady + (speed[k] - steady) * keep
    read = speed + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    text = ONE.replace('"0.02 kg m^2"', '"0.02 kg m^2 ± 20 %"\nviscous = "0.05 N m s/rad ± 20 %"')
    rig = parse_rig(text.replace('"q"', '"w"').replace('unit = "rad"', 'unit = "rad/s"'))
    units = {"in_u": "N·m", "out_near": "rad/s"}
    found = diagnose_rig([Log("run", t, {"in_u": ask, "out_near": read}, units=units)], rig)
    (effect,) = found.effects
    assert (effect.name, found.verdict) == ("drive_saturation", "explained")
    assert 1.0 / effect.parameters["inverse_limit"]["value"] == pytest.approx(limit, rel=0.01)
