"""Rows, keys and clocks of logs as programs write them: what stays and what is said."""

import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.signals.test_programs import (
    FRAME,
    RIG,
    ROWS,
    STEP,
    Q,
    T,
    U,
    dated,
    each,
    is_the_run,
    read,
    rig,
    rows,
    table,
)

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.info import describe_file

LINES = table().splitlines(keepends=True)
ALL = slice(None)


def inserted(*lines):
    return "".join([*LINES[:100], *lines, *LINES[100:]])


def replaced(begin, end, cells):
    """Lines of the file with other cells after their time."""
    other = (line.split(",")[0] + cells for line in LINES[begin:end])
    return "".join([*LINES[:begin], *other, *LINES[end:]])


LEFT_OUT = {  # content, rows that stay, what is said
    "cut last line": ("".join(LINES[:-1]) + LINES[-1][:9], slice(0, -1), "line 241"),
    "cut last number": ("".join(LINES).rstrip()[:-2], slice(0, -1), "line 241"),
    "cut last exponent": ("".join(LINES[:-1]) + "2.39,1.0,1.2e", slice(0, -1), "line 241"),
    "comment at the end": ("".join(LINES) + "# stopped by operator\n", ALL, "line 242"),
    "EOF": ("".join(LINES) + "EOF\n", ALL, "line 242"),
    "comment in the middle": (inserted("# marker, 2, 3\n"), ALL, "line 101"),
    "words in the middle": (inserted("connection lost\n"), ALL, "line 101"),
    "header again": (inserted(LINES[0]), ALL, "line 101"),
    "header and units again": (inserted(LINES[0], "s,Nm,rad\n"), ALL, "lines 101, 102"),
    "cut line and header again": (inserted("0.99,1", "\n", LINES[0]), ALL, "line 101"),
    "empty cells at the start": (replaced(1, 6, ",,\n"), slice(5, None), "first 5 rows"),
    "NaN at the start": (replaced(1, 6, ",NaN,nan\n"), slice(5, None), "no value for u, q"),
    "words at the start": (replaced(1, 4, ",ERR,1.5\n"), slice(3, None), "lines 2, 3, 4"),
    "infinite at the start": (replaced(1, 4, ",inf,1.5\n"), slice(3, None), "first 3 rows"),
    "NULL at the start": (replaced(1, 3, ",NULL,NULL\n"), slice(2, None), "first 2 rows"),
    "n/a at the end": (replaced(-3, ROWS + 1, ",1.0,n/a\n"), slice(0, -3), "last 3 rows"),
}


def test_json_without_a_clock_or_names(tmp_path):
    columns = FRAME[["u", "q"]].to_dict("list")
    for rate in ({"dt": STEP}, {"meta": 1, "fs": 1 / STEP}):
        is_the_run(read(tmp_path, json.dumps({**rate, **columns}), rig(data=""), "run.json"))
    a_rig = rig("column2", "column3", 'time = { column = "column1", unit = "s" }')
    is_the_run(read(tmp_path, json.dumps(FRAME.to_numpy().tolist()), a_rig, "run.json"))
    cut = FRAME.to_json(orient="records", lines=True).rstrip()[:-9]
    log = read(tmp_path, cut, name="run.json")
    is_the_run(log, slice(0, -1))
    assert log.warnings == ("left out incomplete rows in line 240",)


def test_words_among_the_numbers_are_no_values(tmp_path):
    smooth = rows(",", T, 0 * T + 1 + T, 0 * T + T).splitlines(keepends=True)
    for i, word in ((100, "OVL"), (101, "OVL"), (150, "---.--")):
        smooth[i] = smooth[i].replace(f",{T[i]:.5f}", f",{word}")
    log = read(tmp_path, "t,u,q\n" + "".join(smooth))
    np.testing.assert_allclose(log["out_q"], T, atol=1.1e-5)
    assert "q is 'OVL' in lines 102, 103, 152: taken as no value" in log.warnings
    for i in range(20, 60):
        smooth[i] = smooth[i].replace(f",{T[i]:.5f}", ",OVL")
    with pytest.raises(LogError, match="q, which is 'OVL' in lines 22, .* out .start, stop"):
        read(tmp_path, "t,u,q\n" + "".join(smooth))
    clock = 'time = { column = "t", unit = "s" }\nstart = 0.7'
    log = read(tmp_path, "t,u,q\n" + "".join(smooth), rig(data=clock))
    assert len(log) == ROWS - 70


