"""Files as programs export them: encodings, headers, answers of data bases."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from tests.signals.test_programs import ROWS, Q, T, U, is_the_run, read, rig, table

from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.info import describe_file

STAMPS = pd.Timestamp("2025-11-09T00:00:00") + pd.to_timedelta(T, unit="s")
MS = [round(1762680423000 + 1e3 * t) for t in T]
NO_CLOCK = rig(data="")


def test_a_size_in_a_header_is_no_unit_of_the_clock(tmp_path):
    head = ["Name\tu\tName\tq", "Data-Type\tREAL64\tData-Type\tREAL64"]
    head += [
        "SampleTime[ms]\t10\tSampleTime[ms]\t10",
        "VariableSize[Byte]\t8\tVariableSize[Byte]\t8",
    ]
    body = [f"{1e3 * t:.2f}\t{u}\t{1e3 * t:.2f}\t{q}" for t, u, q in zip(T, U, Q, strict=True)]
    log = read(tmp_path, "\n".join([*head, "", *body]) + "\n", NO_CLOCK)
    is_the_run(log)
    assert not log.warnings


ASIA = {
    "gbk": ("时间", "转矩", "角度"),
    "big5": ("時間", "轉矩", "角度"),
    "euc_kr": ("시간", "토크", "각도"),
    "euc_jp": ("時間", "トルク", "角度"),
    "shift_jis": ("時間", "トルク", "角度"),
    "utf-8": ("時間", "トルク", "角度"),
    "cp1251": ("Время", "Момент", "Скорость"),
    "koi8_r": ("Время", "Момент", "Скорость"),
}


@pytest.mark.parametrize("encoding", ASIA)
def test_names_in_letters_of_other_countries(tmp_path, encoding):
    """Also without a rig that says what they are called."""
    time, *names = (f"{n}[{u}]" for n, u in zip(ASIA[encoding], ("s", "Nm", "rad"), strict=True))
    own = rig(*names, f'time = {{ column = "{time}", unit = "s" }}')
    is_the_run(read(tmp_path, table(header=(time, *names)), own, encoding=encoding))
    assert [c.column for c in describe_file(tmp_path / "run.csv").channels] == [time, *names]


@pytest.mark.parametrize(
    ("encoding", "names"),
    [("gb18030", ("电机给定", "编码器")), ("cp1250", ("točivý", "úhel")), ("cp1253", ("τ", "θ"))],
)
def test_names_of_the_rig_file_tell_the_encoding(tmp_path, encoding, names):
    is_the_run(read(tmp_path, table(header=("t", *names)), rig(*names), encoding=encoding))


@pytest.mark.parametrize(
    "names",
    [("Zeit", "Größe", "Übersetzung °"), ("temps", "répétée", "été"), ("t", "u – µ", "q‰…“é”")],
)
def test_latin_names_are_no_japanese(tmp_path, names):
    data = f'time = {{ column = "{names[0]}", unit = "s" }}'
    is_the_run(read(tmp_path, table(header=names), rig(*names[1:], data), encoding="cp1252"))


@pytest.mark.parametrize("name", ["data", "y"])
def test_variables_of_matlab_that_are_called_as_a_series_has_them(tmp_path, name):
    savemat(tmp_path / "run.mat", {"t": T, name: np.column_stack([U, Q])})
    (log,) = rig(f"{name}1", f"{name}2").read(tmp_path / "run.mat")
    is_the_run(log)


def influx():
    stamps = [s.isoformat() + "Z" for s in STAMPS]
    values = [*zip(stamps, U, Q, strict=True)]
    series = {"name": "drive", "columns": ["time", "u", "q"], "values": values}
    return {"results": [{"statement_id": 0, "series": [series]}]}


def grafana():
    return [
        {"target": n, "datapoints": [[v, ms] for v, ms in zip(values, MS, strict=True)]}
        for n, values in (("u", U), ("q", Q))
    ]


def frames():
    fields = [{"name": "time", "type": "time"}, {"name": "u"}, {"name": "q"}]
    frame = {"schema": {"refId": "A", "fields": fields}, "data": {"values": [MS, [*U], [*Q]]}}
    return {"results": {"A": {"status": 200, "frames": [frame]}}}


@pytest.mark.parametrize("answer", [influx, grafana, frames])
def test_answers_of_data_bases(tmp_path, answer):
    is_the_run(read(tmp_path, json.dumps(answer()), NO_CLOCK, "run.json"))


def test_decimal_commas_in_texts_of_json(tmp_path):
    def comma(value):
        return f"{value:.5f}".replace(".", ",")

    records = [{"t": comma(t), "u": comma(u), "q": q} for t, u, q in zip(T, U, Q, strict=True)]
    is_the_run(read(tmp_path, json.dumps(records), name="run.json"))
    for record in records:
        record["u"] = "1,234"
    with pytest.raises(LogError, match="'u' holds '1,234', no number"):
        read(tmp_path, json.dumps(records), name="run.json")


@pytest.mark.parametrize(
    "form", ["%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%d/%m/%y %H:%M:%S.%f"]
)
def test_a_date_that_may_be_read_two_ways_goes_over_midnight(tmp_path, form):
    stamps = pd.Timestamp("2025-03-04T23:59:59") + pd.to_timedelta(T, unit="s")
    texts = [f"{s},{u},{q}" for s, u, q in zip(stamps.strftime(form), U, Q, strict=True)]
    log = read(tmp_path, "\n".join(["t,u,q", *texts]) + "\n", NO_CLOCK)
    is_the_run(log)
    assert len(log) == ROWS
