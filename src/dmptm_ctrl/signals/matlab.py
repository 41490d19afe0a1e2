"""MATLAB files: plain arrays, structures, Simulink logs and dSPACE recordings."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import ColumnsError, NotALogError, optional
from dmptm_ctrl.signals.subprocess_reader import Signal, read_in_subprocess
from dmptm_ctrl.signals.units import unit_of

MAX_WIDTH = 64  # columns of one array that are taken apart
_OBJECTS = "(objects)"  # their names, among the texts
_OBJECT = 0xDD000000  # begins the reference to an object, which only MATLAB can follow


def read_matlab(path: Path, choose: Choose) -> Table:
    """Read the signals of a .mat file: to version 7 by SciPy, 7.3 by pymatreader.

    A column is called by its variable or field, as far from the end of its path as makes it
    unique: ``rig.omega_L_deg_s`` is omega_L_deg_s if there is no other; column k of a matrix
    ``data`` is data1, data2, … Scalars and texts are in ``meta``.
    """
    found, meta = read_in_subprocess(path)
    objects = meta.pop(_OBJECTS, "")
    how = (
        f"objects such as {objects or 'timeseries'} must be saved as structures: s.time_s = ts.Time"
    )
    if not found:
        raise NotALogError(f"{path.name}: no signals in the file; {how}")
    times = {s.clock: s.values for s in found if s.is_time}
    main = max(times, key=lambda c: len(times[c]), default=0)
    found = [s for s in found if not s.is_time or s.clock == main]
    names = _short_names([signal.path for signal in found])
    units = {n: s.unit for n, s in zip(names, found, strict=True) if s.unit}
    try:
        kept = set(choose(names, units))
    except ColumnsError as error:
        raise (ColumnsError(f"{error}; {how}") if objects else error) from None
    read = {n: s for n, s in zip(names, found, strict=True) if n in kept}
    clocks = {n: times[s.clock] for n, s in read.items() if s.clock in times and s.clock != main}
    return Table({n: s.values for n, s in read.items()}, units, meta, (), clocks)


def find_signals(path: Path) -> tuple[list[Signal], dict[str, Any]]:
    """Signals, scalars and texts of a .mat file; run it by `read_in_subprocess`, it may crash."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        hdf = stream.read(10) == b"MATLAB 7.3"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of classes that are read as far as they can be
        if hdf:
            content = optional("pymatreader", "MATLAB 7.3 files", "mat73").read_mat(str(path))
        else:
            content = loadmat(path, simplify_cells=True, appendmat=False)
    meta: dict[str, Any] = {}
    plain = {name: content[name] for name in sorted(content) if not name.startswith(("__", "#"))}
    return _one_clock(list(_walk((), plain, meta))), meta


def _walk(path: tuple[str, ...], value: Any, meta: dict[str, Any]) -> Iterator[Signal]:
    if isinstance(value, Mapping):
        if {"X", "Y"} <= value.keys():
            yield from _dspace(path, value)
        elif {"time", "signals"} <= value.keys():
            yield from _simulink(path, value)
        elif (path or "Data" in value) and (series := _series(value)) is not None:
            yield from _timeseries(path, series)
        else:
            for name, inner in value.items():
                # of an element of a Dataset
                own = path if name == "Values" and path else (*path, str(name))
                yield from _walk(own, inner, meta)
    elif isinstance(value, list) and (columns := _columns(value)) is not None:
        yield from _walk(path, columns, meta)
    elif isinstance(value, list):
        for index, inner in enumerate(value, start=1):
            yield from _walk((*path[:-1], f"{path[-1]}{index}"), inner, meta)
    elif isinstance(value, str | int | float):
        meta[".".join(path)] = value
    elif isinstance(value, np.ndarray) and value.dtype == np.uint32 and _OBJECT in value.flat[:1]:
        meta[_OBJECTS] = ", ".join(filter(None, (meta.get(_OBJECTS), ".".join(path))))
    else:
        yield from _array(path, value, None)


def _array(
    path: tuple[str, ...], value: Any, unit: str | None, clock: int = 0, is_time: bool = False
) -> Iterator[Signal]:
    array = np.squeeze(np.asarray(value))
    if array.dtype.kind not in "fiub" or array.size < 2 or array.ndim > 2:
        return
    if array.ndim == 1:
        yield Signal(path, array, unit, clock, is_time)
        return
    if array.shape[1] > array.shape[0]:
        array = array.T
    if array.shape[1] <= MAX_WIDTH:
        for k, column in enumerate(array.T, start=1):
            own = (*path[:-1], f"{path[-1]}{k}")
            yield Signal(own, np.ascontiguousarray(column), unit, clock, is_time)


