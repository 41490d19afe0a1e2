"""Which effect is taken first, and which is asked for beyond what it can be."""

from types import SimpleNamespace

import pytest

from dmptm_ctrl.diagnosis import decide
from dmptm_ctrl.diagnosis.bursts import BURSTS, Bursts
from dmptm_ctrl.diagnosis.curves import Curve
from dmptm_ctrl.diagnosis.decide import (
    FAINT,
    FAINT_SHARE,
    FIRST,
    SECOND,
    Decision,
    Start,
    convincing,
    faint_one,
    first_of,
    said_by_a_name,
)
from dmptm_ctrl.diagnosis.trace import Trial, unknowns_of
from dmptm_ctrl.diagnosis.unknown import Unexplained

NOWHERE = SimpleNamespace(unknowns=(), p=())


def trial(name, gain, held, fit=NOWHERE):
    return Trial(name, gain, held, fit)


@pytest.fixture
def beside(monkeypatch):
    """Trials beside each first effect, by its name; which were asked for."""
    rest, asked = {}, []

    def of(measured, first, skip, jobs):
        asked.append(first.name)
        return Start(first, None, rest.get(first.name, []))

    monkeypatch.setattr(decide.Start, "of", of)
    return rest, asked


def test_the_first_effect_leaves_room_for_a_second(beside):
    """Alone a weak motor does best; held-out logs object to a late drive beside it."""
    rest, _ = beside
    rest["torque_constant_mismatch"] = [trial("drive_delay", 464.0, -244.0)]
    rest["back_emf"] = [trial("drive_delay", 887.0, 690.0)]
    trials = [
        trial("torque_constant_mismatch", 3607.0, 911.0),
        trial("back_emf", 3682.0, 724.0),
        trial("quadratic_drag", 2000.0, 100.0),  # far behind
    ]
    assert first_of(None, trials, (), 1).trial.name == "back_emf"


def test_no_other_first_effect_is_tried_where_no_second_is_in_sight(beside):
    rest, asked = beside
    rest["unbalance"] = [trial("cogging", SECOND - 1.0, 0.0)]
    trials = [trial("unbalance", 900.0, 300.0), trial("position_dependent_friction", 890.0, 290.0)]
    assert first_of(None, trials, (), 1).trial.name == "unbalance"
    assert asked == ["unbalance"]


def test_the_best_alone_stays_where_others_with_a_second_are_not_clearly_better(beside):
    rest, asked = beside
    rest["unbalance"] = [trial("cogging", 2.0 * SECOND, 10.0)]
    rest["local_spot"] = [trial("cogging", 2.5 * SECOND, 10.0)]
    trials = [trial("unbalance", 900.0, 300.0), trial("local_spot", 890.0, 290.0)]
    assert first_of(None, trials, (), 1).trial.name == "unbalance"
    assert asked == ["unbalance", "local_spot"]


@pytest.mark.parametrize(("share", "told"), [(1.0, False), (0.9, True), (0.0, True)])
def test_more_than_an_effect_can_be_is_another_one(share, told):
    own = unknowns_of("thermal_drift")
    names = [k.name for k in own]
    p = [1.0] * len(own)
    j = names.index("ring_extra")
    p[j] = share * own[j].low
    fit = SimpleNamespace(unknowns=own, p=p)
    assert convincing(trial("thermal_drift", FIRST, FIRST, fit), FIRST) is told


def test_of_little_evidence_fitted_and_held_out_logs_have_a_share():
    """A bank searched for its best frequency finds some on the fitted logs of any drive."""
    bank = trial("base_vibration", FAINT, FAINT_SHARE + 1.0)
    told = trial("quadratic_drag", FAINT - FAINT_SHARE, 1.5 * FAINT_SHARE)
    more = trial("back_emf", FAINT, 2.0 * FAINT_SHARE)
    assert faint_one([bank]) is None
    assert faint_one([trial("quadratic_drag", 2.0 * FAINT, 0.5 * FAINT_SHARE)]) is None
    assert faint_one([trial("quadratic_drag", 0.0, 2.0 * FAINT)]) is None
    assert faint_one([trial("cogging", 0.3 * FAINT, FAINT_SHARE + 1.0)]) is None
    assert faint_one([bank, told]) is told
    assert faint_one([bank, told, more]) is more


@pytest.mark.parametrize(
    ("evidence", "held", "bursts", "said"),
    [
        (63.0, 28.0, 0.0, True),
        (40.0, 28.0, 0.0, False),
        (63.0, 2.0, 0.0, False),
        (63.0, 28.0, BURSTS, False),
    ],
)
def test_a_curve_that_explains_no_more_than_a_name_is_not_on_no_list(evidence, held, bursts, said):
    """Between what a curve and what a first name need, a name with two numbers was "unknown"."""
    what = Unexplained(("u",), Curve(("u",), 63.0, 27.0), Bursts(bursts, ()), beyond_names=False)
    told = trial("drive_offset", evidence - held, held)
    decision = Decision(None, None, rest=[told], unexplained=what)
    assert said_by_a_name(decision) is said
