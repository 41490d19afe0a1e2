"""The controller's difference equations run as they stand, against its transfer function."""

import re
from collections import defaultdict

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.control.sections import sampled_notch
from dmptm_ctrl.design.controller import Controller, Notch
from dmptm_ctrl.simulate.compiled import OUTPUTS, close_loop
from dmptm_ctrl.simulate.model import Model

DT = 1e-3
NOTCHES = (Notch(60.0, 0.2, 0.4), Notch(231.0, 0.1, 0.3), Notch(7.0, 2.0, 0.2), Notch(400, 0.5, 1))
NOTCHES = (*NOTCHES, *(Notch(hz, 0.2, 0.4) for hz in (6.0, 11.0, 24.0, 90.0)))


def run(text, ref, omega):
    """Execute the lines for each sample; of the feed-forward there is none."""
    values = defaultdict(lambda: defaultdict(float))  # 0 before the first sample
    values["ref"] |= dict(enumerate(ref))
    values["omega_L"] |= dict(enumerate(omega))
    lines = [x for x in text.splitlines() if not x.startswith(("every", "f_s"))]
    scope = {"clip": lambda x, low, high: min(max(x, low), high), "abs": abs}
    for name in set(re.findall(r"([A-Za-z_]\w*)\[k", text)):
        scope[name] = values[name]
    code = [compile(line, "<equations>", "exec") for line in lines]
    for k in range(len(ref)):
        for line in code:
            exec(line, {"__builtins__": {}}, {**scope, "k": k})
    return {n: np.array([v[k] for k in range(len(ref))]) for n, v in values.items()}


@pytest.mark.parametrize("count", range(9))
def test_equations_are_the_transfer_function(count):
    controller = Controller(
        4.5836623610465859, 85.943669269623484, 1e6, notches=NOTCHES[:count], sample_time=DT
    )
    error = np.random.default_rng(3).normal(size=400)
    found = run(controller.equations(), error, np.zeros(400))
    expected = ct.forced_response(controller.to_discrete(), DT * np.arange(400), error).outputs
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found["u_left"], expected, atol=1e-9 * scale)
    # the transfer function itself, section by section in z
    z = np.exp(2j * np.pi * DT * np.array([0.3, 5.0, 60.0, 300.0]))
    own = controller.kp + controller.ki * DT * z / (z - 1)
    for part in controller.notches:
        b0, b1, b2, a1, a2 = sampled_notch(part.hz, part.depth, part.width, DT)
        own = own * (b0 * z**2 + b1 * z + b2) / (z**2 + a1 * z + a2)
    np.testing.assert_allclose(controller.to_discrete()(z), own, rtol=1e-8)


@pytest.mark.parametrize(
    "more",
    [{}, {"relief_from": 0.3, "relief_to": 0.9}, {"limit": 0.5}],
    ids=["", "relief", "limit"],
)
def test_equations_are_the_simulated_loop(more):
    """Also preload, its relief, the limit and the anti-windup: volts of the compiled loop."""
    given = {"limit": 10.0, "preload": 0.2, "notches": NOTCHES[:2], "tracking": 25.0, **more}
    controller = Controller(4.6, 86.0, **given)
    time = DT * np.arange(500)
    ref = 0.3 * np.sin(2 * np.pi * 2 * time)
    u, out = close_loop(Model(), controller.law(), ref, DT)
    found = run(controller.equations(), ref, out[:, OUTPUTS.index("omega_L")])
    np.testing.assert_allclose(found["u_left"], u[0], atol=1e-9)
    np.testing.assert_allclose(found["u_right"], u[1], atol=1e-9)


def test_nan_is_refused():
    with pytest.raises(ValueError, match="ki is NaN; it must be"):
        Controller(1.0, np.nan, 10.0)
    with pytest.raises(ValueError, match="sample_time is 0; it must be more than 0"):
        Controller(1.0, 1.0, 10.0, sample_time=0.0)