def _dspace(path: tuple[str, ...], record: Mapping[str, Any]) -> Iterator[Signal]:
    """Recording of dSPACE ControlDesk: axes X, signals Y with Name, Data, Unit and XIndex."""
    clocks: list[tuple[int, int]] = []  # and their samples
    for axis in _structs(record["X"]):
        for found in _array((*path, "time_s"), axis.get("Data"), "s", id(axis), is_time=True):
            clocks.append((id(axis), found.values.size))
            yield found
    for signal in _structs(record["Y"]):
        # Names are paths into the model: "Model Root"/"Plant"/"omega_L"
        name = tuple(p.strip().strip('"') for p in str(signal.get("Name", "Y")).split("/"))
        unit = signal.get("Unit")
        for found in _array((*path, *name), signal.get("Data"), unit if _text(unit) else None):
            own = signal.get("XIndex", 0)
            like = [c for c, size in clocks if size == found.values.size]
            if own in range(1, len(clocks) + 1) and clocks[own - 1][0] in like:
                like = [clocks[own - 1][0]]
            yield found._replace(clock=(like or [0])[0])


def _simulink(path: tuple[str, ...], log: Mapping[str, Any]) -> Iterator[Signal]:
    """Simulink's structure with time: time, signals.values, signals.label."""
    yield from _array((*path, "time_s"), log["time"], "s", id(log), is_time=True)
    for index, signal in enumerate(_structs(log["signals"]), start=1):
        label = signal.get("label")
        name = str(label) if _text(label) else f"signal{index}"
        yield from _array((*path, name), signal.get("values"), None, id(log))


def _series(value: Mapping[str, Any]) -> dict[str, Any] | None:
    """Fields, as of a timeseries, of a structure of one signal with a name or a time, or None."""
    fields = {
        "time": "Time", "t": "Time", "data": "Data", "values": "Data", "value": "Data", "y": "Data",
        "name": "Name", "label": "Name", "unit": "Unit", "units": "Unit",
    }  # fmt: skip
    found = {fields.get(n.lower(), n): v for n, v in value.items()}
    arrays = {n for n, v in found.items() if not isinstance(v, str | Mapping) and np.size(v) > 1}
    named = arrays == {"Data"} and _text(found.get("Name"))
    if len(found) < len(value) or not (named or arrays == {"Time", "Data"}):
        return None
    return found


def _columns(value: list[Any]) -> dict[str, Any] | None:
    """Columns of an array of structures with a number in each field: a structure per sample."""
    if len(value) < 2 or not all(isinstance(v, Mapping) for v in value):
        return None
    if not all(np.isscalar(x) and not isinstance(x, str) for v in value for x in v.values()):
        return None
    names = value[0].keys()
    if any(v.keys() != names for v in value):
        return None
    return {name: np.array([v[name] for v in value]) for name in names}


def _timeseries(path: tuple[str, ...], series: Mapping[str, Any]) -> Iterator[Signal]:
    """Fields of a timeseries: Time, Data, Name, DataInfo.Units, TimeInfo.Units."""
    clock = id(series) if "Time" in series else 0
    if "Time" in series:
        ticks = unit_of(str(_inner(series, "TimeInfo", "Units")))
        factor = ticks.factor if ticks is not None and ticks.symbol == "s" else 1.0
        for found in _array((*path, "time_s"), series["Time"], "s", clock, is_time=True):
            yield found._replace(values=factor * found.values)
    stated = series.get("Unit") or _inner(series, "DataInfo", "Units")
    name = series.get("Name")
    own = (*path, str(name)) if _text(name) and name != "unnamed" else path
    unit = stated if _text(stated) else None
    yield from _array(own or ("Data",), series["Data"], unit, clock)


def _inner(value: Mapping[str, Any], *keys: str) -> Any:
    """What stands below keys, "" if nothing does."""
    for key in keys:
        value = value.get(key, "") if isinstance(value, Mapping) else ""
    return value


def _text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _structs(value: Any) -> list[Mapping[str, Any]]:
    """Structure array as a list; version 7.3 gives one structure of lists instead."""
    if isinstance(value, Mapping):
        lists = [v for v in value.values() if isinstance(v, list)]
        if lists and len(lists) == len(value) and len({len(v) for v in lists}) == 1:
            return [dict(zip(value, row, strict=True)) for row in zip(*lists, strict=True)]
        return [value]
    if isinstance(value, list | np.ndarray):
        return [item for item in value if isinstance(item, Mapping)]
    return []


def _one_clock(found: list[Signal]) -> list[Signal]:
    """Make clocks that tick alike one: each timeseries brings its own."""
    times: dict[int, Any] = {}
    same: dict[int, int] = {}
    kept = []
    for signal in found:
        if signal.is_time:
            alike = (c for c, t in times.items() if np.array_equal(t, signal.values))
            same[signal.clock] = next(alike, signal.clock)
            if same[signal.clock] in times:
                continue
            times[signal.clock] = signal.values
        kept.append(signal._replace(clock=same.get(signal.clock, signal.clock)))
    return kept


def _short_names(paths: list[tuple[str, ...]]) -> list[str]:
    """Shortest end of each path that no other path ends in; equal paths stay equal."""
    names = []
    for path in paths:
        others = [other for other in paths if other != path]
        for length in range(1, len(path) + 1):
            end = path[-length:]
            if not any(other[-length:] == end for other in others):
                break
        names.append(".".join(end))
    return names
