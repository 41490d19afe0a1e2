"""The distance over which friction builds up, from logs of plants where it is known."""

import numpy as np
import pytest

from dmptm_ctrl.design.draws import slow_friction
from dmptm_ctrl.identify.build_up import friction_distance, with_build_up
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
TIME = DT * np.arange(6000)


def logged(model, seed):
    """A closed-loop sine with the noise and the counts of a rig."""
    reference = 8 * DEG * np.sin(np.pi * TIME)
    u, out = close_loop(model, Loop(0.08 / DEG, 1.5 / DEG, 10.0, 0.15, -0.15), reference, DT)
    rng = np.random.default_rng(seed)
    columns = {n: out[:, OUTPUTS.index(n)].copy() for n in OUTPUTS[:4]}
    columns["omega_L"] += 0.05 * DEG * rng.standard_normal(TIME.size)
    count = 2 * np.pi / 2**18
    columns["theta_L"] = count * np.round(columns["theta_L"] / count)
    return Log("sine", TIME, {"u_left": u[0], "u_right": u[1], **columns})


@pytest.mark.parametrize("distance", [0.0, 20e-6, 40e-6])
def test_known_distance_is_found(distance):
    plant = Model()
    if distance > 0.0:
        plant = slow_friction(plant, distance)
    found = friction_distance(Model(), [logged(plant, 1)])
    assert found == pytest.approx(distance, abs=5e-6)


def test_free_runs_tell_which_friction_builds_up_late():
    """Friction of the ring gear builds up over 0.4 mrad, that of the reducers at once."""
    plant = Model().with_effect("presliding", reducer_distance=0.0, ring_distance=4e-4)
    wrong = plant.with_effect("presliding", reducer_distance=3e-3, ring_distance=2e-4)
    found = with_build_up(wrong, [logged(plant, 2)]).effects["presliding"]
    assert found["reducer_distance"] == 0.0
    assert found["ring_distance"] == pytest.approx(4e-4, rel=1e-12)


def test_right_distances_stay():
    distances = {"reducer_distance": 1e-3, "ring_distance": 4e-4}
    plant = Model().with_effect("presliding", **distances)
    found = with_build_up(plant, [logged(plant, 3)]).effects["presliding"]
    assert found == plant.effects["presliding"]
    with pytest.raises(ValueError, match="distances are known"):
        friction_distance(plant, [])
