"""In which order free runs are asked, and beside which law of friction."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dmptm_ctrl.diagnosis import free_runs, unseen
from dmptm_ctrl.diagnosis.at_rest import NAME, AtRest
from dmptm_ctrl.diagnosis.decide import Decision
from dmptm_ctrl.diagnosis.giving import Giving
from dmptm_ctrl.diagnosis.landings import FIRST_SECONDS
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, drive_unknowns
from dmptm_ctrl.simulate.model import Model

UNKNOWNS = drive_unknowns(Model())
ASTRAY = Fit(Model(), UNKNOWNS, np.zeros(len(UNKNOWNS)), np.eye(len(UNKNOWNS)), 0.0)


@pytest.mark.parametrize(
    ("told", "encoders", "stuck", "order"),
    [
        (True, False, False, ["race, or to where it is stuck", "landings"]),
        # to begin anew takes longest, and is seldom won
        (True, False, True, ["race, or to where it is stuck", "landings", "race"]),
        (False, False, False, ["landings", "race"]),  # who races loses step at the first landings
        (False, True, True, ["race", "landings"]),  # the balances see what landings would tell
    ],
)
def test_in_which_order_landings_are_asked(told, encoders, stuck, order, monkeypatch):
    asked = []
    racing = SimpleNamespace(ended=False)

    def races(decision, after, racing, jobs, *, pauses=False):
        asked.append("race, or to where it is stuck" if pauses else "race")
        racing.ended = not (pauses and stuck)
        return ASTRAY

    def lands(decision, *arguments):
        asked.append("landings")
        return ASTRAY

    for name in ("of_little", "told_apart", "rested"):
        monkeypatch.setattr(free_runs, name, lambda decision, after, *arguments: after)
    monkeypatch.setattr(free_runs, "sobered", lambda decision, without, after, *arguments: after)
    law = Giving(None, [], False, told)
    monkeypatch.setattr(free_runs, "law_of_friction", lambda decision, jobs: law)
    monkeypatch.setattr(free_runs, "entered", lambda *arguments: racing)
    monkeypatch.setattr(free_runs, "in_step", races)
    monkeypatch.setattr(free_runs, "uncovered", lands)
    left = SimpleNamespace(
        measured=SimpleNamespace(has_motor_encoders=encoders, held_logs=()),
        base=SimpleNamespace(unknowns=UNKNOWNS),
    )
    free_runs.traced(Decision(left, left), ASTRAY, 0.1, 1, 0)
    assert asked == order


@pytest.mark.parametrize("missed", [1.0, 0.2])  # 0.2: the first landings are met
@pytest.mark.parametrize(
    ("rested", "laws"),
    [
        (AtRest(100.0, 100.0, (0.1, 0.1), ASTRAY), ["gives", "sticks"]),  # it helps little
        (AtRest(100.0, 100.0, (0.6, 0.6), ASTRAY), ["gives"]),
        (AtRest(100.0, 100.0, (0.6, 0.6), ASTRAY, told=False), ["sticks", "gives"]),
        (None, ["sticks"]),
    ],
)
def test_law_of_friction_beside_which_landings_are_tried(rested, laws, missed, monkeypatch):
    tried, turned = [], []

    def landings(left, base, *arguments, **options):
        tried.append("gives" if NAME in base.model.effects else "sticks")
        alone = SimpleNamespace(level=1.0)
        return SimpleNamespace(alone=alone, nearest=lambda count: [])

    n = len(UNKNOWNS)
    base = BalanceFit(Model(), UNKNOWNS, np.zeros(n), 0.0, [], [], np.zeros((0, n)), np.eye(n))
    monkeypatch.setattr(unseen, "landings", landings)
    monkeypatch.setattr(unseen, "rattled", lambda records, fit, *arguments: fit)
    monkeypatch.setattr(unseen, "by_all_logs", lambda *arguments, **options: None)
    monkeypatch.setattr(unseen, "by_impacts", lambda *arguments, turns: turned.append(turns))
    measured = SimpleNamespace(fit=(), held=(), has_motor_encoders=False, drive=None)
    monkeypatch.setattr(unseen, "level", lambda *arguments: missed)
    left = SimpleNamespace(measured=measured, base=base)
    before = replace(ASTRAY, horizon=FIRST_SECONDS[-1])
    assert unseen.unseen(left, before, rested=rested, alone=False) is None
    assert tried == laws
    assert turned == [law == "sticks" for law in laws]  # only then reversals tell
