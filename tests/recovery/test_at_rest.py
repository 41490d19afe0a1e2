"""Pre-sliding told by the first tenth of a second, on rigs of another program with bristles."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "identify"))

from test_ensemble import noisy_log

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.at_rest import (
    MATTERS,
    NAME,
    SHARE,
    AtRest,
    a_little,
    matters,
    presliding,
    travel,
)
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.decide import decide, slid
from dmptm_ctrl.diagnosis.giving import giving_or_not
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace, unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.fit import Fit, position
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, march, rest
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")


def left_by_the_drive(seed, effects, friction, sensors="all", contact="kelvin_voigt", logs=LOGS):
    """What the declared model leaves on a rig, and the rig's own label."""
    laws = {"friction": friction, "contact": contact}
    rig = make_rig(seed, effects, sensors=sensors, logs=logs, **laws)
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


def test_landings_tell_which_law_where_the_balances_are_mistaken():
    """Bristles of the ring gear alone: the balances hardly see them without motor encoders."""
    left, _ = left_by_the_drive(510100014, ((NAME, 1.0),), "karnopp", "load", "eq21", "paper")
    shown = presliding(left, 2)
    assert shown.fit.model.effects[NAME]["viscous_at_once"] == 1.0
    values = shown.fit.model.effects[NAME]

    def lost(share):
        model = left.base.model.with_effect(NAME, **{**values, "viscous_at_once": share})
        one = residual(left.measured, model, unknowns=left.base.unknowns)
        return one.base.loss + one.held_base

    assert lost(0.0) < lost(1.0)
    assert slid(left, shown, 2).base.model.effects[NAME]["viscous_at_once"] == 1.0


@pytest.mark.parametrize(("friction", "sticking"), [("karnopp", True), ("lugre", False)])
def test_beside_an_offset_the_nearer_law_goes_on(friction, sticking):
    """57 mV on both motors let the drive leave rest early: pre-sliding alone helps."""
    name = "drive_offset"
    left, _ = left_by_the_drive(700100039, ((name, 3.0),), friction, "load", "eq21", "paper")
    assert presliding(left, 2).gives
    records = left.measured.fit
    begun = rattled(records, left.base, left.measured.drive, 2)
    law = giving_or_not(records, begun, trace(left, only=(name,)), 2)
    assert law.sticks == sticking
    assert law.told
    (trial,) = law.trials
    for fit in (law.start, trial.fit):
        assert (NAME in fit.model.effects) != sticking


def test_what_helps_much_is_doubtful_where_nothing_meets_the_landings_beside_it():
    helps = AtRest(200.0, 100.0, (0.7, 0.5), Fit(Model(paper_drive()), (), np.zeros(0), np.eye(0)))
    assert helps.gives
    assert not helps.doubtful
    assert replace(helps, told=False).doubtful
    assert not replace(helps, told=False, sticks=True).doubtful


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_either_law_is_told(share):
    """Of the product's own drive, which may obey Dahl's, under the voltages of a rig."""
    values = {"ring_distance": 3e-4, "damping": 0.4, "viscous_at_once": share}
    plant, rng = Model(paper_drive()).with_effect(NAME, **values), np.random.default_rng(11)
    driven = []
    for name, table in make_rig(510100010, sensors="load", friction="karnopp").logs.items():
        log = load_log(table, name=name)
        u = np.array([log["u_left"], log["u_right"]])
        x0 = rest(plant, float(log["theta_L"][0]))
        out = march(plant.arrays(), u, x0, log.sample_time, substeps=FINE_SUBSTEPS)
        driven.append(noisy_log(name, u, out, rng))
    fit = presliding(residual(measure(driven, paper_drive()), Model(paper_drive())), 2).fit
    assert fit.model.effects[NAME]["viscous_at_once"] == share
    assert fit.model.effects[NAME]["ring_distance"] == pytest.approx(3e-4, rel=0.15)


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


def fit_of(counts, error, damping=0.4):
    """A fit of pre-sliding of the ring gear, in counts of its encoder."""
    distances = {"ring_distance": counts * MATTERS / 4.0, "reducer_distance": 1e-6}
    model = Model().with_effect(NAME, **distances, damping=damping)
    unknowns = unknowns_of(NAME)
    scales = np.array([u.scale for u in unknowns])
    errors = np.where([u.name == "ring_distance" for u in unknowns], error * MATTERS / 4.0, 1e-7)
    return Fit(model, unknowns, position(model, unknowns), np.diag((errors / scales) ** 2), 0.1)


@pytest.mark.parametrize(
    ("counts", "error", "told"),
    [(4.73, 6.8, False), (4.73, 2.0, True), (3.9, 0.1, False), (12.0, 5.0, True)],
)
def test_a_name_needs_a_distance_that_is_known(counts, error, told):
    """The first is of a rig that lacks nothing: friction with bristles, gears of other damping."""
    fit = fit_of(counts, error)
    assert matters(fit) is told
    assert matters(fit, fit) is told
    assert not matters(Fit(Model(), (), np.zeros(0), np.zeros((0, 0)), 0.1))


def test_a_refit_that_knows_less_takes_no_name_away_but_one_that_finds_less_does():
    """The one before knew its distance to a sixtieth; a refit that holds for 0.05 s to a half."""
    before, unsure, small = (fit_of(*one) for one in ((18.0, 0.3), (17.0, 9.0), (3.9, 0.1)))
    assert matters(before, unsure)
    assert not matters(unsure)
    assert not matters(before, small)


@pytest.mark.parametrize(
    ("then", "damping", "told"),
    [
        ((4.65, 4.33), 1.46, False),  # a rig that lacks nothing, with gears of another law
        ((6.57, 1.17), 1.46, True),
        ((4.65, 4.33), 0.3, True),
    ],
)
def test_bristles_that_creep_are_known_by_every_fit(then, damping, told):
    assert matters(fit_of(8.19, 0.44, damping), fit_of(*then, damping)) is told
