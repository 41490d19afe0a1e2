"""Harmonic balance against closed forms and against simulation."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.design.harmonic_balance import Balance
from dmptm_ctrl.design.limit_cycle import limit_cycles, mesh_describing_function
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.simulate.compiled import Loop, close_loop
from dmptm_ctrl.simulate.model import Model

GAP = 4e-3  # rad
DT = 1e-3
FINE = 32  # steps per sample


def drive(gap, dry, viscous=1.0):
    """Equal half-gaps; dry and viscous friction as shares of Table 2."""
    shares = {"T3": dry, "TL": dry, "B3": viscous, "BL": viscous}
    values = {n: shares[n[:2]] * v for n, v in Model().drive.items() if n[:2] in shares}
    return Model().with_values(gap_l=gap, gap_r=gap, **values)


@pytest.mark.parametrize("depth", [1.1, 2.0, 10.0])
def test_describing_function_of_an_undamped_mesh(depth):
    """A dead zone is 1 minus a saturation; python-control owns the saturation."""
    law = Backlash(stiffness=2.0, damping=0.0, gap_damping=0.0, half_gap=GAP)
    found = mesh_describing_function(law, depth * GAP, 30.0)
    expected = 2.0 * (1 - ct.saturation_nonlinearity(GAP).describing_function(depth * GAP))
    assert found == pytest.approx(complex(expected), abs=2e-5)


def test_damping_leads():
    law = Backlash(stiffness=2.0, damping=1e-2, gap_damping=1e-3, half_gap=GAP)
    assert mesh_describing_function(law, 2 * GAP, 30.0).imag > 0
    closed = law._replace(half_gap=0.0, damping=1e-3)  # k + jωc, but for teeth that never pull
    assert mesh_describing_function(closed, 1.0, 30.0).imag == pytest.approx(0.03, rel=0.01)


def test_derivatives_against_differences():
    """Two chains that differ, all unknowns, the frequency among them."""
    balance = Balance(drive(GAP, 0.3).with_values(gap_r=3e-3), 8.0, 1500.0, DT, preload=0.1)
    n, rng = 4, np.random.default_rng(0)
    x = 0.5 * rng.standard_normal(2 * (2 * n + 1) + 2 * n + 2)
    x[-1] = np.log(100.0)
    setpoint = 0.1 * rng.standard_normal(2 * n + 1)

    def left(y):
        return balance.equations(y, n, None, setpoint)[0]

    step = 1e-7
    expected = np.array([(left(x + e) - left(x - e)) / (2 * step) for e in step * np.eye(x.size)]).T
    found = balance.equations(x, n, None, setpoint)[1]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def simulated(model, kp, ki):
    """Frequency by zero crossings, √2 rms, half peak-to-peak of z, once it has settled."""
    ref = np.zeros(7000)
    ref[:300] = np.deg2rad(15.0)
    _, out = close_loop(model, Loop(kp, ki, 1e3), ref, DT, substeps=FINE)
    speed, z = out[-3000:, 1], out[-3000:, 6]
    up = np.flatnonzero((speed[:-1] < 0) & (speed[1:] >= 0))
    when = up - speed[up] / (speed[up + 1] - speed[up])
    hz = (when.size - 1) / (when[-1] - when[0]) / DT if when.size > 2 else 0.0
    return hz, np.sqrt(2) * speed.std(), np.ptp(z) / 2


@pytest.mark.parametrize(
    ("gap", "dry", "kp", "ki"),
    [
        (GAP, 0.0, 8.0, 300.0),  # just outside the gap: pulses, which take many harmonics
        (GAP, 0.1, 8.0, 1500.0),
        (GAP, 0.3, 8.0, 1500.0),  # the ring sticks for a tenth of the time
        (GAP, 0.3, 18.7, 300.0),
        (GAP / 2, 0.3, 8.0, 3000.0),
        (GAP, 1.0, 18.7, 3000.0),  # for a sixth
        (GAP, 1.0, 8.0, 6000.0),
    ],
)
def test_predicted_cycle_is_the_simulated_one(gap, dry, kp, ki):
    model = drive(gap, dry)
    hz, amplitude, twist = simulated(model, kp, ki)
    cycles = limit_cycles(model, kp, ki)
    found = min(cycles, key=lambda c: abs(c.hz - hz))  # others exist that do not attract
    assert found.hz == pytest.approx(hz, rel=0.03)
    assert found.amplitude == pytest.approx(amplitude, rel=0.03)
    assert found.twist == pytest.approx(twist, rel=0.03)


def test_sticking_friction_ends_it():
    model = drive(GAP, 1.0)
    assert limit_cycles(model, 8.0, 300.0) == []
    assert simulated(model, 8.0, 300.0)[1] == 0.0


def test_effects_that_depend_on_angle_are_refused():
    with pytest.raises(ValueError, match="effects on load"):
        limit_cycles(Model().with_effect("unbalance", cosine=4.0, sine=0.0), 8.0, 300.0)
