"""What a long command says while it works."""

import json

import pytest

from dmptm_ctrl.progress import Progress


def test_json_lines(capsys):
    with Progress(as_json=True) as progress:
        progress.stage("reading")
        progress.warn("clipped, at 5 N·m")
        progress.done(verdict="none", effects=[])
    out, err = capsys.readouterr()
    lines = [json.loads(line) for line in err.splitlines()]
    assert out == ""
    assert [line["event"] for line in lines] == ["stage", "warning", "done"]
    assert lines[1]["text"] == "clipped, at 5 N·m"
    assert lines[2]["verdict"] == "none"
    assert 0 <= lines[0]["seconds"] <= lines[2]["seconds"]


@pytest.mark.parametrize("quiet", [False, True])
def test_only_warnings_where_nobody_watches(capsys, quiet):
    with Progress(quiet=quiet) as progress:
        progress.stage("reading")
        progress.warn("clipped")
        progress.done(verdict="none")
    assert capsys.readouterr() == ("", "warning: clipped\n")


@pytest.mark.parametrize("quiet", [False, True])
def test_a_line_that_moves_where_somebody_does(monkeypatch, capsys, quiet):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("TTY_COMPATIBLE", "1")  # to rich, a terminal
    monkeypatch.setenv("TERM", "xterm")
    with Progress(quiet=quiet) as progress:
        progress.stage("reading [red]logs")
        progress.warn("clipped [bold]here")
    err = capsys.readouterr().err
    assert ("reading" in err) is not quiet
    assert "clipped [bold]here" in err
