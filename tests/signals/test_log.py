import pickle

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl import Log, LogError, load_log

TIME = np.arange(500) * 1e-3


def make(**channels):
    return Log("run", TIME, channels or {"theta_L": np.sin(TIME), "u_left": np.cos(TIME)})


def test_channels_and_time():
    log = make()
    assert log["theta_L"] == pytest.approx(np.sin(TIME), abs=0)
    assert log["time"] is log.time
    assert log.has("theta_L", "u_left")
    assert not log.has("theta_L", "omega_L")
    assert list(log) == ["theta_L", "u_left"]
    assert len(log) == 500
    assert log.sample_time == 1e-3
    assert log.duration == pytest.approx(0.499)
    assert log.units == {"theta_L": "rad", "u_left": "V"}


def test_missing_channel_names_those_that_are_there():
    with pytest.raises(LogError, match=r"^run: no channel 'omega_L'; it has theta_L, u_left$"):
        make()["omega_L"]
    with pytest.raises(KeyError):
        make()["omega_L"]


def test_nobody_can_write_to_it():
    mine = np.sin(TIME)
    log = make(theta_L=mine)
    mine[0] = 7.0
    assert log["theta_L"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        log["theta_L"][0] = 1.0
    with pytest.raises(TypeError):
        log.channels["theta_L"] = mine
    with pytest.raises(AttributeError):
        log.name = "other"


@pytest.mark.parametrize(
    ("time", "values", "message"),
    [
        ([0, 1, 2], [1, 2], "theta_L has 2 samples, time has 3"),
        ([0, 1, 2], [1, np.nan, 3], "theta_L is nan in row 2"),
        ([0, np.inf, 2], [1, 2, 3], "time is inf in row 2"),
        ([0, 1, 1], [1, 2, 3], "time does not increase in row 3"),
        ([], [], "the log is empty"),
        ([0, 1], ["a", "b"], "theta_L is not an array of numbers"),
        ([0, 1], [[1, 2], [3, 4]], "theta_L has shape"),
    ],
)
def test_refuses_what_is_no_signal(time, values, message):
    with pytest.raises(LogError, match=message):
        Log("run", np.array(time, dtype=float), {"theta_L": np.array(values)})


def test_segment_keeps_the_clock():
    part = make().segment(0.1, 0.2)
    assert part.time[0] == pytest.approx(0.1)
    assert part.time[-1] == pytest.approx(0.2)
    assert part["theta_L"] == pytest.approx(np.sin(part.time), abs=1e-15)
    with pytest.raises(LogError, match="no sample from 5 to 6 s"):
        make().segment(5, 6)


def test_uneven_time_has_no_sample_time():
    log = Log("run", [0.0, 1.0, 2.5], {"theta_L": np.zeros(3)})
    with pytest.raises(LogError, match="uneven time, steps 1 to 1.5 s"):
        _ = log.sample_time


def test_frame_has_units_in_its_names_and_reads_back():
    log = make(theta_L=np.sin(TIME), omega_L=np.cos(TIME), u_left=TIME)
    frame = log.to_frame()
    assert list(frame) == ["time_s", "theta_L_deg", "omega_L_deg_s", "u_left_V"]
    assert frame["theta_L_deg"].to_numpy() == pytest.approx(np.degrees(np.sin(TIME)), rel=1e-14)
    assert "theta_L_rad" in log.to_frame(degrees=False)
    again = load_log(frame)
    for channel in log:
        assert again[channel] == pytest.approx(log[channel], rel=1e-14, abs=1e-16)


def test_survives_a_trip_to_another_process():
    log = Log("run", TIME, {"x": TIME}, "ab", {"rig": "A"}, {"x": "m"}, ("look",))
    again = pickle.loads(pickle.dumps(log))
    np.testing.assert_array_equal(again["x"], log["x"])
    assert (again.name, again.sha256, again.warnings) == ("run", "ab", ("look",))
    assert dict(again.meta) == {"rig": "A"}
    assert dict(again.units) == {"x": "m"}


def test_html_shows_channels_and_no_foreign_markup():
    log = Log("<script>", TIME, {"theta_L": TIME})
    assert "theta_L_deg" in log._repr_html_()
    assert "<script>" not in log._repr_html_()


def test_with_channels_leaves_the_original():
    log = make()
    more = log.with_channels(omega_L=np.ones(500))
    assert more.has("omega_L")
    assert not log.has("omega_L")


def test_public_names_load_on_demand():
    import dmptm_ctrl

    assert "Log" in dir(dmptm_ctrl)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = dmptm_ctrl.nonsense


def test_frame_is_a_frame():
    assert isinstance(make().to_frame(), pd.DataFrame)
