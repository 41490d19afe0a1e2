"""Derivatives of runs against closed forms, against differences of the reference, and none."""

import numpy as np
import pytest
from tests.agreement.test_simulate import AXIS

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.sensitivity import simulate_with_sensitivities

DT = 1e-3  # s
MOTOR = OUTPUTS.index("theta_ml")


@pytest.fixture(scope="module")
def coulomb():
    """Chains alone in gaps that they never cross, with dry and viscous friction."""
    dry = {f"T3{kind}_{way}": 2.0 for kind in "sc" for way in ("plus", "minus")}
    viscous = {"B3_plus": 0.5, "B3_minus": 0.5}
    return Model().with_values(gap_l=100.0, gap_r=100.0, c_f=0.0, **dry, **viscous)


def stop_angle(drive, volts, pushed, dry):
    """Where a chain that was pushed for a while comes to rest, at the pinion [rad]."""
    gain = drive["N_1"] * drive["K_d"] * drive["K_M"]
    tau = (drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]) / 0.5
    final = (gain * volts - dry) / 0.5
    peak = final * (1.0 - np.exp(-pushed / tau))
    reached = final * (pushed - tau * (1.0 - np.exp(-pushed / tau)))
    running_down = tau * np.log(1.0 + peak * 0.5 / dry)
    return reached + tau * peak - dry / 0.5 * running_down


def test_through_a_stop_by_closed_form(coulomb):
    """d(angle of rest)/d(dry friction): pushed, let go, at rest for good."""
    time = DT * np.arange(401)
    u = np.where(time < 0.1 - DT / 2, 0.5, 0.0) * np.array([[1.0], [-1.0]])
    # dry friction in this direction is static and Coulomb together
    found = simulate_with_sensitivities(coulomb, time, u, ["T3s_plus", "T3c_plus"], substeps=64)
    step = 1e-4
    angles = [stop_angle(coulomb.drive, 0.5, 0.1, 2.0 + x) for x in (step, -step)]
    expected = coulomb.drive["N_1"] * (angles[0] - angles[1]) / (2 * step)
    together = found.derivatives[:, MOTOR, -1].sum()
    assert together == pytest.approx(expected, rel=1e-3)
    assert found.exists.all()


NAMES = ("c", "T3c_plus", "J_L", "TLs_plus", "unbalance.cosine", "cogging.left_cosine")


@pytest.fixture(scope="module")
def lively_reference():
    """Differences of the event-located reference, through contacts, stops and starts."""
    model = Model().with_effect("cogging", left_cosine=0.01)
    time = DT * np.arange(91)
    u = 0.85 * np.sin(2 * np.pi * 6.0 * time) + np.array([[0.15], [-0.15]])
    rows = []
    for name in NAMES:
        effect, _, key = name.rpartition(".")
        step = 1e-5 * (model.drive[key] if not effect else 1.0)
        value = model.drive[key] if not effect else model.effects.get(effect, {}).get(key, 0.0)
        runs = []
        for x in (value + step, value - step):
            moved = (
                model.with_effect(effect, **{key: x}) if effect else model.with_values(**{key: x})
            )
            runs.append(simulate(moved, time, u, method="reference", rtol=1e-12).outputs)
        rows.append((runs[0] - runs[1]) / (2 * step))
    return model, time, u, np.array(rows)


def test_converges_to_the_reference(lively_reference):
    model, time, u, exact = lively_reference
    scale = np.sqrt(np.mean(exact**2, axis=2))
    errors = []
    for substeps in (8, 32, 128):
        few = [
            simulate_with_sensitivities(model, time, u, names, substeps=substeps)
            for names in (NAMES[:3], NAMES[3:])
        ]
        assert min(found.exists.mean() for found in few) > 0.99
        derivatives = np.concatenate([found.derivatives for found in few])
        error = np.sqrt(np.mean((derivatives - exact) ** 2, axis=2)) / scale
        errors.append(np.median(error, axis=1))
    assert np.all(errors[2] < 0.03), dict(zip(NAMES, errors[2], strict=True))
    assert np.all(errors[2] < 0.25 * errors[0])  # first order gives 1/16


MIXED = ("c", "T3s_plus", "gap_l", "J_L", "K_d", "k_m", "W3_minus", "TLc_minus", "c_f", "J_m")


def moved_runs(model, time, u, name, step):
    """Central difference of the loop that runs one drive at a time, and its size of a rounding."""
    effect, _, key = name.rpartition(".")
    own = model.effects[effect] if effect else model.drive
    runs = []
    for x in (own[key] + step, own[key] - step):
        if effect:
            other = model.with_effect(effect, **{**own, key: x})
        else:
            other = model.with_values(**{key: x})
        runs.append(simulate(other, time, u, substeps=8).outputs)
    return (runs[0] - runs[1]) / (2 * step)


@pytest.mark.parametrize("names", [MIXED[:2], MIXED])
def test_derivatives_are_differences_of_whole_runs(names):
    """Through both flanks and rests, by runs and steps that are others."""
    time = DT * np.arange(401)
    u = 0.9 * np.sin(2 * np.pi * 4.0 * time) + np.array([[0.05], [-0.05]])
    model = Model()
    found = simulate_with_sensitivities(model, time, u, names)
    z = found.outputs[OUTPUTS.index("z_l")]
    assert np.ptp(np.sign(z)) == 2.0  # both flanks
    assert np.sum(found.outputs[1] == 0.0) > 10  # and the ring gear at rest in between
    for name, derivative in zip(names, found.derivatives, strict=True):
        other = moved_runs(model, time, u, name, 2e-7 * model.drive[name])
        size = np.sqrt(np.mean(other**2, axis=1))
        apart = np.sqrt(np.mean((derivative - other) ** 2, axis=1))
        assert np.all(apart < 1e-2 * size), (name, apart / size)


