"""Pre-sliding told by the first tenth of a second, on rigs of another program with bristles."""

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.at_rest import (
    MATTERS,
    NAME,
    SHARE,
    a_little,
    matters,
    presliding,
    travel,
)
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.decide import decide
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.fit import Fit, position
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")


def left_by_the_drive(seed, effects, friction, sensors="all"):
    """What the declared model leaves on a rig, and the rig's own label."""
    laws = {"friction": friction, "contact": "kelvin_voigt"}
    rig = make_rig(seed, effects, sensors=sensors, logs=LOGS, **laws)
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    return residual(measure(logs, drive), Model(drive)), rig.label["effect_parameters"]


@pytest.mark.parametrize(("sensors", "friction"), [("all", "karnopp"), ("load", "tanh")])
def test_half_of_a_typical_effect(sensors, friction):
    left, true = left_by_the_drive(90100057, ((NAME, 0.5),), friction, sensors)
    shown = presliding(left, 2)
    assert shown.convincing
    assert min(shown.shares) > 0.5
    # bristles as long as Coulomb friction over their stiffness; here it is Dahl's distance, at
    # the level of friction as a whole, which breaks away above Coulomb's
    bristle = np.deg2rad(true[NAME]["deflection_deg"])
    assert shown.fit.model.effects[NAME]["ring_distance"] == pytest.approx(bristle, rel=0.5)


def test_of_the_ring_gear_alone_is_told_by_keeping_step():
    """The pinions cross their gaps first: little of the first tenth of a second is left for it."""
    left, true = left_by_the_drive(9200, ((NAME, 0.5),), "karnopp")
    before = augment(left.measured.fit, left.base, paper_drive())
    shown = a_little(left, before, presliding(left, 2), 2)
    assert before.horizon <= 0.1
    assert shown.convincing
    assert shown.in_step >= 0.15
    bristle = np.deg2rad(true[NAME]["deflection_deg"])
    assert shown.fit.model.effects[NAME]["ring_distance"] == pytest.approx(bristle, rel=0.5)
    assert shown.fit.model.effects[NAME]["reducer_distance"] < MATTERS


def test_is_found_before_what_the_balances_would_call_it():
    """Long bristles: near rest the balances miss torques, and viscous friction is not held back."""
    left, _ = left_by_the_drive(90100014, ((NAME, 3.0),), "karnopp")
    decision = decide(left)
    assert [found.name for found in decision.found] == [NAME]
    assert decision.unexplained is None
    assert decision.after.base.model.effects[NAME]["viscous_at_once"] == 1.0


def test_bristles_too_short_for_a_name():
    """The same law of friction, as a rig has it that lacks nothing."""
    left, _ = left_by_the_drive(8200157, (), "lugre")
    shown = presliding(left, 2)
    assert min(shown.shares) > SHARE
    assert travel(shown.fit) < MATTERS
    assert not shown.convincing
    before = augment(left.measured.fit, left.base, paper_drive())
    little = a_little(left, before, shown, 2)
    assert before.horizon <= 0.1
    assert little.in_step >= 0.15
    assert not little.convincing


def test_nothing_where_the_model_keeps_step():
    left, _ = left_by_the_drive(4000, (), "karnopp")
    shown = presliding(left, 2)
    assert shown.evidence == 0.0
    assert NAME not in shown.fit.model.effects


@pytest.mark.parametrize(
    ("counts", "error", "told"),
    [(4.73, 6.8, False), (4.73, 2.0, True), (3.9, 0.1, False), (12.0, 5.0, True)],
)
def test_a_name_needs_a_distance_that_is_known(counts, error, told):
    """The first is of a rig that lacks nothing: friction with bristles, gears of other damping."""
    model = Model().with_effect(NAME, ring_distance=counts * MATTERS / 4.0, reducer_distance=1e-6)
    unknowns = unknowns_of(NAME)
    scales = np.array([u.scale for u in unknowns])
    errors = np.where([u.name == "ring_distance" for u in unknowns], error * MATTERS / 4.0, 1e-7)
    fit = Fit(model, unknowns, position(model, unknowns), np.diag((errors / scales) ** 2), 0.1)
    assert matters(fit) is told
    assert not matters(Fit(Model(), (), np.zeros(0), np.zeros((0, 0)), 0.1))
