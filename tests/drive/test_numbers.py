"""python-control's own numbers of every StateSpace, against the equations of motion alone.

The references know no state space: M q̈ + D q̇ + K q = E T at each frequency, or stepped by the
exponential of its matrix in angles.
"""

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from dmptm_ctrl.control import assess_pi, close_speed_loop, common_mode, pi_controller
from dmptm_ctrl.control.sections import notch
from dmptm_ctrl.drive import (
    GearTrain,
    Joint,
    Tooth,
    baseline_drive,
    mesh_damping,
    mesh_damping_ratio,
    mesh_torsion,
    nine_dof_ss,
    nine_dof_train,
    pair_stiffness,
    paper_drive,
    reduced_pinion_inertia,
    three_dof_ss,
    three_dof_train,
    tooth_stiffness,
)
from dmptm_ctrl.simulate.linear import linearize
from dmptm_ctrl.simulate.model import Model

MODELS = {"3": (three_dof_ss, three_dof_train()), "9": (nine_dof_ss, nine_dof_train())}
# 2 N1 N2 K_d K_M over what the viscous friction of ring gear and both pinions takes
D3, DL = 0.009 * 180 / np.pi, 1.1 * 180 / np.pi
STEADY = 2 * 25 * 8.25 * 0.39 / (DL + 2 * 8.25**2 * D3)


def response(train, omega):
    """Speed of the ring gear over one voltage on both motors."""
    dynamic = train.stiffness + 1j * omega * train.damping - omega**2 * train.mass
    pull = train.torque_per_volt * train.drives.sum(axis=1)
    return 1j * omega * np.linalg.solve(dynamic, pull)[-1]


def crossings(function, grid):
    values = np.array([function(w) for w in grid])
    changes = np.flatnonzero(np.diff(np.sign(values)))
    return [brentq(function, grid[i], grid[i + 1]) for i in changes]


@pytest.mark.parametrize("name", MODELS)
def test_open_loop_as_it_comes(name):
    build, train = MODELS[name]
    plant = common_mode(build())
    assert ct.dcgain(plant) == pytest.approx(STEADY, rel=1e-9)
    assert ct.dcgain(build()).sum() == pytest.approx(STEADY, rel=1e-9)
    grid = np.geomspace(0.5, 3e3, 3000)
    turned = crossings(lambda w: response(train, w).imag, grid)
    gains = [1 / abs(response(train, w)) for w in turned if response(train, w).real < 0]
    over = crossings(lambda w: abs(response(train, w)) - 1.0, grid)
    phases = [180 + np.degrees(np.angle(response(train, w))) for w in over]
    gain, phase, _, _ = ct.margin(plant)
    assert gain == pytest.approx(min(gains), rel=1e-6)
    assert phase == pytest.approx(min(phases), rel=1e-6)
    falls = crossings(lambda w: abs(response(train, w)) - STEADY * 10 ** (-3 / 20), grid)
    assert ct.bandwidth(plant) == pytest.approx(falls[0], rel=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_step_as_it_comes(name):
    build, train = MODELS[name]
    n, dt = len(train.bodies), 1e-3
    solve = 1.0 / train.inertia[:, None]
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-solve * train.stiffness, -solve * train.damping]]
    )
    b = np.concatenate([np.zeros(n), train.torque_per_volt * train.drives.sum(axis=1)])
    b[n:] /= train.inertia
    step = expm(dt * np.block([[a, b[:, None]], [np.zeros((1, 2 * n + 1))]]))
    x, speed = np.zeros(2 * n + 1), []
    x[-1] = 1.0
    for _ in range(4000):
        speed.append(x[2 * n - 1])
        x = step @ x
    speed = np.array(speed)
    settled = dt * (np.flatnonzero(abs(speed / STEADY - 1) > 0.02)[-1] + 1)
    rise = dt * (np.argmax(speed > 0.9 * STEADY) - np.argmax(speed > 0.1 * STEADY))
    found = ct.step_info(common_mode(build()))
    assert found["SteadyStateValue"] == pytest.approx(STEADY, rel=1e-9)
    assert found["SettlingTime"] == pytest.approx(settled, abs=0.02)
    assert found["RiseTime"] == pytest.approx(rise, abs=0.02)


@pytest.mark.parametrize("name", MODELS)
def test_closed_loop_as_it_comes(name):
    """T = G C/(1 + G C) has gain 1 at rest, and −3 dB where the equations of motion say."""
    build, train = MODELS[name]
    kp, ki = 1.0, 8.0
    closed = close_speed_loop(build(), kp, ki)["omega_L", "ref"]
    assert ct.dcgain(closed) == pytest.approx(1.0, rel=1e-9)

    def excess(w):
        loop = response(train, w) * (kp + ki / (1j * w))
        return abs(loop / (1 + loop)) - 10 ** (-3 / 20)

    falls = crossings(excess, np.geomspace(0.5, 300.0, 500))
    assert ct.bandwidth(closed) == pytest.approx(falls[0], rel=1e-6)
    assert ct.step_info(closed)["SteadyStateValue"] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_angles_that_nothing_reads_are_left_out(name):
    """Also of models that have them as states: one angle goes, and no other state."""
    build, train = MODELS[name]
    plant = common_mode(build(states="angles"))
    assert plant.nstates == 2 * len(train.bodies) - 1
    assert ct.dcgain(plant) == pytest.approx(STEADY, rel=1e-6)
    assert ct.margin(plant)[:2] == pytest.approx(ct.margin(common_mode(build()))[:2], rel=1e-4)


