"""Torques and temperatures that only rise, beside the clock."""

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals.header import is_clock_name

RIG = """
[body.rotor]
inertia = "0.01 kg m^2"
[input.drive]
column = "{torque}"
unit = "N m"
[sensor.phi]
column = "phi"
unit = "rad"
"""


@pytest.mark.parametrize("torque", ["T_Nm", "T_mot", "t_cmd"])
def test_a_torque_in_steps_that_rise_is_no_clock_of_the_next_column(tmp_path, torque):
    time = 1e-3 * np.arange(4000)
    push = np.repeat([-1.3, 0.9, 1.8, 2.0], 1000)
    angle = np.cumsum(np.cumsum(push)) * 1e-5
    path = tmp_path / "steps.csv"
    pd.DataFrame({"t": time, torque: push, "phi": angle}).to_csv(path, index=False)
    log = parse_rig(RIG.format(torque=torque)).load(path)
    np.testing.assert_allclose(log["out_phi"], angle, atol=1e-9)
    np.testing.assert_allclose(log["in_drive"], push)


@pytest.mark.parametrize("name", ["T_Nm", "T1", "T_motor"])  # a torque, and temperatures
def test_what_nothing_reads_and_seldom_rises_is_no_clock(tmp_path, name):
    time = 1e-3 * np.arange(4000)
    path = tmp_path / "steps.csv"
    table = {"time_s": time, "u_left_V": np.sin(time), "u_right_V": np.cos(time)}
    table |= {name: np.round(time, 1), "theta_L_deg": time**2}
    pd.DataFrame(table).to_csv(path, index=False)
    np.testing.assert_allclose(load_log(path)["theta_L"], np.deg2rad(time**2), atol=1e-9)


def test_a_temperature_that_always_rises_is_no_clock_beside_another_word(tmp_path):
    """Clocks of channels are called alike, as by the programs that write them."""
    time = 1e-3 * np.arange(4000)
    path = tmp_path / "warm.csv"
    table = {"Time [s]": time, "T_winding": 20.0 + 3.0 * time, "phi": np.sin(time), "u": time}
    pd.DataFrame(table).to_csv(path, index=False)
    log = parse_rig(RIG.format(torque="u")).load(path)
    np.testing.assert_allclose(log["out_phi"], np.sin(time), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "clock"),
    [("t", True), ("time_s", True), ("t [ms]", True), ("Time CH2", True), ("T_Nm", False),
     ("T [N m]", False), ("T_A", False), ("timestamp_us", True)],
)  # fmt: skip
def test_a_clock_has_a_unit_of_time_or_none(name, clock):
    assert is_clock_name(name) == clock
