"""The controller in the simulated loop: by hand, against python-control, over lanes."""

import numpy as np
import pytest

from dmptm_ctrl.control.sections import sampled_notch
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop
from dmptm_ctrl.simulate.law import Law
from dmptm_ctrl.simulate.linear import turning
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
KP, KI = 0.08 / DEG, 1.5 / DEG
TIME = DT * np.arange(700)
SINE = 15 * DEG * np.sin(2 * np.pi * TIME)
STEER = Model().with_effect("unbalance", cosine=4.0, sine=-3.0)


def column(out, name):
    return out[:, OUTPUTS.index(name)]


def test_without_extras_it_is_the_plain_loop():
    plain = close_loop(Model(), Loop(KP, KI, 10.0, 0.15, -0.15), SINE, DT)
    general = close_loop(Model(), Law(KP, KI, 10.0, 0.15, -0.15), SINE, DT)
    for one, other in zip(plain, general, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12)


def test_sections_against_scipy():
    """Two notches behind the PI: the same voltage from the recorded error."""
    from scipy.signal import lfilter

    parts = [sampled_notch(60.0, 0.1, 0.5, DT), sampled_notch(7.0, 2.0, 0.2, DT)]
    u, out = close_loop(Model(), Law(KP, KI, 10.0, sections=parts), SINE, DT)
    error = SINE - column(out, "omega_L")
    expected = KP * error + KI * DT * np.cumsum(error)
    for b0, b1, b2, a1, a2 in parts:
        expected = lfilter([b0, b1, b2], [1.0, a1, a2], expected)
    np.testing.assert_allclose(u[0], expected, atol=1e-11)


def test_anti_windup_by_hand():
    """Back-calculation: what the limit cut off leaves the integral at the tracking rate."""
    ref = np.where(TIME < 0.3, 60 * DEG, 0.0)
    limit, rate = 0.6, 25.0
    u, out = close_loop(Model(), Law(KP, KI, limit, tracking=rate), ref, DT)
    integral, expected = 0.0, []
    for error in ref - column(out, "omega_L"):
        integral += error * DT
        wanted = KP * error + KI * integral
        expected.append(np.clip(wanted, -limit, limit))
        integral += rate * DT * (expected[-1] - wanted) / KI
    assert np.mean(np.abs(expected) == limit) > 0.3  # the premise
    np.testing.assert_allclose(u[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("cogging", {"left_cosine": 0.02, "right_sine": 0.01, "order": 6.0}),
        ("unbalance", {"cosine": 6.0, "sine": 2.0}),
        ("quadratic_drag", {"coefficient": 40.0}),
        ("back_emf", {"damping": 2e-3}),
        ("position_dependent_friction", {"cosine": 4.0, "order": 2.0}),
        ("load_dependent_friction", {"coefficient": 0.1}),
        ("drive_offset", {"left": 0.1, "right": -0.05}),
        ("drive_dead_band", {"width": 0.1}),
        ("torque_constant_mismatch", {"error": 0.1, "pattern": 2.0}),
    ],
)
def test_the_kernel_of_an_effect_undoes_it(effect, values):
    """Steady turn under preload: the right model leaves the integral with nothing to do."""
    model = Model().with_effect(effect, **values)
    time = DT * np.arange(1200)
    ref = np.interp(time, [0.0, 0.2], [0.0, 12 * DEG])

    def feedback(design):
        """Largest voltage of the PI once the turn is steady."""
        law = Law(KP, KI, 10.0, 0.4, -0.4, inertia=1.0, friction=1.0, effects=1.0, lead=5e-4,
                  invert=True, model=design)  # fmt: skip
        _, out = close_loop(model, law, ref, DT)
        error = ref - column(out, "omega_L")
        return np.abs(KP * error + KI * DT * np.cumsum(error))[700:].max()

    assert feedback(model) < 0.05 * feedback(Model())


def test_feed_forward_of_a_steady_turn_against_the_balance():
    """Voltages of the turn that `turning` finds by root search on the same kernels."""
    speed, preload = 10 * DEG, 0.4
    _, volts = turning(STEER, speed=speed, preload=preload, theta_L=0.7)
    law = Law(0.0, 0.0, 10.0, preload, -preload, friction=1.0, effects=1.0, model=STEER)
    step = law.stepper(DT)
    n1, n2 = STEER.drive["N_1"], STEER.drive["N_2"]
    found = [step(speed, 0.7, speed, n1 * n2 * 0.7, n1 * n2 * 0.7) for _ in range(2)]
    np.testing.assert_allclose(found[-1], volts, rtol=1e-6)


def test_stepper_is_the_loop():
    law = Law(KP, KI, 2.0, 0.2, -0.2, tracking=5.0, inertia=1.0, friction=0.9, effects=1.0,
              lead=1e-3, late=1e-3, invert=True, sections=[sampled_notch(60.0, 0.2, 0.3, DT)],
              model=STEER)  # fmt: skip
    u, out = close_loop(Model(), law, SINE, DT)
    step = law.stepper(DT)
    readings = zip(SINE, *(column(out, n) for n in ("theta_L", "omega_L")),
                   *(column(out, n) for n in ("theta_ml", "theta_mr")), strict=True)  # fmt: skip
    np.testing.assert_allclose(np.array([step(*row) for row in readings]).T, u, atol=1e-12)


def test_lanes_are_the_scalar_loop():
    plants = [Model().with_values(J_L=2.5 * f) for f in (0.9, 1.0, 1.1)]
    noise = 9e-4 * np.random.default_rng(1).standard_normal(SINE.size)
    laws = [
        Law(f * KP, KI, 2.0, 0.2, -0.2, tracking=5.0, inertia=1.0, friction=0.9, effects=1.0,
            lead=1e-3, model=STEER)
        for f in (1.0, 1.5, 0.7)
    ]  # fmt: skip
    runs = simulate_batch(plants, TIME, SINE, loop=laws, noise=noise, outputs=["omega_L", "u_left"])
    for k, (plant, law) in enumerate(zip(plants, laws, strict=True)):
        u, out = close_loop(plant, law, SINE, DT, noise=noise)
        np.testing.assert_allclose(runs.outputs[k, 0], column(out, "omega_L"), atol=1e-9)
        np.testing.assert_allclose(runs.outputs[k, 1], u[0], atol=1e-8)


def test_refusals():
    with pytest.raises(ValueError, match="3 notches; the loop has room for 2"):
        Law(1.0, 1.0, 1.0, sections=[(1.0, 0.0, 0.0, 0.0, 0.0)] * 3)
    law = Law(1.0, 1.0, 1.0, model=Model())
    with pytest.raises(ValueError, match="mixes"):
        simulate_batch([Model()] * 2, TIME, SINE, loop=[law, Loop(1.0, 1.0, 1.0)])


def test_laws_of_different_design_models_in_one_batch():
    laws = [Law(1.0, 1.0, 1.0, model=m) for m in (Model(), STEER)]
    both = simulate_batch([Model()] * 2, TIME, SINE, loop=laws)
    for k, law in enumerate(laws):
        alone = simulate_batch([Model()], TIME, SINE, loop=law)
        np.testing.assert_allclose(both.outputs[k], alone.outputs[0], rtol=1e-9, atol=1e-12)