@pytest.mark.parametrize("name", list(CATALOGUE)[1::9])  # lanes of their own, 6 s to compile
def test_derivatives_by_an_effect_are_differences_of_whole_runs(name):
    """Every ninth effect; `benchmarks/long/test_derivatives.py` has all."""
    derivatives_are_differences(CATALOGUE[name])


def derivatives_are_differences(effect):
    time = DT * np.arange(301)
    u = 0.9 * np.sin(2 * np.pi * 4.0 * time) + np.array([[0.25], [-0.25]])
    own = [p for p in effect.parameters if not p.bank]
    # a delay of whole steps would be on a kink
    sizes = {p.name: 2.06 * p.step * (1.0 + 0.1 * k) for k, p in enumerate(own)}
    model = Model().with_effect(effect.name, **sizes)
    names = [f"{effect.name}.{p.name}" for p in (own[0], own[-1])]
    found = simulate_with_sensitivities(model, time, u, names)
    scale = np.ptp(found.outputs, axis=1)
    for name, derivative in zip(names, found.derivatives, strict=True):
        value = sizes[name.rpartition(".")[2]]
        other = moved_runs(model, time, u, name, 2e-7 * value)
        size = np.sqrt(np.mean(other**2, axis=1))
        apart = np.sqrt(np.mean((derivative - other) ** 2, axis=1))
        assert np.all(apart < 1e-2 * size + 1e-4 * scale / value), (name, apart / size)
    assert found.exists.mean() > 0.99


def test_flagged_where_a_voltage_is_just_clipped():
    """At exactly the limit a higher limit changes nothing, a lower one does; beside it both do."""
    time = DT * np.arange(61)
    u = np.zeros((2, time.size))
    names = ["drive_saturation.inverse_limit", "c"]
    model = Model().with_effect("drive_saturation", inverse_limit=0.5)  # 2 V
    for height, exists in ((1.9, True), (2.0, False), (2.1, True)):
        u[:, 30:] = height
        found = simulate_with_sensitivities(model, time, u, names)
        assert found.exists[:, :31].all()
        assert found.exists[MOTOR, 33:].all() == found.exists[MOTOR, 33:].any() == exists
        assert (abs(found.derivatives[0, MOTOR, -1]) > 1e-6) == (height > 1.95)


def test_flagged_where_a_body_is_just_held(coulomb):
    """Driven by exactly what friction holds: a little less friction and it turns."""
    drive = coulomb.drive
    time = DT * np.arange(51)
    volts = 2.0 / (drive["N_1"] * drive["K_d"] * drive["K_M"])
    u = np.full((2, time.size), volts)
    names = ["T3s_plus", "T3c_plus"]
    # rounding of the net torque decides on which side the body is: just below is held
    u[0] = np.nextafter(volts, 0.0)
    found = simulate_with_sensitivities(coulomb, time, u, names)
    assert np.ptp(found.outputs[MOTOR]) == 0.0
    assert not found.exists[MOTOR, 10:].any()
    assert found.exists[OUTPUTS.index("theta_L")].all()
    u[:] = 0.99 * volts
    assert simulate_with_sensitivities(coulomb, time, u, names).exists.all()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["stiffness"], "the drive has no parameter 'stiffness'"),
        (["cogging.size"], "no parameter 'cogging.size'"),
        (["phi_r"], "phi_r is zero: its size is not known"),
        (["drive_dead_band.width"], "is at its lower bound 0: no derivative from below"),
        ([], "parameters is empty"),
    ],
)
def test_refuses_what_has_no_derivative(names, message):
    with pytest.raises(ValueError, match=message):
        simulate_with_sensitivities(Model(), DT * np.arange(5), np.zeros((2, 5)), names)


def test_of_a_rig_by_closed_form():
    """A first-order lag g u / b (1 - exp(-b t / J)), and an unbalance that pushes at angle 0."""
    text = AXIS.replace('coulomb = "0.1 N m"\nstatic = "0.15 N m"\n', "")
    rig = RigModel(parse_rig(text.replace('stribeck_speed = "0.1 rad/s"\n', "")))
    time = 1e-3 * np.arange(400)
    volts, inertia, b = np.full(time.size, 3.0), 0.02, 0.04
    keys = ["body.table.inertia", "input.motor.gain"]
    run = simulate_with_sensitivities(rig, time, volts, keys, substeps=32)
    left = np.exp(-b * time / inertia)
    by_inertia = -3.0 * 0.1 / b * left * b * time / inertia**2
    np.testing.assert_allclose(run.derivatives[0, 0], by_inertia, atol=1e-2)
    np.testing.assert_allclose(run.derivatives[1, 0], 3.0 / b * (1.0 - left), rtol=1e-3, atol=1e-3)
    heavy = rig.with_effect(Placed("unbalance", "table", {"cosine": 0.1, "sine": 0.0}))
    one = simulate_with_sensitivities(heavy, time[:20], volts[:20], ["unbalance@table.cosine"])
    assert one.derivatives[0, 0, 10] == pytest.approx(time[10] / inertia, rel=0.03)
    with pytest.raises(ValueError, match="no parameter 'unbalance@table.size'"):
        simulate_with_sensitivities(heavy, time, volts, ["unbalance@table.size"])