@pytest.mark.parametrize("cell", ["", "NaN", "off"])
def test_a_column_without_a_value_is_named(tmp_path, cell):
    for head, line in (("t,u,q", "{:.5f},{:.5f},%s\n"), ("t,q,u", "{:.5f},%s,{:.5f}\n")):
        with pytest.raises(LogError, match="q has no value in any row|'q' holds 'off'"):
            read(tmp_path, f"{head}\n" + each(line % cell))


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_left_out(tmp_path, kind):
    content, part, said = LEFT_OUT[kind]
    log = read(tmp_path, content)
    is_the_run(log, part)
    assert any(said in w and "left out" in w for w in log.warnings), log.warnings


def test_a_column_sampled_more_rarely(tmp_path):
    slow = "".join(
        f"{a:.5f},{b:.5f},{f'{c:.5f}' if i % 4 == 0 else ''}\n"
        for i, (a, b, c) in enumerate(FRAME.to_numpy())
    )
    log = read(tmp_path, "t,u,q\n" + slow)
    assert len(log) == ROWS - 3  # after the last value nothing is known
    assert np.abs(log["out_q"] - Q[:-3]).max() < 1.1e4 * (4 * STEP) ** 2 / 8 * 2.1**2
    assert any("one of 4 rows" in w for w in log.warnings)


def test_a_slower_channel_on_a_clock_of_its_own(tmp_path):
    """TwinCAT: each channel with its clock; the slower one ends after half of the lines."""
    slow = [f"{1e3 * a:.1f}\t{b:.5f}" for a, b in zip(T[::2], Q[::2], strict=True)]
    slow += ["\t"] * (ROWS - len(slow))
    fast = (f"{1e3 * a:.1f}\t{b:.5f}" for a, b in zip(T, U, strict=True))
    lines = ["\t".join(pair) for pair in zip(fast, slow, strict=True)]
    head = "Name\tu\tName\tq\nSampleTime[ms]\t10\tSampleTime[ms]\t20\n"
    log = read(tmp_path, head + "\n".join(lines), rig(data='time = { column = "t", unit = "ms" }'))
    assert log.sample_time == pytest.approx(STEP)
    np.testing.assert_allclose(log["out_q"][::2], Q[::2], atol=1e-9)
    np.testing.assert_allclose(log["in_u"], U[: len(log)], atol=1e-9)
    assert any("another clock" in w for w in log.warnings)


@pytest.mark.parametrize("end", ["", "EOF\n"])
@pytest.mark.parametrize("separator", ["\t", ";"])
def test_rows_shorten_where_slower_channels_have_ended(tmp_path, end, separator):
    """The fastest channel first, as TwinCAT sorts them: later rows hold that one only."""
    slow = slice(None, None, 5)
    lines = [f"{1e3 * a:g}{separator}{b:.5f}" for a, b in zip(T, U, strict=True)]
    for k, (a, b) in enumerate(zip(T[slow], Q[slow], strict=True)):
        lines[k] += f"{separator}{1e3 * a:g}{separator}{b:.5f}"
    names = [["Name", "u", "Name", "q"], ["SampleTime[ms]", "10", "SampleTime[ms]", "50"]]
    text = "\n".join([*map(separator.join, names), "", *lines]) + "\n" + end
    log = read(tmp_path, text, rig(data='time = { column = "t", unit = "ms" }'))
    last = T.size - 4
    is_the_run(log, slice(last), q=np.interp(T, T[slow], Q[slow]))
    assert len(log) == last
    assert any("q on another clock" in w for w in log.warnings)


KEYS = {
    "header": ("a,b,c\nt,u,q\nx,y,z\n" + rows(",", T, U, Q), "header = 2"),
    "no header": (rows(",", T, U, Q), "header = 0"),
    "separator and decimal": (table(";", ","), 'separator = ";"\ndecimal = ","'),
    "separator by word": (table("\t"), 'separator = "tab"'),
    "another separator": (table("~"), 'separator = "~"'),
    "skip": ("1,2,3\n" * 30 + table(), "skip = 30"),
}


@pytest.mark.parametrize("key", KEYS)
def test_keys_of_the_rig_file(tmp_path, key):
    content, keys = KEYS[key]
    names = ("column1", "column2", "column3") if key == "no header" else ("t", "u", "q")
    data = f'time = {{ column = "{names[0]}", unit = "s" }}\n{keys}'
    is_the_run(read(tmp_path, content, rig(names[1], names[2], data)))


