"""What the balances tell nothing of, too long for CI: ``python -m pytest benchmarks/long``."""

from dataclasses import replace

import numpy as np
import pytest
from tests.recovery.test_unseen import fitted

from dmptm_ctrl import diagnose, load_log
from dmptm_ctrl.diagnosis.at_rest import presliding
from dmptm_ctrl.diagnosis.decide import Decision
from dmptm_ctrl.diagnosis.free_runs import uncovered
from dmptm_ctrl.diagnosis.giving import giving_or_not
from dmptm_ctrl.diagnosis.landings import enter, landings, race_first, variants
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace, unknowns_of
from dmptm_ctrl.diagnosis.unseen import by_all_logs, by_impacts, outlasting, unseen
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.lock import LOST, UNEASY, Locked
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig


def test_eccentric_ring_without_motor_encoders():
    """The twist is not measured; the times of the impacts tell its size within a tenth."""
    name = "ring_gear_eccentricity"
    before, left, true = fitted(402, ((name, 0.5),), "load")
    assert before.horizon <= 0.1
    decision = Decision(left, left)
    fit = uncovered(decision, np.inf, before, left.measured.held_logs, 2, 0)
    (found,) = decision.found
    assert found.name == name
    assert found.rivals == ()
    # How large they are hangs on rounding: an impact met one sample later is worth ten
    assert min(found.trial.gain, found.trial.held_gain) > 0.0
    assert found.evidence > found.threshold
    assert fit.horizon >= 0.4
    values = fit.model.effects[name]
    size = np.hypot(values["cosine"], values["sine"])
    wanted = np.deg2rad(true[name]["amplitude_arcmin"] / 60.0)
    assert size == pytest.approx(wanted, rel=0.1)


def test_runout_that_the_other_pinion_tells():
    """First impacts are met in many ways; where the other pinion lands, one of them is left."""
    name, drive = "pinion_runout", paper_drive()
    laws = {"friction": "karnopp", "contact": "eq21"}
    rig = make_rig(4228218833, ((name, 3.0),), sensors="load", **laws)
    measured = measure([load_log(table, name=log) for log, table in rig.logs.items()], drive)
    left = residual(measured, Model(drive))
    base = rattled(measured.fit, left.base, drive, 2)
    alone = enter([base.model], base, (), 0)
    (models,) = variants(name, base.model)
    one = enter(models, base, unknowns_of(name), 0)
    race_first(alone, [one], measured.fit, 2)
    assert alone.level > LOST
    assert one.level < UNEASY
    values = one.there.effects[name]
    sizes = [np.hypot(values[f"{s}_cosine"], values[f"{s}_sine"]) for s in ("left", "right")]
    true = rig.label["effect_parameters"][name]
    assert true["location"] == "right"
    wanted = np.deg2rad(true["amplitude_arcmin"] / 60.0)
    assert sizes == pytest.approx([0.0, wanted], abs=0.1 * wanted)


def test_friction_that_hardly_gives_may_be_motors_that_differ():
    """A little pre-sliding mends a part of what the motors do; beside it none meets the landings.

    With friction that sticks, the right one does.
    """
    before, left, truth = fitted(350100023, (("torque_constant_mismatch", 1.0),), "load")
    # what it takes off, fitted and held out, where it does mend a part
    rested = replace(presliding(left, 2), gain=150.0, held_gain=40.0, shares=(0.24, 0.18))
    assert rested.gives
    assert rested.doubtful
    found = unseen(left, before, rested=rested)
    assert found.name == "torque_constant_mismatch"
    assert found.fit.horizon >= 0.1
    size = found.fit.model.effects[found.name]["error"]
    assert size == pytest.approx(truth[found.name]["left_share"], rel=0.1)


def test_where_neither_law_of_friction_meets_the_landings_both_are_tried():
    """A gap that varies is missed as friction that gives would be, and balances tell nothing."""
    before, left, truth = fitted(800100026, (("backlash_variation", 0.5),), "load")
    rested = presliding(left, 2)
    assert rested.gives
    assert not rested.doubtful
    start = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    trials = trace(left, only=("cogging", "position_dependent_friction"))
    law = giving_or_not(left.measured.fit, start, trials, 2)
    assert not law.told
    found = unseen(left, before, rested=replace(rested, sticks=law.sticks, told=law.told))
    assert found.name == "backlash_variation"
    values = found.fit.model.effects[found.name]
    drive = found.fit.model.drive
    share = np.hypot(values["cosine"], values["sine"]) / np.mean([drive["gap_l"], drive["gap_r"]])
    assert share == pytest.approx(truth[found.name]["share"], rel=0.2)


