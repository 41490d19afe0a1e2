"""MATLAB files as people have them, written by SciPy (5) and h5py (7.3)."""

import sys

import numpy as np
import pytest
from scipy.io import savemat

from dmptm_ctrl import LogError, load_log
from dmptm_ctrl.signals import matlab, subprocess_reader

TIME = np.arange(400) * 2.5e-3
X = np.sin(TIME)
U = np.cos(TIME)


def structs(*rows):
    """Structure array as MATLAB stores it."""
    array = np.zeros(len(rows), dtype=[(name, object) for name in rows[0]])
    for i, row in enumerate(rows):
        array[i] = tuple(row.values())
    return array


def dspace():
    return {
        "rec1": {
            "X": {"Name": "Time", "Data": TIME[None, :], "Unit": "s"},
            "Y": structs(
                {"Name": '"Model Root"/"Rig"/"x_mm"', "Data": X[None, :], "Unit": ""},
                {"Name": '"Model Root"/"Drive"/"u"', "Data": U[None, :], "Unit": "mV"},
            ),
            "Description": {"General": {"DateTime": "2020-01-01"}},
        }
    }


def simulink():
    return {
        "out": {
            "time": TIME[:, None],
            "signals": structs(
                {"values": X[:, None], "dimensions": 1.0, "label": "x_mm"},
                {"values": U[:, None], "dimensions": 1.0, "label": "u_mV"},
            ),
            "blockName": "rig/To Workspace",
        }
    }


def timeseries():
    def one(name, data, unit):
        info = {"Units": unit, "Interpolation": "linear"}
        return {"Name": name, "Time": TIME[:, None], "Data": data[None, None, :], "DataInfo": info}

    return {"logged": {"a": one("x_mm", X, ""), "u": one("unnamed", U, "mV")}}


def plain():
    return {"time_s": TIME, "x_mm": X[:, None], "u_mV": U[None, :], "gain": 2.0, "note": "rig A"}


def nested():
    return {"rig": {"time_s": TIME, "left": {"x_mm": X}, "u_mV": U}}


KINDS = [plain, nested, dspace, simulink, timeseries]


def save_hdf(path, content):
    """MATLAB's layout of version 7.3: groups are structures, arrays transposed, class attributes,
    structure arrays as one structure of references.
    """
    h5py = pytest.importorskip("h5py")

    def put(parent, name, value):
        if isinstance(value, dict):
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, inner in value.items():
                put(group, key, inner)
        elif isinstance(value, str):
            codes = np.array([[ord(c)] for c in value] or np.zeros((0, 1)), dtype=np.uint16)
            data = parent.create_dataset(name, data=codes if value else np.zeros(2, np.uint64))
            data.attrs["MATLAB_class"] = np.bytes_("char")
            if not value:
                data.attrs["MATLAB_empty"] = np.int32(1)
        elif getattr(value, "dtype", None) is not None and value.dtype.names:
            group = parent.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in value.dtype.names:
                references = []
                for inner in value[key]:
                    number = len(parent.file.require_group("#refs#"))
                    put(parent.file["#refs#"], f"r{number}", inner)
                    references.append(parent.file["#refs#"][f"r{number}"].ref)
                column = group.create_dataset(key, (len(references), 1), dtype=h5py.ref_dtype)
                column[:, 0] = references
        else:
            data = parent.create_dataset(name, data=np.atleast_2d(value).T)
            data.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in content.items():
            put(file, name, value)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize(
    ("kind", "version"), [(plain, "4"), *((k, v) for k in KINDS for v in ("5", "7.3"))]
)
def test_same_log_from_every_layout(tmp_path, kind, version):
    path = tmp_path / "run.mat"
    if version == "7.3":
        pytest.importorskip("pymatreader")
        save_hdf(path, kind())
    elif version == "4":
        savemat(path, {k: v for k, v in kind().items() if k != "note"}, format="4")
    else:
        savemat(path, kind(), do_compression=True)
    mapping = {"time_s": "time_s", "u": ("u", "mV")} if kind is timeseries else None
    log = load_log(path, mapping and {**mapping, "x_mm": "x_mm"})
    np.testing.assert_allclose(log.time, TIME, rtol=1e-15)
    np.testing.assert_allclose(log["x"], 1e-3 * X, rtol=1e-15)
    np.testing.assert_allclose(log["u"], 1e-3 * U, rtol=1e-15)
    assert log.units == {"x": "m", "u": "V"}


def test_scalars_and_texts_are_kept_beside(tmp_path):
    savemat(tmp_path / "run.mat", plain())
    assert dict(load_log(tmp_path / "run.mat").meta) == {"gain": 2.0, "note": "rig A"}


def test_matrix_is_taken_apart(tmp_path):
    savemat(tmp_path / "run.mat", {"data": np.column_stack([TIME, X, U])})
    log = load_log(
        tmp_path / "run.mat", {"data1": "time_s", "data2": "x_m", "data3": ("u", "V", -1.0)}
    )
    np.testing.assert_array_equal(log["u"], -U)


def test_same_field_in_two_structures(tmp_path):
    savemat(tmp_path / "run.mat", {"time_s": TIME, "left": {"x_m": X}, "right": {"x_m": U}})
    log = load_log(tmp_path / "run.mat", {"left.x_m": "left_m", "right.x_m": "right_m"})
    np.testing.assert_array_equal(log["right"], U)