def test_start_and_stop_of_single_logs(tmp_path):
    """What is left out is not checked."""
    data = 'time = { column = "t", unit = "s" }\nstart = { "run" = 0.5, "*" = 1.0 }\nstop = "2 s"'
    bad = "".join([LINES[0], LINES[1], "0.01,bad,0\n".replace("bad", ""), *LINES[3:]])
    log = read(tmp_path, bad, rig(data=data))
    assert (log.time[0], log.time[-1]) == (pytest.approx(0.5), pytest.approx(2.0))
    log = read(tmp_path, table(), rig(data=data), "other.csv")
    assert log.time[0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("header = -1", "line 11.*header = -1 is no number of lines"),
        ('separator = "ab"', 'separator = ";"'),
        ('decimal = ";"', 'decimal = "."'),
        ("sample_rate = 0", "sample_rate above 0"),
        ('sample_rate = "1 kHz"\nsample_time = 0.1', "or sample_time, not both"),
    ],
)
def test_bad_keys(key, message):
    with pytest.raises(LogError, match=message):
        rig(data=key)


def test_units_of_the_file_that_contradict(tmp_path):
    log = read(tmp_path, "t,u,q\ns,mNm,deg\n" + rows(",", T, U, Q))
    (table,) = rig().read(pd.DataFrame({"t": T, "u [mNm]": U, "q [deg]": Q}))
    for warnings, u, q in ((log.warnings, "u", "q"), (table.warnings, "u [mNm]", "q [deg]")):
        one, other = warnings
        assert f"'{u}' is in mNm by the file, and taken in N m as you say, 1000 times that" in one
        assert f"'{q}' is in deg by the file" in other
        assert other.endswith("[sensor.q] says the unit")
    assert read(tmp_path, "t,u,q\ns,Nm,rad\n" + rows(",", T, U, Q)).warnings == ()
    # texts that are no units say nothing
    assert read(tmp_path, "t,u,q\nfirst,channel,A\n" + rows(",", T, U, Q)).warnings == ()


def test_rows_of_another_width_in_the_middle_are_refused(tmp_path):
    for line in ("0.5,1.0\n", "0.5,1.0,2.0,3.0\n"):
        with pytest.raises(LogError, match="line 101 has"):
            read(tmp_path, "".join([*LINES[:100], line, *LINES[100:]]))


def test_decimal_comma_that_shows_late(tmp_path):
    """The machine stands still for longer than the lines looked at first."""
    still = "".join(f"{i};0;0\n" for i in range(1000))
    moving = "".join(
        f"{1000 + i};{b:.5f};{c:.5f}\n".replace(".", ",")
        for i, (_, b, c) in enumerate(FRAME.to_numpy())
    )
    log = read(
        tmp_path, "t;u;q\n" + still + moving, rig(data='time = { column = "t", unit = "ms" }')
    )
    np.testing.assert_allclose(log["in_u"][1000:], U, atol=1e-9)


def test_full_time_stamps_of_twincat(tmp_path):
    """A clock without a name in ticks of 100 ns since 1601, whatever the label says."""
    ticks = 133_000_000_000_000_000 + (1e7 * T).round().astype(np.int64)
    lines = "".join(f"{t}\t{b:.5f}\t{t}\t{c:.5f}\n" for t, b, c in zip(ticks, U, Q, strict=True))
    head = "Name\tu\tName\tq\nSampleTime[ms]\t10\tSampleTime[ms]\t10\n"
    log = read(tmp_path, head + lines, rig(data='time = { column = "t", unit = "ticks" }'))
    is_the_run(log)
    assert log.warnings == ()


finite = st.floats(-1e9, 1e9, allow_nan=False).map(lambda v: float(f"{v:.6g}"))


DIALECTS = [(",", "."), (";", "."), (";", ","), ("\t", ","), (" ", "."), ("|", ".")]
PREAMBLES = ["", "Drive AX\n", "Date;2024-01-01\n\n", "# made by a test\n", "a,b\n1,2\n"]
QUIET = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@QUIET
@given(
    values=st.lists(st.tuples(finite, finite), min_size=100, max_size=120),
    dialect=st.sampled_from(DIALECTS),
    preamble=st.sampled_from(PREAMBLES),
    units=st.booleans(),
    trailing=st.booleans(),
    form=st.sampled_from(["{!r}", "{:.6e}", "{:+.9g}"]),
)
def test_any_values_in_any_dialect(tmp_path, values, dialect, preamble, units, trailing, form):
    """What is written comes back to the last bit of what the text says."""
    separator, decimal = dialect
    end = separator * (trailing and separator != " ") + "\n"
    cells = [(form.format(a), form.format(b)) for a, b in values]
    lines = [separator.join(f"{c}".replace(".", decimal) for c in (f"{i * 0.01:.2f}", *row))
             for i, row in enumerate(cells)]  # fmt: skip
    head = separator.join("tuq") + end + (separator.join(["s", "Nm", "rad"]) + end) * units
    log = read(tmp_path, preamble + head + end.join([*lines, ""]))
    np.testing.assert_array_equal(log["in_u"], [float(a) for a, _ in cells])
    np.testing.assert_array_equal(log["out_q"], [float(b) for _, b in cells])


