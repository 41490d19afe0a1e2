"""Every way in which a text file can be wrong gives one sentence that says where."""

import gzip
import hashlib

import numpy as np
import pytest

from dmptm_ctrl import LogError, load_log
from dmptm_ctrl.signals import text


def broken(columns, column, row, value):
    values = columns[column].astype(object)
    values[row] = value
    return "\n".join(
        [
            ",".join(columns),
            *(
                ",".join(str(v) for v in r)
                for r in zip(*{**columns, column: values}.values(), strict=True)
            ),
        ]
    )


def test_reads_si_and_radians(columns, write_csv):
    path = write_csv(columns)
    log = load_log(path)
    assert log.name == "run"
    assert log["theta_L"] == pytest.approx(np.radians(columns["theta_L_deg"]), rel=1e-8)
    assert log["u_left"] == pytest.approx(columns["u_left_V"], rel=1e-8)
    assert log.sample_time == 1e-3
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.warnings == ()


def test_numbers_come_in_to_the_last_bit(write_csv):
    values = np.random.default_rng(1).normal(size=500) * 10.0 ** np.linspace(-250, 28, 500)
    rows = "\n".join(f"{i * 0.5},{v!r}" for i, v in enumerate(values.tolist()))
    log = load_log(write_csv(f"time_s,x_V\n{rows}\n"))
    np.testing.assert_array_equal(log["x"], values)


def test_gzip_is_told_by_content(columns, write_csv):
    plain = load_log(write_csv(columns))
    packed = gzip.compress(write_csv(columns).read_bytes())
    for name in ("run.csv.gz", "other.csv"):
        log = load_log(write_csv(packed, name))
        np.testing.assert_array_equal(log["theta_L"], plain["theta_L"])
    assert load_log(write_csv(packed, "RUN.CSV.GZ")).name == "RUN"


@pytest.mark.parametrize(
    ("old", "new"),
    [(",", ";"), (",", "\t"), (",", " "), (",", ", "), ("\n", "\r\n")],
)
def test_other_separators(columns, write_csv, old, new):
    plain = load_log(write_csv(columns))
    content = write_csv(columns).read_text().replace(old, new)
    log = load_log(write_csv(content, "other.txt"))
    np.testing.assert_array_equal(log["omega_L"], plain["omega_L"])


def test_decimal_comma(columns, write_csv):
    plain = load_log(write_csv(columns))
    content = write_csv(columns).read_text().replace(",", ";").replace(".", ",")
    np.testing.assert_array_equal(load_log(write_csv(content))["theta_L"], plain["theta_L"])


def test_byte_order_mark_comments_and_blank_lines(columns, write_csv):
    content = write_csv(columns).read_text()
    marked = b"\xef\xbb\xbf# rig A\n\n" + content.replace("\n", "\n\n", 3).encode() + b"\n\n"
    assert len(load_log(write_csv(marked))) == 2000


def test_header_in_the_last_comment_as_numpy_writes_it(tmp_path):
    path = tmp_path / "run.txt"
    table = np.column_stack([np.arange(200) * 0.01, np.sin(np.arange(200))])
    np.savetxt(path, table, header="made by a test\ntime_s x_m")
    np.testing.assert_allclose(load_log(path)["x"], table[:, 1], rtol=1e-15)


def test_file_without_a_header_by_position(tmp_path):
    path = tmp_path / "run.dat"
    np.savetxt(path, np.column_stack([np.arange(200) * 0.01, np.ones(200)]))
    log = load_log(path, {"column1": "time_s", "column2": ("x", "mm")})
    assert log["x"] == pytest.approx(1e-3)
    with pytest.raises(LogError, match="no time column"):
        load_log(path)


def test_mapping_renames_scales_and_leaves_out(columns, write_csv):
    del columns["omega_L_deg_s"], columns["theta_ml_deg"], columns["theta_mr_deg"]  # signs differ
    content = write_csv(columns).read_text().replace("theta_L_deg", "Winkel").replace("_V", "")
    log = load_log(
        write_csv(content), {"Winkel": ("theta_L", "deg", -1.0), "u_left": ("u_left", "mV")}
    )
    assert log["theta_L"] == pytest.approx(-np.radians(columns["theta_L_deg"]), rel=1e-8)
    assert log["u_left"] == pytest.approx(1e-3 * columns["u_left_V"], rel=1e-8)
    assert not log.has("u_right")  # neither mapped nor named with a unit


def test_sample_time_replaces_a_time_column(write_csv):
    path = write_csv("x_m\n" + "\n".join(str(i) for i in range(200)))
    assert load_log(path, sample_time=4e-4).sample_time == 4e-4
    with pytest.raises(LogError, match="no time column; call it time_s"):
        load_log(path)
    with pytest.raises(ValueError, match="sample_time is 0; it must be more than 0"):
        load_log(path, sample_time=0)


def test_text_in_a_column_nobody_wants(columns, write_csv):
    columns["note"] = np.full(2000, 0.0)
    content = broken(columns, "note", 700, "gear noise")
    log = load_log(write_csv(content))
    assert len(log) == 2000
    assert any("ignored 'note'" in warning for warning in log.warnings)


