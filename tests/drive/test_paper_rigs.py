"""The paper's models as rig files: linear, and the nine bodies with gaps and friction."""

import numpy as np
import pytest

from dmptm_ctrl import data
from dmptm_ctrl.drive import baseline_drive
from dmptm_ctrl.drive.modes import solve_modes
from dmptm_ctrl.drive.nine_dof import nine_dof_train
from dmptm_ctrl.drive.rigfile import load_rig
from dmptm_ctrl.simulate.compiled import Loop, close_loop, rest
from dmptm_ctrl.simulate.compiled import march as march_dual
from dmptm_ctrl.simulate.linear import linearize, modes
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.reference import run_exactly
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 1e-3
SHAFTS = ("motor_left", "motor_right", "bevel_left", "bevel_right", "pinion_left", "pinion_right")


@pytest.fixture(scope="module")
def nine():
    return RigModel(load_rig(data.PAPER_9DOF))


@pytest.fixture(scope="module")
def three():
    return RigModel(load_rig(data.PAPER_RIG))


def stiffer(model, factor):
    """The nine bodies with stiffer shafts, their damping ratios kept."""
    values = {f"link.{s}.stiffness": factor * model.value(f"link.{s}.stiffness") for s in SHAFTS}
    for s in ("left", "right"):
        key = f"link.bevel_{s}.damping"
        values[key] = np.sqrt(factor) * model.value(key)
    return model.with_values(values)


def test_modes_are_those_of_the_matrices_put_together_from_the_paper(nine):
    known = solve_modes(nine_dof_train()).omega / (2 * np.pi)
    assert modes(nine).hz == pytest.approx(known, rel=1e-9, abs=1e-3)


def test_modes_go_to_those_of_three_bodies_as_shafts_stiffen(nine, three):
    """Springs in series: what is left of them falls with the inverse of the factor."""
    limit = modes(three).hz[1:]
    apart = [np.abs(modes(stiffer(nine, f)).hz[1:3] / limit - 1.0).max() for f in (1e2, 1e3)]
    assert apart[1] < 2e-3
    assert apart[0] / apart[1] == pytest.approx(10.0, rel=0.1)


def test_nine_bodies_with_gaps_and_friction_are_the_reference(nine):
    """A reversal through both gaps."""
    t = DT * np.arange(51)
    push = 2.4 * np.cos(2 * np.pi * 20.0 * t)
    u = np.array([push, 0.5 - push])
    plant, layout = nine.plant(), nine.layout
    zero = np.zeros(layout.coordinates)
    exact = run_exactly(plant, u, zero, zero, DT, rtol=1e-7)
    g = layout.coordinate["ring_gear"]
    true = layout.ratio["ring_gear"] * exact.v[:, g]
    twist = exact.links[:, layout.links.index("left")]
    assert twist.max() > 10.0
    assert twist.min() < 0.0
    errors = []
    for substeps in (32, 128):
        found = march(nine, u, DT, substeps=substeps).speed("ring_gear")
        errors.append(np.sqrt(np.mean((found - true) ** 2)) / np.ptp(true))
    assert errors[1] < 1e-3
    assert errors[1] < 0.5 * errors[0]  # first order through impacts


def test_under_its_speed_loop_it_does_what_three_bodies_do(nine):
    """Slow against the shafts: their wind-up changes the speed little."""
    per_degree = 180.0 / np.pi
    loop = Loop(0.08 * per_degree, 1.5 * per_degree, 10.0, 0.5, -0.5)
    t = DT * np.arange(1000)
    target = np.deg2rad(10.0) * np.sin(2 * np.pi * t)
    u = np.zeros((2, t.size))
    run = march(nine, u, DT, substeps=24, controller=loop.controller(), reference=target)
    _, known = close_loop(Model(), loop, target, DT)
    apart = np.sqrt(np.mean((run.speed("ring_gear") - known[:, 1]) ** 2))
    assert apart < 0.05 * np.abs(known[:, 1]).max()


def test_linear_model_of_nine_bodies_is_that_of_three_at_low_frequency(nine, three):
    """Below all shafts; friction of the file is the mean of both directions in both."""
    for hertz in (0.5, 3.0):
        s = 2j * np.pi * hertz
        assert linearize(nine)(s) == pytest.approx(linearize(three)(s), rel=0.02)


def test_the_three_inertia_model_as_a_file_is_the_built_in_one():
    """The same motion through gaps; the file's coordinates are the motors."""
    t = DT * np.arange(600)
    push = 0.9 * np.sin(2 * np.pi * 3.0 * t)
    u = np.array([push + 0.2, push - 0.2])
    built_in = Model(baseline_drive())
    one = march_dual(built_in, u, rest(built_in, 0.0), DT)[:, 1]
    other = march(RigModel(load_rig(data.BASELINE)), u, DT, substeps=8).speed("ring_gear")
    assert np.abs(one).max() > 0.05
    assert np.abs(other - one).max() < 1e-6 * np.abs(one).max()
