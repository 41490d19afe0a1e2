"""The one door: python-control's conventions and clear refusals."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate import METHODS, simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS

DT = 1e-3
TIME = DT * np.arange(30)
VOLTS = np.tile(np.linspace(0.0, 1.0, TIME.size), (2, 1))


@pytest.mark.parametrize("method", METHODS)
def test_gives_time_response_data(paper, method):
    before = VOLTS.copy()
    response = simulate(paper, TIME, VOLTS, method=method)
    assert isinstance(response, ct.TimeResponseData)
    np.testing.assert_array_equal(response.time, TIME)
    np.testing.assert_array_equal(response.inputs, VOLTS)
    assert response.outputs.shape == (len(OUTPUTS), TIME.size)
    assert list(response.output_labels) == list(OUTPUTS)
    np.testing.assert_array_equal(VOLTS, before)


def test_blocks_run_in_python_control_itself(paper):
    """`input_output_response` on the same blocks: a ramp, held at each sample's middle."""
    time = 1e-4 * np.arange(501)
    volts = np.tile(np.linspace(0.0, 1.0, time.size), (2, 1))
    own = ct.input_output_response(
        paper.to_blocks(),
        time,
        volts,
        solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-10, "max_step": 1e-3},
    )
    held = simulate(paper, time, volts + 0.5 * (volts[0, 1] - volts[0, 0]))
    error = np.abs(own.outputs - held.outputs).max(axis=1)
    scale = np.ptp(held.outputs, axis=1)
    moving = scale > 0.0
    assert moving.sum() >= 6
    assert np.all(error[moving] < 1e-3 * scale[moving])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": VOLTS[:1]}, r"inputs has shape \(1, 30\); needs \(2, 30\)"),
        ({"inputs": VOLTS.T}, r"inputs has shape \(30, 2\); needs \(2, 30\)"),
        ({"inputs": VOLTS * np.nan}, "inputs holds a value that is not finite"),
        ({"timepts": TIME**1.1}, "timepts is uneven: steps from"),
        ({"timepts": TIME[::-1]}, "timepts is uneven"),
        ({"timepts": 0.5}, r"timepts has shape \(\); needs \(n,\)"),
        ({"initial_state": np.zeros(3)}, r"initial_state has shape \(3,\); needs \(6,\)"),
        ({"method": "fast"}, "no method 'fast'; there are compiled, blocks, reference"),
        ({"substeps": 0}, "substeps is 0; needs a whole number of at least 1"),
    ],
)
def test_refuses_what_does_not_fit(paper, change, message):
    given = {"timepts": TIME, "inputs": VOLTS, **change}
    with pytest.raises(ValueError, match=message):
        simulate(paper, **given)


@pytest.mark.parametrize(("method", "option"), [("reference", "substeps"), ("compiled", "rtol")])
def test_refuses_an_option_of_another_method(paper, method, option):
    with pytest.raises(TypeError, match=f"method '{method}' has no option '{option}'"):
        simulate(paper, TIME, VOLTS, method=method, **{option: 1})


AXIS = """
name = "axis"
[body.table]
inertia = "0.02 kg m^2"
coulomb = "0.1 N m"
static = "0.15 N m"
stribeck_speed = "0.1 rad/s"
viscous = "0.04 N m s/rad"
[input.motor]
column = "u"
unit = "V"
gain = "0.1 N m/V"
[sensor.w]
column = "w"
unit = "rad/s"
"""


def test_a_rig_runs_by_every_method():
    """Starts, stops and turns back: what friction holds and lets go."""
    rig, time = parse_rig(AXIS), DT * np.arange(120)
    volts = 4.0 * np.sin(2 * np.pi * 12.0 * time)
    runs = {m: simulate(rig, time, volts, method=m).outputs[0] for m in METHODS}
    exact = runs["reference"]
    assert np.ptp(exact) > 0.5
    assert (exact == 0.0).sum() > 5
    for method in ("compiled", "blocks"):
        assert np.abs(runs[method] - exact).max() < 5e-3 * np.ptp(exact), method
    with pytest.raises(TypeError, match="method 'blocks' has no option 'contact'"):
        simulate(rig, time, volts, method="blocks", contact="eq21")
