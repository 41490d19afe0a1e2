"""The map of the gains against single runs and the linear loop's own test."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dmptm_ctrl.control import assess_pi
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.design.stability import stability_map
from dmptm_ctrl.plots.control import plot_stability
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
KP, KI = np.array([4.6, 20.0, 200.0]), np.array([86.0, 1300.0])


def test_gaps_shrink_what_a_linear_model_calls_stable():
    found = stability_map(Model(), KP, KI, n_jobs=1)
    quiet = found.amplitude < 0.05 * DEG
    assert quiet[0, 0]
    assert found.linear[1, 1]
    assert found.amplitude[1, 1] > 1 * DEG  # the premise of the preload: linear says stable
    preloaded = stability_map(Model(), np.array([4.6, 10.0]), KI, preload=0.5, n_jobs=1)
    assert np.all(preloaded.amplitude < 0.05 * DEG)
    plant = linear_plant(Model())
    for i, kp in enumerate(KP):
        for j, ki in enumerate(KI):
            if found.linear[i, j]:
                assess_pi(plant, kp, ki)
            else:
                with pytest.raises(ValueError, match="unstable"):
                    assess_pi(plant, kp, ki)
    panel = plot_stability(found)
    assert panel.get_xlabel().startswith("$k_i$")
    plt.close(panel.figure)
