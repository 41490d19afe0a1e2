"""Harmonic balance against closed forms and against simulation."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.design import limit_cycle
from dmptm_ctrl.design.harmonic_balance import Balance, mesh_along
from dmptm_ctrl.design.harmonics import Basis
from dmptm_ctrl.design.limit_cycle import limit_cycles
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.simulate.batch import simulate_batch
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


def mesh_describing_function(law, amplitude, omega):
    """First harmonic of the mesh torque over z = amplitude · sin ωt [N·m/rad]."""
    points = Basis.of(1).points
    angle = 2.0 * np.pi * (np.arange(points) + 0.5) / points
    torque = np.empty((4, points))
    step = Basis.of(1).step(omega)
    mesh_along(amplitude * np.sin(angle), amplitude * omega * np.cos(angle), law, step, torque)
    return complex(2j * np.mean(torque[0] * np.exp(-1j * angle)) / amplitude)


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

    def left(y):
        return balance.equations(y, n)[0]

    step = 1e-7
    expected = np.array([(left(x + e) - left(x - e)) / (2 * step) for e in step * np.eye(x.size)]).T
    found = balance.equations(x, n)[1]
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


@pytest.mark.long
@pytest.mark.parametrize(
    ("gap", "dry", "kp", "ki"),
    [
        (GAP, 0.0, 8.0, 300.0),  # just outside the gap: pulses, which take many harmonics
        (2e-3, 0.3, 18.7, 1500.0),  # near a fold: a thousandth of the torque is 5 % in frequency
    ],
)
def test_predicted_cycle_is_the_simulated_one(gap, dry, kp, ki):
    predicted_is_simulated(gap, dry, kp, ki)


def predicted_is_simulated(gap, dry, kp, ki):
    model = drive(gap, dry)
    hz, amplitude, twist = simulated(model, kp, ki)
    cycles = limit_cycles(model, kp, ki, check=False)
    found = min(cycles, key=lambda c: abs(c.hz - hz))  # others exist that do not attract
    assert found.hz == pytest.approx(hz, rel=0.02)
    assert found.amplitude == pytest.approx(amplitude, rel=0.02)
    assert found.twist == pytest.approx(twist, rel=0.02)
    assert found.simulated is None
    assert not found.confirmed


@pytest.mark.long
def test_cycle_that_only_the_simulator_finds_is_balanced_and_confirmed(monkeypatch):
    """Two bounces on one flank, one on the other; no start of the balance's own leads there."""
    monkeypatch.setattr(limit_cycle, "HZ", limit_cycle.HZ[::3])
    model = drive(GAP, 1.0)
    hz, amplitude, _ = simulated(model, 8.0, 3000.0)
    (found,) = [c for c in limit_cycles(model, 8.0, 3000.0) if c.confirmed]
    assert found.seeded
    assert found.hz == pytest.approx(hz, rel=0.02)
    assert found.amplitude == pytest.approx(amplitude, rel=0.02)
    assert found.simulated.hz == pytest.approx(hz, rel=2e-3)
    assert found.miss < 0.05


def test_cycle_that_repels_is_not_confirmed():
    """Below a fold: the larger one attracts, from the smaller one the drive comes to rest."""
    large, small = limit_cycles(drive(2e-3, 0.3), 18.7, 300.0)
    assert large.confirmed
    assert large.hz == pytest.approx(simulated(drive(2e-3, 0.3), 18.7, 300.0)[0], rel=0.02)
    assert small.amplitude < 0.7 * large.amplitude
    assert not small.confirmed
    assert small.simulated is not None


def test_state_of_a_predicted_cycle_stays_on_it():
    """The simulator, started there, is on the cycle in its first period already."""
    balance = Balance(drive(GAP, 0.0), 18.7, 300.0, DT)
    z = 1.5 * GAP
    cycle = balance.guess(z, 600.0, balance.free_ring(z, 600.0))
    for n in (3, 15):
        cycle = balance.solve(cycle, n)
    state, volts = balance.state(cycle)
    count = int(2 * np.pi / cycle.omega / DT)
    run = simulate_batch(
        *([balance.model], np.arange(count) * DT, np.zeros(count), state[None]),
        loop=[Loop(18.7, 300.0, 1e3, volts, volts)],
        outputs=["omega_L", "z_l"],
        substeps=FINE,
    )
    n = np.arange(1, cycle.ring.size // 2 + 1)
    turn = np.exp(1j * cycle.omega * DT * np.outer(np.arange(count), n))
    for simulated_wave, packed in zip(run.outputs[0], (cycle.ring, cycle.z[0]), strict=True):
        wave = packed[0] + (turn @ (packed[1 : n.size + 1] + 1j * packed[n.size + 1 :])).real
        np.testing.assert_allclose(simulated_wave, wave, atol=0.05 * np.abs(wave).max())


def test_sticking_friction_ends_it():
    model = drive(GAP, 1.0)
    assert limit_cycles(model, 8.0, 300.0) == []
    assert simulated(model, 8.0, 300.0)[1] == 0.0


def test_effects_that_depend_on_angle_are_refused():
    with pytest.raises(ValueError, match="effects on load"):
        limit_cycles(Model().with_effect("unbalance", cosine=4.0, sine=0.0), 8.0, 300.0)
