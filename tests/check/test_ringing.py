"""Logs that begin in motion: a load that nothing measures has rung since before."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.check import evidence
from dmptm_ctrl.check.ringing import poles_of, ringing
from dmptm_ctrl.check.run import check
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

TRUTH = Machine(j1=2e-4, j2=4e-4, k=4.0, c=3e-3, fc=0.02, fs=0.02, b1=2.4e-3, b2=4e-4, emf=0.0)
SHAFT = 'stiffness = "4 N m/rad ± 30 %"\ndamping = "0.003 N m s/rad ± 50 %"'
BENCH = Bench(
    TRUTH, kinds=(("square", 4.0),), sensors=("position",), extra={"shaft": SHAFT}, counts=65536
)
VALUES = {
    "body.motor.inertia": TRUTH.j1, "body.motor.viscous": TRUTH.b1,
    "body.load.inertia": TRUTH.j2, "body.load.viscous": TRUTH.b2,
}  # fmt: skip
FROM, TO = 3.0, 5.5  # s


def logged(truth):
    """Model of the machine that all is about, and a log of another that begins at rest."""
    rig = parse_rig(BENCH.rig(), "rig.toml")
    friction = Placed("coulomb_friction", "motor", {"level": TRUTH.fc})
    (columns,) = BENCH.with_(machine=truth).logs().values()
    (log,) = rig.read([pd.DataFrame(columns)])
    return RigModel(rig, (friction,), VALUES), log


def test_poles_of_a_load_on_a_shaft_in_closed_form():
    model, log = logged(TRUTH)
    (pole,) = poles_of(model, [0])
    decay = (TRUTH.c + TRUTH.b2) / (2 * TRUTH.j2)
    assert pole == pytest.approx(complex(-decay, np.sqrt(TRUTH.k / TRUTH.j2 - decay**2)))
    assert poles_of(model, [0, 1]).size == 0
    (waves,) = ringing(model, balance_of(model.rig, [log]))
    assert waves.shape[1] == 2  # how far it was, and how fast


def test_a_log_that_begins_in_motion_is_of_the_same_machine(monkeypatch):
    model, log = logged(TRUTH)
    floor = evidence.evidence_of(model, [log]).torque_rms
    cut = log.segment(FROM, TO)
    assert check(model, [cut], floor=floor).same

    def none(_, balance):
        return tuple(np.zeros((m.rows.size, 0)) for m in balance.motions)

    monkeypatch.setattr(evidence, "ringing", none)
    assert not check(model, [cut], floor=floor).same  # the premise


def test_a_change_shows_in_a_log_that_begins_in_motion():
    model, log = logged(replace(TRUTH, fc=1.2 * TRUTH.fc, fs=1.2 * TRUTH.fs))
    moved = check(model, [log.segment(FROM, log.time[-1])]).moved
    assert moved[0].entry.name == "coulomb_friction@motor"
    assert moved[0].change == pytest.approx(0.2, abs=0.05)


def test_logs_that_are_too_short_for_single_entries_are_called_so():
    """Two seconds say hardly anything of how errors scatter from second to second."""
    model, log = logged(replace(TRUTH, fc=1.2 * TRUTH.fc, fs=1.2 * TRUTH.fs))
    short, long = (check(model, [log.segment(FROM, end)]) for end in (TO, log.time[-1]))
    assert short.moved == []
    (said,) = short.warnings
    assert said.startswith("too short to show whether these have changed: ")
    assert "coulomb_friction@motor" in said
    assert long.warnings == ()