def test_many_chunks_are_one_log(columns, write_csv, monkeypatch):
    whole = load_log(write_csv(columns))
    monkeypatch.setattr(text, "CHUNK_ROWS", 500)  # divides the number of rows
    np.testing.assert_array_equal(load_log(write_csv(columns))["theta_L"], whole["theta_L"])
    monkeypatch.setattr(text, "CHUNK_ROWS", 333)
    np.testing.assert_array_equal(load_log(write_csv(columns))["theta_L"], whole["theta_L"])
    log = load_log(write_csv(broken(columns, "theta_L_deg", 1700, "bad")))
    assert "theta_L_deg is 'bad' in line 1702: taken as no value" in log.warnings


@pytest.mark.parametrize("value", ["nan", "-inf", "1e999", "", "off"])
def test_a_missing_value_is_bridged_and_told(columns, write_csv, value):
    log = load_log(write_csv(broken(columns, "theta_L_deg", 1234, value)))
    expected = np.radians(columns["theta_L_deg"])
    np.testing.assert_allclose(log["theta_L"], expected, atol=1e-6)
    assert "theta_L_deg lacks 1 value, at most 1 in a row: bridged" in log.warnings


def test_a_line_of_too_many_values_is_named(columns, write_csv):
    with pytest.raises(LogError, match="^run.csv: line 1236 has 8 values, the header names 7 col"):
        load_log(write_csv(broken(columns, "theta_L_deg", 1234, "1,2")))


def test_a_number_that_cannot_be_measured_is_no_value(columns, write_csv):
    log = load_log(write_csv(broken(columns, "theta_L_deg", 1234, "1e200")))
    assert log.warnings[0] == "theta_L_deg is 1e+200 at times, far from all else: taken as no value"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, r"^run.csv: u_left_V is missing \(NaN\) in row 11 \(12 such values\); .*start"),
        (1e200, r"^run.csv: u_left_V, where 1e\+200 stands for no value, is missing"),
        (np.inf, "^run.csv: u_left_V, where inf stands for no value, is missing"),
    ],
)
def test_values_missing_for_long_are_refused(columns, write_csv, value, message):
    columns["u_left_V"][10:22] = value
    with pytest.raises(LogError, match=message):
        load_log(write_csv(columns))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\n\n", "the file is empty"),
        (b"time_s,theta_L_deg\n", "no rows of numbers"),
        (b"time_s,theta_L_deg\n1,2,3\n", "the header names 2 columns, the first row has 3 values"),
        (b"time_s,x_m\n0,1\n0.1,1\n", "2 samples, at least 100 are needed"),
        (b"\xff\xfet\x00i\x00m\x00e\x00", "no rows of numbers"),
        (b"time_s,x_m\n0,1\x00\n", "not a text file; save it as CSV in UTF-8"),
        (b"\x1f\x8b\x08\x00garbage", "gzip archive is damaged"),
        (b"time_s,x_m,x_m\n0,1,2\n", "column 'x_m' occurs 2 times"),
        (b"time_s,x_m,x_mm\n0,1,2\n", "columns 'x_m' and 'x_mm' are both x"),
        (b"time_s,theta_L_dge\n0,1\n", "'theta_L_dge' ends in no known unit; write theta_L_UNIT"),
        (b"time_s,theta_L\n0,1\n", "'theta_L' ends in no known unit"),
        (b"time_s,theta_L_V\n0,1\n", "'theta_L_V' is in V, but theta_L is in rad"),
        (b"time_s,theta_m\n0,1\n", "'theta_m' is in m, but theta is in rad"),
        (b"time_V,theta_L_deg\n0,1\n", "'time_V' is in V, but time is in s"),
    ],
)
def test_bad_file_is_refused(write_csv, content, message):
    with pytest.raises(LogError, match=message):
        load_log(write_csv(content))


def test_cut_short_gzip(columns, write_csv):
    packed = gzip.compress(write_csv(columns).read_bytes())
    with pytest.raises(LogError, match="gzip archive is damaged or cut short"):
        load_log(write_csv(packed[: len(packed) // 2], "run.csv.gz"))


def test_endless_line_is_not_read_into_memory(write_csv):
    bomb = gzip.compress(b"time_s,x_m\n" + b"1" * (64 << 20))
    with pytest.raises(LogError, match="a line runs over"):
        load_log(write_csv(bomb, "run.csv.gz"))


def test_no_such_file_and_other_names(tmp_path, write_csv):
    with pytest.raises(LogError, match="no such file"):
        load_log(tmp_path / "none.csv")
    with pytest.raises(LogError, match="is a folder, not a log"):
        load_log(tmp_path)
    with pytest.raises(LogError, match="a packed file, such as Excel's; save it as CSV"):
        load_log(write_csv("PK\3\4 x", "run.xlsx"))


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"nothing": "x_m"}, "no column 'nothing'"),
        ({"time_s": "time"}, "mapped to 'time', not a NAME_UNIT"),
        ({"theta_L_deg": ("theta_L", "furlong/")}, "unknown unit"),
        ({"theta_L_deg": ("theta_L", "deg", 0.0)}, "scale 0"),
        ({"theta_L_deg": ("u_left", "V"), "u_left_V": "u_left_V"}, "are both u_left"),
    ],
)
def test_bad_mapping(columns, write_csv, mapping, message):
    with pytest.raises(LogError, match=message):
        load_log(write_csv(columns), mapping)
