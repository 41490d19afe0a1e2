"""The sampled speed loop: by hand, and against the continuous one of the blocks."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.blocks import initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import (
    OUTPUTS,
    Loop,
    close_loop,
    march,
    rest,
)
from dmptm_ctrl.simulate.dual import start
from dmptm_ctrl.simulate.observer import observer_gains, rigid_observer
from dmptm_ctrl.simulate.run import advance, start_state, structure_for

PER_DEGREE = 180.0 / np.pi
LOOP = Loop(kp=0.08 * PER_DEGREE, ki=1.5 * PER_DEGREE, limit=1.0, bias_l=0.15, bias_r=-0.15)
DT = 1e-3  # s


@pytest.fixture(scope="module")
def closed(paper):
    reference = np.deg2rad(15.0) * np.sin(2 * np.pi * 1.0 * DT * np.arange(600))
    noise = 9e-4 * np.random.default_rng(3).normal(size=reference.size)
    return reference, noise, *close_loop(paper, LOOP, reference, DT, noise=noise)


def test_controller_by_hand(closed):
    """PI on the noisy reading, clip of the common voltage, preload on top."""
    reference, noise, u, out = closed
    error = reference - (out[:, OUTPUTS.index("omega_L")] + noise)
    common = np.clip(LOOP.kp * error + LOOP.ki * DT * np.cumsum(error), -1.0, 1.0)
    np.testing.assert_allclose(u[0], common + 0.15, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(u[1], common - 0.15, rtol=1e-12, atol=1e-12)


def test_closed_run_is_the_open_run_of_its_voltages(paper, closed):
    _, _, u, out = closed
    again = march(paper, u, rest(paper, 0.0), DT)
    np.testing.assert_array_equal(again, out)


def test_clip_is_reached(paper):
    """The premise of the limit: a step beyond it."""
    u, _ = close_loop(paper, LOOP, np.full(50, 5.0), DT)
    assert u[0].max() == pytest.approx(LOOP.limit + LOOP.bias_l)


def test_sampled_loop_tends_to_the_continuous_one(frictionless):
    """First order in the sample time; the limit is the run of the PI block."""
    model = frictionless.with_values(gap_l=0.0, gap_r=0.0)
    loop = LOOP._replace(limit=10.0)
    end = 0.12  # s

    def target(t):
        return 0.1 * np.sin(2 * np.pi * 5.0 * t)

    sys = to_blocks(model, loop=loop)
    run = solve_ivp(
        lambda t, x: sys.dynamics(t, x, np.atleast_1d(target(t))),
        (0.0, end),
        initial_state(model, sys, np.zeros(6)),
        rtol=1e-8,
        atol=1e-11,
    )
    limit = run.y[sys.state_labels.index("ring_omega"), -1]
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        _, out = close_loop(model, loop, target(dt * np.arange(round(end / dt) + 1)), dt)
        errors.append(abs(out[-1, OUTPUTS.index("omega_L")] - limit))
    assert errors[0] < 0.02 * np.ptp(run.y[sys.state_labels.index("ring_omega")])
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 1.0) < 0.2), orders


def test_observer_leaves_a_perfect_run_alone_and_draws_in_a_wrong_one(paper, closed):
    _, _, u, out = closed
    angle = np.ascontiguousarray(out[:, 0])
    gains = observer_gains(2.0, DT)
    x0 = rest(paper, 0.0)
    kept = march(paper, u, x0, DT, observer=gains, measured=angle)
    np.testing.assert_allclose(kept, out, rtol=0.0, atol=1e-8)
    # An angle off by 1 mrad all along: the rigid mode follows, the meshes do not feel it.
    off = march(paper, u, x0, DT, observer=gains, measured=angle + 1e-3)
    assert abs(off[-1, 0] - angle[-1] - 1e-3) < 1e-4
    free = simulate(paper, DT * np.arange(angle.size), u).outputs
    np.testing.assert_array_equal(free[0], angle)


def test_a_led_run_goes_on_where_it_was_cut(paper, closed):
    """Bit for bit; and free from there it is another run."""
    _, _, u, out = closed
    plant = paper.plant()
    begun = start_state(structure_for(plant), *start(plant, rest(paper, 0.0)))
    angle = out[None, :, 0] + 1e-3
    lead = {"observer": rigid_observer(plant, 0, observer_gains(2.0, DT))}
    whole = advance(plant, begun, u, DT, 8, **lead, measured=angle)
    first = advance(plant, begun, u[:, :200], DT, 8, **lead, measured=angle[:, :200])
    second = advance(plant, first.state, u[:, 200:], DT, 8, **lead, measured=angle[:, 200:])
    np.testing.assert_array_equal(np.vstack([first.rows, second.rows]), whole.rows)
    free = advance(plant, first.state, u[:, 200:], DT, 8)
    assert np.abs(free.readings[0, 0] - angle[0, 200]) < 1e-4  # from where the sensor says
    assert np.abs(free.readings - second.readings).max() > 1e-5


def test_a_run_may_begin_late(paper):
    """A shake that begins a quarter of its period late has the other phase."""
    u, x0, hz = np.zeros((2, 400)), rest(paper, 0.0), 8.0
    shaken = [
        paper.with_effect("base_vibration", frequency=hz, **wave)
        for wave in ({"cosine": 60.0, "sine": 0.0}, {"cosine": 0.0, "sine": -60.0})
    ]
    late = march(shaken[0], u, x0, DT, begin=0.25 / hz)
    other = march(shaken[1], u, x0, DT)
    np.testing.assert_allclose(late, other, rtol=0.0, atol=1e-9)
    assert np.ptp(other[:, 0]) > 1e-4
