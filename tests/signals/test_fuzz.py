"""Whatever is in a file: a log or a LogError, never another error.

A long campaign: ``DMPTM_FUZZ_EXAMPLES=10000 python -m pytest tests/signals/test_fuzz.py``.
"""

import contextlib
import gzip
import io
import os

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from dmptm_ctrl import LogError, load_log

QUIET = settings(
    max_examples=int(os.environ.get("DMPTM_FUZZ_EXAMPLES", "120")),
    deadline=None,
    derandomize="DMPTM_FUZZ_EXAMPLES" not in os.environ,  # a check of a change; else a search
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

TIME = np.arange(150) * 1e-3
GOOD = pd.DataFrame(
    {"time_s": TIME, "theta_L_deg": TIME**2, "u_left_V": np.cos(TIME), "note": 1.0}
).to_csv(index=False)

cells = st.one_of(
    st.floats(width=32).map(repr),
    st.integers(-5, 5).map(str),
    st.sampled_from(["", "nan", "1e999", "0x1p3", "1_0", "'", '"', '"1"', "1,5", "١", "#", "\r"]),
    st.text(max_size=5),
)
headers = st.sampled_from(
    ["time_s", "time_ms", "theta_L_deg", "theta_L", "x_m", "", "time_s;x_m", "a b", '"x_m"', "x_"]
)


def load(path, content):
    path.write_bytes(content)
    with contextlib.suppress(LogError):
        log = load_log(path)
        assert all(np.isfinite(log[channel]).all() for channel in ("time", *log))


@QUIET
@given(
    header=st.lists(headers, min_size=1, max_size=4),
    rows=st.lists(st.lists(cells, min_size=1, max_size=4), max_size=6),
    separator=st.sampled_from([",", ";", "\t", " ", ", "]),
    end=st.sampled_from(["\n", "\r\n", "\r", ""]),
)
def test_tables_of_anything(tmp_path, header, rows, separator, end):
    lines = [separator.join(header), *(separator.join(row) for row in rows)]
    load(tmp_path / "run.csv", end.join(lines).encode("utf-8", "surrogatepass"))


@QUIET
@given(place=st.integers(0, len(GOOD)), cut=st.integers(0, 40), put=st.binary(max_size=12))
def test_good_file_with_a_wound(tmp_path, place, cut, put):
    content = GOOD.encode()
    load(tmp_path / "run.csv", content[:place] + put + content[place + cut :])


@QUIET
@given(content=st.binary(max_size=300))
@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run.parquet"])
def test_bytes_of_anything(tmp_path, name, content):
    load(tmp_path / name, content)


def wounded(content):
    places = st.integers(0, len(content) - 1)
    return st.lists(st.tuples(places, st.integers(0, 255)), min_size=1, max_size=6)


def with_wounds(content, wounds):
    spoilt = bytearray(content)
    for place, value in wounds:
        spoilt[place] = value
    return bytes(spoilt)


def packed_formats():
    yield "run.csv.gz", gzip.compress(GOOD.encode(), mtime=0)
    for compression in (False, True):
        stream = io.BytesIO()
        content = {"time_s": TIME, "rig": {"x_m": TIME, "u_V": TIME}, "n": 3.0}
        savemat(stream, content, do_compression=compression)
        header = b"MATLAB 5.0 MAT-file".ljust(116)
        yield "run.mat", header + stream.getvalue()[116:]
    stream = io.BytesIO()
    pd.DataFrame({"time_s": TIME, "x_m": TIME}).to_parquet(stream)
    yield "run.parquet", stream.getvalue()


@pytest.mark.parametrize(("name", "content"), list(packed_formats()), ids=lambda v: str(v)[:12])
def test_packed_file_with_wounds(tmp_path, name, content):
    # A .mat file is read in a process of its own, which takes its time to start.
    examples = 8 if name.endswith(".mat") else 100

    @settings(QUIET, max_examples=examples)
    @given(wounds=wounded(content))
    def check(wounds):
        load(tmp_path / name, with_wounds(content, wounds))

    check()
    for cut in range(0, len(content), 1 + len(content) // (examples // 4)):
        load(tmp_path / name, content[:cut])
