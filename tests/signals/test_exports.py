"""Files as programs export them: encodings, headers, answers of data bases."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from tests.signals.test_programs import ROWS, Q, T, U, is_the_run, read, rig, table

from dmptm_ctrl.signals import LogError

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


@pytest.mark.parametrize("encoding", ["shift_jis", "utf-8"])
def test_names_in_japanese(tmp_path, encoding):
    header = ("時間[s]", "トルク[Nm]", "角度[rad]")
    data = 'time = { column = "時間[s]", unit = "s" }'
    own = rig("トルク[Nm]", "角度[rad]", data)
    is_the_run(read(tmp_path, table(header=header), own, encoding=encoding))


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
