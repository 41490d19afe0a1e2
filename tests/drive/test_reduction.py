import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive import nine_dof_parameters, paper_drive, simplification_cost


@pytest.fixture(scope="module")
def cost():
    return simplification_cost()


def test_balanced_truncation_obeys_its_bounds(cost):
    """σ_{r+1} ≤ ‖error‖∞ ≤ 2 Σ_{i>r} σ_i (Glover 1984)."""
    upper, lower = ct.gram(cost.full, "cf"), ct.gram(cost.full, "of")
    hankel = np.linalg.svd(lower @ upper.T, compute_uv=False)
    tail = hankel[cost.balanced.nstates :]
    assert tail[0] <= cost.h_inf["balanced"] <= 2 * tail.sum()


def test_norms_against_frequency_grid_and_scipy(cost):
    error = cost.full - cost.three_dof
    peaks = abs(error.poles().imag)
    grid = np.unique(np.concatenate([np.logspace(-1, 5, 2000), peaks * 1.0, peaks * 1.0002]))
    over = cost.error_over(grid)
    for name, largest in over.items():
        assert largest.max() <= cost.h_inf[name] * (1 + 1e-6)
        assert largest.max() == pytest.approx(cost.h_inf[name], rel=0.01)
    assert ct.norm(error, 2, method="scipy") == pytest.approx(cost.h_2["three_dof"], rel=1e-5)


def test_simplification_costs_more_than_a_balanced_one(cost):
    assert cost.three_dof.nstates == cost.balanced.nstates == 5
    assert cost.h_inf["balanced"] < 0.2 * cost.h_inf["three_dof"]
    assert cost.h_2["balanced"] < 0.5 * cost.h_2["three_dof"]


def test_rigid_links_cost_nothing():
    """With stiff links the 3-DOF model is the 9-DOF one: its error falls in proportion."""
    p = nine_dof_parameters(paper_drive())
    low = np.logspace(0, np.log10(2 * np.pi * 200), 100)  # links' own modes are far above
    worst = []
    for stiff in (300.0, 3000.0):
        links = {k: p[k] * stiff for k in ("K_01", "K_12", "K_23")}
        cost = simplification_cost(**links, D_12=p["D_12"] * stiff)
        worst.append(cost.error_over(low)["three_dof"].max())
    assert worst[1] == pytest.approx(worst[0] / 10, rel=0.1)
