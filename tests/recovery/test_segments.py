"""Reversals cut from logs, and what shakes the pinions where no encoder sees them."""

from dataclasses import replace

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.decide import FIRST
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.led import LEAD_HZ, LEAD_SUBSTEPS, side_by_side
from dmptm_ctrl.identify.lock import LOST, NOISE_LEVEL, level
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.segments import FREE_SECONDS, PRESSED_SECONDS, openings, reversals
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, march, observer_gains, rest
from dmptm_ctrl.simulate.model import Model, stacked
from rigs import make_rig

DT, HZ = 1e-3, 0.4
KARNOPP = {"friction": "karnopp"}


@pytest.fixture(scope="module")
def turned():
    """A run of the model itself over four reversals, as a record; (model, record)."""
    model = Model()
    t = DT * np.arange(6000)
    u = np.ascontiguousarray([1.6 * np.sin(2.0 * np.pi * HZ * t)] * 2)
    x0 = rest(model, 0.3)
    out = march(model.arrays(), u, x0, DT)
    return model, Record("own", DT, u, out[:, 0], out[:, 1], None, x0, 5, t)


def test_reversals_are_behind_the_turns_of_the_voltage(turned):
    model, rec = turned
    parts = reversals([rec], model, 0.1)
    turns = 0.5 / HZ * np.arange(1, 5)
    opened = [part.time[part.led] + FREE_SECONDS for part in parts]
    assert len(parts) == 4
    # friction keeps the meshes closed until the voltage has overcome it
    late = np.array(opened) - turns
    assert np.all((late > 0.0) & (late < 0.2))
    for part in parts:
        np.testing.assert_array_equal(part.u, rec.u[:, np.isin(rec.time, part.time)])


def test_the_model_meets_its_own_reversals_and_another_does_not(turned):
    model, rec = turned
    parts = reversals([rec], model, 0.1)
    assert level(model, parts, 0.07, 1) < 0.1 * NOISE_LEVEL  # there is no noise
    wider = model.with_values(gap_l=1.3 * model.drive["gap_l"])
    assert level(wider, parts, 0.07, 1) > LOST


def test_the_clock_is_that_of_a_run_from_the_start_of_the_log(turned):
    """Whatever the logger's clock showed there."""
    model, rec = turned
    own, late = (reversals([r], model, 0.1) for r in (rec, replace(rec, time=rec.time + 5.0)))
    for one, other in zip(own, late, strict=True):
        np.testing.assert_allclose(other.time, one.time, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("timed", [{}, {"base_vibration": {"cosine": 2.0, "frequency": 3.1}}])
def test_reversals_run_side_by_side_as_each_alone(turned, timed):
    """Of different times, which matter only to what depends on the time."""
    model, rec = turned
    for name, values in timed.items():
        model = model.with_effect(name, **values)
    parts = reversals([rec], model, 0.05)
    drives = [model.arrays(), model.with_values(gap_l=1.2 * model.drive["gap_l"]).arrays()]
    together = {}
    for rows, runs in side_by_side(parts, stacked(drives), 1, None):
        together |= zip(rows, runs, strict=True)
    assert sorted(together) == [*range(len(parts))]
    for i, part in enumerate(parts):
        runs = together[i]
        alone = [
            march(
                drive,
                part.u,
                part.x0,
                part.dt,
                substeps=FINE_SUBSTEPS,
                lead_substeps=LEAD_SUBSTEPS,
                observer=observer_gains(LEAD_HZ, part.dt),
                measured=part.theta[: part.led],
                begin=float(part.time[0]),
                meshes=False,
            )
            for drive in drives
        ]
        np.testing.assert_allclose(runs, alone, rtol=0.0, atol=1e-9)


def test_openings_need_both_meshes_closed_for_a_while():
    gaps, least = [1.0, 1.0], round(PRESSED_SECONDS / DT)
    z = np.full((1000, 2), 2.0)
    z[300:320, 0] = 0.0  # a bounce, and closed again on the same side
    z[380:, 1] = -2.0  # changes sides before it has been closed for long
    z[700:, :] = 0.0
    assert openings(z, gaps, least).tolist() == [300, 700]


def test_tooth_errors_shake_the_ring_without_motor_encoders():
    """No encoder sees the twist, but the flanks push the pinions, whose inertia shows."""
    rig = make_rig(7, (("mesh_error", 0.5),), sensors="load", **KARNOPP)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    drive = paper_drive()
    left = residual(measure(logs, drive), Model(drive))
    best, *others = trace(left, only=("mesh_error", "base_vibration", "unbalance"))
    assert best.name == "mesh_error"
    assert min(best.gain, best.held_gain) > FIRST
    assert best.held_gain > max(other.held_gain for other in others) + FIRST
    values = best.fit.model.effects["mesh_error"]
    both = sum(
        complex(values[f"{side}_cosine"], values[f"{side}_sine"]) for side in ("left", "right")
    )
    # the ring gear feels both pinions; which of them, it does not tell
    own = rig.record[0]
    wanted = own["tooth_error"] * np.exp(-1j * own["tooth_phase"]).sum()
    assert abs(both - wanted) < 0.1 * abs(wanted)
