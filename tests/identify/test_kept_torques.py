"""Torques of springs are kept along measured motion; whatever changes them makes them anew."""

from dataclasses import replace

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.forces import forces_of
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.measured_motion import NONE, Nuisance
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

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
