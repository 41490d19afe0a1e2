"""Logs as programs write them: the same run in many layouts, read without help."""

import csv
import io
import json

import numpy as np
import pandas as pd
import pytest

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
