"""What a refit inside the simulator knows where its lock holds nowhere."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis import augment
from dmptm_ctrl.diagnosis.at_rest import NAME, sized
from dmptm_ctrl.diagnosis.decide import adopt
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace, unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.fit import Fit, position
from dmptm_ctrl.identify.lock import Locked
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_square_0v60", "closed_sine_10")


@pytest.mark.parametrize(("horizon", "kept"), [(0.0, True), (0.3, False)])
def test_what_was_known_is_kept_where_a_lock_holds_nowhere(monkeypatch, horizon, kept):
    """How surely pre-sliding is known decides about its name; a lock that fails tells nothing."""
    rig = make_rig(41, (), sensors="all", logs=LOGS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    base, own = residual(measured, Model(paper_drive())).base, unknowns_of(NAME)
    model = sized(NAME, base.model, 1.0)
    unknowns = (*base.unknowns, *own)
    size = len(unknowns)
    near = Fit(model, unknowns, position(model, unknowns), 1e-4 * np.eye(size), 0.4)

    def lock(records, model, unknowns, known, **how):
        p = position(model, unknowns)
        return Locked(model, p, horizon, 0.3, 5.0 * np.eye(size))

    monkeypatch.setattr(augment, "lock", lock)
    monkeypatch.setattr(augment, "onto_whole", lambda records, begun, known, jobs: begun[1])
    how = {"beside": own, "near": near, "onward": True, "jobs": 1}
    done = augment.augment(measured.fit, base, measured.drive, **how)
    told = np.diag(done.covariance)[-len(own) :]
    np.testing.assert_allclose(told, augment.NOT_NEWS * (1e-4 if kept else 5.0))


def of_magnets(seed, strength, sensors, friction, contact, logs=None):
    """Of a rig whose motors cog: logs, what the balances make of it, and its label."""
    how = {} if logs is None else {"logs": logs}
    laws = {"friction": friction, "contact": contact}
    rig = make_rig(seed, (("cogging", strength),), sensors=sensors, **laws, **how)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    (trial,) = trace(residual(measured, Model(paper_drive())), only=("cogging",))
    return measured, adopt(measured, trial, 2).base, rig.label["effect_parameters"]["cogging"]


@pytest.mark.parametrize(("sensors", "open_"), [("load", True), ("all", False)])
def test_how_large_a_ripple_is_stays_open_where_motors_turn_unmeasured(sensors, open_):
    _, base, _ = of_magnets(41, 1.0, sensors, "karnopp", "eq21", LOGS)
    known = augment.loosened(base, 2)
    assert known.mean.shape == (base.p.size + 2,)
    balances = np.linalg.inv(augment.LOOSE * base.covariance)
    n = base.p.size
    own = [i for i, k in enumerate(base.unknowns) if k.effect == "cogging"]
    assert own
    if open_:
        priors = [base.unknowns[i].prior ** -2 for i in own]
        np.testing.assert_allclose(known.precision[np.ix_(own, own)], np.diag(priors), rtol=1e-6)
        assert np.all(np.diag(balances)[own] > 4.0 * np.array(priors))
    else:
        np.testing.assert_allclose(known.precision[:n, :n], balances, rtol=1e-9)
    assert not known.precision[n:].any()


def test_bounces_tell_a_large_ripple_that_balances_see_badly():
    """It opens the meshes, and one motor's is seen as the other's."""
    measured, base, true = of_magnets(450100023, 3.0, "load", "karnopp", "eq21")
    size = true["amplitude_N_m"]
    told = base.model.effects["cogging"]
    assert told["order"] == true["order"]
    assert np.hypot(told["right_cosine"], told["right_sine"]) > 0.5 * size  # it has none
    fit = augment.augment(measured.fit, base, measured.drive)
    told = fit.model.effects["cogging"]
    assert fit.horizon >= 0.1
    assert np.hypot(told["left_cosine"], told["left_sine"]) == pytest.approx(size, rel=0.1)
    assert np.hypot(told["right_cosine"], told["right_sine"]) < 0.1 * size
