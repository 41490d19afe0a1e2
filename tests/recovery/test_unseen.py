"""What the balances tell nothing of, told by keeping step on rigs of another program."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.curves import Curve
from dmptm_ctrl.diagnosis.decide import FIRST, Decision
from dmptm_ctrl.diagnosis.free_runs import (
    entered,
    in_step,
    law_of_friction,
    may_ring,
    met_by_landings,
    uncovered,
)
from dmptm_ctrl.diagnosis.landings import FIRST_SECONDS, PLACES_OF_ALL, landings, race_first
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.report import unnamed
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.runners import Runner
from dmptm_ctrl.diagnosis.runoff import Run
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.diagnosis.unknown import Unexplained
from dmptm_ctrl.diagnosis.unseen import (
    AGEING,
    LEAST,
    aged_at_landings,
    by_all_logs,
    names,
    stands_apart,
    unseen,
)
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.lock import LOST, UNEASY
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig


def fitted(seed, effects, sensors, friction="karnopp", contact="eq21"):
    """The model as it is, what it leaves, and the rig's own label."""
    rig = make_rig(seed, effects, sensors=sensors, friction=friction, contact=contact)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    drive = paper_drive()
    measured = measure(logs, drive)
    left = residual(measured, Model(drive))
    return augment(measured.fit, left.base, drive), left, rig.label["effect_parameters"]


def test_friction_that_grows_at_rest_is_unknown_by_its_variable():
    """On nobody's list: no name, but what it depends on, and a curve over it in the model."""
    effects = (("dwell_breakaway", 1.0),)
    before, left = fitted(301, effects, "all", "karnopp", "kelvin_voigt")[:2]
    assert before.horizon <= 0.1
    decision = Decision(left, left)
    fit = uncovered(decision, np.inf, before, left.measured.held_logs, 2, 0)
    assert decision.unexplained.variables == ("time_at_rest",)
    assert not decision.found
    assert fit.horizon >= 0.3
    assert fit.model.effects[AGEING]["rise"] > 0.0
    curve = unnamed(decision.tables)
    assert curve.name == "unknown"
    assert curve.probability > 0.9
    # half a breakaway's age is slipped off within a few encoder counts
    assert fit.model.effects[AGEING]["slip"] == pytest.approx(2e-4, rel=0.6)


@pytest.mark.parametrize(
    ("effects", "friction"), [((("dwell_breakaway", 3.0),), "karnopp"), ((), "lugre")]
)
def test_at_landings_much_of_it_is_told_by_what_it_leaves(effects, friction):
    """Too much for any model to keep step; another law of friction is none of it."""
    _, left, true = fitted(620100007, effects, "all", friction)
    base = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    found = aged_at_landings(left, base, 2, 0)
    assert (found is not None) == bool(effects)
    if found is not None:
        rise = found.fit.model.effects[AGEING]["rise"]
        assert rise == pytest.approx(true["dwell_breakaway"]["rise_N_m"], rel=0.3)


def test_friction_that_grows_at_rest_is_tried_before_landings(monkeypatch):
    """Where the model as it is loses step at once; those take ten times as long."""

    def unwanted(*args, **kwargs):
        raise AssertionError("landings of other effects were tried")

    before, left, _ = fitted(305, (("dwell_breakaway", 1.0),), "load")
    assert before.horizon < 0.1
    monkeypatch.setitem(unseen.__globals__, "landings", unwanted)
    assert unseen(left, before).name == AGEING
    monkeypatch.undo()
    monkeypatch.setitem(unseen.__globals__, "landings", unwanted)
    with pytest.raises(AssertionError, match="landings"):  # beside another effect it is not tried
        unseen(left, before, alone=False)


def test_nothing_where_the_model_keeps_step():
    before, left, _ = fitted(4000, (), "all")
    assert before.horizon >= 0.3
    assert unseen(left, before) is None
    assert names(left) == (AGEING,)  # with motor encoders the balances tell the rest


def test_an_effect_leaves_no_more_than_none_where_that_meets_the_landings():
    """One that is not there goes on from where the model as it is is, with nothing of it."""
    before, left, _ = fitted(1355135373, (("backlash_variation", 1.0),), "load")
    start = replace(left.base, model=before.model)
    some = ("backlash_variation", "torque_constant_mismatch", "unbalance")
    landed = landings(left, start, 2, 0, some, none_tells=True)
    assert landed.alone.level < UNEASY
    assert {name for name, _ in landed.entered} == set(some)
    for _, one in landed.entered:
        assert one.cost < landed.alone.cost + 2.0  # as well as steps tell that end at a thousandth


def test_reversals_tell_what_the_first_landings_do_not():
    """A gap that varies by a quarter: the model as it is meets every first landing."""
    before, left, truth = fitted(1355135373, (("backlash_variation", 1.0),), "load")
    found = unseen(left, before)
    assert found.name == "backlash_variation"
    assert found.everywhere
    assert not found.rivals
    assert found.evidence > 2.0 * LEAST
    model = found.fit.model
    told = model.effects["backlash_variation"]
    for side, way in (("l", 1.0), ("r", -1.0)):
        cosine, sine = (told[k] + way * told[f"apart_{k}"] for k in ("cosine", "sine"))
        share = np.hypot(cosine, sine) / model.drive[f"gap_{side}"]
        assert share == pytest.approx(truth["backlash_variation"]["share"], rel=0.2)


