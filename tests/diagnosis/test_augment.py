"""What a refit inside the simulator knows where its lock holds nowhere."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis import augment
from dmptm_ctrl.diagnosis.at_rest import NAME, sized
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import unknowns_of
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
