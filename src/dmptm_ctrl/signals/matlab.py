"""MATLAB files: plain arrays, structures, Simulink logs and dSPACE recordings."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import LogError

MAX_VALUES = 1 << 30  # numbers in one file, 8 GB; guards against files that unpack without end
MAX_WIDTH = 64  # columns of one array that are taken apart


class _Found(NamedTuple):
    path: tuple[str, ...]  # where in the file, outermost first
    values: Any
    unit: str | None
    clock: bool = False  # the time of a structure, in seconds by MATLAB's convention


def read_matlab(path: Path, choose: Choose) -> Table:
    """Read the signals of a .mat file.

    Parameters
    ----------
    path : Path
        Version 4 to 7 by SciPy, 7.3 by pymatreader (extra ``mat73``).
    choose : callable
        Gets the columns and the units stated in the file, returns those to keep.

    Returns
    -------
    Table
        A column is called by its variable or field, as far from the end of its path as makes it
        unique: ``rig.omega_L_deg_s`` is omega_L_deg_s if there is no other; column k of a matrix
        ``data`` is data1, data2, … Scalars and texts are in ``meta``.

    Raises
    ------
    LogError
        Not readable, or without signals.
    """
    content = _content(path)
    meta: dict[str, Any] = {}
    found = list(_walk((), content, meta))
    if not found:
        advice = ""
        if _has_objects(content):
            advice = "; save objects such as timeseries as structures: s.time_s = ts.Time"
        raise LogError(f"{path.name}: no signals in the file{advice}")
    found = _one_clock(found)
    names = _short_names([signal.path for signal in found])
    units = {n: s.unit for n, s in zip(names, found, strict=True) if s.unit}
    kept = set(choose(names, units))
    columns = {n: s.values for n, s in zip(names, found, strict=True) if n in kept}
    return Table(columns, units, meta)


def _content(path: Path) -> dict[str, Any]:
    """Variables of the file as nested dicts, lists and arrays."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        hdf = stream.read(10) == b"MATLAB 7.3"
    try:
        if hdf:
            return _content_hdf(path)
        _refuse_huge(path, _unpacked_bytes(path) // 8)
        content = loadmat(path, simplify_cells=True, appendmat=False)
    except (LogError, OSError):
        raise
    except ImportError as error:
        raise LogError(
            f"{path.name}: MATLAB 7.3 files need pymatreader: pip install 'dmptm-ctrl[mat73]'"
        ) from error
    except Exception as error:  # SciPy and h5py raise what their parsers stumble on
        raise LogError(f"{path.name}: not a readable MATLAB file, or damaged") from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _content_hdf(path: Path) -> dict[str, Any]:
    import warnings

    import h5py
    from pymatreader import read_mat

    sizes: list[int] = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda _, item: sizes.append(getattr(item, "size", 0) or 0))
    _refuse_huge(path, sum(sizes))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of classes that it reads as far as it can
        content = read_mat(str(path))
    return {name: content[name] for name in sorted(content) if not name.startswith(("__", "#"))}


def _unpacked_bytes(path: Path) -> int:
    """Size that the packed variables of a version 5 to 7 file state; 0 where none is packed.

    Source: MAT-File Format, MathWorks, section 1: a 128-byte header, then elements of type and
    size (4 bytes each); type 15 is a zlib stream of one element.
    """
    total = 0
    with path.open("rb") as stream:
        order = {b"IM": "<", b"MI": ">"}.get(stream.read(128)[-2:])
        while order and len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(order + "II", tag)
            begin = stream.tell()
            if kind == 15:
                inner = zlib.decompressobj().decompress(stream.read(min(size, 256)), 8)
                total += struct.unpack(order + "II", inner)[1]
            stream.seek(begin + size)
    return total


def _refuse_huge(path: Path, values: int) -> None:
    if values > MAX_VALUES:
        raise LogError(f"{path.name}: {values} values, more than {MAX_VALUES} are not read")


def _walk(path: tuple[str, ...], value: Any, meta: dict[str, Any]) -> Iterator[_Found]:
    if isinstance(value, Mapping):
        if {"X", "Y"} <= value.keys():
            yield from _dspace(path, value)
        elif {"time", "signals"} <= value.keys():
            yield from _simulink(path, value)
        elif {"Time", "Data"} <= value.keys():
            yield from _timeseries(path, value)
        else:
            for name, inner in value.items():
                yield from _walk((*path, str(name)), inner, meta)
    elif isinstance(value, list):
        for index, inner in enumerate(value, start=1):
            yield from _walk((*path[:-1], f"{path[-1]}{index}"), inner, meta)
    elif isinstance(value, str | int | float):
        meta[".".join(path)] = value
    else:
        yield from _array(path, value, None)


def _array(path: tuple[str, ...], value: Any, unit: str | None) -> Iterator[_Found]:
    array = np.squeeze(np.asarray(value))
    if array.dtype.kind not in "fiub" or array.size < 2 or array.ndim > 2:
        return
    if array.ndim == 1:
        yield _Found(path, array, unit)
        return
    if array.shape[1] > array.shape[0]:
        array = array.T
    if array.shape[1] <= MAX_WIDTH:
        for k, column in enumerate(array.T, start=1):
            yield _Found((*path[:-1], f"{path[-1]}{k}"), np.ascontiguousarray(column), unit)


def _dspace(path: tuple[str, ...], record: Mapping[str, Any]) -> Iterator[_Found]:
    """Recording of dSPACE ControlDesk: axes X, signals Y with Name, Data and Unit."""
    for axis in _structs(record["X"]):
        for found in _array((*path, "time_s"), axis.get("Data"), "s"):
            yield found._replace(clock=True)
    for signal in _structs(record["Y"]):
        # Names are paths into the model: "Model Root"/"Plant"/"omega_L"
        name = tuple(p.strip().strip('"') for p in str(signal.get("Name", "Y")).split("/"))
        unit = signal.get("Unit")
        yield from _array((*path, *name), signal.get("Data"), unit if _text(unit) else None)


def _simulink(path: tuple[str, ...], log: Mapping[str, Any]) -> Iterator[_Found]:
    """Simulink's structure with time: time, signals.values, signals.label."""
    for found in _array((*path, "time_s"), log["time"], "s"):
        yield found._replace(clock=True)
    for index, signal in enumerate(_structs(log["signals"]), start=1):
        label = signal.get("label")
        name = str(label) if _text(label) else f"signal{index}"
        yield from _array((*path, name), signal.get("values"), None)


def _timeseries(path: tuple[str, ...], series: Mapping[str, Any]) -> Iterator[_Found]:
    """Fields of a timeseries: Time, Data, Name, DataInfo.Units."""
    for found in _array((*path, "time_s"), series["Time"], "s"):
        yield found._replace(clock=True)
    info = series.get("DataInfo")
    unit = info.get("Units") if isinstance(info, Mapping) else None
    name = series.get("Name")
    own = (*path[:-1], str(name)) if _text(name) and name != "unnamed" else path
    yield from _array(own or ("Data",), series["Data"], unit if _text(unit) else None)


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


def _one_clock(found: list[_Found]) -> list[_Found]:
    """Drop clocks that tick like one before: each timeseries brings its own."""
    kept: list[_Found] = []
    for signal in found:
        clocks = [other for other in kept if other.clock]
        if signal.clock and any(np.array_equal(signal.values, c.values) for c in clocks):
            continue
        kept.append(signal)
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


def _has_objects(content: Any) -> bool:
    if isinstance(content, Mapping):
        return any(_has_objects(value) for value in content.values())
    return type(content).__name__ in ("MatlabOpaque", "MatlabObject", "MatlabFunction")
