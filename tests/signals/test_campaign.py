import numpy as np
import pytest

from dmptm_ctrl import Log, LogError, data, load_logs
from dmptm_ctrl.signals import Campaign

TIME = np.arange(500) * 1e-3


def log(name, *, step=1.0, scale=1.0, **units):
    units = units or {"u": "V", "x": "m"}
    channels = {c: scale * np.sin(TIME + i) for i, c in enumerate(units)}
    return Log(name, step * TIME, channels, units=units)


def test_folder_is_a_campaign():
    campaign = load_logs(data.path("demo_rig"))
    assert len(campaign) == 10
    assert campaign.names[0] == "closed_sine_10"
    assert campaign.channels == ("u_left", "u_right", "theta_L", "omega_L")
    assert campaign.sample_time == 1e-3
    assert campaign["open_sine_0v60"] is campaign[6]
    assert campaign[:3].names == campaign.names[:3]
    assert len({log.sha256 for log in campaign}) == 10
    with pytest.raises(KeyError, match="no log 'none'"):
        campaign["none"]


def test_files_one_by_one():
    paths = sorted(data.path("demo_rig").glob("open_*.csv.gz"))
    assert load_logs(paths).names == tuple(p.name.removesuffix(".csv.gz") for p in paths)
    assert len(load_logs(paths[0])) == 1


def test_empty_folder(tmp_path):
    (tmp_path / "README.md").write_text("no log")
    with pytest.raises(LogError, match="no logs in"):
        load_logs(tmp_path)
    with pytest.raises(LogError, match="no logs"):
        load_logs([])


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"u": "V"}, "different rigs: a has x, b has not"),
        ({"u": "V", "x": "m", "v": "m/s"}, "different rigs: b has v, a has not"),
        ({"u": "V", "x": "rad"}, "different rigs: x is in m in a, in rad in b"),
    ],
)
def test_different_rigs(other, message):
    with pytest.raises(LogError, match=message):
        Campaign((log("a"), log("b", scale=2.0, **other)))


def test_different_rigs_from_files():
    sources = [
        data.path("demo_rig") / "open_sine_0v60.csv.gz",
        data.path("null_rig") / "open_sine_0v75.csv.gz",
    ]
    with pytest.raises(LogError, match="open_sine_0v75 has theta_ml, open_sine_0v60 has not"):
        load_logs(sources)


def test_same_name_other_samples():
    with pytest.raises(LogError, match="two logs named a with different samples"):
        Campaign((log("a"), log("a", scale=2.0)))


def test_different_sample_time():
    with pytest.raises(LogError, match=r"different sample time: a 0.001 s, b 0.0011 s"):
        Campaign((log("a"), log("b", step=1.1)))


def test_setpoint_is_optional():
    units = {"u": "V", "x": "m"}
    assert Campaign((log("a"), log("b", scale=2.0, ref="m", **units))).channels == ("u", "x")


def test_duplicates_are_left_out_and_named():
    campaign = Campaign((log("a"), log("copy"), log("b", scale=2.0)))
    assert campaign.names == ("a", "b")
    assert campaign.warnings == ("copy holds the same samples as a and is left out",)


def test_frames_and_logs_mix():
    campaign = load_logs([log("a"), log("b", scale=2.0).to_frame()])
    assert campaign.names == ("a", "table2")
