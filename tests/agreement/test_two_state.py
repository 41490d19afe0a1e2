"""The two-state contact law in the blocks, against SciPy on its own equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.compiled import OUTPUTS


def own(model, volts, times):
    """Both pinions alike: θ3, θL, their speeds and the position in the gap; no dry friction."""
    d = model.drive
    k, c, cf, gap, n2 = (d[n] for n in ("k_m", "c", "c_f", "gap_l", "N_2"))
    j3 = d["N_1"] ** 2 * d["J_m"] + d["J_2"]
    pull = d["N_1"] * d["K_d"] * d["K_M"] * volts

    def rates(t, x):
        z, rate, place = x[0] - n2 * x[1], x[2] - n2 * x[3], np.clip(x[4], -gap, gap)
        slip = (k * (z - place) + c * rate) / (c + cf)
        if (place >= gap and slip > 0) or (place <= -gap and slip < 0):
            slip = 0.0
        torque = k * (z - place) + c * (rate - slip)
        return [x[2], x[3], (pull - torque) / j3, 2 * n2 * torque / d["J_L"], slip]

    found = solve_ivp(
        rates, times[[0, -1]], np.zeros(5), "LSODA", times, rtol=1e-9, atol=1e-12, max_step=2e-4
    )
    return found.y


def test_blocks_follow_the_two_state_law(frictionless):
    model = frictionless.with_values(gap_r=frictionless.drive["gap_l"], c_f=0.5)
    times = 1e-3 * np.arange(60)
    run = simulate(
        model, times, np.full((2, 60), 0.5), method="blocks", contact="two_state", rtol=1e-8
    )
    known = own(model, 0.5, times)
    out = dict(zip(OUTPUTS, np.asarray(run.outputs), strict=True))
    assert np.abs(out["torque_l"]).max() > 5.0  # it came through the gap and landed
    scale = np.abs(known[3]).max()
    np.testing.assert_allclose(out["omega_L"], known[3], atol=2e-3 * scale)
    compiled = simulate(model, times, np.full((2, 60), 0.5), contact="two_state", substeps=256)
    fast = np.asarray(compiled.outputs)[OUTPUTS.index("omega_L")]
    np.testing.assert_allclose(fast, known[3], atol=2e-3 * scale)
    plain = simulate(model, times, np.full((2, 60), 0.5), method="blocks", rtol=1e-8)
    apart = np.asarray(run.outputs - plain.outputs)[OUTPUTS.index("torque_l")]
    assert np.abs(apart).max() > 1e-3  # Eq. 21 is another law


def test_states_and_refusals(frictionless):
    system = to_blocks(frictionless, contact="two_state")
    assert {"mesh_l_position", "mesh_r_position"} < set(system.state_labels)
    with pytest.raises(ValueError, match="it must be one of eq21, two_state"):
        to_blocks(frictionless, contact="hertz")
    with pytest.raises(ValueError, match=r"c \+ c_f is 0"):
        to_blocks(frictionless.with_values(c=0.0, c_f=0.0), contact="two_state")
    with pytest.raises(TypeError, match="no option 'contact'"):
        simulate(frictionless, [0, 1e-3], np.zeros((2, 2)), method="reference", contact="two_state")
