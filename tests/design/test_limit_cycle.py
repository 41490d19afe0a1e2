"""Harmonic balance against closed forms and against simulation."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.design.limit_cycle import limit_cycles, mesh_describing_function
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.simulate.compiled import Loop, close_loop
from dmptm_ctrl.simulate.model import Model

GAP = 4e-3  # rad
DT = 1e-3
EQUAL = Model().with_values(gap_l=GAP, gap_r=GAP)


def without(*kinds):
    return EQUAL.with_values(**{n: 0.0 for n in EQUAL.drive if n[:2] in kinds})


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


def simulated(model, kp, ki):
    """Frequency by zero crossings, √2 rms, half peak-to-peak of z, once it has settled."""
    ref = np.zeros(8000)
    ref[:300] = np.deg2rad(15.0)
    _, out = close_loop(model, Loop(kp, ki, 1e3), ref, DT, substeps=16)
    speed, z = out[-3000:, 1], out[-3000:, 6]
    up = np.flatnonzero((speed[:-1] < 0) & (speed[1:] >= 0))
    when = up - speed[up] / (speed[up + 1] - speed[up])
    hz = (when.size - 1) / (when[-1] - when[0]) / DT if when.size > 2 else 0.0
    return hz, np.sqrt(2) * speed.std(), np.ptp(z) / 2


@pytest.mark.parametrize(
    ("model", "kp", "ki"),
    [
        (without("T3", "TL", "B3", "BL"), 18.7, 1281.0),
        (without("T3", "TL", "B3", "BL"), 8.0, 1500.0),
        (without("T3", "TL"), 18.7, 1281.0),
        (without("T3", "TL"), 8.0, 1500.0),
    ],
)
def test_predicted_cycle_is_the_simulated_one(model, kp, ki):
    hz, amplitude, twist = simulated(model, kp, ki)
    found = limit_cycles(model, kp, ki)[0]
    assert found.hz == pytest.approx(hz, rel=0.03)
    assert found.amplitude == pytest.approx(amplitude, rel=0.03)
    assert found.twist == pytest.approx(twist, rel=0.03)
    assert abs(found.start_hz / hz - 1) > 0.05  # one harmonic is not enough


def test_sticking_friction_ends_it():
    assert limit_cycles(EQUAL, 8.0, 300.0) == []
    assert simulated(EQUAL, 8.0, 300.0)[1] == 0.0


def test_unequal_gaps_are_refused():
    with pytest.raises(ValueError, match="half-gaps differ"):
        limit_cycles(Model(), 8.0, 300.0)
