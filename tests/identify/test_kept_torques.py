"""Torques of springs are kept along measured motion; whatever changes them makes them anew."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dmptm_ctrl
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.forces import _wound, forces_of, hidden_run, measured_motion
from dmptm_ctrl.identify.inverse_dynamics import balance_of, residual
from dmptm_ctrl.identify.measured_motion import NONE, Nuisance
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

RIG = parse_rig(
    """
[body.motor]
inertia = "0.002 kg m^2"
viscous = "0.01 N m s/rad"
[body.table]
inertia = "0.02 kg m^2"
[shaft.one]
between = ["motor", "table"]
stiffness = "40 N m/rad"
damping = "0.1 N m s/rad"
[input.u]
column = "u"
unit = "N m"
body = "motor"
"""
    + "".join(
        f'[sensor.{body}]\ncolumn = "{body}"\nunit = "rad"\nbody = "{body}"\nabsolute = true\n'
        for body in ("motor", "table")
    ),
    "rig.toml",
)
MODEL = RigModel(RIG)
GAP = Placed("backlash", "one", {"half_gap": 1e-3})


@pytest.fixture(scope="module")
def balance():
    time = 1e-3 * np.arange(3000)
    angles = np.sin(5.0 * time), np.sin(5.0 * time) - 0.01 * np.cos(5.0 * time)
    read = dict(zip(("out_motor", "out_table"), angles, strict=True))
    return balance_of(RIG, [Log("a", time, {"in_u": np.cos(5.0 * time), **read})])


@pytest.mark.parametrize("twist", [0.0, 2e-3])
def test_torque_of_a_spring_between_two_sensors_is_that_of_a_run(balance, twist):
    (motion,) = balance.motions
    nuisance = Nuisance({}, {"one": twist})
    measured, _ = measured_motion(MODEL, balance, motion, nuisance)
    run = hidden_run(MODEL, motion, measured, nuisance).link("one")
    by_twist = _wound(MODEL, motion, measured, nuisance, "one")
    np.testing.assert_allclose(by_twist, run, rtol=0, atol=1e-12 * np.abs(run).max())


@pytest.mark.parametrize(
    ("model", "nuisance", "changes"),
    [
        (MODEL.with_values({"link.one.stiffness": 50.0}), NONE, True),
        (MODEL.with_values({"link.one.damping": 0.5}), NONE, True),
        (MODEL.with_effect(GAP), NONE, True),
        (MODEL, Nuisance({}, {"one": 2e-3}), True),
        (MODEL.with_values({"body.motor.viscous": 0.02}), NONE, False),
    ],
    ids=["stiffness", "damping", "gap", "twist", "friction"],
)
def test_kept_torques_are_those_of_a_run(balance, model, nuisance, changes):
    (motion,) = balance.motions
    before = forces_of(MODEL, balance, motion).left[1]
    kept = forces_of(model, balance, motion, nuisance).left[1]
    anew = forces_of(model, balance, replace(motion, known={}), nuisance).left[1]
    np.testing.assert_array_equal(kept, anew)
    assert np.array_equal(kept, before) == (not changes)
    np.testing.assert_array_equal(forces_of(MODEL, balance, motion).left[1], before)


def test_nothing_is_kept_of_a_motion_that_follows_from_another():
    """The motor's, from the table's through the spring: made anew each time, as the values are."""
    rig = replace(RIG, sensors=tuple(s for s in RIG.sensors if s.body == "table"))
    time = 1e-3 * np.arange(3000)
    log = Log("a", time, {"in_u": np.cos(5.0 * time), "out_table": np.sin(5.0 * time)})
    (motion,) = (balance := balance_of(rig, [log])).motions
    forces_of(RigModel(rig), balance, motion)
    assert "links" not in motion.known


MANY = [
    Placed("cogging", "motor_left", {"order": 6.0, "cosine": 0.01, "sine": 0.02}),
    Placed("current_lag", "left", {"time_constant": 2e-3}),
    Placed("load_dependent_friction", "pinion_left", {"coefficient": 0.05}),
    Placed("mesh_error", "left", {"order": 1.0, "cosine": 1e-4, "sine": 2e-4}),
    Placed("presliding", "ring_gear", {"distance": 1e-4}),
    Placed("thermal_drift", "ring_gear", {"rise": 0.1, "time_constant": 2.0}),
    Placed("unbalance", "ring_gear", {"cosine": 1.0, "sine": 2.0}),
]


@pytest.fixture(scope="module")
def geared():
    """The dual-motor drive with all its bodies measured."""
    text = (Path(dmptm_ctrl.__file__).parent / "data/paper_3dof.toml").read_text()
    seen = "".join(
        f'\n[sensor.{b}]\ncolumn = "{b}_rad"\nbody = "{b}"\n' for b in ("motor_left", "motor_right")
    )
    rig = parse_rig(text + seen, "rig.toml")
    time = 1e-3 * np.arange(4000)
    wave = np.sin(3.0 * time) + 0.3 * np.sin(14.0 * time)
    u = np.array([wave, 0.8 * wave])
    run = march(RigModel(rig), u, 1e-3)
    read = {f"out_{s.name}": run.reading(s.name) for s in rig.sensors}
    return balance_of(rig, [Log("a", time, {"in_left": u[0], "in_right": u[1], **read})])


def numbers(model):
    """Every value that can be changed, of the drive and of its effects."""
    for key, quantity in model.quantities.items():
        if quantity.value:
            yield model.with_values({key: 1.1 * quantity.value})
    for effect in model.effects:
        for name, value in effect.values.items():
            more = effect._replace(values={**effect.values, name: 1.1 * value})
            yield replace(model, effects=tuple(more if e is effect else e for e in model.effects))


def test_kept_results_are_those_made_anew(geared):
    model = RigModel(geared.rig)
    for effect in MANY:
        model = model.with_effect(effect)
    (motion,) = geared.motions
    assert geared.teeth  # both ends of the meshes are measured
    shifted = Nuisance({MANY[0].key: 0.1}, {"left": 1e-3})
    asked = [(one, n) for one in (model, *numbers(model), model) for n in (NONE, shifted)]
    kept = [residual(one, geared, motion, n) for one, n in asked]
    for (one, n), found in zip(asked, kept, strict=True):
        anew = residual(one, geared, replace(motion, known={}), n)
        for a, b in zip(found, anew, strict=True):
            assert np.array_equal(a, b)
    assert len({left.tobytes() for left, _ in kept}) > len(kept) // 2
