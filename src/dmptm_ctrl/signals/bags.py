"""Recordings of robots: MCAP files (extra ``mcap``) and ROS bags (extra ``rosbags``)."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dmptm_ctrl.signals.columns import CLOCK, Choose, Table
from dmptm_ctrl.signals.errors import LogError, NotALogError, optional

MAX_ITEMS = 64  # of an array in a message that become columns

_Message = tuple[str, int, Any]  # topic, time [ns], fields


def read_bag(path: Path, choose: Choose) -> Table:
    """Read numbers in the messages of .mcap (JSON or ROS), .bag of ROS 1, .db3 of a ROS 2 bag.

    A column is called by its topic and field: ``/joint_states.position[0]``, ``/drive.current``.
    Each topic is on the clock of its header, or else on that of the recording.
    """
    messages = _mcap(path) if path.suffix.lower() == ".mcap" else _ros(path)
    times: dict[str, list[int]] = {}
    rows: dict[str, list[dict[str, float]]] = {}
    try:
        for topic, recorded, message in messages:
            row: dict[str, float] = {}
            stamp = _flatten("", message, row)
            times.setdefault(topic, []).append(stamp or recorded)
            rows.setdefault(topic, []).append(row)
    except (ImportError, OSError, LogError):
        raise
    except Exception as error:  # the libraries raise what their parsers stumble on
        raise NotALogError(f"{path.name}: not a readable {path.suffix} file, or damaged") from error
    names = {t: list(dict.fromkeys(n for r in rs for n in r)) for t, rs in rows.items()}
    every = [f"{topic}{n}" for topic, fields in names.items() for n in fields]
    if not every:
        raise NotALogError(f"{path.name}: no numbers in its messages")
    chosen = choose([CLOCK, *every], {CLOCK: "s"})
    used = [t for t, fields in names.items() if any(f"{t}{n}" in chosen for n in fields)]
    if not used:
        return Table({}, {}, {})
    start = min(times[t][0] for t in used)
    clocks = {t: (np.array(times[t], dtype=np.int64) - start) * 1e-9 for t in used}
    main = max(used, key=lambda t: len(times[t]))
    columns: dict[str, Any] = {CLOCK: clocks[main]}
    own = {}
    for topic in used:
        for field in names[topic]:
            name = f"{topic}{field}"
            if name in chosen:
                columns[name] = np.array([row.get(field, np.nan) for row in rows[topic]])
                if topic != main:
                    own[name] = clocks[topic]
    return Table(columns, {CLOCK: "s"}, {}, (), own)


def _flatten(name: str, value: Any, row: dict[str, float]) -> int:
    """Put the numbers of a message into `row`; the time in its header [ns], 0 without one."""
    fields = value if isinstance(value, Mapping) else getattr(value, "__dict__", None)
    if isinstance(value, bool | int | float | np.number):
        row[name] = float(value)
    elif fields is not None:
        second = next((fields[k] for k in ("sec", "secs") if k in fields), None)
        fraction = next((fields[k] for k in ("nanosec", "nsec", "nsecs") if k in fields), 0)
        if second is not None and len(fields) <= 3:
            return int(second) * 10**9 + int(fraction)
        stamps = [_flatten(f"{name}.{k}", v, row) for k, v in fields.items() if k[:2] != "__"]
        return max(stamps, default=0)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= MAX_ITEMS:
        for index, item in enumerate(value):
            _flatten(f"{name}[{index}]", item, row)
    return 0


def _mcap(path: Path) -> Iterator[_Message]:
    make_reader = optional("mcap.reader", "MCAP files", "mcap").make_reader
    stores: dict[str, Any] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.message_encoding == "json":
                yield channel.topic, message.log_time, json.loads(message.data)
            elif schema is not None and schema.encoding in ("ros1msg", "ros2msg"):
                yield channel.topic, message.log_time, _decoded(stores, schema, message.data)


def _decoded(stores: dict[str, Any], schema: Any, data: bytes) -> Any:
    """ROS message in an MCAP file, by the definition that the file carries."""
    ros1, name = schema.encoding == "ros1msg", schema.name
    if "/msg/" not in name:
        name = name.replace("/", "/msg/", 1)
    if name not in stores:
        typesys = _rosbags("typesys")
        which = typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE
        store = stores[name] = typesys.get_typestore(which)
        known = typesys.get_types_from_msg(schema.data.decode(), name)
        store.register({n: t for n, t in known.items() if n not in store.fielddefs})
    store = stores[name]
    return (store.deserialize_ros1 if ros1 else store.deserialize_cdr)(data, name)


def _rosbags(module: str) -> Any:
    return optional(f"rosbags.{module}", "ROS messages", "rosbags")


def _ros(path: Path) -> Iterator[_Message]:
    typesys = _rosbags("typesys")
    source = path.parent if path.suffix.lower() == ".db3" else path
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with _rosbags("highlevel").AnyReader([source], default_typestore=store) as reader:
        for connection, time, raw in reader.messages():
            yield connection.topic, time, reader.deserialize(raw, connection.msgtype)