def test_other_lengths(tmp_path):
    content = {"time_s": TIME, "x_m": X, "period_V": np.arange(7.0)}
    savemat(tmp_path / "run.mat", content)
    log = load_log(tmp_path / "run.mat")
    assert not log.has("period")
    assert log.warnings == ("ignored 'period_V': 7 values, the others have 400",)
    with pytest.raises(LogError, match="column 'period_V' has 7 values, the others 400"):
        load_log(tmp_path / "run.mat", {"period_V": "u_V", "x_m": "x_m"})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a readable .mat file"),
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\xff" * 100, "not a readable"),
        (b"MATLAB 7.3 MAT-file".ljust(600), "not a readable .mat file"),
        (b"time_s,x_m\n0,1\n", "not a readable .mat file"),
    ],
)
def test_damaged_file(tmp_path, content, message):
    (tmp_path / "run.mat").write_bytes(content)
    with pytest.raises(LogError, match=message):
        load_log(tmp_path / "run.mat")


def test_nothing_in_it(tmp_path):
    savemat(tmp_path / "run.mat", {"note": "hello"})
    with pytest.raises(LogError, match="no signals in the file"):
        load_log(tmp_path / "run.mat")


def test_file_on_which_scipy_crashes(tmp_path):
    """Byte 184 is the type of the first variable's numbers; 24 is none, SciPy 1.17 reads astray."""
    path = tmp_path / "run.mat"
    savemat(path, {"time_s": TIME, "x_m": X})
    content = bytearray(path.read_bytes())
    assert content[184] == 9  # miDOUBLE
    content[184] = 24
    path.write_bytes(content)
    with pytest.raises(LogError, match="not a readable .mat file, or damaged"):
        load_log(path)


def test_file_that_takes_for_ever(tmp_path, monkeypatch):
    savemat(tmp_path / "run.mat", {"x_m": X})
    monkeypatch.setattr(subprocess_reader, "MAX_SECONDS", 1e-3)
    with pytest.raises(LogError, match="not read within 0.001 s"):
        load_log(tmp_path / "run.mat", sample_time=1.0)


def test_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymatreader", None)
    path = tmp_path / "run.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(600))
    with pytest.raises(ImportError, match=r"pip install 'dmptm-ctrl\[mat73\]'"):
        matlab.find_signals(path)


def test_structures_of_time_and_data(tmp_path):
    """Called by their variables, also where the names in them are alike."""
    path = tmp_path / "run.mat"
    savemat(path, {n: {"time": TIME, "data": v} for n, v in (("x_mm", X), ("u_mV", U))})
    np.testing.assert_array_equal(load_log(path)["u"], 1e-3 * U)
    series = {n: {"Time": TIME, "Data": v, "Name": "y"} for n, v in (("x", X), ("u", U))}
    savemat(path, series)
    columns = {"x.y": ("x", "m"), "u.y": ("u", "V")}
    np.testing.assert_array_equal(load_log(path, columns)["u"], U)


def one_per_signal():
    return {"s": structs({"name": "x_mm", "t": TIME, "y": X}, {"name": "u_mV", "t": TIME, "y": U})}


def names_and_data():
    return {"time_s": TIME, "s": structs(*({"Name": n, "Data": v} for n, v in NAMED.items()))}


def one_per_sample():
    rows = zip(TIME, X, U, strict=True)
    return {"s": structs(*({"time_s": t, "x_mm": x, "u_mV": u} for t, x, u in rows))}


def dataset():
    return {"out": {n: {"Values": {"Time": TIME, "Data": v}} for n, v in NAMED.items()}}


def in_milliseconds():
    info = {"Units": "milliseconds"}
    return {n: {"Time": 1e3 * TIME, "Data": v, "TimeInfo": info} for n, v in NAMED.items()}


def rasters():
    """ControlDesk: each signal says which axis is its own."""
    axes = structs({"Name": "slow", "Data": TIME[::2]}, {"Name": "fast", "Data": TIME})
    signals = structs(*({"Name": n, "Data": v, "XIndex": 2} for n, v in NAMED.items()))
    return {"rec": {"X": axes, "Y": signals}}


NAMED = {"x_mm": X, "u_mV": U}


@pytest.mark.parametrize(
    "kind", [one_per_signal, names_and_data, one_per_sample, dataset, in_milliseconds, rasters]
)
def test_structures_of_signals(tmp_path, kind):
    savemat(tmp_path / "run.mat", kind())
    log = load_log(tmp_path / "run.mat")
    np.testing.assert_allclose(log.time, TIME, rtol=1e-13)
    np.testing.assert_array_equal(log["x"], 1e-3 * X)
    np.testing.assert_array_equal(log["u"], 1e-3 * U)


def test_text_of_matlab(tmp_path):
    """Of ``save run.mat -ascii``."""
    path = tmp_path / "run.mat"
    np.savetxt(path, np.column_stack([TIME, X]))
    columns = {"column1": ("time", "s"), "column2": ("x", "m")}
    np.testing.assert_allclose(load_log(path, columns)["x"], X, rtol=1e-15)


def test_timeseries_on_clocks_of_their_own(tmp_path):
    """Three series on two clocks: the slower one is interpolated to the faster."""
    fast, slow = 0.01 * np.arange(400), 0.04 * np.arange(100)
    series = {
        name: {"Time": time, "Data": 2.0 * time, "Name": name}
        for name, time in (("u_V", slow), ("x_m", fast), ("y_m", fast.copy()))
    }
    savemat(tmp_path / "run.mat", series)
    log = load_log(tmp_path / "run.mat")
    assert log.sample_time == pytest.approx(0.01)
    for channel in ("u", "x", "y"):
        np.testing.assert_allclose(log[channel], 2.0 * log.time, atol=1e-12)
    assert any("u_V on another clock" in w for w in log.warnings)