def test_landings_of_all_logs_tell_nothing_under_another_law_of_the_flanks():
    _, left, _ = fitted(420200033, (), "load", "karnopp", "hunt_crossley")
    base = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    landed = landings(left, base, 2, 0, ("pinion_runout", "backlash_variation"))
    assert landed.alone.level > LOST
    assert by_all_logs(landed, 2, 0) is None


def test_a_longer_run_tells_what_no_reversal_does():
    """A gap that varies, beside a limit at which all lose step at the reversals of whole logs."""
    effects = (("backlash_variation", 1.0), ("drive_saturation", 1.0))
    _, left, _ = fitted(450100016, effects, "load")
    base = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    some = ("pinion_runout", "ring_gear_eccentricity", "backlash_variation")
    landed = landings(left, base, 2, 0, some)
    found = by_impacts(landed, 2, 0)
    assert found.name == "backlash_variation"
    assert not found.everywhere  # no reversal told it
    assert found.fit.horizon >= 0.3
    none, longest = Locked(base.model, base.p, 0.1, 0.3, base.covariance), found.fit
    same = Locked(longest.model, longest.p, longest.horizon, 0.3, longest.covariance)
    assert outlasting({"a": none, "b": same}, landed.whole, 2) == "b"
    assert outlasting({"a": same, "b": same}, landed.whole, 2) is None
    assert outlasting({}, landed.whole, 2) is None


def test_a_gap_that_is_nearly_all_variation_is_found_from_the_reversals():
    """Logs begin within 30 degrees: their first landings another constant gap meets as well."""
    effects = (("backlash_variation", 3.0),)
    _, left, true = fitted(500100023, effects, "load")
    base = rattled(left.measured.fit, left.base, left.measured.drive, 2)
    found = by_all_logs(landings(left, base, 2, 0), 2, 0)
    assert found is not None
    assert found.name == "backlash_variation"
    own = found.fit.model.effects["backlash_variation"]
    share, phase = true["backlash_variation"]["share"], true["backlash_variation"]["phase_rad"]
    gaps = [found.fit.model.drive[gap] for gap in ("gap_l", "gap_r")]
    wave = 0.5 * share * sum(gaps) * np.exp(1j * phase)  # cosine and minus sine
    assert abs(complex(own["cosine"], -own["sine"]) - wave) < 0.3 * abs(wave)


def test_bursts_at_steps_of_the_voltage_are_a_soft_reducer_s_ringing():
    """By the balances what is left depends on the time and on du/dt, and is on nobody's list."""
    name = "reducer_compliance"
    laws = {"friction": "karnopp", "contact": "eq21"}
    rig = make_rig(550100018, ((name, 3.0),), sensors="load", **laws)
    found = diagnose([load_log(table, name=log) for log, table in rig.logs.items()])
    assert [effect.name for effect in found.effects] == [name]
    told = found.augmented.effects[name]["compliance"]
    true = rig.label["effect_parameters"][name]["stiffness_N_m_rad"]
    assert 1.0 / told == pytest.approx(true, rel=0.1)
    assert found.error["after"]["rmse"] < 0.4 * found.error["before"]["rmse"]


@pytest.mark.parametrize("seed", [7050, 8050])
def test_motors_that_differ_much_land_where_no_window_is_expected(seed):
    """What stands out of the balances then is where meshes are closed, not what is on no list."""
    effects = (("torque_constant_mismatch", 5.0),)
    rig = make_rig(seed, effects, sensors="load", friction="karnopp", contact="eq21")
    found = diagnose([load_log(table, name=name) for name, table in rig.logs.items()])
    (effect,) = found.effects
    assert found.verdict == "explained"
    true = rig.label["effect_parameters"]["torque_constant_mismatch"]["left_share"]
    assert effect.parameters["error"]["value"] == pytest.approx(true, abs=0.01)


def test_soft_reducers_of_next_to_no_size_have_no_name():
    """Of other laws of friction and of the flanks they mend a part, at a tenth of what shows."""
    laws = {"friction": "tanh", "contact": "hunt_crossley"}
    rig = make_rig(610100036, (), sensors="load", **laws)
    found = diagnose([load_log(table, name=name) for name, table in rig.logs.items()])
    assert (found.verdict, found.effects) == ("none", ())


def test_what_a_name_stands_in_for_is_unknown():
    """Each volt's torque ripples over the motor's turn; a cogging explains it until it runs."""
    laws = {"friction": "karnopp", "contact": "kelvin_voigt"}
    rig = make_rig(710100007, (("torque_ripple", 1.0),), sensors="load", **laws)
    found = diagnose([load_log(table, name=name) for name, table in rig.logs.items()])
    assert found.ranking[0]["name"] == "cogging"
    assert found.ranking[0]["status"] == "rejected"
    assert found.verdict == "unknown"
    assert found.depends_on == ("theta_m",)
