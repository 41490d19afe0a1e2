"""A fit that keeps step goes on with each log for as long as its run tells of the drive."""

from dataclasses import replace

import numpy as np
import pytest

from dmptm_ctrl.identify.fit import Fit, Known, drive_unknowns, place, position
from dmptm_ctrl.identify.longer import LEAST_SECONDS, longer, told
from dmptm_ctrl.identify.records import record
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, OUTPUTS, Loop, close_loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
TIME = DT * np.arange(2500)
LOOP = Loop(0.08 / DEG, 1.5 / DEG, 10.0, 0.15, -0.15)
SETPOINTS = {  # deg/s
    "rest": 0.0 * TIME,
    "slow": 4.0 * np.sin(1.3 * np.pi * TIME),
    "trapezoid": 15.0 * np.clip(np.minimum(TIME / 0.3, 1.0 - (TIME - 0.7) / 0.3), -1.0, 1.0),
    "fast": 15.0 * np.sin(1.2 * np.pi * TIME),
}
WRONG = ("T3c_minus", "TLc_minus")  # drag on the way back, which no log tells before 0.75 s
OFF, KNOWN = 0.2, 0.02  # half-ranges of what is declared: by which it is wrong; the rest is known


@pytest.fixture(scope="module")
def plant():
    """A drive inside its declared ranges, and where in them."""
    model = Model()
    unknowns = drive_unknowns(model)
    p = position(model, unknowns) + np.random.default_rng(1).uniform(-0.6, 0.6, len(unknowns))
    return place(model, unknowns, p), p


@pytest.fixture(scope="module")
def records(plant):
    rng = np.random.default_rng(2)
    several = []
    for name, setpoint in SETPOINTS.items():
        u, out = close_loop(plant[0], LOOP, setpoint * DEG, DT, substeps=FINE_SUBSTEPS)
        columns = {n: out[:, OUTPUTS.index(n)].copy() for n in OUTPUTS[:2]}
        columns["omega_L"] += 0.05 * DEG * rng.standard_normal(TIME.size)
        log = Log(name, TIME, {"u_left": u[0], "u_right": u[1], **columns})
        several.append(record(log, plant[0].drive))
    return several


def astray(plant, horizon):
    """A fit that is wrong about the way back, and what is known of its unknowns."""
    model, p = plant
    unknowns = drive_unknowns(Model())
    open_ = np.array([k.name in WRONG for k in unknowns])
    wrong, spread = p + OFF * open_, np.where(open_, 1.5 * OFF, KNOWN)
    fit = Fit(place(model, unknowns, wrong), unknowns, wrong, np.diag(spread**2), horizon)
    return fit, Known(wrong, np.diag(spread**-2))


def test_friction_of_the_way_back(plant, records):
    start, known = astray(plant, LEAST_SECONDS)
    done = longer(records, start, known, 2)
    off = done.p - plant[1]
    error = np.sqrt(np.diag(done.covariance))
    for k, miss, sigma in zip(start.unknowns, off, error, strict=True):
        assert abs(miss) < 4.0 * sigma, k.name
        if k.name in WRONG:
            assert abs(miss) < 0.1 * OFF
    assert np.linalg.norm(off) < 0.2 * np.linalg.norm(start.p - plant[1])
    np.testing.assert_allclose(done.p, position(done.model, start.unknowns), atol=1e-12)


def test_who_loses_step_early_does_not_go_on(plant, records):
    start, known = astray(plant, 0.4)
    assert longer(records, start, known, 2) is start


def test_a_log_ends_where_other_meshes_are_elsewhere(plant, records):
    """As long as it is met it goes on; at rest nothing is ever elsewhere."""
    seconds = TIME.size * DT
    assert told(plant[0], records, 2) == pytest.approx([seconds] * len(records))
    late = [replace(rec, omega=np.roll(rec.omega, 30)) for rec in records]
    ends = dict(zip(SETPOINTS, told(plant[0], late, 2), strict=True))
    assert ends["rest"] == pytest.approx(seconds)
    assert 0.1 < ends["fast"] < 0.8 * ends["slow"]
