"""The two laws of the flanks: that of Eq. 21 and the one that damps by depth."""

import numpy as np
import pytest

from dmptm_ctrl.design.draws import one_plant
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.fit import drive_unknowns, is_damping, place, position
from dmptm_ctrl.identify.ripple import closed
from dmptm_ctrl.simulate.compiled import OUTPUTS, march
from dmptm_ctrl.simulate.damping import (
    DAMPING,
    FLANKS,
    LOADED,
    OF_FLANKS,
    by_depth,
    damped,
    damping_of,
    possible,
    undamped,
)
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import from_toml, to_toml


def damping_by_depth(model):
    """Flanks that damp by depth, as much as a model's own do when loaded."""
    drive = model.drive
    given = {OF_FLANKS: drive[DAMPING] / LOADED, "ratio": drive["N_2"], "stiffness": drive["k_m"]}
    return Model(undamped(drive), model.effects).with_effect(FLANKS, **given)


EQ21 = Model(paper_drive())
BY_DEPTH = damping_by_depth(EQ21)
DT = 1e-3  # s


def free_ring(model, torque):
    """Angle in the closed meshes over time, of a drive without friction pressed by a torque."""
    none = {k: 0.0 for k in model.drive if k[:2] in ("T3", "TL", "B3", "BL")}
    model = model.with_values(**none, c_f=0.0)
    z = model.drive["gap_l"] + torque / model.drive["k_m"]
    y = model.drive["gap_r"] + torque / model.drive["k_m"]
    x0 = np.array([1.001 * z, -y, 0.0, 0.0, 0.0, 0.0])  # a little deeper on the left
    drive = model.drive
    volts = torque / (drive["N_1"] * drive["K_d"] * drive["K_M"])
    u = np.full((2, 300), volts) * np.array([[1.0], [-1.0]])
    out = march(model, u, x0, DT, substeps=32)
    return out[:, OUTPUTS.index("z_l")] - z


def test_damps_as_the_other_law_does_when_loaded():
    """A small oscillation about the usual torque decays alike; about twice the torque faster."""
    usual, other = (free_ring(m, LOADED) for m in (EQ21, BY_DEPTH))
    assert np.abs(usual - other).max() < 0.03 * np.abs(usual).max()
    twice, linear = (free_ring(m, 2.0 * LOADED) for m in (BY_DEPTH, EQ21))
    assert np.abs(twice[150:]).max() < 0.7 * np.abs(linear[150:]).max()


def test_rings_as_the_flanks_do():
    """Closed form at the first moment: the torque is k d (1 + χ ż) at depth d and rate ż."""
    k, damping = BY_DEPTH.drive["k_m"], damping_of(BY_DEPTH)
    depth, rate = 2e-4, 0.05
    z = BY_DEPTH.drive["gap_l"] + depth
    for sign in (1.0, -1.0):
        x0 = np.array([sign * z, 0.0, 0.0, sign * rate, 0.0, 0.0])
        out = march(BY_DEPTH, np.zeros((2, 2)), x0, DT)
        torque = sign * k * depth * (1.0 + damping * rate)
        assert out[0, OUTPUTS.index("torque_l")] == pytest.approx(torque, rel=1e-12)


def test_no_torque_at_the_touch():
    """Eq. 21 jumps by c ż there."""
    drive, rate = EQ21.drive, 0.2
    z = drive["gap_l"] + drive["c_f"] / drive["k_m"] * rate  # where the gap's transient ends
    x0 = np.array([(1.0 + 1e-9) * z, 0.0, 0.0, rate, 0.0, 0.0])
    first = [march(m, np.zeros((2, 2)), x0, DT)[0, 4] for m in (EQ21, BY_DEPTH)]
    assert OUTPUTS[4] == "torque_l"
    touch = drive["c_f"] * rate  # what that depth presses
    assert first[0] == pytest.approx(touch + rate * drive["c"], rel=1e-3)
    assert first[1] == pytest.approx(touch * (1.0 + damping_of(BY_DEPTH) * rate), rel=1e-3)


def test_the_damping_is_one_unknown_of_either_law():
    names = {}
    for model in (EQ21, BY_DEPTH):
        unknowns = drive_unknowns(model)
        (one,) = (k for k in unknowns if is_damping(k))
        names[model.drive["c"]] = (one.effect, one.name)
        again = place(model, unknowns, position(model, unknowns))
        assert damping_of(again) == pytest.approx(damping_of(model), rel=1e-12)
        assert by_depth(again) is by_depth(model)
        assert len(unknowns) == len(drive_unknowns(EQ21))
        assert damping_of(damped(model, 2.0)) == 2.0
        low, high, declared = possible(model, EQ21.drive)
        assert low < damping_of(model) == pytest.approx(declared, rel=1e-12)
        assert declared < high
    assert names == {3.0: (None, "c"), 0.0: ("flank_damping", "damping")}


def test_a_ripple_meets_the_damping_of_loaded_flanks():
    assert np.frombuffer(closed(EQ21.plant()))[-1] == 3.0
    assert np.frombuffer(closed(BY_DEPTH.plant()))[-1] == pytest.approx(3.0, rel=1e-12)


def test_goes_into_a_file_and_through_draws():
    """What flanks do not have does not come back from a file, nor from a draw of the drive."""
    again = from_toml(to_toml(BY_DEPTH))
    assert again.effects == BY_DEPTH.effects
    drawn = one_plant(again, 1.0, 0, 0)
    assert again.drive["c"] == drawn.drive["c"] == 0.0
    assert drawn.drive["k_m"] != again.drive["k_m"]
