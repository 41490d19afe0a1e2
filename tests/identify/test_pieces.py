"""Long logs: pieces from each tenth stand for them, with times, names and signals of the whole."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig, split
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.free_parameters import free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.measured_motion import HELD_STRETCHES
from dmptm_ctrl.identify.rig_fit import fit_rig, residuals
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DT = 2e-3
INERTIA, VISCOUS, RISE = 0.02, 0.05, 0.5
RIG = parse_rig(
    """
[body.rotor]
inertia = "0.022 kg m^2 ± 20 %"
viscous = "0.045 N m s/rad ± 30 %"
[input.drive]
column = "T"
unit = "N m"
body = "rotor"
[sensor.encoder]
column = "q"
unit = "rad"
body = "rotor"
""",
    "rig.toml",
)
MODEL = RigModel(RIG)


def moved(seconds, name="long"):
    """A motion of five sines, and the torque of which each sample holds the mean."""
    t = DT * np.arange(round(seconds / DT))
    waves = [(0.7, 3.0), (1.9, 1.5), (4.1, 0.6), (7.3, 0.3), (0.11, 5.0)]
    q = sum(a * np.sin(2 * np.pi * f * t + f) for f, a in waves)
    v = sum(2 * np.pi * f * a * np.cos(2 * np.pi * f * t + f) for f, a in waves)
    rise = 1.0 + RISE * t / seconds
    torque = INERTIA * np.diff(v) / DT + VISCOUS * rise[:-1] * np.diff(q) / DT
    return Log(name, t[:-1], {"in_drive": torque, "out_encoder": q[:-1]})


@pytest.fixture(scope="module")
def whole():
    return balance_of(RIG, [moved(120.0), moved(20.0, "short")])


def test_pieces_lie_in_each_tenth_and_are_parts_of_the_whole(whole):
    cut = whole.at_most(30_000)
    long, short = whole.motions
    pieces = cut.motions[:-1]
    assert cut.motions[-1] is short
    assert [p.tenth for p in pieces] == [*range(10)]
    assert sum(p.time.size for p in pieces) == (30_000 - short.time.size) // 10 * 10
    for p in pieces:
        assert p.time[0] * 10 // long.time[-1] == p.time[-1] * 10 // long.time[-1] == p.tenth
        assert np.array_equal(p.time, long.time[p.samples])
        assert np.array_equal(p.a["encoder"], long.a["encoder"][p.samples])


def test_a_piece_leaves_what_the_whole_leaves_there(whole):
    state = State(MODEL)
    (left, *_), _ = residuals(state, whole)
    rows = whole.motions[0].rows
    for piece, own in zip(
        whole.at_most(40_000).motions, residuals(state, whole.at_most(40_000))[0], strict=True
    ):
        if piece.tenth is None:
            continue
        inside = own[0] != 0.0
        there = np.interp(piece.rows[inside], rows, left[0])
        assert np.abs(own[0][inside] - there).max() < 0.05 * np.abs(left).max()


@pytest.mark.parametrize("most", [1, 30_000, 80_000])
def test_pieces_keep_rows_enough(whole, most):
    assert all(m.rows.size >= 60 for m in whole.at_most(most).motions)


def test_held_out_pieces_are_whole_tenths():
    balance = balance_of(RIG, [moved(120.0)]).at_most(20_000)
    fitted, held, names, on = split(RIG, balance)
    assert {m.tenth for m in held.motions} == {*HELD_STRETCHES}
    assert {m.tenth for m in fitted.motions} == {*range(10)} - {*HELD_STRETCHES}
    assert not names
    assert on == "held-out parts of every log"
    log = moved(120.0)
    runs = Runs.none_yet(RIG, [log], held, 1)
    assert len(runs.logs) == 1
    assert runs.held[0].mean() == pytest.approx(0.3, abs=1e-3)


def test_what_belongs_to_a_log_belongs_to_all_its_pieces():
    """An encoder that starts anywhere has one zero in each log."""
    balance = balance_of(RIG, [moved(120.0), moved(20.0, "short")]).at_most(30_000)
    cogging = Placed("cogging", "rotor", {"order": 12.0, "cosine": 0.01, "sine": 0.0})
    frees = free_parameters(MODEL.with_effect(cogging), balance, scales_of(balance))
    assert [f.owner for f in frees if f.kind == "zero"] == ["short"]


def test_numbers_of_the_pieces_are_those_of_the_whole(whole):
    short = whole.only(["long"]).at_most(20_000)
    found = [fit_rig(State(MODEL), b).values for b in (whole.only(["long"]), short)]
    for name in found[0]:
        assert found[1][name] == pytest.approx(found[0][name], rel=0.02)


@pytest.mark.long
def test_a_drift_over_a_long_log_is_found(monkeypatch):
    monkeypatch.setattr("dmptm_ctrl.diagnosis.rig_diagnose.SAMPLES", 20_000)
    reported = diagnose_rig([moved(120.0)], RIG, jobs=1)
    assert any("of 119.996 s, 10 pieces of 4 s each are fitted" in w for w in reported.warnings)
    assert [e.name for e in reported.effects] == ["thermal_drift"]
    assert reported.verdict == "explained"
