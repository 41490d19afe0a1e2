"""Lanes against the loop that runs one drive at a time: the same scheme, rounding aside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.agreement.test_simulate import AXIS

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import BRAKING, SPEED, WAVE, WIDEST
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.batch import BATCH_OUTPUTS, march_any, simulate_batch
from dmptm_ctrl.simulate.compiled import BODIES, OUTPUTS, Loop, close_loop, march
from dmptm_ctrl.simulate.law import Law
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.observer import observer_gains
from dmptm_ctrl.simulate.rig_model import RigModel

DT = 1e-3  # s
TIME = DT * np.arange(61)
STATE = np.array([0.83, 0.82, 0.1, 0.0, 0.0, 0.0])
LOOP = Loop(kp=4.0, ki=80.0, limit=2.0, bias_l=0.15, bias_r=-0.15)


def voltages(amplitude, frequency, bias):
    wave = amplitude * np.sin(2 * np.pi * frequency * TIME)
    return wave + np.array([[bias], [-bias]])


def visible(name):
    parameters = CATALOGUE[name].parameters
    return {p.name: p.bank[len(p.bank) // 2] if p.bank else 0.1 * p.high for p in parameters}


def assert_same(found, expected):
    """Rounding, grown over the run; the differences of effects are above 1e-5 of the range."""
    scale = np.ptp(expected, axis=(0, 1)) + 1e-12
    assert np.max(np.abs(found - expected) / scale) < 1e-7


def drawn(data, name):
    """A drive with drawn numbers and one effect, None for none."""
    model = Model()
    factor = st.floats(0.5, 1.5)
    for key in ("c", "k_m", "J_L", "gap_l", "gap_r", "T3c_plus", "TLs_minus", "BL_plus", "c_f"):
        model = model.with_values(**{key: model.drive[key] * data.draw(factor, label=key)})
    if name is None:
        return model
    values = {
        p.name: data.draw(st.sampled_from(p.bank))
        if p.bank
        else data.draw(st.floats(max(p.low, -0.2 * p.high), 0.2 * p.high), label=p.name)
        for p in CATALOGUE[name].parameters
    }
    if values.get("variable") in (SPEED, BRAKING, WAVE):
        # steep over a speed it drives what it should brake: any rounding grows beyond bounds
        knots = {key: 0.1 * x for key, x in values.items() if key[0] == "k"}
        values |= {"low": -WIDEST, "high": WIDEST, **knots}
    return model.with_effect(name, **values)


OF_SHAPE = ("reducer_compliance", "presliding", "sensor_delay")  # a drive of another shape


def full(*shape):
    """A drive with every effect of the catalogue that leaves its shape, and some that do not."""
    model = Model()
    for name in CATALOGUE:
        if name not in OF_SHAPE or name in shape:
            model = model.with_effect(name, **visible(name))
    return model


# beside it any drive of the shape runs in an engine that is there already
FULL = full().with_values(k_a=9e3, phi_r=0.3)
# Alone they would have engines of their own; they stand among all effects, and
# `test_observer` has one of them alone.
AMONG_OTHERS = ("reducer_compliance", "sensor_delay")
ALONE = [name for name in CATALOGUE if name not in AMONG_OTHERS]


def lanes(models, u):
    runs = simulate_batch([*models, FULL], TIME, u, STATE, outputs=OUTPUTS)
    return runs.outputs[: len(models)].transpose(0, 2, 1)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    data=st.data(),
    names=st.lists(st.sampled_from([None, *ALONE]), min_size=1, max_size=9),
    amplitude=st.floats(0.3, 2.0),
    frequency=st.floats(5.0, 40.0),
    bias=st.floats(-0.3, 0.3),
)
def test_lanes_are_the_plain_loop(data, names, amplitude, frequency, bias):
    """Drawn drives side by side, each with another effect of the catalogue or none."""
    models = [drawn(data, name) for name in names]
    u = voltages(amplitude, frequency, bias)
    assert_same(lanes(models, u), np.array([march(m, u, STATE, DT) for m in models]))


def test_every_effect_and_all_together():
    models = [Model(), *(Model().with_effect(name, **visible(name)) for name in ALONE)]
    varying = Model().with_values(k_a=9e3, phi_r=0.3)
    curved = full(*OF_SHAPE).with_values(delta3=0.7, deltaL=1.3)
    models += [varying, FULL, curved]
    u = voltages(1.2, 12.0, 0.15)
    expected = np.array([march(m, u, STATE, DT) for m in models])
    assert_same(lanes(models, u), expected)


@pytest.mark.parametrize("name", [None, "pinion_runout", "reducer_compliance"])
def test_without_the_columns_of_the_meshes_the_rest_is_the_same(name):
    model = Model() if name is None else Model().with_effect(name, **visible(name))
    u = voltages(1.2, 12.0, 0.15)
    whole, bodies = (march(model, u, STATE, DT, meshes=m) for m in (True, False))
    assert bodies.shape == (u.shape[1], BODIES)
    np.testing.assert_array_equal(bodies, whole[:, :BODIES])
    target = 0.2 * np.sin(20.0 * TIME)
    (volts, whole), (same, bodies) = (
        close_loop(model, LOOP, target, DT, meshes=m) for m in (True, False)
    )
    np.testing.assert_array_equal(bodies, whole[:, :BODIES])
    np.testing.assert_array_equal(same, volts)


@pytest.mark.parametrize("name", [None, "reducer_compliance", "drive_delay", "cogging"])
def test_observer(name):
    """As the diagnosis uses it: with a measured angle, each lane by its own."""
    model = Model() if name is None else Model().with_effect(name, **visible(name))
    models = [model.with_values(c=c) for c in (1.0, 2.0, 3.0, 5.0, 8.0)]
    u = voltages(1.2, 12.0, 0.15)
    angle = 0.1 + np.array([[1e-3], [2e-3], [-1e-3], [3e-3], [-2e-3]]) * np.sin(40.0 * TIME)
    options = {"observer": observer_gains(2.0, DT), "begin": 0.37}
    expected = np.array(
        [march(a, u, STATE, DT, measured=m, **options) for a, m in zip(models, angle, strict=True)]
    )
    assert_same(march_any(models, u, STATE, DT, measured=angle, **options), expected)


@pytest.mark.parametrize("count", [1, 4, 5, 16, 18])
@pytest.mark.parametrize("own", [False, True])
def test_any_number_one_by_one_where_lanes_would_be_empty(count, own):
    """Alone, all in lanes, or some of each; with voltages and angles in common, or of their own."""
    model = Model().with_effect("reducer_compliance", **visible("reducer_compliance"))
    models = [model.with_values(c=1.0 + 0.3 * k) for k in range(count)]
    many = count if own else 1
    u = np.array([voltages(1.2, 12.0 + k, 0.15) for k in range(many)])
    angle = 0.1 + np.outer(1e-3 * (1 + np.arange(many)), np.sin(40.0 * TIME))
    starts = STATE + np.outer(1e-3 * np.arange(count), [1, 1, 0, 0, 0, 0])
    options = {"observer": observer_gains(2.0, DT), "substeps": 4, "begin": 0.37}
    columns = (1, 6)
    found = march_any(models, u, starts, DT, measured=angle, columns=columns, **options)
    assert found.shape == (count, TIME.size, len(columns))
    for k, run in enumerate(found):
        j = k if own else 0
        alone = march(models[k], u[j], starts[k], DT, measured=angle[j], **options)
        assert_same(run[None], alone[None][..., columns])


def test_closed_loop_each_with_its_own_gains():
    reference = 0.3 * np.sin(2 * np.pi * 6.0 * TIME)
    noise = 1e-3 * np.random.default_rng(2).normal(size=(9, TIME.size))
    models = [Model().with_values(J_L=2.0 + 0.2 * k) for k in range(9)]
    loops = [LOOP._replace(kp=3.0 + 0.5 * k) for k in range(9)]
    runs = simulate_batch(models, TIME, reference, loop=loops, noise=noise, outputs=BATCH_OUTPUTS)
    for k, (model, loop) in enumerate(zip(models, loops, strict=True)):
        u, out = close_loop(model, loop, reference, DT, noise=noise[k])
        assert_same(runs.outputs[k].T[None], np.hstack([out, u.T])[None])


def test_statistics_are_those_of_the_signals():
    models = [Model().with_values(c=c) for c in np.linspace(1.0, 9.0, 11)]
    u = voltages(1.2, 12.0, 0.15)
    runs = simulate_batch(models, TIME, u, STATE, outputs=BATCH_OUTPUTS)
    np.testing.assert_array_equal(runs.least, runs.outputs.min(axis=2))
    np.testing.assert_array_equal(runs.greatest, runs.outputs.max(axis=2))
    np.testing.assert_allclose(runs.mean, runs.outputs.mean(axis=2), rtol=1e-12, atol=1e-13)
    rms = np.sqrt(np.mean(runs.outputs**2, axis=2))
    np.testing.assert_allclose(runs.rms, rms, rtol=1e-12)
    few = simulate_batch(models, TIME, u, STATE, outputs=["omega_L"], every=7, jobs=1)
    np.testing.assert_array_equal(few.outputs[:, 0], runs.outputs[:, 1, ::7])
    np.testing.assert_array_equal(few.time, TIME[::7])
    np.testing.assert_array_equal(few.rms, runs.rms)


def test_result_does_not_depend_on_the_neighbours():
    """Bit for bit the same in any lane, beside any others, on any number of threads."""
    u = voltages(1.2, 12.0, 0.15)
    models = [Model().with_values(c=1.0 + 0.3 * k) for k in range(17)]
    runs = simulate_batch(models, TIME, u, outputs=OUTPUTS, jobs=2).outputs
    backwards = simulate_batch(models[::-1], TIME, u, outputs=OUTPUTS, jobs=1).outputs
    np.testing.assert_array_equal(runs, backwards[::-1])
    alone = simulate_batch(models[4:5], TIME, u, outputs=OUTPUTS).outputs
    np.testing.assert_array_equal(alone[0], runs[4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"models": []}, "models is empty"),
        ({"inputs": np.zeros((3, 61))}, r"inputs has shape \(3, 61\); needs \(2, 61\), or"),
        ({"outputs": ["speed"]}, "no output 'speed'; there are theta_L, omega_L"),
        ({"every": 0}, "every is 0; needs a whole number of at least 1"),
        ({"loop": [LOOP], "inputs": np.zeros(61)}, "loop has 1 entries for 2 models"),
        ({"inputs": np.full((2, 61), np.nan)}, "inputs holds a value that is not finite"),
    ],
)
def test_refuses_what_does_not_fit(change, message):
    given = {"models": [Model()] * 2, "timepts": TIME, "inputs": np.zeros((2, 61)), **change}
    with pytest.raises(ValueError, match=message):
        simulate_batch(**given)


def test_rigs_side_by_side_open_loop_and_under_a_law():
    """With sensors and inputs of their own names, from rest, as each alone."""
    rig = RigModel(parse_rig(AXIS))
    models = [rig.with_values({"body.table.inertia": x}) for x in (0.01, 0.02, 0.03)]
    volts = 6.0 * np.sin(2 * np.pi * 9.0 * TIME)
    runs = simulate_batch(models, TIME, volts[None], outputs=["w", "motor"])
    for model, (speed, signal) in zip(models, runs.outputs, strict=True):
        alone = simulate(model, TIME, volts).outputs[0]
        np.testing.assert_allclose(speed, alone, atol=1e-9 * np.ptp(alone))
        np.testing.assert_array_equal(signal, volts)
    law = Law(4.0, 20.0, model=rig)
    closed = simulate_batch(models, TIME, np.full(TIME.size, 2.0), loop=law, outputs=["w"])
    assert np.all(closed.outputs[:, 0, -1] > 1.0)
    with pytest.raises(ValueError, match="a Loop is of the dual-motor drive"):
        simulate_batch(models, TIME, volts, loop=LOOP)
    with pytest.raises(ValueError, match="no output 'omega_L'; there are w, motor"):
        simulate_batch(models, TIME, volts[None], outputs=["omega_L"])
