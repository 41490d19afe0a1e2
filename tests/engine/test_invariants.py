"""What holds for any drive: drawn numbers and voltages, each effect of the catalogue."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import OUTPUTS, march
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.model import Model

DT = 1e-3  # s
TIME = DT * np.arange(81)
ANGLES = ("theta_L", "theta_p", "theta_m")
FREE = [
    name
    for name, effect in CATALOGUE.items()
    if not any(angle in effect.depends_on for angle in ANGLES)
]
factors = st.lists(st.floats(0.4, 2.0), min_size=8, max_size=8)
KEYS = ("c", "c_f", "k_m", "J_L", "gap_l", "gap_r", "T3c_plus", "TLs_minus")


def drive(scales):
    paper = Model().drive
    return Model().with_values(**{k: paper[k] * x for k, x in zip(KEYS, scales, strict=True)})


def voltages(amplitude, frequency, bias):
    wave = amplitude * np.sin(2 * np.pi * frequency * TIME)
    return wave + np.array([[bias], [-bias]])


inputs = st.builds(voltages, st.floats(0.2, 3.0), st.floats(3.0, 40.0), st.floats(-0.5, 0.5))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(scales=factors, u=inputs, substeps=st.sampled_from([1, 3, 8]))
def test_teeth_push_but_never_pull(scales, u, substeps):
    """Dry gaps: the torque has the sign of z, and none where z is inside the gap by far."""
    model = drive(scales).with_values(c_f=0.0)
    for out in (
        march(model, u, np.zeros(6), DT, substeps=substeps),
        march_any(LANES * [model], u, np.zeros(6), DT, substeps=substeps)[0],
    ):
        for s in "lr":
            torque, z = (out[:, OUTPUTS.index(f"{q}_{s}")] for q in ("torque", "z"))
            assert np.all(torque * z >= 0.0)


@pytest.mark.parametrize("name", [None, *FREE])
@settings(max_examples=8, deadline=None, derandomize=True)
@given(scales=factors, u=inputs, turn=st.sampled_from([-40.0, 0.75, 6.5]))
def test_only_the_angles_know_their_zero(name, scales, u, turn):
    """All angles moved together: the same motion, moved; but for rounding grown by impacts."""
    model = drive(scales)
    if name is not None:
        parameters = CATALOGUE[name].parameters
        values = {p.name: p.bank[len(p.bank) // 2] if p.bank else 0.1 * p.high for p in parameters}
        model = model.with_effect(name, **values)
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    moved = np.array([n2 * turn, n2 * turn, turn, 0.0, 0.0, 0.0])
    here, there = (march(model, u, x0, DT) for x0 in (np.zeros(6), moved))
    shift = {"theta_L": turn, "theta_ml": n1 * n2 * turn, "theta_mr": n1 * n2 * turn}
    for i, output in enumerate(OUTPUTS):
        difference = there[:, i] - shift.get(output, 0.0) - here[:, i]
        largest = max(np.abs(there[:, i]).max(), np.abs(here[:, i]).max(), 1.0)
        assert np.abs(difference).max() < 1e-6 * largest, output


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    scales=factors,
    state=st.tuples(
        *[st.floats(-0.01, 0.01)] * 2, st.floats(-0.5, 0.5), *[st.floats(-3.0, 3.0)] * 2
    ),
    speed=st.floats(-0.4, 0.4),
)
def test_free_decay_in_lanes_gains_no_energy(scales, state, speed):
    """Kinetic and elastic energy at each step; the scheme keeps one that differs by (ω h)²/8."""
    model = drive(scales)
    values = model.drive
    h, steps = 1e-5, 2000  # s
    n2 = values["N_2"]
    z_l, z_r, theta, v_l, v_r = state
    x0 = np.array([n2 * theta + z_l, n2 * theta + z_r, theta, v_l, v_r, speed])
    out = march_any(LANES * [model], np.zeros((2, steps)), x0, h, substeps=1)[0]
    angles = np.array([out[:, 2] / values["N_1"], out[:, 3] / values["N_1"], out[:, 0]])
    # q₊ = q + ½ h (v + v₊), solved for v₊ from the first on: an alternating sum
    turns = 2.0 * np.diff(angles, prepend=angles[:, :1]) / h
    turns[:, 0] = x0[3:]
    sign = (-1.0) ** np.arange(steps)
    speeds = sign * np.cumsum(sign * turns, axis=1)
    np.testing.assert_allclose(speeds[2], out[:, 1], atol=1e-6)
    pinion = values["J_2"] + values["N_1"] ** 2 * values["J_m"]
    energy = 0.5 * np.array([pinion, pinion, values["J_L"]]) @ speeds**2
    for column, gap in (("z_l", "gap_l"), ("z_r", "gap_r")):
        depth = np.maximum(np.abs(out[:, OUTPUTS.index(column)]) - values[gap], 0.0)
        energy += 0.5 * values["k_m"] * depth**2
    stiffest = np.sqrt(values["k_m"] * (1.0 / pinion + 2.0 * n2**2 / values["J_L"]))
    allowed = 0.25 * (stiffest * h) ** 2 * energy[0]
    assert np.all(energy - np.minimum.accumulate(energy) <= allowed + 1e-12)
