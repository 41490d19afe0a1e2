"""The contact law of a gap as a key of the rig file."""

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.linear import modes
from dmptm_ctrl.simulate.reference import run_exactly
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 1e-3  # s
NEAR = 4e-4  # of the largest speed: what 32 substeps leave
PUSH = np.where(np.arange(120) < 60, 1.0, -1.5)


def geared(contact, damping):
    return f"""
[body.motor]
inertia = 0.01
viscous = 0.05
[body.load]
inertia = 0.02
viscous = 0.02
[mesh.gears]
between = ["motor", "load"]
stiffness = 300
damping = {damping}
backlash = 0.004
gap_damping = 0.2
{contact}
[input.m]
column = "u_V"
body = "motor"
gain = "0.5 N m/V"
[sensor.w]
column = "w_rad_s"
body = "load"
"""


LAWS = {
    "eq21": geared('contact = "eq21"', 1),
    "two_state": geared('contact = "two_state"', 1),
    "impact": geared('contact = "impact"', '"2 s/rad"'),
}


def exact(model):
    return run_exactly(model.plant(), PUSH[None], [0.0, 0.0], [0.0, 0.0], DT).v


@pytest.mark.parametrize("law", LAWS)
def test_compiled_run_is_the_reference(law):
    model = RigModel(parse_rig(LAWS[law]))
    known = exact(model)[:, 1]
    run = march(model, PUSH[None], DT, substeps=32)
    assert np.abs(run.speed("load") - known).max() < NEAR * np.abs(known).max()


def test_laws_differ_and_the_default_is_the_papers():
    runs = {law: exact(RigModel(parse_rig(text)))[:, 1] for law, text in LAWS.items()}
    plain = exact(RigModel(parse_rig(geared("", 1))))[:, 1]
    np.testing.assert_array_equal(plain, runs["eq21"])
    scale = np.abs(plain).max()
    for law in ("two_state", "impact"):
        assert np.abs(runs[law] - plain).max() > 5 * NEAR * scale, law


def test_place_in_the_gap_is_a_state_of_the_block():
    blocks = to_blocks(RigModel(parse_rig(LAWS["two_state"])))
    assert "link_gears_position" in blocks.state_labels


def test_modes_do_not_depend_on_the_law():
    found = [modes(parse_rig(text)).hz for text in LAWS.values()]
    by_hand = np.sqrt(300 * (1 / 0.01 + 1 / 0.02)) / (2 * np.pi)
    for hertz in found:
        assert hertz[1] == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (geared('contact = "hertz"', 0.3), "contact of a gap is one of eq21, two_state, impact"),
        (LAWS["eq21"].replace("backlash = 0.004\n", ""), "contact of a gap is one of"),
        (geared('contact = "impact"', '"2 N m s/rad"'), "another quantity than s/rad"),
    ],
)
def test_others_are_refused(text, said):
    with pytest.raises(LogError, match=said):
        parse_rig(text)


def test_two_states_need_damping():
    text = LAWS["two_state"].replace("damping = 1\n", "damping = 0\n")
    model = RigModel(parse_rig(text.replace("gap_damping = 0.2", "gap_damping = 0")))
    with pytest.raises(ValueError, match="gears: the two-state contact needs damping"):
        model.plant()