def test_one_output_of_a_plant_with_angles():
    """The speed alone does not depend on the angle: `common_mode` leaves it out."""
    plant = three_dof_ss(outputs=("theta_L", "omega_L"))
    assert plant.nstates == 6
    assert ct.dcgain(common_mode(plant)) == pytest.approx(STEADY, rel=1e-9)
    assert np.isinf(ct.dcgain(common_mode(plant, "theta_L")))


def test_linearised_drive_as_it_comes():
    """About a turn: the steady speed per volt is that of two turns a little apart."""
    from dmptm_ctrl.simulate.linear import turning

    model = Model()
    volts = [turning(model, speed=s)[1].mean() for s in np.deg2rad([9.99, 10.01])]
    expected = np.deg2rad(0.02) / (volts[1] - volts[0])
    plant = common_mode(linearize(model))
    assert plant.nstates == 5
    assert ct.dcgain(plant) == pytest.approx(expected, rel=1e-4)
    assert ct.dcgain(common_mode(linearize(model, outputs=("theta_L", "omega_L")))) == (
        pytest.approx(expected, rel=1e-3)
    )


BAD = [
    ({"J_L": 0.0}, r"J_L is 0 kg·m², it must be more than zero"),
    ({"J_m": -2e-4}, r"J_m is -0.0002"),
    ({"J_L": float("nan")}, r"J_L is nan"),
    ({"k_m": -1.0}, r"k_m is -1 N·m/rad"),
    ({"c": float("inf")}, r"c is inf; it must be finite"),
]


@pytest.mark.parametrize(("values", "said"), BAD)
@pytest.mark.parametrize("build", [three_dof_ss, nine_dof_ss, Model])
def test_what_no_drive_has_is_refused(values, said, build):
    with pytest.raises(ValueError, match=f"^paper: {said}"):
        build(paper_drive().with_values(**values))


@pytest.mark.parametrize(
    ("inertia", "stiffness", "said"),
    [
        (-1.0, 1.0, "own: inertia of a is -1 kg·m²"),
        (np.nan, 1.0, "own: inertia of a is nan"),
        (1.0, -1.0, "own: stiffness of joint shaft is -1"),
        (1.0, np.nan, "own: stiffness of joint shaft is nan"),
    ],
)
def test_an_own_train_is_refused_alike(inertia, stiffness, said):
    with pytest.raises(ValueError, match=said):
        GearTrain(
            "own",
            ("a", "b"),
            np.array([inertia, 1.0]),
            np.zeros(2),
            (Joint("shaft", np.array([1.0, -1.0]), stiffness, 0.0),),
            np.eye(2),
            1.0,
            {},
        )


REFUSED = [
    (lambda: tooth_stiffness(Tooth(-0.002, 20, 0.01)), "module is -0.002"),
    (lambda: pair_stiffness(Tooth(0.002, 20, 0.01), Tooth(0.002, np.nan, 0.01)), "teeth is nan"),
    (lambda: mesh_damping(0.03, -3.6e4, 0.25, 2.5, 8.25), "stiffness is -36000"),
    (lambda: mesh_damping(0.03, 3.6e4, 0.0, 2.5, 8.25), "pinion is 0"),
    (lambda: mesh_damping_ratio(1.0, 3.6e4, 0.25, np.inf, 8.25), "ring is inf"),
    (lambda: mesh_torsion(np.nan, 0.02), "stiffness is nan"),
    (lambda: reduced_pinion_inertia(25, -2e-4, 0, 0.1, 0), "j_m is -0.0002 kg·m²"),
    (lambda: baseline_drive(speed=0.0), "speed of the baseline's sine is 0 rad/s"),
    (lambda: pi_controller(np.nan, 1.0), "kp is nan"),
    (lambda: assess_pi(three_dof_ss(), 1.0, np.inf), "ki is inf"),
    (lambda: notch(60.0, np.nan, 0.5), "all must be > 0"),
]


@pytest.mark.parametrize(("call", "said"), REFUSED)
def test_one_sentence_for_each_nonsense(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def test_the_baseline_differs():
    """Its viscous friction takes as much work from a sine of 10 deg/s as the dry one it lacks."""
    drive, model = paper_drive(), baseline_drive()
    for body, amplitude in (("3", np.deg2rad(10) * 8.25), ("L", np.deg2rad(10))):
        phase = np.linspace(0, 2 * np.pi, 200001)
        speed = amplitude * np.sin(phase)
        coulomb = [drive[f"T{body}c_{s}"] for s in ("plus", "minus")]
        viscous = np.mean([drive[f"B{body}_{s}"] for s in ("plus", "minus")])
        torque = np.where(speed > 0, coulomb[0], -coulomb[1]) + viscous * speed
        work = np.trapezoid(torque * speed, phase)
        own = np.trapezoid(model[f"B{body}_plus"] * speed**2, phase)
        assert own == pytest.approx(work, rel=1e-6)
    ours, theirs = (ct.dcgain(common_mode(three_dof_ss(d))) for d in (drive, model))
    total = model["BL_plus"] + 2 * 8.25**2 * model["B3_plus"]
    assert theirs == pytest.approx(2 * 25 * 8.25 * 0.39 / total, rel=1e-9)
    assert theirs < 0.6 * ours
