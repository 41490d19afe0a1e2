"""Recordings of robots, where the readers are installed."""

import io
import json
import sys

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError, load_log

T = 0.01 * np.arange(300)
RIG = """
[body.a]
inertia = "unknown"
[input.u]
column = "/drive.current"
unit = "A"
[sensor.q]
column = "/joint_states.position[0]"
unit = "rad"
[data]
time = "t_s"
"""


def messages():
    for i, t in enumerate(T):
        stamp = {"sec": 1_760_000_000 + int(t), "nanosec": round(1e9 * (t % 1))}
        yield (
            "/joint_states",
            t,
            {"header": {"stamp": stamp}, "name": ["a"], "position": [np.sin(t)]},
        )
        if i % 2 == 0:  # half as often
            yield "/drive", t, {"header": {"stamp": stamp}, "current": float(np.cos(t)), "on": True}


def test_mcap_of_json(tmp_path):
    writer_of = pytest.importorskip("mcap.writer")
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = writer_of.Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        topics = {
            t: writer.register_channel(t, "json", schema) for t in ("/joint_states", "/drive")
        }
        for topic, t, content in messages():
            moment = 5 + int(1e9 * t)
            writer.add_message(topics[topic], moment, json.dumps(content).encode(), moment)
        writer.finish()
    (log,) = parse_rig(RIG).read(tmp_path / "run.mcap")
    assert log.sample_time == pytest.approx(0.01)
    np.testing.assert_allclose(log["out_q"], np.sin(log.time), atol=1e-6)
    np.testing.assert_allclose(log["in_u"], np.cos(log.time), atol=0.02**2 / 8 * 1.01 + 1e-6)
    assert any("/drive.current on another clock" in w for w in log.warnings)


def test_ros_bag(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = store.types["sensor_msgs/msg/JointState"]
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with Writer(tmp_path / "run.bag") as writer:
        connection = writer.add_connection("/joint_states", kind.__msgtype__, typestore=store)
        for i, t in enumerate(T):
            stamp = time(sec=1_760_000_000 + int(t), nanosec=round(1e9 * (t % 1)))
            message = kind(
                header=header(seq=i, stamp=stamp, frame_id=""), name=["a"],
                position=np.array([np.sin(t)]), velocity=np.array([np.cos(t)]),
                effort=np.array([0.5]),
            )  # fmt: skip
            raw = store.serialize_ros1(message, kind.__msgtype__)
            writer.write(connection, 10**18 + int(1e9 * t), raw)
    text = RIG.replace("/drive.current", "/joint_states.velocity[0]")
    (log,) = parse_rig(text).read(tmp_path / "run.bag")
    np.testing.assert_allclose(log.time, T, atol=1e-7)
    np.testing.assert_allclose(log["out_q"], np.sin(T), atol=1e-12)


@pytest.mark.parametrize(("name", "extra"), [("run.mcap", "mcap"), ("run.bag", "rosbags")])
def test_missing_reader_is_named(tmp_path, monkeypatch, name, extra):
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    (tmp_path / name).write_bytes(io.BytesIO(b"x" * 50).getvalue())
    with pytest.raises(LogError, match=rf"pip install 'dmptm-ctrl\[{extra}\]'"):
        load_log(tmp_path / name)


@pytest.mark.parametrize("name", ["run.mcap", "run.bag"])
def test_damaged(tmp_path, name):
    pytest.importorskip("mcap.reader")
    pytest.importorskip("rosbags")
    (tmp_path / name).write_bytes(b"x" * 50)
    with pytest.raises(LogError, match=f"{name}: not a readable"):
        load_log(tmp_path / name)
