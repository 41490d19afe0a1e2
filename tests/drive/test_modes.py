import numpy as np
import pytest

from dmptm_ctrl.drive import (
    both_readings,
    closed_form,
    nine_dof_parameters,
    nine_dof_train,
    paper_drive,
    sensitivities,
    solve_modes,
    three_dof_train,
)


def determinant(train, omega):
    """Eq. 20 scaled by det M: det(M⁻¹K − ω² I); zero at each mode."""
    square = train.stiffness / train.inertia[:, None]
    return np.linalg.det(square - omega**2 * np.eye(len(square)))


TRAINS = {"3": three_dof_train, "9": nine_dof_train}


@pytest.mark.parametrize(
    ("reading", "hz"), [("beside", [0, 60.395, 230.868]), ("motor", [0, 85.412, 238.637])]
)
def test_both_readings_of_j2(reading, hz):
    """By hand: √(k/J̄3), √(k/J̄3 + 2 k N2²/J_L), k = 3.6e4, J̄3 = 0.25 or 0.125, J_L = 2.5."""
    drive = both_readings()[reading]
    np.testing.assert_allclose(solve_modes(three_dof_train(drive)).hz, hz, atol=5e-4)
    np.testing.assert_allclose(closed_form(drive) / (2 * np.pi), hz, atol=5e-4)


def test_closed_form_over_random_drives():
    rng = np.random.default_rng(2)
    for _ in range(20):
        names = ("k_m", "J_m", "J_2", "J_L", "N_2")
        drive = paper_drive()
        drive = drive.with_values(**{n: drive[n] * rng.uniform(0.3, 3) for n in names})
        modes = solve_modes(three_dof_train(drive))
        np.testing.assert_allclose(modes.omega[1:], closed_form(drive)[1:], rtol=1e-10)
        assert modes.kinds == ("rigid", "antisymmetric", "symmetric")


@pytest.mark.parametrize("dof", ["3", "9"])
def test_determinant_is_zero_at_the_modes_and_nowhere_else(dof):
    """Eq. 20. The modes come in pairs close together, so the signs are counted, not searched."""
    train = TRAINS[dof]()
    omega = solve_modes(train).omega
    single = omega[1:][np.append(np.diff(omega[1:]) > 1e-6 * omega[-1], True)]
    between = np.sqrt(single[:-1] * single[1:])
    points = np.concatenate([[0.5 * single[0]], between, [2 * single[-1]]])
    signs = np.sign([determinant(train, w) for w in points])
    multiplicity = [np.sum(abs(omega - w) <= 1e-6 * omega[-1]) for w in single]
    np.testing.assert_array_equal(signs[1:] / signs[:-1], [(-1.0) ** m for m in multiplicity])
    assert sum(multiplicity) == len(omega) - 1  # with the rigid mode, all roots are counted
    for w, m in zip(single, multiplicity, strict=True):
        if m == 1:
            nearby = abs(determinant(train, w * 1.001))
            assert abs(determinant(train, w)) < 1e-6 * nearby


@pytest.mark.parametrize("dof", ["3", "9"])
def test_shapes(dof):
    train = TRAINS[dof]()
    modes = solve_modes(train)
    np.testing.assert_allclose(
        modes.shapes.T @ train.mass @ modes.shapes, np.eye(len(train.bodies)), atol=1e-10
    )
    residual = train.stiffness @ modes.shapes - train.mass @ modes.shapes * modes.omega**2
    assert abs(residual).max() < 1e-8 * abs(train.stiffness @ modes.shapes).max()
    rigid = modes.shapes[:, 0] / modes.shapes[-1, 0]
    assert rigid[train.bodies.index("3l")] == pytest.approx(8.25, rel=1e-6)
    ring = abs(modes.shapes[-1])
    for kind, amplitude in zip(modes.kinds, ring, strict=True):
        if kind == "antisymmetric":
            assert amplitude < 1e-8 * ring.max()  # the ring stands still
    assert modes.kinds.count("rigid") == 1
    assert "mixed" not in modes.kinds


def test_unequal_chains_are_mixed():
    train = three_dof_train()
    uneven = train.__class__(**{**train.__dict__, "inertia": np.array([0.25, 0.1, 2.5])})
    assert solve_modes(uneven).kinds == ("rigid", "mixed", "mixed")


def test_damping_ratio_of_the_antisymmetric_mode():
    """One pinion on its spring: ζ = (c + D3)/(2 √(k J̄3))."""
    drive = paper_drive()
    modes = solve_modes(three_dof_train(drive))
    d3 = 0.009 * 180 / np.pi
    assert modes.damping_ratios[1] == pytest.approx((3.0 + d3) / (2 * np.sqrt(3.6e4 * 0.25)))


@pytest.mark.parametrize("dof", [3, 9])
def test_sensitivities_against_solving_again(dof):
    drive = paper_drive()
    p = nine_dof_parameters(drive)
    found = sensitivities(drive, dof=dof)
    h = 1e-5
    for name, values in found.items():

        def hz(factor, name=name):
            if dof == 3:
                changed = drive.with_values(**{name: drive[name] * factor})
                return solve_modes(three_dof_train(changed)).omega[1:]
            if name in p:
                changed = {**p, name: p[name] * factor}
                return solve_modes(nine_dof_train(drive, **changed)).omega[1:]
            changed = drive.with_values(**{name: drive[name] * factor})
            return solve_modes(nine_dof_train(changed, **p)).omega[1:]

        expected = (hz(1 + h) - hz(1 - h)) / (2 * h) / hz(1.0)
        np.testing.assert_allclose(values[1:], expected, atol=2e-6, err_msg=name)
        assert values[0] == 0.0


def test_sensitivities_add_up_by_dimension():
    """ω² = stiffness / inertia: scaling all k and all J changes f by ±1/2 in sum."""
    found = sensitivities()
    np.testing.assert_allclose(found["k_m"][1:], 0.5, rtol=1e-9)
    inertia = found["J_m"] + found["J_2"] + found["J_L"]
    np.testing.assert_allclose(inertia[1:], -0.5, rtol=1e-6)


def test_refusals():
    with pytest.raises(ValueError, match="3 or 9"):
        sensitivities(dof=5)
    with pytest.raises(ValueError, match="has no K_01"):
        sensitivities(K_01=1.0)
