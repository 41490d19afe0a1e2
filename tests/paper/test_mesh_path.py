"""Eq. 21 beside its two-state original along a motion: alike at constant rate, apart else."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dmptm_ctrl.effects.backlash import Backlash, gap_rate
from dmptm_ctrl.simulate.mesh_path import along_path

LAW = Backlash(3.6e4, 10.0, 0.5, 0.004)
RELAXATION = (LAW.damping + LAW.gap_damping) / LAW.stiffness


def crossing(rate):
    start = -LAW.half_gap - LAW.damping / LAW.stiffness * rate

    def z(t):
        return start + rate * t

    return along_path(z, lambda t: rate, 2.3 * LAW.half_gap / rate, LAW, position=-LAW.half_gap)


@pytest.mark.parametrize("rate", [0.3, 0.9])
def test_alike_at_constant_rate(rate):
    """From the flank left to contact on the other; the moment of contact is a jump."""
    path = crossing(rate)
    gap = np.abs(path.memoryless - path.two_state)
    landing = np.flatnonzero(path.position >= LAW.half_gap)[0]
    away = np.abs(np.arange(gap.size) - landing) > 2
    away &= path.time > 1e-3 * RELAXATION
    released = path.time > 12 * RELAXATION
    # between the flanks Eq. 21 gives c_f ż at once, the original after its relaxation
    assert gap[away & released].max() < 1e-3 * LAW.gap_damping * rate
    assert path.two_state[-1] > 1.0
    assert path.two_state[-1] == pytest.approx(path.memoryless[-1], rel=1e-12)


def test_position_against_scipy():
    """A sine within the gap: relaxation driven by a changing rate, by DOP853."""
    omega, depth = 2 * np.pi * 231.0, 1e-3

    def z(t):
        return depth * np.sin(omega * t)

    def rate(t):
        return depth * omega * np.cos(omega * t)

    path = along_path(z, rate, 2 / 231.0, LAW)
    exact = solve_ivp(
        lambda t, y: [gap_rate(y[0], z(t), rate(t), LAW)],
        (0.0, path.time[-1]),
        [0.0],
        method="DOP853",
        t_eval=path.time,
        rtol=1e-12,
        atol=1e-16,
    )
    np.testing.assert_allclose(path.position, exact.y[0], atol=1e-8 * depth)


def test_apart_where_the_rate_changes_in_the_gap():
    """Turned back within the relaxation time: the tooth is still bent, Eq. 21 knows nothing."""
    omega = 2 * np.pi * 231.0

    def z(t):
        return -LAW.half_gap + 1e-4 * (np.sin(omega * t) - 0.3)

    path = along_path(
        z, lambda t: 1e-4 * omega * np.cos(omega * t), 2 / 231.0, LAW, position=-LAW.half_gap
    )
    gap = np.abs(path.memoryless - path.two_state)
    assert gap.max() > 0.05
    still = crossing(0.3)
    steady = np.abs(still.memoryless - still.two_state)[still.time > 12 * RELAXATION]
    assert np.median(steady) < 1e-6


def test_no_damping_at_all():
    bare = LAW._replace(damping=0.0, gap_damping=0.0)
    with pytest.raises(ValueError, match="an undamped tooth has no place in its gap"):
        along_path(lambda t: 0.0, lambda t: 0.0, 1.0, bare)
