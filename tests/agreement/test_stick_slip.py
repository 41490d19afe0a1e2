"""Where bodies stick and slip and flanks are left and hit."""

import numpy as np
import pytest

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop

DT = 1e-3  # s
SHORTEST = 5  # samples of rest that count as sticking
SPEED = OUTPUTS.index("omega_L")


def rests(moves):
    """First and last sample of each stretch of rest."""
    padded = np.concatenate([[True], moves, [True]])
    edges = np.flatnonzero(np.diff(padded))
    starts, ends = edges[::2], edges[1::2] - 1
    long = ends - starts + 1 >= SHORTEST
    return starts[long], ends[long]


def sine(paper):
    """Open loop, the paper's second kind of run: long rests around each reversal."""
    time = DT * np.arange(701)
    return np.tile(0.7 * np.sin(2 * np.pi * 2.0 * time), (2, 1))


def loop_run(paper):
    """Voltages of a closed-loop run with reversals, driven open loop."""
    time = DT * np.arange(501)
    per_degree = 180.0 / np.pi
    loop = Loop(kp=0.08 * per_degree, ki=1.5 * per_degree, limit=10.0)
    reference = np.deg2rad(10.0) * np.sin(2 * np.pi * 2.0 * time)
    u, _ = close_loop(paper, loop, reference, DT)
    return u


@pytest.fixture(scope="module", params=[sine, loop_run])
def run(request, paper):
    u = request.param(paper)
    time = DT * np.arange(u.shape[1])
    return time, u, simulate(paper, time, u, method="reference").outputs


def test_breakaway_times_to_a_millisecond(paper, run):
    """Ring gear by its speed, chains by their motors' angles, all at default substeps."""
    time, u, exact = run
    found = simulate(paper, time, u).outputs
    seen = 0
    for name in ("omega_L", "theta_ml", "theta_mr"):
        a, b = (rows[OUTPUTS.index(name)] for rows in (found, exact))
        if name != "omega_L":
            a, b = (np.append(0.0, np.diff(x)) for x in (a, b))
        (stops, starts), (stops_exact, starts_exact) = rests(a != 0.0), rests(b != 0.0)
        assert starts.size == starts_exact.size, name
        assert np.abs(starts - starts_exact).max() <= 1, name  # samples of 1 ms
        assert np.abs(stops - stops_exact).max() <= 1, name
        seen += starts.size
    assert seen >= 4


def test_compiled_stays_at_the_reference(paper, run):
    """Share of the motion's range at default substeps, through rattle."""
    time, u, exact = run
    found = simulate(paper, time, u).outputs
    rms = np.sqrt(np.mean((found - exact) ** 2, axis=1)) / np.ptp(exact, axis=1)
    assert rms[OUTPUTS.index("theta_L")] < 2e-3
    assert rms[SPEED] < 2e-2


def test_order_through_contacts(paper):
    """Flanks hit and left, bodies stopped and started: still second order in the step.

    Each event shifts the error constant, so the slope is taken over a factor of 64.
    """
    time = DT * np.arange(201)
    u = np.tile(0.7 * np.sin(2 * np.pi * 5.0 * time), (2, 1))
    exact = simulate(paper, time, u, method="reference").outputs
    assert np.count_nonzero(np.diff(np.sign(exact[OUTPUTS.index("torque_l")]))) >= 4
    steps = np.array([8, 16, 32, 64, 128, 256, 512])
    errors = [
        np.sqrt(np.mean((simulate(paper, time, u, substeps=int(s)).outputs - exact) ** 2, axis=1))
        for s in steps
    ]
    orders = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert np.all(orders > 1.7), dict(zip(OUTPUTS, orders, strict=True))
    assert np.all(errors[-1] < 1e-5 * np.ptp(exact, axis=1))


def test_blocks_stick_and_slip(paper, lively):
    """Without located events, by error control alone."""
    time, u, x0 = lively
    exact = simulate(paper, time, u, x0, method="reference").outputs
    found = simulate(paper, time, u, x0, method="blocks").outputs
    rms = np.sqrt(np.mean((found - exact) ** 2, axis=1)) / np.ptp(exact, axis=1)
    assert np.all(rms < 2e-3), dict(zip(OUTPUTS, rms, strict=True))
