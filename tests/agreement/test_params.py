"""`params` of a block simulation: honoured by name, or refused; blocks at rest linearise."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive import baseline_drive, three_dof_ss
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.blocks import initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.model import Model

LOOP = Loop(kp=2.0, ki=20.0, limit=10.0)


def rates(system, model, params=None):
    """A generic state, where every block has something to say."""
    x = initial_state(model, system, np.array([0.01, -0.008, 0.0, 0.4, 0.3, 0.05]))
    u = np.full(system.ninputs, 0.3)
    return np.concatenate(
        [system.dynamics(0.0, x, u, params=params), system.output(0.0, x, u, params=params)]
    )


@pytest.mark.parametrize(
    "values", [{"k_m": 2e4}, {"J_L": 5.0, "J_m": 3e-4}, {"N_1": 30.0}, {"K_d": 1.0, "BL_plus": 9.0}]
)
def test_values_of_the_drive_are_honoured(values):
    model, other = Model(), Model().with_values(**values)
    given = rates(to_blocks(model, loop=LOOP), model, values)
    np.testing.assert_allclose(given, rates(to_blocks(other, loop=LOOP), other), rtol=1e-12)
    assert np.abs(given - rates(to_blocks(model, loop=LOOP), model)).max() > 1e-6


def test_gains_of_the_loop_are_honoured():
    model = Model()
    given = rates(to_blocks(model, loop=LOOP), model, {"kp": 3.0})
    other = rates(to_blocks(model, loop=LOOP._replace(kp=3.0)), model)
    np.testing.assert_allclose(given, other, rtol=1e-12)


def test_in_a_run():
    model, time = Model(), np.linspace(0.0, 0.05, 51)
    system, drive = to_blocks(model), np.full((2, 51), 1.5)
    x0 = initial_state(model, system, np.zeros(6))

    def run(system, **more):
        return ct.input_output_response(system, time, drive, x0, **more).outputs

    heavy = run(system, params={"J_m": 4e-4})
    np.testing.assert_allclose(heavy, run(to_blocks(model.with_values(J_m=4e-4))), rtol=1e-9)
    assert np.abs(heavy - run(system)).max() > 1e-3


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"stiffness": 1.0}, "the blocks have no 'stiffness'; they have K_d, K_M,"),
        ({"kp": 1.0}, "the blocks have no 'kp'"),  # no loop there
        ({"J_L": -1.0}, "J_L is -1 kg·m², it must be more than zero"),
    ],
)
def test_others_are_refused(params, said):
    (ring,) = (block for block in to_blocks(Model()).syslist if block.name == "ring")
    for system in (to_blocks(Model()), ring):
        x, u = np.zeros(system.nstates), np.zeros(system.ninputs)
        with pytest.raises(ValueError, match=said):
            system.dynamics(0.0, x, u, params=params)


def test_own_block_has_params_of_its_own():
    """python-control hands them to our blocks too, which know whose they are."""
    own = ct.nlsys(
        None, lambda t, x, u, params: [params["gain"] * u[0]] * 2, inputs=["volts"],
        outputs=["u_left", "u_right"], params={"gain": 0.5}, name="own",
    )  # fmt: skip

    def joined(**reported):
        return ct.interconnect(
            [own, to_blocks(Model(), **reported)], inputs=["volts"], outputs=["torque_l"],
            check_unused=False,
        )  # fmt: skip

    with pytest.raises(ValueError, match=r"build ours with others=\('gain',\)"):
        joined().dynamics(0.0, np.zeros(6), [1.0])
    system = joined(others=("gain",))
    x = np.zeros(system.nstates)
    one = system.dynamics(0.0, x, [1.0])
    np.testing.assert_allclose(system.dynamics(0.0, x, [0.5], params={"gain": 1.0}), one)
    assert np.abs(one).max() > 0.0
    lighter = system.dynamics(0.0, x, [1.0], params={"J_m": 1e-4})
    assert np.abs(lighter).max() > 1.2 * np.abs(one).max()


def test_at_rest_with_the_default_step():
    """A drive with viscous friction only, meshes closed: the 3-DOF model, at rest."""
    drive = baseline_drive()
    model = Model(drive)
    wound = np.array([0.006, -0.006, 0.0, 0.0, 0.0, 0.0])
    blocks = to_blocks(model)
    found = ct.linearize(blocks, initial_state(model, blocks, wound), np.zeros(2))
    order = [blocks.state_labels.index(f"{b}_{q}") for q in ("theta", "omega")
             for b in ("pinion_l", "pinion_r", "ring")]  # fmt: skip
    known = three_dof_ss(drive, states="angles")
    a = found.A[np.ix_(order, order)]
    np.testing.assert_allclose(a, known.A, rtol=1e-5, atol=1e-5 * np.abs(known.A[3:, 3:]).max())
    np.testing.assert_allclose(found.B[order], known.B, rtol=1e-5)


def test_effects_of_negative_size_are_refused():
    model = Model().with_effect("cable_spring", stiffness=-8.0)
    for use in (to_blocks, lambda m: simulate(m, [0.0, 1e-3], np.zeros((2, 2)))):
        with pytest.raises(ValueError, match="cable_spring: stiffness is -8; it must be zero or"):
            use(model)
    with pytest.raises(ValueError, match="cable_spring: stiffness is NaN"):
        Model().with_effect("cable_spring", stiffness=np.nan)
