"""What the pictures draw is what was computed, on the axes that were given."""

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

from dmptm_ctrl.control import common_mode
from dmptm_ctrl.drive import Tooth, simplification_cost, three_dof_ss
from dmptm_ctrl.effects.backlash import Backlash, mesh_torque
from dmptm_ctrl.plots.linear import bode_compare, response_plot, simplification_plot, step_compare
from dmptm_ctrl.plots.mesh import dead_zone_plot, tooth_plot
from dmptm_ctrl.plots.paper import amplitude_styles, experiment_plot, friction_plot

PLANT = common_mode(three_dof_ss())


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def test_bode_draws_the_response():
    plot = bode_compare({"plant": PLANT}, omega_limits=(1.0, 100.0))
    assert isinstance(plot, ct.ControlPlot)
    magnitude, phase = (panel.lines[0] for panel in plot.axes[:, 0])
    response = PLANT(2j * np.pi * magnitude.get_xdata())
    np.testing.assert_allclose(magnitude.get_ydata(), 20 * np.log10(abs(response)), atol=1e-6)
    turned = np.exp(1j * np.radians(phase.get_ydata()))
    np.testing.assert_allclose(turned, response / abs(response), atol=1e-6)
    assert "Hz" in plot.axes[1, 0].get_xlabel()


def test_a_wide_legend_stands_below_the_bode_plot():
    for label, panel in (("plant", 0), ("my drive: motor_encoder over current", 1)):
        plot = bode_compare({label: PLANT}, omega_limits=(1.0, 100.0))
        shown = [axes.get_legend() is not None for axes in plot.axes[:, 0]]
        assert shown == [panel == 0, panel == 1]


def test_bode_takes_radians_and_plain_gain():
    plot = bode_compare({"plant": PLANT}, omega_limits=(1.0, 100.0), Hz=False, dB=False)
    line = plot.axes[0, 0].lines[0]
    np.testing.assert_allclose(line.get_ydata(), abs(PLANT(1j * line.get_xdata())), rtol=1e-9)
    assert "rad" in plot.axes[1, 0].get_xlabel()


def test_step_draws_the_step_on_the_axes_given():
    _, ax = plt.subplots()
    plot = step_compare({"plant": PLANT}, 1.0, height=0.6, scale=2.0, unit="speed", ax=ax)
    assert isinstance(plot, ct.ControlPlot)
    assert plot.axes[0, 0] is ax
    line = ax.lines[0]
    expected = ct.step_response(PLANT, line.get_xdata()).outputs
    np.testing.assert_allclose(line.get_ydata(), 1.2 * expected, atol=1e-9)
    assert ax.get_ylabel() == "speed"
    assert step_compare({"plant": PLANT}, 1.0).axes[0, 0].get_ylabel() == "omega_L [SI]"


def test_response_leaves_out_where_nothing_moves():
    """No gain has no phase, rattle none that means a thing: not drawn, their coherence is."""
    omega = 2 * np.pi * np.array([1.0, 2.0, 4.0, 8.0])
    data = ct.frd([[[1j, -0.5, 0.0, 1e-4]]], omega)
    seen = [0.9, 0.8, 0.0, 0.02]
    panels = response_plot({"held": (data, seen)}, reference={"plant": PLANT})
    np.testing.assert_allclose(panels[0].lines[0].get_ydata(), 20 * np.log10([1.0, 0.5]))
    np.testing.assert_allclose(panels[1].lines[0].get_ydata(), [90.0, 180.0])
    np.testing.assert_allclose(panels[2].lines[0].get_ydata(), seen)
    reference = panels[0].lines[1]
    np.testing.assert_allclose(
        reference.get_ydata(), 20 * np.log10(abs(PLANT(2j * np.pi * reference.get_xdata())))
    )


def test_simplification_shows_the_norms():
    cost = simplification_cost()
    panel = simplification_plot(cost)
    labels = [text.get_text() for text in panel.get_legend().get_texts()]
    assert any(f"H∞ {cost.h_inf['three_dof']:.3g}" in label for label in labels)
    top = max(line.get_ydata().max() for line in panel.lines)
    assert top <= cost.h_inf["full"] * (1 + 1e-9)


def test_experiment_is_in_degrees():
    time = np.linspace(0.0, 1.0, 11)
    panel = experiment_plot(
        time,
        np.radians(10 * time),
        {"existing": np.radians(9 * time)},
        scores={"existing": (1.0, 90.0, np.radians(0.5))},
    )
    np.testing.assert_allclose(panel.lines[0].get_ydata(), 10 * time)
    np.testing.assert_allclose(panel.lines[1].get_ydata(), 9 * time)
    assert "RMSE 0.50 deg/s" in panel.get_legend().get_texts()[1].get_text()


def test_friction_keeps_the_sign_of_the_speed():
    speed = np.radians([-10.0, -1.0, 1.0, 10.0])
    torque = np.array([3.0, 2.0, 2.5, 3.5])
    panel = friction_plot(speed, torque, 0.1 * torque, (speed, np.sign(speed) * torque))
    drawn = [line.get_ydata() for line in panel.lines[:2]]
    np.testing.assert_allclose(np.concatenate(drawn), [-3.0, -2.0, 2.5, 3.5])
    assert [t.get_text() for t in panel.get_xticklabels()] == ["-10", "-1", "0", "1", "10"]


def test_dead_zone_is_the_kernels():
    law = Backlash(3.6e4, 3.0, 0.05, 0.004)
    panels = dead_zone_plot(law, (0.0, 0.5))
    line = panels[1].lines[1]
    expected = [mesh_torque(1e-3 * z, 0.5, law) for z in line.get_xdata()]
    np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-9)


def test_tooth_is_half_a_pitch_wide_where_the_load_is():
    tooth = Tooth(0.002, 20, 0.01)
    panel = tooth_plot(tooth)
    x, y = panel.collections[0].get_paths()[0].vertices.T
    level = 1e3 * (tooth.section(tooth.pitch_radius)[0] - tooth.section(tooth.root_radius)[0])
    at = np.abs(y - level).argmin()
    assert 2 * abs(x[at]) == pytest.approx(np.pi, rel=0.01)  # π m/2, chord a little less


def test_amplitudes_differ_in_marks_models_in_colour():
    styles = amplitude_styles(["proposed, 1", "proposed, 2", "existing, 1", "existing, 2"])
    assert styles["proposed, 1"]["color"] == styles["proposed, 2"]["color"]
    assert styles["proposed, 1"]["color"] != styles["existing, 1"]["color"]
    assert styles["existing, 1"]["markerfacecolor"] != styles["existing, 2"]["markerfacecolor"]


def test_wrong_number_of_axes():
    _, ax = plt.subplots()
    with pytest.raises(ValueError, match="1 axes given, 2 are needed"):
        bode_compare({"plant": PLANT}, ax=ax)
