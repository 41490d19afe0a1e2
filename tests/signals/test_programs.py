"""Logs as programs write them: the same run in many layouts, read without help."""

import csv
import io
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.info import describe_file

ROWS = 240
STEP = 0.01  # s
T = STEP * np.arange(ROWS)
U = np.round(1.3 * np.sin(9.0 * T), 5)
Q = np.round(1500.0 * np.sin(2.1 * T) ** 3, 5)  # four digits before the point: thousands show

RIG = """
[body.a]
inertia = "0.02 kg m^2"
[input.u]
column = "{u}"
unit = "N m"
[sensor.q]
column = "{q}"
unit = "rad"
[data]
{data}
"""


def rig(u="u", q="q", data='time = { column = "t", unit = "s" }'):
    return parse_rig(RIG.format(u=u, q=q, data=data))


def rows(separator, *columns, digits=5, decimal=".", end="\n"):
    """Lines of numbers."""
    table = (f"{v:.{digits}f}".replace(".", decimal) for r in zip(*columns, strict=True) for v in r)
    cells = iter(table)
    count = len(columns)
    return "".join(
        separator.join(next(cells) for _ in range(count)) + end for _ in range(len(columns[0]))
    )


def table(separator=",", decimal=".", header=("t", "u", "q"), **how):
    return separator.join(header) + "\n" + rows(separator, T, U, Q, decimal=decimal, **how)