def test_beside_what_meets_the_landings_another_one_is_raced():
    """Motors that differ, and an offset of one: until that is there the free run goes astray."""
    effects = (("drive_offset", 1.0), ("torque_constant_mismatch", 1.0))
    before, left, truth = fitted(370100009, effects, "load")
    some = ("drive_offset", "torque_constant_mismatch", "unbalance")
    decision = Decision(left, left, rest=trace(left, only=some))
    held = left.measured.held_logs
    without = speed_error(before.model, held)["rmse"]
    fit = uncovered(decision, without, before, held, 2, 0)
    assert [found.name for found in decision.found] == ["torque_constant_mismatch"]
    assert [found.name for found in met_by_landings(decision)] == ["torque_constant_mismatch"]
    racing = entered(decision, fit, law_of_friction(decision, 2), 2, 0)
    fit = in_step(decision, fit, racing, 2)
    assert {found.name for found in decision.found} == {name for name, _ in effects}
    assert speed_error(fit.model, held)["rmse"] < 0.5 * without
    told = fit.model.effects
    share, offset = (truth[name] for name in ("torque_constant_mismatch", "drive_offset"))
    mismatch = told["torque_constant_mismatch"]["error"]
    assert mismatch == pytest.approx(share["left_share"], rel=0.1)
    apart = told["drive_offset"]["left"] - told["drive_offset"]["right"]
    assert apart == pytest.approx(offset["offset_V"], rel=0.2)


def test_a_faint_ripple_without_motor_encoders_is_told_by_the_race():
    """The gyro's fast part says too little of it; without it no landing is met."""
    before, left, truth = fitted(440100014, (("cogging", 0.5),), "load")
    decision = Decision(left, left, rest=trace(left, only=("cogging", "mesh_error", "unbalance")))
    assert max(trial.evidence for trial in decision.rest) < FIRST
    racing = entered(decision, before, law_of_friction(decision, 2), 2, 0)
    fit = in_step(decision, before, racing, 2)
    assert [found.name for found in decision.found] == ["cogging"]
    assert before.horizon < 0.1 < 0.6 < fit.horizon
    told, true = fit.model.effects["cogging"], truth["cogging"]
    assert (true["location"], told["order"]) == ("left", true["order"])
    size = np.hypot(told["left_cosine"], told["left_sine"])
    assert size == pytest.approx(true["amplitude_N_m"], rel=0.1)


@pytest.mark.parametrize(
    ("variables", "encoders", "tables", "may"),
    [
        (None, False, None, True),
        (("u", "du_dt"), False, None, True),
        (("time", "du_dt"), False, None, True),  # steps come by the clock of the log
        (("time", "du_dt"), False, "a curve over them", False),
        (("time",), False, None, False),
        (("time", "theta_L", "du_dt"), False, None, False),
        (("time", "du_dt"), True, None, False),  # the twist would show it
    ],
)
def test_what_is_left_without_a_name_may_be_what_rings(variables, encoders, tables, may):
    curve = None if variables is None else Curve(variables, 100.0, 10.0)
    what = None if curve is None else replace(Unexplained.without_curve(variables), curve=curve)
    left = SimpleNamespace(measured=SimpleNamespace(has_motor_encoders=encoders))
    assert may_ring(Decision(left, left, unexplained=what, tables=tables)) is may


@pytest.mark.parametrize("encoders", [False, True])
def test_windows_that_stand_out_may_be_where_a_pinion_lands(encoders):
    """Without motor encoders a run tells where the meshes are closed, and may be wrong."""
    what = Unexplained.without_curve(("time",))
    left = SimpleNamespace(measured=SimpleNamespace(has_motor_encoders=encoders))
    assert may_ring(Decision(left, left, unexplained=what)) is not encoders


def test_landings_of_all_logs_tell_what_half_of_them_leave_open():
    """Fitted to six logs, the runout that is there misses first landings of the others as well."""
    _, left, truth = fitted(627365687, (("pinion_runout", 1.0),), "load")
    base = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    landed = landings(left, base, 2, 0, ("pinion_runout", "backlash_variation"))
    own = landed.runs["pinion_runout"]
    assert own.level < LOST
    assert own.held > 5.0 * own.fitted
    found = by_all_logs(landed, 2, 0)
    assert found.name == "pinion_runout"
    assert not found.rivals
    true, told = truth["pinion_runout"], found.fit.model.effects["pinion_runout"]
    assert true["location"] == "right"
    size = np.rad2deg(np.hypot(told["right_cosine"], told["right_sine"])) * 60.0
    assert size == pytest.approx(true["amplitude_arcmin"], rel=0.1)


@pytest.mark.parametrize(("leaves", "laps"), [(2.0, 2), (0.5, len(FIRST_SECONDS))])
def test_who_loses_the_second_lap_of_all_logs_runs_no_other(monkeypatch, leaves, laps):
    class Lagging:
        level, places = leaves * LOST, ()

        def settle(self):
            pass

        def different(self, _):
            return ()

    run = []

    def together(action, some, *_):
        if action is Runner.go:
            run.append(len(some))

    monkeypatch.setattr("dmptm_ctrl.diagnosis.landings.together", together)
    race_first(Lagging(), [Lagging()], (), 1, PLACES_OF_ALL, afresh=False, hopeless=LOST)
    assert run == [2] * laps


def test_one_stands_apart_of_others_that_leave_much():
    def of(loss):
        return Run(1.0, loss, loss)

    assert stands_apart(of(45.0), of(100.0), [152.0])
    assert not stands_apart(of(46.0), of(100.0), [152.0])  # leaves too much
    assert not stands_apart(of(45.0), of(100.0), [152.0, 148.0])  # another one does as well
