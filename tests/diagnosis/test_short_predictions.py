"""What short predictions show and balances do not, on rigs of another program."""

import sys
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, key_of
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import of_windows, predicting, residual
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.diagnosis.short_predictions import with_short_predictions
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.observer_driven import ObserverRun
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_sine_0v75", "open_square_0v60", "open_square_0v75")
LAWS = {"friction": "karnopp", "contact": "eq21", "sensors": "load"}


@cache
def fitted(effects, seed=5, spread=None):
    """The declared model fitted to short logs without motor encoders."""
    rig = make_rig(seed, effects, logs=LOGS, spread=spread, **LAWS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    return measured, DualState(residual(measured, Model(paper_drive()), jobs=2))


def looked_at(effects):
    """Selection by short predictions alone."""
    measured, base = fitted(effects)
    return with_short_predictions(DualEvidence(measured, (), 2), Selection(base, base))


def test_what_balances_do_not_see_is_named():
    found = looked_at((("presliding", 2.0),))
    assert [e.key for e in found.entries] == [key_of("presliding")]
    (entry,) = found.entries
    assert entry.probability > 0.9
    assert entry.held_gain > 0.0


def test_nothing_is_named_where_nothing_lacks():
    found = looked_at(())
    assert found.entries == []
    assert found.final is found.base


def test_runs_that_go_together_miss_what_each_misses():
    """Lanes against single runs; impacts let rounding grow, so most rows are compared."""
    measured, base = fitted(())
    model = base.left.base.model
    models = [model, model.with_effect("unbalance", cosine=2.0, sine=0.0)]
    one = ObserverRun(measured.fit[0])
    together = one.missing_of(models)
    apart = np.array([one.missing(m) for m in models])
    assert np.quantile(np.abs(together - apart), 0.9) < 1e-3 * np.std(apart[1] - apart[0])


def test_a_fitted_drive_predicts_as_well_as_the_true_one():
    """What both leave is the noise of the gyro in blocks, and what that of the angle adds."""
    measured, base = fitted((), spread=0.0)
    left = predicting(base.left)
    parts = zip(left.base.parts, left.balance.kinds, strict=True)
    ours = usual([part for part, kind in parts if kind == "observer"])
    true = usual([ObserverRun(rec).missing(Model(paper_drive())) for rec in measured.fit])
    gyro = np.deg2rad(0.05) / np.sqrt(ObserverRun(measured.fit[0]).block)
    assert gyro < true < 2.0 * gyro
    assert ours < 1.05 * true


def usual(rows):
    """Standard deviation of what is left most of the time: of a normal law, by the median."""
    return np.median(np.abs(np.concatenate(rows))) / 0.6745


def test_balances_alone_keep_what_they_do_not_see():
    _, base = fitted(())
    left = predicting(base.left)
    model = left.base.model.with_effect("presliding", ring_distance=1e-4)
    assert of_windows(base.left) is base.left
    left.base = type(left.base)(
        model,
        left.base.unknowns,
        left.base.p,
        left.base.covariance,
        left.base.loss,
        left.balance.missing(model),
        left.balance.kinds,
        left.base.jacobian,
    )
    back = of_windows(left)
    assert not back.balance.observer_driven
    assert back.base.model.effects["presliding"]["ring_distance"] == 1e-4