def read(tmp_path, content, a_rig=None, name="run.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    (log,) = (a_rig or rig()).read(path)
    return log


def is_the_run(log, part=slice(None), u=U, q=Q):
    np.testing.assert_allclose(log["in_u"], u[part], atol=1e-9)
    np.testing.assert_allclose(log["out_q"], q[part], atol=1e-9)
    np.testing.assert_allclose(log.time - log.time[0], T[: len(log)], atol=1e-8)


def quoted(**how):
    stream = io.StringIO()
    writer = csv.writer(stream, quoting=csv.QUOTE_ALL, **how)
    writer.writerow(["t", "u", "q"])
    writer.writerows([f"{a:.5f}", f"{b:.5f}", f"{c:.5f}"] for a, b, c in zip(T, U, Q, strict=True))
    return stream.getvalue()


def swiss(value):
    return f"{value:,.5f}".replace(",", "'")


def german(value):
    return f"{value:,.5f}".translate(str.maketrans(",.", ".,"))


def formatted(separator, write, quote=""):
    lines = (
        separator.join(f"{quote}{write(v)}{quote}" for v in r) for r in zip(T, U, Q, strict=True)
    )
    return separator.join("tuq") + "\n" + "\n".join(lines) + "\n"


def each(form):
    """A line of each row."""
    return "".join(form.format(*row) for row in zip(T, U, Q, strict=True))


def french(value):
    return f"{value:,.5f}".replace(",", "\u202f").replace(".", ",")


def with_state():
    """A column of words, quoted where they hold the separator."""
    states = ("RUN" if i % 7 else '"IDLE, ok"' for i in range(ROWS))
    lines = (f"{a:.5f},{s},{b:.5f},{c:.5f}\n" for a, s, b, c in zip(T, states, U, Q, strict=True))
    return "t,state,u,q\n" + "".join(lines)


def numbered():
    lines = (f'"{i + 1}" {r}' for i, r in enumerate(rows(" ", T, U, Q).splitlines(keepends=True)))
    return '"t" "u" "q"\n' + "".join(lines)


FRAME = pd.DataFrame({"t": T, "u": U, "q": Q})
PREAMBLE = "Drive;AX-01\nSample rate;100 Hz\nComment;a;b\n\n"


def remarked(remark):
    lines = rows(",", T, U, Q).splitlines()
    return "".join(line + remark * (k % 50 == 20) + "\n" for k, line in enumerate(lines))


SIGNALS = [
    {"name": n, "unit": u, "y": list(y)}
    for n, u, y in (("t", "s", T), ("u", "Nm", U), ("q", "rad", Q))
]
TRIPLES = [list(r) for r in zip(T, U, Q, strict=True)]
HALSCOPE = "Sampling period is 10000000 ns \n" + "".join(
    f"\nu {u:+.14f} q {q:+.14f} " for u, q in zip(U, Q, strict=True)
)
LAYOUTS = {
    "comma": table(),
    "semicolon": table(";"),
    "tab": table("\t"),
    "bar": table("|"),
    "blanks": table(" "),
    "blanks in columns": "  t   u    q\n"
    + "".join(f"{a:10.5f}  {b:10.5f} {c:12.5f}\n" for a, b, c in zip(T, U, Q, strict=True)),
    "comma and blank": table(", "),
    "decimal comma": table(";", ","),
    "decimal comma by tabs": table("\t", ","),
    "decimal comma by blanks": table(" ", ","),
    "quoted decimal comma by commas": formatted(",", lambda v: f"{v:.5f}".replace(".", ","), '"'),
    "whole numbers first": "t;u;q\n0;0;0\n" + rows(";", T, U, Q, decimal=",").split("\n", 1)[1],
    "thousands": formatted(";", lambda v: f"{v:,.5f}"),
    "quoted thousands by commas": formatted(",", lambda v: f"{v:,.5f}", '"'),
    "German thousands": formatted(";", german),
    "Swiss thousands": formatted(";", swiss),
    "French thousands": formatted(";", french),
    "all quoted": quoted(),
    "all quoted by semicolons": quoted(delimiter=";"),
    "CR LF": table().replace("\n", "\r\n"),
    "CR alone": table().replace("\n", "\r"),
    "no end of line": table().rstrip("\n"),
    "trailing separators": table(";").replace("\n", ";\n"),
    "trailing separators of rows": "t;u;q\n" + rows(";", T, U, Q, end=";\n"),
    "blank lines": table().replace("\n", "\n\n"),
    "Excel's sep=": "sep=;\n" + table(";"),
    "quoted sep=": '"sep=;"\n' + table(";"),
    "preamble": PREAMBLE + table(";"),
    "long preamble": "".join(f"Setting {i};{i}\n" for i in range(150)) + table(";"),
    "preamble of numbers": "Gain,1.5,2.5\nOffset,0,0\n1,2,3\n" + table(),
    "units row": "t,u,q\ns,Nm,rad\n" + rows(",", T, U, Q),
    "units row in brackets": "t;u;q\n[s];[Nm];[rad]\n" + rows(";", T, U, Q),
    "units above names": "(s);(Nm);(rad)\nt;u;q\n" + rows(";", T, U, Q),
    "types and units": "t,u,q\nfloat,float,double\ns,N*m,rad\n" + rows(",", T, U, Q),
    "units in names": table(header=("t [s]", "u [Nm]", "q [rad]")),
    "units in round brackets": table(header=("t (s)", "u (Nm)", "q (rad)")),
    "units after a slash": table(header=("t/s", "u/(N m)", "q/rad")),
    "units of other things beside": "t;u;Temp;q\ns;Nm;°C;rad\n" + rows(";", T, U, 0 * T, Q),
    "numpy": "# written by savetxt\n# t u q\n" + rows(" ", T, U, Q),
    "percent before the names": "%t,u,q\n" + rows(",", T, U, Q),
    "index of pandas": FRAME.to_csv(),
    "R": numbered(),
    "description below names": "t;u;q\nTime since start;Motor torque;Angle\n" + rows(";", T, U, Q),
    "text column": with_state(),
    "empty column": "t,x,u,q\n" + each("{:.5f},,{:.5f},{:.5f}\n"),
    "TwinCAT": "Name\tYT Scope Project\nFile\tC:\\run.svdx\n"
    "Starttime of export\t132959733843760000\tMonday, 2. May 2022\n\n\n"
    "Name\tu\tName\tq\nSymbolName\tMAIN.u\tSymbolName\tMAIN.q\n"
    "NetId\t5.1.2.3.1.1\tNetId\t5.1.2.3.1.1\nPort\t851\tPort\t851\n"
    "Data-Type\tREAL64\tData-Type\tREAL64\nSampleTime[ms]\t10\tSampleTime[ms]\t10\n\n"
    + rows("\t", 1e3 * T, U, 1e3 * T, Q, decimal=",") + "EOF\n",
    "LabVIEW": "LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
    "***End_of_Header***\n\nChannels\t2\nSamples\t240\t240\nDate\t2020/01/01\t2020/01/01\n"
    "Y_Unit_Label\tNm\trad\nX_Dimension\tTime\tTime\nDelta_X\t0.01\t0.01\n***End_of_Header***\n"
    "t\tu\tq\tComment\n" + rows("\t", T, U, Q),
    "Tektronix": "Model,MSO4104\nFirmware Version,2.8\n\nPoint Format,Y,\n"
    "Horizontal Units,S,\nSample Interval,0.01,\nRecord Length,240,\nVertical Units,V,\n\n\n"
    "t,u,q\n" + rows(",", T, U, Q),
    "Keysight": "t,u,q\nsecond,Nm,radian\n" + rows(",", T, U, Q),
    "LeCroy": "LECROYHDO4054,12345,Waveform\nSegments,1,SegmentSize,240\nSegment,TrigTime,Time\n"
    "#1,12-Nov-2020 10:00:00,0\nt,u,q\n" + rows(",", T, U, Q),
    "clock before each channel": "t,u,t,q\n" + rows(",", T, U, T, Q),
    "clocks of other names": "t,u,Time CH2,q\n" + rows(",", T, U, T, Q),
    "name=value": each("t={:.5f} u={:.5f} q={:.5f}\n"),
    "name: value": each("t: {:.5f}, u: {:.5f}, q: {:.5f}\n"),
    "name:value by tabs": each("t:{:.5f}\tu:{:.5f}\tq:{:.5f}\n"),
    "name value": each("t {:.5f} u {:.5f} q {:.5f}\n"),
    "a name and a value per line": each("t {:.5f}\nu {:.5f}\nq {:.5f}\n"),
    "halscope": HALSCOPE,
    "Markdown": "| t | u | q |\n|---|:---:|--:|\n" + each("| {:.5f} | {:.5f} | {:.5f} |\n"),
    "Org": "| t | u | q |\n|---+---+---|\n" + each("| {:.5f} | {:9.5f} | {:.5f} |\n"),
    "grid": "+--+--+\n| t | u | q |\n+==+==+\n" + each("| {:.5f} | {:.5f} | {:.5f} |\n"),
    "names underlined": "t u q\n--- --- ---\n" + rows(" ", T, U, Q),
    "names by commas, rows by blanks": "# t, u, q\n" + rows(" ", T, U, Q),
    "names by semicolons, rows by commas": "t;u;q\n" + rows(",", T, U, Q),
    "names by blanks, rows by tabs": "t u q\n" + rows("\t", T, U, Q),
    "tuples": "t,u,q\n" + each("({:.5f}, {:.5f}, {:.5f})\n"),
    "single quotes": "'t','u','q'\n" + each("'{:.5f}','{:.5f}','{:.5f}'\n"),
    "texts of Excel": "t,u,q\n" + each('="{:.5f}",="{:.5f}",="{:.5f}"\n'),
    "apostrophes": "t,u,q\n" + each("'{:.5f},'{:.5f},'{:.5f}\n"),
    "numbers of numpy": "t,u,q\n" + each("({:.5f}, np.float64({:.5f}), np.float64({:.5f}))\n"),
    "names over two lines": 't,"u\n[N m]","q\r\n[rad]"\n' + rows(",", T, U, Q),
    "marks of inches": '# pulley of 5"\n' + table(),
    "quotes in a name": 't,u,q,"a ""b"""\n' + each("{:.5f},{:.5f},{:.5f},1\n"),
    "serial monitor": "t,u,q\n" + each("12:00:01.234 -> {:.5f},{:.5f},{:.5f}\n"),
    "serial monitor, names too": "9:00:01.2 -> t,u,q\n"
    + each("9:00:01.2 -> {:.5f},{:.5f},{:.5f}\n"),
    "pairs behind a level": each("2025-11-09 09:27:03,010 INFO t={:.5f} u={:.5f} q={:.5f}\n"),
    "remarks behind some rows": "t,u,q,event\n" + remarked(",start"),
    "remarks with their sign": "t,u,q\n" + remarked(" # start"),
    "lowest and highest above": "t,u,q\nMin,-1.3,-1500\nMax,1.3,1500\n" + rows(",", T, U, Q),
    "Rigol": "t,u,q,Start,Increment,\nSequence,Volt,Volt,0.0,1.0e-02\n"
    + "".join(f"{i},{b:.5f},{c:.5f},\n" for i, (b, c) in enumerate(zip(U, Q, strict=True))),
    "names in two rows": "Date,t,1,2\n,,u,q\n,s,Nm,rad\n"
    + each("2020-07-24,{:.5f},{:.5f},{:.5f}\n"),
    "units row with a label": "descr;;run\nunit;s;Nm;rad\ntrace_values;;;\nt;u;q\n"
    + rows(";", T, U, Q),
    "JSON columns": json.dumps(FRAME.to_dict("list")),
    "JSON records": FRAME.to_json(orient="records"),
    "JSON lines": FRAME.to_json(orient="records", lines=True),
    "JSON dicts of Python": "".join(f"{r}\n" for r in FRAME.to_dict("records")),
    "JSON split": FRAME.to_json(orient="split"),
    "JSON by index": FRAME.to_json(),
    "JSON below a key": json.dumps({"name": "run", "data": FRAME.to_dict("list")}),
    "JSON, signals": json.dumps(SIGNALS),
    "JSON, signals below a key": json.dumps({"gains": [1, 2, 3], "signals": SIGNALS}),
    "JSON, signals by name": json.dumps({s["name"]: {"data": s["y"]} for s in SIGNALS}),
    "JSON, names and rows": json.dumps({"fields": ["t", "u", "q"], "rows": TRIPLES}),
    "JSON, rows": json.dumps([["t", "u", "q"], *TRIPLES]),
    "JSON by row": FRAME.to_json(orient="index"),
    "JSON, signals and their clocks": json.dumps(
        {n: {"t": T.tolist(), "y": FRAME[n].tolist()} for n in "uq"}
    ),
    "JSON, nested records": json.dumps({"log": {"rows": FRAME.to_dict("records")}}),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layout(tmp_path, layout):
    name = "run.json" if layout.startswith("JSON") else "run.csv"
    time = 'time = { column = "t", unit = "ms" }' if layout == "TwinCAT" else None
    a_rig = (
        rig(data="" if layout == "halscope" else time) if time or layout == "halscope" else rig()
    )
    log = read(tmp_path, LAYOUTS[layout], a_rig, name)
    is_the_run(log)
    assert not [w for w in log.warnings if "ignored" in w]


@pytest.mark.parametrize("after", [1, 4, 12])
@pytest.mark.parametrize(
    "between", ["Trigger now", "Trigger at 0.5 s", "t,u,q", "EVENT,start,now", "EVENT,start"]
)
def test_no_row_is_lost_above_a_text(tmp_path, after, between):
    lines = table().splitlines()
    lines.insert(after + 1, between)
    log = read(tmp_path, "\n".join(lines) + "\n")
    is_the_run(log)
    assert log.warnings == (f"left out text in line {after + 2}",)


@pytest.mark.parametrize("row", [1, 4, 12])
def test_no_row_is_lost_by_a_remark(tmp_path, row):
    lines = table().splitlines()
    lines[row] += ",limit hit"
    is_the_run(read(tmp_path, "\n".join(lines) + "\n"))


def test_numbers_above_the_names_are_no_rows(tmp_path):
    log = read(tmp_path, "gains\n1,2,3\noffsets\n0,0.1,0.2\n" + table())
    is_the_run(log)


def date(form):
    return [
        f"{m:{form}}" for m in pd.Timestamp("2024-04-28 23:59:58") + pd.to_timedelta(T, unit="s")
    ]


def winCC():
    """A row per variable; Time_ms counts days in millionths since 1899-12-30."""
    days = 40e3 + T / 0.0864
    head = '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n'
    return (
        head
        + "".join(
            f'"{n}";"{s}";{v:.5f};1;{d:.8f}\n'.replace(".", ",").replace(",04,", ".04.")
            for s, d, *values in zip(date("%d.04.%Y %H:%M:%S"), days, U, Q, strict=True)
            for n, v in zip("uq", values, strict=True)
        )
        + '"$RT_COUNT$";480;;;\n'
    )


def influx():
    """A table per field, one after the other."""
    head = (
        "#datatype,string,long,dateTime:RFC3339,double,string\n,result,table,_time,_value,_field\n"
    )
    return head + "".join(
        f",,{k},{s}Z,{v:.5f},{n}\n"
        for k, (n, values) in enumerate((("q", Q), ("u", U)))
        for s, v in zip(date("%Y-%m-%dT%H:%M:%S.%f"), values, strict=True)
    )


def dated(head, line, form="%d.%m.%Y %H:%M:%S,%f"):
    return head + "".join(line.format(*r) for r in zip(date(form), U, Q, strict=True))


WITHOUT_KEYS = {  # what says nothing of the clock in the rig file
    "WinCC": winCC(),
    "Python's logging": dated("", "{} INFO servo: u={:.5f} q={:.5f}\n", "%Y-%m-%d %H:%M:%S,%f"),
    "Influx": influx(),
    "a row per signal": "tag,t,value\n" + each("u,{0:.5f},{1:.5f}\nq,{0:.5f},{2:.5f}\n"),
    "dSPACE": "# Device: MicroLabBox\ntime;u;q\n" + rows(";", T, U, Q),
    "elapsed": "Elapsed [ms];u;q\n" + rows(";", 1e3 * T, U, Q),
    "Rohde": '"in s","u in Nm","q in rad"\n' + rows(",", T, U, Q),
    "Rigol MSO": "u,q,t0 =-0.004, tInc = 0.01,\n" + rows(",", U, Q, end=",,\n"),
    "Rigol DS": "X,u,q,Start,Increment,\nSequence,,,0.0,1.0e-02\n"
    + "".join(f"{i},{b:.5f},{c:.5f},\n" for i, (b, c) in enumerate(zip(U, Q, strict=True))),
    "Keysight": "XInc:,1.0E-02\nData:,\nu,q\n" + rows(",", U, Q),
    "Grafana": dated("Time,u,q\n", "{},{:.5f} N·m,{:.5f} rad\n", "%Y-%m-%d %H:%M:%S.%f"),
    "Grafana, scaled": dated("Time,u,q\n", "{},{:.5f} Nm,{:.5f} rad\n", "%Y-%m-%d %H:%M:%S.%f")
    .replace("0.11684 Nm", "116.84 mNm"),
    "units in cells": "t;u;q\n" + each("{:.5f} s;{:.5f} Nm;{:.5f} rad\n").replace(".", ","),
    "monitor, pairs": dated("", "{} -> u:{:.5f},q:{:.5f}\n", "%H:%M:%S.%f"),
    "date and time": dated("Date;Time;u;q\n", "{};{:.5f};{:.5f}\n", "%d.%m.%Y;%H:%M:%S.%f"),
    "LabVIEW": dated(
        "waveform\t[0]\t[1]\ndelta t\t0,01\t0,01\n\ntime\tu\tq\n", "{}\t{:.5f}\t{:.5f}\n"
    ),
    "SignalExpress": dated("channel names:\nu\tq\n", "{}\t{:.5f}\t{:.5f}\n"),
    "CODESYS": "Time;u;q\n" + each("T#{:.3f}s;{:.5f};{:.5f}\n"),
    "terminal": "\x1b[2J\x1b[Ht,u,q\n" + rows(",", T, U, Q),
}  # fmt: skip


@pytest.mark.parametrize("layout", WITHOUT_KEYS)
def test_layout_without_keys(tmp_path, layout):
    log = read(tmp_path, WITHOUT_KEYS[layout], rig(data=""))
    is_the_run(log)
    assert not [w for w in log.warnings if "ignored" in w or "by the file" in w]


def test_what_the_rig_file_says_against_the_file(tmp_path):
    log = read(tmp_path, table(), rig(data='time = "t"\nsample_rate = "1 kHz"'))
    assert "samples are 0.01 s apart by the clock, and 0.001 s as you say" in log.warnings[0]
    log = read(tmp_path, "Delta_X,0.01\nu,q\n" + rows(",", U, Q), rig(data="sample_time = 0.02"))
    assert "0.01 s apart by the file, and 0.02 s as you say; the latter" in log.warnings[0]
    with pytest.raises(LogError, match="no rows of numbers, read with separator = ';' of"):
        read(tmp_path, table(), rig(data='time = "t"\nseparator = ";"'))


@pytest.mark.parametrize("layout", ["WinCC", "Influx", "a row per signal", "Keysight"])
def test_columns_of_a_table_without_units_are_listed(tmp_path, layout):
    (tmp_path / "run.csv").write_text(WITHOUT_KEYS[layout])
    info = describe_file(tmp_path / "run.csv")
    assert {c.column for c in info.channels} >= {"u", "q"}
    assert info.samples == ROWS


def test_columns_beside_a_clock_with_gaps_are_listed(tmp_path):
    (tmp_path / "run.csv").write_text("t,u,q\n" + rows(",", T + 3.0 * (T > 1), U, Q))
    info = describe_file(tmp_path / "run.csv")
    assert [c.column for c in info.channels] == ["t", "u", "q"]
    assert "gap of 3.01 s after 1 s" in info.warnings[0]


def test_name_with_an_unknown_unit(tmp_path):
    is_the_run(read(tmp_path, table(header=("t", "IL.FB (Arms)", "q")), rig("IL.FB")))


def test_frames_of_a_bus_are_no_log(tmp_path):
    lines = "".join(f"({1e9 + t:.6f}) can0 1A0#0011223344\n" for t in T)
    with pytest.raises(LogError, match="frames of a CAN bus"):
        read(tmp_path, lines)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32", "cp1252"])
def test_encoding(tmp_path, encoding):
    log = read(tmp_path, table(header=("t", "µ °", "q")), rig(u="µ °"), encoding=encoding)
    is_the_run(log)


@pytest.mark.parametrize("name", ["run.log", "run.asc", "run.out", "run.lvm", "run", "RUN.TXT"])
def test_any_extension(tmp_path, name):
    assert read(tmp_path, table(), name=name).name in ("run", "RUN")


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
