"""The command line: what is printed where, and the exit code."""

import gzip
import json
import subprocess
import sys

import numpy as np
import pytest

import dmptm_ctrl
from dmptm_ctrl import data
from dmptm_ctrl.cli import main
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.signals.info import NEEDS
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE

LOG = str(data.path("null_rig") / "open_multisine_preload.csv.gz")


def one_line(capsys):
    """Message on standard error, which must be one line; standard output must be empty."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert err.startswith("dmptm: ")
    return err.removeprefix("dmptm: ").rstrip("\n")


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"dmptm {dmptm_ctrl.__version__}\n"


def test_without_a_command_shows_help(capsys):
    assert main([]) == 0
    assert "Usage: dmptm" in capsys.readouterr().out


def test_help_keeps_its_units(capsys):
    assert main(["tune", "--help"]) == 0
    out = capsys.readouterr().out
    assert "program [s]." in out
    assert "[rad/s or" in out


def test_a_log_of_another_drive_needs_a_rig_file(tmp_path, capsys):
    (tmp_path / "axis.csv").write_text("t_s,u_V\n" + "".join(f"{k / 1e3},0\n" for k in range(3000)))
    assert main(["diagnose", str(tmp_path)]) == 2
    assert "no channel 'u_left'; it has u. Other columns" in one_line(capsys)


def test_log_info(capsys):
    assert main(["log", "info", LOG]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "open_multisine_preload: 10000 samples, 9.999 s at 1000 Hz" in out
    assert "theta_ml_deg" in out
    assert "those of the dual-motor drive; so are these effects" in out
    reported, untold = out.split("Cannot identify")
    assert "torque_constant_mismatch" in reported
    assert "thermal_drift" in untold


def test_log_info_of_another_drive_names_no_effects(tmp_path, capsys):
    time = 1e-3 * np.arange(3000)
    rows = "".join(f"{t:.3f},{np.cos(6 * t):.4f},{np.sin(6 * t):.4f}\n" for t in time)
    (tmp_path / "axis.csv").write_text(f"time_s,current_A,speed_rpm\n{rows}")
    assert main(["log", "info", str(tmp_path / "axis.csv")]) == 0
    out = capsys.readouterr().out
    assert "an tell about" not in out
    assert "99 % of the input's power lie below" in out
    assert "give its rig file with --rig" in out


def test_log_info_tells_of_effects_that_the_rig_has_a_place_for(capsys):
    """A slide with one motor has no teeth, and nothing to compare its motor with."""
    rig, log = (str(data.path("axis") / name) for name in ("rig.toml", "moves.csv.gz"))
    assert main(["log", "info", log, "--rig", rig]) == 0
    out = capsys.readouterr().out
    assert "cogging" in out
    assert "drive_saturation" in out
    for absent in ("torque_constant", "mesh_error", "pinion", "backlash", "load_dependent"):
        assert absent not in out


@pytest.mark.filterwarnings("error")
def test_log_info_of_numbers_whose_squares_overflow(tmp_path, capsys):
    time = 1e-3 * np.arange(200)
    rows = "".join(f"{t:.3f},{1e200 * np.sin(9 * t):.6e}\n" for t in time)
    (tmp_path / "big.csv").write_text(f"time_s,gauge\n{rows}")
    assert main(["log", "info", str(tmp_path / "big.csv")]) == 0
    rms = 1e200 * np.sqrt(np.mean(np.sin(9 * time) ** 2))
    assert f"{rms:.5g}" in capsys.readouterr().out


def test_every_effect_of_a_log_has_its_needs():
    known = {n for n in {**CATALOGUE, **PLACED_CATALOGUE} if not n.startswith("unknown")}
    assert known <= {*NEEDS}


def test_log_info_for_programs(capsys):
    assert main(["log", "info", LOG, "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["samples"] == 10000
    assert info["excitation"]["preload"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("arguments", "message", "command"),
    [
        (["--bogus"], "No such option", "dmptm"),
        (["bogus"], "No such command 'bogus'", "dmptm"),
        (["log"], "Missing command", "dmptm log"),
        (["log", "info"], "Missing argument", "dmptm log info"),
        (["log", "info", "a", "b"], "unexpected extra argument", "dmptm log info"),
        (["log", "info", "--json=3", "a"], "--json", "dmptm"),
    ],
)
def test_wrong_usage(capsys, arguments, message, command):
    assert main(arguments) == 2
    line = one_line(capsys)
    assert message in line
    assert line.endswith(f"see '{command} --help'.")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("run.csv", b"", "the file is empty"),
        ("run.csv", b"time_s,theta_L_dge\n0,1\n", "ends in no known unit"),
        ("run.csv.gz", gzip.compress(b"time_s,x_m\n0,1\n" * 99)[:40], "damaged or cut short"),
        ("run.csv", b"time_s,a\x1b[31mb_m,x\ry\n0,1,2\n", "run.csv"),
        ("run.xlsx", b"PK\3\4", "a packed file, such as Excel"),
        ("run.mat", b"MATLAB 5.0 MAT-file", "not a readable .mat file"),
    ],
    ids=["empty", "unit", "gzip", "control characters", "extension", "matlab"],
)
def test_bad_log(capsys, tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert main(["log", "info", str(tmp_path / name)]) == 2
    line = one_line(capsys)
    assert message in line
    assert line.isprintable()


def test_no_such_log(capsys, tmp_path):
    assert main(["log", "info", str(tmp_path / "none.csv")]) == 2
    assert "no such file" in one_line(capsys)
    assert main(["log", "info", str(tmp_path)]) == 2
    assert "is a folder" in one_line(capsys)


def test_uneven_clock(capsys, tmp_path):
    """What a diagnosis would mend is no reason to refuse the file."""
    time = np.arange(300) * 1e-3 + 2e-4 * np.sin(np.arange(300))
    rows = "\n".join(f"{t:.6f},{np.sin(t):.6f}" for t in time)
    (tmp_path / "run.csv").write_text("time_s,x_m\n" + rows)
    assert main(["log", "info", str(tmp_path / "run.csv")]) == 0
    assert "warning: resampled to even steps" in capsys.readouterr().out


def test_markup_in_a_name_is_only_text(capsys, tmp_path):
    rows = "\n".join(f"{i},{i}" for i in range(200))
    (tmp_path / "[red]run.csv").write_text("time_s,[bold]x_m\n" + rows)
    assert main(["log", "info", str(tmp_path / "[red]run.csv")]) == 0
    out = capsys.readouterr().out
    assert "[red]run" in out
    assert "[bold]x_m" in out


@pytest.mark.parametrize("program", [["-m", "dmptm_ctrl"], ["-m", "dmptm_ctrl.cli"]])
def test_as_a_program(program):
    done = subprocess.run(
        [sys.executable, *program, "log", "info", "none.csv"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "dmptm: no such file: none.csv\n"


def test_reader_that_goes_away():
    command = f"'{sys.executable}' -m dmptm_ctrl log info '{LOG}' --json | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_import_loads_nothing_heavy():
    """``import dmptm_ctrl`` and ``dmptm --version`` must stay quick."""
    program = (
        "import sys, dmptm_ctrl, dmptm_ctrl.cli; "
        "print([m for m in ('control', 'scipy', 'matplotlib', 'pandas', 'numba', 'pint', 'numpy')"
        " if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


def test_bundled_logs_are_named():
    with pytest.raises(ValueError, match="no bundled logs named 'x'; there are demo_rig, null_rig"):
        data.path("x")
    program = [sys.executable, "-m", "dmptm_ctrl.data"]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(data.path("demo_rig"))
    done = subprocess.run([*program, "x"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "no bundled logs named 'x'; there are demo_rig, null_rig, axis\n"