def test_units_of_twincat_and_german_counts(tmp_path):
    head = "Name\tu\tName\tq\nPort\t851\tPort\t851\nUnit\tNm\tUnit\t°\n"
    (tmp_path / "scope.csv").write_text(head + rows("\t", T, U, T, Q), encoding="utf-8")
    head = "Zeit;u;q\nms;%;Inkr\n"
    (tmp_path / "counts.csv").write_text(head + rows(";", 1e3 * T, U, np.round(Q)))
    scope, counts = (describe_file(tmp_path / f"{n}.csv") for n in ("scope", "counts"))
    assert [c.column for c in scope.channels] == ["(clock) [s]", "u [Nm]", "q [°]"]
    assert [c.column for c in counts.channels] == ["Zeit [ms]", "u [%]", "q [Inkr]"]
    assert counts.sample_time == pytest.approx(STEP)


def test_two_clocks(tmp_path):
    """The one that the rig file names is taken; without a rig, the first that is one."""
    stamps = (f"2024-03-05 10:00:{t + 0.25:06.3f}," for t in T)
    lines = rows(",", T, U, Q).splitlines(keepends=True)
    text = "".join(s + r for s, r in zip(stamps, lines, strict=True))
    (tmp_path / "run.csv").write_text("Timestamp,Time [s],u [Nm],q [rad]\n" + text)
    for time in ('time = "Timestamp"', 'time = { column = "Time", unit = "s" }'):
        (log,) = rig(data=time).read(tmp_path / "run.csv")
        is_the_run(log)
        assert log.warnings == ()
    info = describe_file(tmp_path / "run.csv")
    assert info.samples == ROWS
    assert info.warnings == ("ignored 'Time [s]': another clock",)


def test_a_clock_in_other_ticks_than_the_rig_file_says(tmp_path):
    text = "t [100ns],u,q\n" + rows(",", np.round(1e7 * T), U, Q)
    log = read(tmp_path, text, rig(data='time = { column = "t", unit = "us" }'))
    assert log.warnings[0] == (
        "column 't [100ns]' is in 100ns by the file, and taken in us as you say, 10 times that; "
        "time in [data] says the unit"
    )


def test_a_rate_without_a_clock_leaves_the_files_clock_out(tmp_path):
    broken = np.where(T > 1.0, T + 5.0, T)
    (tmp_path / "run.csv").write_text("Time [s],u,q\n" + rows(",", broken, U, Q))
    (log,) = rig(data='sample_rate = "100 Hz"').read(tmp_path / "run.csv")
    is_the_run(log)
    (tmp_path / "run.csv").write_text("Time [s],u,q\n" + rows(",", T, U, Q))
    (log,) = rig(data='sample_rate = "50 Hz"').read(tmp_path / "run.csv")
    assert "0.01 s apart by the file, and 0.02 s as you say" in log.warnings[-1]


def test_the_clock_of_a_file_that_states_its_unit(tmp_path):
    """PicoScope: a row of units below the names; time = "t" alone is in milliseconds."""
    content = "t;u;q\n(ms);(V);(V)\n\n" + rows(";", 1e3 * T, U, Q, decimal=",")
    is_the_run(read(tmp_path, content, rig(data='time = "t"')))


def test_who_counts_columns_knows_of_no_names(tmp_path):
    """A line of three words above the rows is no line of names then."""
    content = "MOT: Init\nMOT: sensor direction==CW\nMOT: Ready.\n" + rows("\t", T, U, Q)
    counted = 'time = { column = "column1", unit = "s" }'
    is_the_run(read(tmp_path, content, rig("column2", "column3", counted)))


@pytest.mark.parametrize("asked", ["Q", "rate", "qq_pos"])
def test_a_column_that_is_nearly_named(tmp_path, asked):
    names = {"Q": "q", "rate": "drive.rate", "qq_pos": "q_pos"}
    (tmp_path / "run.csv").write_text(f"t,u,{names[asked]}\n" + rows(",", T, U, Q))
    with pytest.raises(LogError, match=f"no column '{asked}'; did you mean '{names[asked]}'"):
        rig(q=asked).read(tmp_path / "run.csv")


