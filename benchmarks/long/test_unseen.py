"""What the balances tell nothing of, too long for CI: ``python -m pytest benchmarks/long``."""

import numpy as np
import pytest
from tests.recovery.test_unseen import fitted

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.decide import Decision
from dmptm_ctrl.diagnosis.diagnose import uncovered
from dmptm_ctrl.diagnosis.landings import enter, race_first, variants
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.lock import LOST, UNEASY
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
