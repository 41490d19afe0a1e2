"""Where nothing switches, blocks, compiled loop and reference are the same to 1e-6."""

import numpy as np
import pytest

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS

SAME = 1e-6  # of each output's range


@pytest.fixture(scope="module")
def exact(paper, smooth):
    time, u, x0 = smooth
    return simulate(paper, time, u, x0, method="reference").outputs


def relative_error(outputs, exact):
    return np.abs(outputs - exact).max(axis=1) / np.ptp(exact, axis=1)


def test_run_is_smooth(paper, exact):
    """The premise: both meshes stay closed, the ring gear never slows to rest."""
    z_l, z_r, speed = (exact[OUTPUTS.index(name)] for name in ("z_l", "z_r", "omega_L"))
    assert np.all(z_l > paper.drive["gap_l"])
    assert np.all(z_r < -paper.drive["gap_r"])
    assert np.ptp(speed) > 0.02
    assert speed.min() > 0.1


def test_compiled_is_the_reference(paper, smooth, exact):
    time, u, x0 = smooth
    found = simulate(paper, time, u, x0, substeps=256).outputs
    assert np.all(relative_error(found, exact) < SAME)


def test_blocks_are_the_reference(paper, smooth, exact):
    (time, u, x0), n = smooth, 31  # they are slow
    options = {"rtol": 1e-10, "atol": 1e-13}
    found = simulate(paper, time[:n], u[:, :n], x0, method="blocks", **options).outputs
    assert np.all(np.abs(found - exact[:, :n]).max(axis=1) < SAME * np.ptp(exact[:, :n], axis=1))


def test_compiled_loop_is_second_order(paper, smooth, exact):
    time, u, x0 = smooth
    steps = np.array([2, 4, 8, 16, 32, 64])
    errors = np.array(
        [
            relative_error(simulate(paper, time, u, x0, substeps=int(s)).outputs, exact)
            for s in steps
        ]
    )
    orders = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert np.all(np.abs(orders - 2.0) < 0.1), dict(zip(OUTPUTS, orders, strict=True))


def test_reference_does_not_depend_on_its_tolerance(paper, smooth, exact):
    time, u, x0 = smooth
    found = simulate(paper, time, u, x0, method="reference", rtol=1e-8).outputs
    assert np.all(relative_error(found, exact) < 1e-7)