def test_ros_nanoseconds(tmp_path):
    time = 1_600_000_000_123_456_789 + (T * 1e9).astype(np.int64)
    lines = "".join(f"{a},{b:.5f},{c:.5f}\n" for a, b, c in zip(time, U, Q, strict=True))
    data = 'time = { column = "time", unit = "ns" }'
    log = read(tmp_path, "%time,field.u,field.q\n" + lines, rig("field.u", "field.q", data))
    is_the_run(log)
    assert log.sample_time == pytest.approx(STEP, rel=1e-9)


def test_columns_are_listed_as_the_file_names_them(tmp_path):
    """What a rig file is to say, in the file's units; an empty column is no fault."""
    head = "Zeit;Moment;Lage;Bemerkung\nms;mNm;Inkr;\n"
    cells = zip(1e3 * T, 1e3 * U, np.round(Q), strict=True)
    (tmp_path / "run.csv").write_text(head + "".join(f"{a};{b};{c};\n" for a, b, c in cells))
    info = describe_file(tmp_path / "run.csv")
    assert [c.column for c in info.channels] == ["Zeit [ms]", "Moment [mNm]", "Lage [Inkr]"]
    assert info.channels[1].high == pytest.approx(1e3 * U.max())
    read(
        tmp_path, (tmp_path / "run.csv").read_bytes(),
        parse_rig(RIG.format(u="Moment", q="Lage", data="").replace("N m", "mN m")),
    )  # fmt: skip


def test_units_of_labview_stand_above_their_columns(tmp_path):
    """A label, a unit for each channel, and nothing above the comments."""
    head = "Y_Unit_Label\tNm\trad\t\nDelta_X\t0.01\t0.01\t\nX_Value\tu\tq\tComment\n"
    log = read(tmp_path, head + rows("\t", T, U, Q), rig(data=""))
    is_the_run(log)
    assert not any("by the file" in w for w in log.warnings)


def test_infinite_is_no_value(tmp_path):
    text = table().splitlines(keepends=True)
    text[50] = text[50].replace(f"{U[49]:.5f}", "\u221e")
    log = read(tmp_path, "".join(text))
    assert np.abs(log["in_u"] - U)[np.arange(ROWS) != 49].max() < 1e-9
    assert "u is inf at times, far from all else: taken as no value" in log.warnings


def test_time_name_and_value_without_a_header(tmp_path):
    lines = (f"{t:.2f} {n} {v}\n" for t, *v2 in zip(T, U, Q, strict=True)
             for n, v in zip("uq", v2, strict=True))  # fmt: skip
    is_the_run(read(tmp_path, "".join(lines), rig(data="")))


@pytest.mark.parametrize("sign", [".", ","])
def test_thousands_of_whole_numbers(tmp_path, sign):
    """998, 999, 1.000: decimals would be written everywhere, or without a 0 at their end."""
    q = np.arange(ROWS) * 10.0 + 500.0
    counts = (f"{v:,.0f}".replace(",", sign) for v in q)
    text = "t_ms;u;q\n" + "".join(f"{10 * i};1;{c}\n" for i, c in enumerate(counts))
    log = read(tmp_path, text, rig(data=""))
    np.testing.assert_allclose(log["out_q"], q)


def test_decimals_that_look_like_thousands_are_decimals(tmp_path):
    q = np.round(5.0 + 4.0 * np.sin(3.0 * T), 3)
    text = "t_ms;u;q\n" + "".join(f"{10 * i};1;{v:g}\n" for i, v in enumerate(q))
    np.testing.assert_allclose(read(tmp_path, text, rig(data=""))["out_q"], q)


def test_counts_against_a_unit_are_told(tmp_path):
    text = table(header=("t", "u", "q")).replace("\n", "\ns,Nm,Ink\n", 1)
    (warning,) = read(tmp_path, text, rig(data="")).warnings
    said = "column 'q' is in Ink by the file, and taken in rad as you say"
    assert warning == f"{said}; [sensor.q] says the unit"


def test_a_comma_for_everything_is_refused_with_the_reason(tmp_path):
    with pytest.raises(LogError, match="comma before decimals needs another separator"):
        read(tmp_path, table(decimal=","))


def test_a_date_beside_the_time_of_day_is_no_column(tmp_path):
    """A day that is the same in each line names nothing, and is no clock."""
    path = tmp_path / "run.log"
    path.write_text(dated("", "{} INFO servo: u={:.5f} q={:.5f}\n", "2026-03-01 %H:%M:%S,%f"))
    info = describe_file(path)
    assert [c.column for c in info.channels] == ["column2 [s]", "u", "q"]
